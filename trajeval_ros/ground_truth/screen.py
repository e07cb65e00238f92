# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of single samples, found before these are used.

A sample is suspicious when it lies many times further from the one before than is usual, or repeats
it while the body moves. It is then held back, with those after it, until a few more tell:

- they go on from where the samples before it led: it was an outlier, and costs itself alone;
- they stay with it, turned on the spot as no body can: another body was taken for it, and what
  follows is turned back;
- they stay with it, and no body could have moved so fast, or this one never did (``jumps``): the
  origin has jumped. There the samples are cut, and after a large jump what follows is moved back to
  where the motion, from both sides, goes on; unless they are where the samples began, or had jumped
  to before: then the body was put back there, as where a simulation is reset;
- otherwise it was motion.

What is decided is a function of the samples alone, however they were cut into batches.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth import jumps
from trajeval_ros.ground_truth.bursts import Bursts
from trajeval_ros.ground_truth.faults import Faults
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.ticks import middle, middles

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# What is usual is the median of so many steps before; with fewer than the second nothing is.
_USUAL_STEPS = 32
_FEWEST_STEPS = 8
_USUAL_CHANGES = _USUAL_STEPS - 2
# A step is suspicious beyond so many times the usual one, and so many times the largest of the last
# few, and this many times the instrument's accuracy.
_TIMES_USUAL = 8.0
# m, rad: a smaller jump of the origin is a cut and no more. A batch estimator's ground truth has
# such ones, and its users expect the figures of the samples as they are.
_LEAST_JUMP, _LEAST_TURN = 0.25, np.radians(5.0)
_TIMES_LAST = 3.0
_TIMES_ACCURACY = 10.0
# So long (s), and so many samples at least and at most, are looked ahead.
_AHEAD = 0.1
_FEWEST_AHEAD, _MOST_AHEAD = 2, 10
# The samples after an outlier are nearer to where the motion led, by this factor.
_RETURNED = 0.3
_CLOSELY = 0.1
_FAR = 30.0
# No body does more: m/s² and rad/s².
_ACCELERATIONS = np.array([50.0, 300.0])
# After a jump the steps are this much smaller than it.
_QUIET = 0.2
# The body was put back where it is within twice the usual step. So many places are known, the first
# one of all among them.
_STEPS_BACK, _PLACES = 2.0, 32
# Intervals are even where they are within this factor of the usual one.
_EVEN = 2.0
# How far is told by so many samples on either side at most.
_SIDE = 8
# It is one when it is so many times the instrument's accuracy.
_JUMP = 20.0
# A turn (rad) on the spot by more than this is that of another body; where stamps are uneven, by
# the second.
_FLIP, _FLIP_AT_ANY_TIME = 0.7, 2.0
_TURNED_BACK = 0.2
# A body that moves goes so many usual steps in so many, and repeats nothing. After so long (ns) it
# is taken to rest.
_DIRECTED = 3.0
_DIRECTED_STEPS = 8
_LONGEST_FREEZE = 4_000_000_000
_LEFT = 4.0
# Where samples are rare one is suspicious that is so many times further off the parabola through
# those before it than any of so many before.
_TIMES_OFF, _OFF = 2.0, 8
# So many samples are looked at in one go: those after a suspicious one are looked at again.
_AT_ONCE = 1024


class Screened(NamedTuple):
    """Samples that may be used, and the numbers left out by the code of their fault.

    ``cuts``: the stamps (ns) from which on samples have a moved origin.
    """

    samples: Samples
    rejected: dict[str, int]
    cuts: tuple[int, ...] = ()


class _Place(NamedTuple):
    """Where samples began, or jumped to: a ``pose`` (4, 4) as it came.

    ``back`` (4, 4): what has moved back those that follow; ``before``: those before the jump.
    """

    pose: Array
    back: Array
    before: Array


class _Steps(NamedTuple):
    """From each sample's predecessor to it: ``sizes`` (n, 2) m and rad, ``intervals`` (n,) s."""

    sizes: Array
    intervals: Array

    @staticmethod
    def between(samples: Samples) -> _Steps:
        """The steps from each of the samples to the next."""
        sizes = _apart(samples.poses[:-1], samples.poses[1:])
        return _Steps(sizes, np.diff(samples.stamps) * 1e-9)


class Screen:
    """Decides sample by sample; owner of those that it holds back."""

    def __init__(self, accuracy: tuple[float, float], faults: Faults) -> None:
        """``accuracy``: the instrument's, in translation (m) and rotation (rad)."""
        self._accuracy = np.array(accuracy)
        self._least, self._least_jump = _TIMES_ACCURACY * self._accuracy, _JUMP * accuracy[0]
        self._faults = faults
        self._bursts = Bursts(faults)
        self._before: Samples | None = None  # the last few that were let through
        self._memory = jumps.Memory()
        self._jump: jumps.Jump | None = None
        self._held: Samples | None = None
        self._turn = np.eye(4)
        self._upright = np.eye(4)  # the last pose before it
        self._back = np.eye(4)
        self._is_moved, self._is_turned_back, self._as_they_come = False, False, True
        self._places: list[_Place] = []  # oldest first
        self._left = 0  # the one from which the samples have gone on
        self._cut = False
        self._resting = False

    @property
    def held(self) -> npt.NDArray[np.int64]:
        """Stamps of the samples held back; (n,)."""
        return np.empty(0, dtype=np.int64) if self._held is None else self._held.stamps

    def accept(self, samples: Samples) -> Screened:
        """Take later samples; return those that may pass, of the ones held back as well."""
        samples = self._put_right(samples)
        pending = samples if self._held is None else self._held + samples
        return self._decide(pending, final=False)

    def conclude(self) -> Screened:
        """No more samples will come."""
        pending, self._held = self._held, None
        if pending is None:
            return Screened(_none(), {})
        return self._decide(pending, final=True)

    def _put_right(self, samples: Samples) -> Samples:
        return samples if self._as_they_come else _moved(samples, self._back, self._turn)

    def _decide(self, pending: Samples, *, final: bool) -> Screened:
        passed: list[Samples] = []
        rejected: dict[str, int] = {}
        cuts: list[int] = []
        while len(pending):
            upright = self._first_upright(pending[:_AT_ONCE])
            if upright == 0:
                pending = self._turned_by(pending, np.eye(4))
                passed.append(self._through(pending[:1], cuts))
                pending = pending[1:]
                continue
            count, repeats = self._unsuspicious(pending[:upright])
            if count:
                passed.append(self._through(pending[:count], cuts))
                pending = pending[count:]
                continue
            judge = self._judge_repeats if repeats else self._judge_step
            verdict = judge(pending, final)
            if verdict is None:
                break
            code, number = verdict
            if code == "":
                passed.append(self._through(pending[:number], cuts))
                pending = pending[number:]
            elif code == "turned":
                pending = self._turned_back(pending)
            elif code == "moved":
                self._cut = True
                back = self._way_back(pending, turned=bool(number))
                pending = self._moved_back(pending, back)
                passed.append(self._through(pending[:1], cuts))
                pending = pending[1:]
            else:
                rejected[code] = rejected.get(code, 0) + number
                kind = "outliers" if code == "outlier" else code
                stamps = pending.stamps[:number]
                self._faults.add(kind, int(stamps[0]), int(stamps[-1]), number)
                pending = pending[number:]
        self._held = pending if len(pending) else None
        samples = passed[0] if passed else _none()
        for more in passed[1:]:
            samples = samples + more
        return Screened(samples, rejected, tuple(cuts))

    def _first_upright(self, pending: Samples) -> int:
        """Of samples that are turned back, the first that came as those before the turn; or all.

        However badly the ones between were told, as of a body that has fallen.
        """
        if self._before is None or not self._is_turned_back:
            return len(pending)
        poses = np.concatenate([self._before.poses[-1:], pending.poses])
        came = poses[1:] @ se3.inverse(self._turn)
        away = _apart(poses[:-1], poses[1:])[:, 1] > _FLIP_AT_ANY_TIME
        away &= _apart(self._upright[None], poses[1:])[:, 1] > _FLIP_AT_ANY_TIME
        away &= _apart(self._upright[None], came)[:, 1] < _FLIP
        found = np.flatnonzero(away)
        return int(found[0]) if len(found) else len(pending)

    def _through(self, samples: Samples, cuts: list[int]) -> Samples:
        """Let samples through, and be those before the next; note it where a cut is before them."""
        if self._cut:
            cuts.append(int(samples.stamps[0]))
            self._cut = False
        self._remember(samples)
        return samples

    def _remember(self, samples: Samples) -> None:
        before, most = self._before, _USUAL_STEPS + 1
        if not self._places and len(samples):
            self._places.append(_Place(samples.poses[0], np.eye(4), np.eye(4)))
        if before is not None:
            self._bursts.look(before + samples, len(samples))
        if before is None or len(samples) >= most:
            known = samples[max(len(samples) - most, 0) :]
        else:
            known = before[max(len(before) + len(samples) - most, 0) :] + samples
        self._before = known
        self._memory.add(samples)
        self._faults.passed += len(samples)
        poses = known.poses[-2:]
        self._resting = len(poses) == 2 and self._resting and not _apart(poses[:1], poses[1:]).any()

    def _unsuspicious(self, pending: Samples) -> tuple[int, bool]:
        """Number of samples before the first suspicious one, and whether that one repeats."""
        before = self._before
        if before is None:
            return 1, False
        if loops.there():
            return self._first_suspicious(before, pending)
        steps = _Steps.between(before + pending)
        known, new = len(before) - 1, len(pending)
        sizes = steps.sizes[known:]
        large = self._large(steps.sizes, known)
        large |= self._sudden(before + pending, steps.intervals)
        large |= self._unlike(before + pending, sizes[:, 0])
        enough = np.arange(known, known + new) >= _FEWEST_STEPS
        large &= enough
        repeats = (sizes == 0.0).all(axis=1) & enough
        if self._resting:
            moved = np.flatnonzero(~repeats)
            repeats[: moved[0] if len(moved) else new] = False
        suspicious = np.flatnonzero(large | repeats)
        if not len(suspicious):
            return new, False
        return int(suspicious[0]), bool(repeats[suspicious[0]])

    def _first_suspicious(self, before: Samples, pending: Samples) -> tuple[int, bool]:
        """The same in C, which looks no further."""
        found = np.empty(2, dtype=np.int64)
        loops.call(
            "screen_first",
            np.ascontiguousarray(before.stamps),
            loops.doubles(before.poses),
            len(before),
            np.ascontiguousarray(pending.stamps),
            loops.doubles(pending.poses),
            len(pending),
            int(self._resting),
            _FEWEST_STEPS,
            _USUAL_STEPS,
            _TIMES_USUAL,
            _TIMES_LAST,
            self._least,
            _EVEN,
            jumps.LEAST,
            jumps.LONGEST,
            self._least_jump,
            0.5 * jumps.GAP,
            _TIMES_OFF,
            _OFF,
            np.empty((3, len(before) + len(pending))),
            found,
        )
        count, repeats = found.tolist()
        return count, bool(repeats)

    def _large(self, sizes: Array, known: int) -> Mask:
        """Which steps behind the ``known`` ones are far larger than usual; sizes: (n, 2)."""
        before = np.concatenate([np.zeros((3, 2)), sizes])[known:-1]
        last = np.maximum(np.maximum(before[:-2], before[1:-1]), before[2:])
        limit = np.maximum(_TIMES_LAST * last, self._least)
        above = sizes[known:] > limit
        # What is usual costs more than the rest, and so it is asked for where it matters.
        places = np.flatnonzero(above.any(axis=1))
        padded = np.concatenate([np.full((_USUAL_STEPS, 2), np.nan), sizes])
        windows = np.lib.stride_tricks.sliding_window_view(padded[:-1], _USUAL_STEPS, axis=0)
        usual, _ = _usual(windows[known + places])
        above[places] &= sizes[known + places] > _TIMES_USUAL * usual
        return np.asarray(above.any(axis=1))

    def _sudden(self, samples: Samples, intervals: Array) -> Mask:
        """Which of the samples that are new change their velocity as they never did before.

        Where a body is fast its origin may jump by less than it goes in a step. At irregular stamps
        velocities do not tell.
        """
        assert self._before is not None
        new = len(samples) - len(self._before)
        found = np.zeros(new, dtype=np.bool_)
        if len(samples) < _FEWEST_STEPS + 3:
            return found
        least = self._least[0]
        newest = _changes(samples.poses[-new - 5 :, :3, 3], intervals[-new - 4 :])
        last = np.maximum(np.maximum(newest[:-3], newest[1:-2]), newest[2:-1])
        if not (newest[3:] > np.maximum(_TIMES_LAST * last, least)).any():  # mostly
            return found
        change = np.zeros(len(intervals))
        change[1:] = _changes(samples.poses[:, :3, 3], intervals)
        # Of 33 samples there are 31 changes, and the first is of the two before it.
        change[0] = np.nan
        padded = np.concatenate([np.full(_USUAL_CHANGES, np.nan), change])
        windows = np.lib.stride_tricks.sliding_window_view(padded[:-1], _USUAL_CHANGES)[-new:]
        usual, last = _usual(windows[:, None])
        limit = np.maximum(_TIMES_USUAL * usual[:, 0], _TIMES_LAST * last[:, 0])
        found = change[-new:] > np.maximum(limit, least)
        found[: max(_FEWEST_STEPS + 2 - len(self._before), 0)] = False
        return np.asarray(found)

    def _unlike(self, samples: Samples, moved: Array) -> Mask:
        """Which of the samples that are new are to be compared with all that is remembered.

        After a gap, and where they leave the parabola through the last three as none before.
        """
        assert self._before is not None
        old = len(self._before)
        intervals = np.diff(samples.stamps)
        here = intervals[old - 1 :]
        found = (here >= jumps.LEAST) & (here <= jumps.LONGEST) & (moved > self._least_jump)
        if old < _OFF + 3:
            found[: _OFF + 3 - old] = False
        if not found.any():
            return np.asarray(found)
        last = np.concatenate([here[:1], intervals])[old - 1 : -1]
        first = max(old - _OFF - 3, 0)
        times = (samples.stamps[first:] - samples.stamps[first]) * 1e-9
        off = jumps.errors(times, samples.poses[first:, :3, 3])
        off = np.concatenate([np.full(max(_OFF + 3 - old, 0), np.inf), off])
        largest = np.lib.stride_tricks.sliding_window_view(off[:-1], _OFF).max(axis=1)
        unlike = off[_OFF:] > np.maximum(_TIMES_OFF * largest, self._least_jump)
        return np.asarray(found & (unlike | (here > 0.5 * jumps.GAP * last)))

    def _motion(self) -> tuple[Array, Array, float]:
        """The usual step (2,), the twist of the last samples (6,), the usual interval (s)."""
        assert self._before is not None
        steps = _Steps.between(self._before)
        usual = middles(steps.sizes.T)
        last = self._before[max(len(self._before) - 4, 0) :]
        span = float(last.stamps[-1] - last.stamps[0]) * 1e-9
        first, second = last.poses[0], last.poses[-1]
        twist = np.concatenate(
            [second[:3, 3] - first[:3, 3], se3.log_so3(first[:3, :3].T @ second[:3, :3])]
        )
        return usual, twist / span, middle(steps.intervals)

    def _led_to(self, stamps: npt.NDArray[np.int64]) -> Array:
        """Where the motion before led to; (n, 4, 4)."""
        assert self._before is not None
        _, twist, interval = self._motion()
        last = self._before.poses[-1]
        ahead = np.minimum((stamps - self._before.stamps[-1]) * 1e-9, _MOST_AHEAD * interval)
        poses = np.tile(last, (len(stamps), 1, 1))
        poses[:, :3, 3] += ahead[:, None] * twist[:3]
        poses[:, :3, :3] = last[:3, :3] @ se3.exp_so3(ahead[:, None] * twist[3:])
        return poses

    def _judge_step(self, pending: Samples, final: bool) -> tuple[str, int] | None:
        """Why so many of the next samples are left out, "" for none; None: not known yet."""
        assert self._before is not None
        verdict = self._judge_by_physics(pending, final)
        gap = jumps.interval(self._before, pending)
        if (
            verdict is None
            or verdict[0] not in ("", "moved")
            or not jumps.LEAST <= gap <= jumps.LONGEST
        ):
            return verdict
        # What the body did before knows of smaller ones, and how large they are.
        if not jumps.is_enough(self._before, pending):
            return verdict if final else None
        certain = verdict[0] == "moved"
        self._jump = self._memory.jump(self._before, pending, self._accuracy, certain)
        return verdict if self._jump is None else ("moved", 1)

    def _judge_by_physics(self, pending: Samples, final: bool) -> tuple[str, int] | None:
        """The same by what no body does."""
        assert self._before is not None
        usual, _, interval = self._motion()
        ahead = _ahead(interval)
        seen = pending[: ahead + 1]
        off = _apart(self._led_to(seen.stamps), seen.poses)
        # From the sample before the last: the last may have been stamped late.
        step = max(float(seen.stamps[0] - self._before.stamps[-2]) * 1e-9, interval)
        impossible = 4.0 * off[0] / step**2 > _ACCELERATIONS
        limit = np.maximum(_TIMES_USUAL * usual, self._least)
        large = off[0] > limit
        far = off[0] > np.maximum(_FAR * usual, self._least)
        if not large.any():
            if not impossible[0] or not self._is_sudden(off[0, 0]):
                return "", 1
            if len(seen) <= ahead and not final:
                return None
            return self._judge_jump(seen, off, np.array([True, False]), final)
        share = off[1:, large] / off[0, large]
        near = (share < _RETURNED).all(axis=1) & bool((impossible & large).any())
        near |= (share < _CLOSELY).all(axis=1) & bool((far & large).any())
        if near.any():
            turned = off[0, 1] > _FLIP and not large[0] and self._is_turned(seen)
            return ("flip" if turned else "outlier"), int(np.argmax(near)) + 1
        if len(seen) <= ahead:
            if not final:
                return None
            return ("outlier", 1) if (impossible & large).any() else ("", 1)
        return self._judge_jump(seen, off, impossible & large, final)

    def _is_sudden(self, off: float) -> bool:
        """Whether so much (m) is far more than the velocity's usual changes."""
        assert self._before is not None
        intervals = np.diff(self._before.stamps) * 1e-9
        changes = _changes(self._before.poses[:, :3, 3], intervals)
        return off > _TIMES_USUAL * middle(changes)

    def _is_even(self, samples: Samples) -> bool:
        """Whether stamps are even around the first of the samples: late ones look like jumps."""
        assert self._before is not None
        stamps = np.concatenate([self._before.stamps, samples.stamps[: 1 + _FEWEST_AHEAD]])
        intervals = np.diff(stamps)
        near = intervals[len(self._before) - 3 :] / middle(intervals[: len(self._before) - 1])
        return bool((near < _EVEN).all() and (near > 1.0 / _EVEN).all())

    def _judge_jump(
        self, seen: Samples, off: Array, jumped: Mask, final: bool
    ) -> tuple[str, int] | None:
        """Whether the samples stay where they went, no body's way in ``jumped`` (2,)."""
        if len(seen) <= _FEWEST_AHEAD:
            return ("", 1) if final else None
        # The steps after, or how they differ from those before.
        after = np.minimum(_Steps.between(seen).sizes, self._unexpected(seen))
        quiet = (after < _QUIET * off[0]).all(axis=0)
        jumped = jumped & quiet & (off[0] > _JUMP * self._accuracy)
        if jumped[1] and off[0, 1] > _FLIP and not jumped[0] and self._is_turned(seen):
            return "turned", 0
        if not jumped.any() or not self._is_even(seen):
            return "", 1
        return "moved", int(jumped[1])

    def _is_turned(self, samples: Samples) -> bool:
        """Whether it is another body, whatever stamps say: late ones lead anywhere."""
        assert self._before is not None
        turn = _apart(self._before.poses[-1:], samples.poses[:1])[0, 1]
        return bool(turn > _FLIP_AT_ANY_TIME) or self._is_even(samples)

    def _unexpected(self, seen: Samples) -> Array:
        """By how much each step between samples differs from what the motion before led to."""
        led = self._led_to(seen.stamps)
        moved = np.diff(seen.poses[:, :3, 3] - led[:, :3, 3], axis=0)
        turned = se3.log_so3(np.swapaxes(led[:, :3, :3], 1, 2) @ seen.poses[:, :3, :3])
        return np.stack(
            [np.linalg.norm(each, axis=1) for each in (moved, np.diff(turned, axis=0))], axis=1
        )

    def _way_back(self, pending: Samples, turned: bool) -> Array:
        """From where the samples are to where the motion goes on; (4, 4), in the world.

        If they are not ``turned``, the position alone: what is off the orientation by noise would
        be off the position by metres further on.
        """
        assert self._before is not None
        if self._jump is not None:
            return self._jump.back(pending.poses[0])
        stamp, interval = int(pending.stamps[0]), self._motion()[2]
        # What is known of the samples after it, in whatever batches they came.
        known = pending[: min(_SIDE, _ahead(interval) + 1)]
        there, here = self._led_to(pending.stamps[:1])[0], pending.poses[0]
        back = np.eye(4)
        if turned:
            back[:3, :3] = there[:3, :3] @ here[:3, :3].T
        back[:3, 3] = there[:3, 3] - back[:3, :3] @ here[:3, 3]
        # What is left of the step, by the samples on both sides.
        sides = self._before[max(len(self._before) - _SIDE, 0) :] + replace(
            known, poses=back @ known.poses
        )
        times = (sides.stamps - stamp) * 1e-9
        near = np.abs(times) < max(_AHEAD, (_FEWEST_AHEAD + 1.5) * interval)
        values = np.concatenate(
            [sides.poses[:, :3, 3], se3.log_so3(sides.poses[:, :3, :3] @ there[:3, :3].T)], axis=1
        )
        step = _step(times[near], values[near])
        more = np.eye(4)
        if turned:
            more[:3, :3] = se3.exp_so3(-step[3:])
        more[:3, 3] = there[:3, 3] - step[:3] - more[:3, :3] @ there[:3, 3]
        return np.asarray(more @ back)

    def _moved_back(self, pending: Samples, back: Array) -> Samples:
        """Move the samples by ``back``, those to come as well, if it is far."""
        here, stamp = pending.poses[0], int(pending.stamps[0])
        moved = np.linalg.norm(here[:3, 3] - (back @ here)[:3, 3])
        angle = np.linalg.norm(se3.log_so3(back[:3, :3]))
        self._jump = None
        if moved < _LEAST_JUMP and angle < _LEAST_TURN:
            self._faults.jumped("origin_jump", stamp, float(moved), float(angle))
            self._memory.forget()
            return pending
        came = se3.inverse(self._back) @ here
        place = self._place(came)
        if place is None:
            self._faults.jumped("origin_jump", stamp, float(moved), float(angle))
            before, back = self._back, back @ self._back
            self._places.append(_Place(came, back, before))
            if len(self._places) > _PLACES:
                del self._places[1]
            self._left = len(self._places) - 1
        else:
            # As it was moved back there; if it left the same place, it was put there before, too.
            self._faults.jumped("put_back", stamp, float(moved), float(angle))
            known = self._places[place]
            if place == self._left:
                known = self._places[place] = known._replace(back=known.before)
            back, self._left = known.back, place
            self._memory.forget()
            self._before = None
        more, self._back = back @ se3.inverse(self._back), back
        self._is_moved = bool((back - np.eye(4)).any())
        self._look_how_they_come()
        return replace(pending, poses=more @ pending.poses)

    def _place(self, pose: Array) -> int | None:
        """The known place at which a ``pose`` is, as it came."""
        usual, _, _ = self._motion()
        near = np.maximum(_STEPS_BACK * usual, _JUMP * self._accuracy)
        known = np.stack([place.pose for place in self._places])
        there = np.flatnonzero((_apart(known, pose[None]) < near).all(axis=1))
        return int(there[-1]) if len(there) else None

    def _look_how_they_come(self) -> None:
        self._is_turned_back = bool((self._turn - np.eye(4)).any())
        self._as_they_come = not self._is_turned_back and not self._is_moved

    def _turned_back(self, pending: Samples) -> Samples:
        """Turn the samples to where the motion led, those to come as well."""
        there, here = self._led_to(pending.stamps[:1])[0], pending.poses[0]
        more = np.eye(4)
        more[:3, :3] = here[:3, :3].T @ there[:3, :3]
        if not self._is_turned_back:
            assert self._before is not None
            self._upright = self._before.poses[-1]
        turn = self._turn @ more
        if np.linalg.norm(se3.log_so3(turn[:3, :3])) < _TURNED_BACK:
            turn = np.eye(4)
        return self._turned_by(pending, turn)

    def _turned_by(self, pending: Samples, turn: Array) -> Samples:
        """Turn the samples by this, in the place of what they have been, those to come as well."""
        # As they came, since what is nearly no turn is none.
        pending = _moved(pending, np.eye(4), se3.inverse(self._turn))
        self._turn = turn
        self._look_how_they_come()
        pending = _moved(pending, np.eye(4), turn)
        stamp = int(pending.stamps[0])
        self._faults.add("flip", stamp, stamp)
        return pending

    def _judge_repeats(self, pending: Samples, final: bool) -> tuple[str, int] | None:
        """The same of samples that repeat the one before."""
        assert self._before is not None
        last = self._before.poses[-1]
        same = (pending.poses == last).all(axis=(1, 2))
        same[0] = True  # by so little that no distance and no angle is left
        number = len(pending) if same.all() else int(np.argmin(same))
        if pending.stamps[number - 1] - self._before.stamps[-1] > _LONGEST_FREEZE:
            self._resting = True
            return "", number
        usual, _, _ = self._motion()
        back = self._before[max(len(self._before) - _DIRECTED_STEPS - 1, 0) :]
        net = _apart(back.poses[:1], last[None])[0]
        directed = (net > _DIRECTED * usual) & (net > self._accuracy)
        if not directed.any():
            self._resting = True
            return "", 1
        ended = number < len(pending)
        if not ended:
            if not final:
                return None
            self._resting = True
            return "", number
        gone = _apart(last[None], pending.poses[number : number + 1])[0]
        span = float(pending.stamps[number] - self._before.stamps[-1])
        expected = net / float(back.stamps[-1] - back.stamps[0]) * span
        frozen = (gone > _LEFT * self._accuracy) & directed
        frozen &= (gone > 0.3 * expected) | (gone > 5.0 * usual)
        if frozen.any():
            return "frozen", number
        self._resting = True
        return "", number


def _moved(samples: Samples, back: Array, turn: Array) -> Samples:
    """The samples moved ``back`` in the world and by a ``turn`` on the spot, both (4, 4)."""
    covariances = samples.covariances
    if covariances is not None:
        adjoint = se3.adjoint(se3.inverse(turn))
        covariances = adjoint @ covariances @ adjoint.T
    return replace(samples, poses=back @ samples.poses @ turn, covariances=covariances)


def _ahead(interval: float) -> int:
    """The number of samples that are looked ahead, at so many seconds from one to the next."""
    return min(max(round(_AHEAD / interval), _FEWEST_AHEAD), _MOST_AHEAD)


def _apart(first: Array, second: Array) -> Array:
    """Distance (m) and angle (rad) between poses; (n, 2)."""
    moved = np.linalg.norm(second[:, :3, 3] - first[:, :3, 3], axis=1)
    between = np.swapaxes(first[:, :3, :3], 1, 2) @ second[:, :3, :3]
    return np.stack([moved, np.linalg.norm(se3.log_so3(between), axis=1)], axis=1)


def _changes(positions: Array, intervals: Array) -> Array:
    """By how much each step (n - 1,) differs from the one before at its velocity, m; (n - 2,)."""
    steps = np.diff(positions, axis=0)
    ratio = np.minimum(intervals[1:] / np.maximum(intervals[:-1], 1e-9), _EVEN)
    return np.asarray(np.linalg.norm(steps[1:] - ratio[:, None] * steps[:-1], axis=1))


def _step(times: Array, values: Array) -> Array:
    """The step at time zero (c,) in values (n, c) that are otherwise a parabola over time."""
    scale = max(float(np.abs(times).max()), 1e-9)
    t = times / scale
    order = min(2, max(len(t) - 3, 0))
    columns = [*(t**k for k in range(order + 1)), (t >= 0.0).astype(np.float64)]
    return np.asarray(np.linalg.lstsq(np.stack(columns, axis=1), values, rcond=None)[0][-1])


def _usual(windows: Array) -> tuple[Array, Array]:
    """The median of each window (n, 2, 32), and the largest of its last three; NaN left out."""
    filled = np.isfinite(windows)
    count = filled.sum(axis=-1)
    ordered = np.sort(np.where(filled, windows, np.inf), axis=-1)
    middle = np.maximum(count - 1, 0) // 2
    median = np.take_along_axis(ordered, middle[..., None], axis=-1)[..., 0]
    last = np.where(filled[..., -3:], windows[..., -3:], 0.0).max(axis=-1)
    return np.where(np.isfinite(median), median, 0.0), last


def _none() -> Samples:
    return Samples(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)))
