# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps of the origin where samples are rare, and within a gap.

There a body could have gone so far, and no bound on accelerations tells a jump from motion. What
tells is the recording: four samples on either side lie on one cubic but for a step between the two
sides, far larger than at any earlier place where the body was about as fast. Over a gap the earlier
places are given a gap as long.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.ticks import middle
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

LEAST, LONGEST = 40_000_000, 4_000_000_000
"""Intervals (ns) between which it is looked for: in shorter ones accelerations tell."""

GAP = 3.0
"""So many times the usual interval is a gap."""

# Samples on either side, and the degree of the polynomial that they share.
_SIDE, _DEGREE = 4, 3
# Of the samples beside a gap one in a quarter of it is looked at.
_TO_A_GAP = 4
# What is remembered: samples at least so far apart (ns), and so many of them.
_SPACING, _MOST = 25_000_000, 2048
# So many of the last ones reach as far back as one side does.
_NEAR = (_SIDE - 1) * LONGEST // _TO_A_GAP // _SPACING + _SIDE
# A jump is so many times the largest step before, and so many times its standard deviation by what
# is left between the samples and the cubic.
_TIMES_LARGEST, _TIMES_STD = 3.0, 8.0
# Where the origin has moved it has turned, too, if the turn is so many times the usual one, and its
# standard deviation.
_TIMES_USUAL = 4.0
# Earlier places count if the body was at least so fast in comparison, as if it had been as fast;
# so many of them, end to end, are enough.
_AS_FAST, _PLACES = 0.3, 8.0
# Their intervals are like the one looked at within this factor.
_LIKE = 0.7
# Usual intervals are usual within this factor.
_EVEN = 2.0
# The body is known to have gone so many times as far as the jump; or it would have to have sped up
# and slowed down like this, m/s².
_KNOWN, _ACCELERATION = 3.0, 10.0
# It was the clock that jumped if so little of the step is left with the gap out of the stamps.
_BY_CLOCK = 0.3


class Jump(NamedTuple):
    """The origin ``turned`` by (3, 3) about the first sample after, and ``moved`` by (3,) m."""

    moved: Array
    turned: Array

    def back(self, pose: Array) -> Array:
        """What moves ``pose`` (4, 4), the first one after it, and those that follow, back."""
        back = np.eye(4)
        back[:3, :3] = self.turned.T
        back[:3, 3] = pose[:3, 3] - self.moved - self.turned.T @ pose[:3, 3]
        return back


@dataclass(frozen=True, slots=True)
class _Places:
    """The samples around each: ``times`` (n, 8), s, and ``poses`` (n, 8, 4, 4)."""

    times: Array
    poses: Array

    def __len__(self) -> int:
        return len(self.times)

    @property
    def positions(self) -> Array:
        """From the last sample before; (n, 8, 3)."""
        points = self.poses[..., :3, 3]
        return np.asarray(points - points[:, _SIDE - 1 : _SIDE])

    @property
    def rotations(self) -> Array:
        """Rotation vectors from the last sample before, in the world; (n, 8, 3)."""
        turns = self.poses[..., :3, :3]
        return se3.log_so3(turns @ np.swapaxes(turns[:, _SIDE - 1 : _SIDE], -1, -2))

    def turned(self, by: Array) -> _Places:
        """With what is after turned by a matrix (3, 3) about its first sample."""
        poses = self.poses.copy()
        after = poses[:, _SIDE:]
        here = after[:, :1, :3, 3].copy()
        after[..., :3, 3] = here + (after[..., :3, 3] - here) @ by.T
        after[..., :3, :3] = by @ after[..., :3, :3]
        return _Places(self.times, poses)

    def later(self, seconds: float) -> _Places:
        """With what is after so much later."""
        times = self.times.copy()
        times[:, _SIDE:] += seconds
        return _Places(times, self.poses)


class _Steps(NamedTuple):
    """Between the sides of places: ``vectors`` (n, 3), ``stds`` (n,) an axis, ``speeds`` (n,)."""

    vectors: Array
    stds: Array
    speeds: Array

    @staticmethod
    def of(times: Array, values: Array, accuracy: float) -> _Steps:
        """Fit cubics with a step to values (n, 8, 3)."""
        t = times - times[:, _SIDE - 1 : _SIDE + 1].mean(axis=1, keepdims=True)
        t = t / np.abs(t).max(axis=1, keepdims=True)
        powers = [t**k for k in range(_DEGREE + 1)]
        q, r = np.linalg.qr(np.stack([*powers, 0.5 * np.sign(t)], axis=-1))
        projected = np.swapaxes(q, 1, 2) @ values
        # The step's row alone: r is triangular.
        scale = r[:, -1, -1]
        vectors = projected[:, -1] / scale[:, None]
        left = ((values - q @ projected) ** 2).sum(axis=(1, 2)) / (3 * (t.shape[1] - _DEGREE - 2))
        stds = np.sqrt(left + accuracy**2) / np.abs(scale)
        sides = np.stack([values[:, _SIDE - 1] - values[:, 0], values[:, -1] - values[:, _SIDE]])
        spans = np.stack([times[:, _SIDE - 1] - times[:, 0], times[:, -1] - times[:, _SIDE]])
        speeds = np.asarray((np.linalg.norm(sides, axis=2) / spans).max(axis=0))
        return _Steps(vectors, stds, speeds)

    @property
    def sizes(self) -> Array:
        """(n,)."""
        return np.asarray(np.linalg.norm(self.vectors, axis=1))

    def is_clear(self, times: float) -> bool:
        """Whether the first one is more than so many times what is left beside it."""
        return bool(self.sizes[0] > times * self.stds[0])

    def is_unusual(self, earlier: _Steps) -> bool:
        """Whether the first one is clear, and larger than most ``earlier`` ones."""
        alike = earlier.speeds >= _AS_FAST * float(self.speeds[0])
        return self.is_clear(_TIMES_USUAL) and bool(
            alike.any() and self.sizes[0] > _TIMES_USUAL * median(earlier.sizes[alike])
        )

    def stands_out(self, earlier: _Steps, enough: float) -> bool:
        """Whether the first one is clear, and far larger than ``earlier`` ones."""
        speed = float(self.speeds[0])
        alike = earlier.speeds >= _AS_FAST * speed
        if not self.is_clear(_TIMES_STD) or np.count_nonzero(alike) < enough:
            return False
        faster = np.maximum(speed / np.maximum(earlier.speeds[alike], 1e-12), 1.0)
        return bool(self.sizes[0] > _TIMES_LARGEST * (faster * earlier.sizes[alike]).max())


class Memory:
    """The last samples, thinned: what the body was seen to do."""

    def __init__(self) -> None:
        """Remember nothing yet."""
        # Written one after the other; when it is full the last ones go to the front.
        self._stamps = np.zeros(2 * _MOST, dtype=np.int64)
        self._poses = np.zeros((2 * _MOST, 4, 4))
        self._count, self._next = 0, -1

    def add(self, samples: Samples) -> None:
        """Remember some of the later samples."""
        chosen = (_apart if loops.there() else _apart_in_numpy)(samples.stamps, self._next)
        while len(chosen):
            if self._count == len(self._stamps):
                for each in (self._stamps, self._poses):
                    each[:_MOST] = each[_MOST:]
                self._count = _MOST
            some, chosen = np.split(chosen, [len(self._stamps) - self._count])
            here = slice(self._count, self._count + len(some))
            self._stamps[here], self._poses[here] = samples.stamps[some], samples.poses[some]
            self._count, self._next = here.stop, int(samples.stamps[some[-1]]) + _SPACING

    def forget(self) -> None:
        """Forget them: what follows has another origin."""
        self._count, self._next = 0, -1

    @property
    def _known(self) -> Samples:
        last = slice(max(self._count - _MOST, 0), self._count)
        return Samples(self._stamps[last], self._poses[last])

    def jump(
        self, before: Samples, after: Samples, accuracy: Array, certain: bool = False
    ) -> Jump | None:
        """The jump from the last sample ``before`` to the first ``after``, if it is one.

        ``after``: as far as `is_enough` asks. ``accuracy``: the samples', m and rad; (2,).
        ``certain``: there is one, and the question is how large; None if that cannot be told.
        """
        gap = interval(before, after)
        known = self._known
        if not len(known) or not LEAST <= gap <= LONGEST or not _is_even(before, after):
            return None
        if known.stamps[-1] < before.stamps[-1]:
            known = known + _bare(before[len(before) - 1 :])
        spacing = _spacing(before, gap)
        near = known[max(len(known) - _NEAR, 0) :] + _bare(after)
        here = _places(near, np.array([min(len(known), _NEAR) - 1]), gap, spacing)
        if not len(here):
            return None
        by = np.eye(3)
        turn = _Steps.of(here.times, here.rotations, accuracy[1])
        move = _Steps.of(here.times, here.positions, accuracy[0])
        if not (certain or turn.is_clear(_TIMES_STD) or move.is_clear(_TIMES_STD)):
            return None
        earlier = _places(known, np.arange(len(known)), gap, spacing)
        enough = _PLACES * float(np.ptp(here.times)) / _pace(known)
        if len(earlier) < enough:
            return None
        turns = _Steps.of(earlier.times, earlier.rotations, accuracy[1])
        if turn.is_unusual(turns):
            by = se3.exp_so3(turn.vectors[0])
            here = here.turned(by.T)
            move = _Steps.of(here.times, here.positions, accuracy[0])
        moves = _Steps.of(earlier.times, earlier.positions, accuracy[0])
        if certain:
            return Jump(move.vectors[0], by)
        if not move.stands_out(moves, enough):
            return None
        # Set down elsewhere, a body that moves little looks the same.
        extent = float(np.linalg.norm(np.ptp(known.poses[:, :3, 3], axis=0)))
        unlikely = 4.0 * move.sizes[0] / (1e-9 * gap) ** 2 > _ACCELERATION
        if extent < _KNOWN * move.sizes[0] and not unlikely:
            return None
        if spacing is not None:
            sooner = here.later(1e-9 * (_usual(before) - gap))
            ran = _Steps.of(sooner.times, sooner.positions, accuracy[0])
            if ran.sizes[0] < _BY_CLOCK * move.sizes[0]:
                return None
        return Jump(move.vectors[0], by)


def _apart(stamps: npt.NDArray[np.int64], begin: int) -> Index:
    """Which of ``stamps`` (n,) to remember, from the first at or after ``begin`` (ns) on."""
    chosen, count = np.empty(len(stamps), dtype=np.int64), np.empty(1, dtype=np.int64)
    stamps = np.ascontiguousarray(stamps)
    loops.call("thinned_by_time", stamps, len(stamps), begin, _SPACING, chosen, count)
    return chosen[: count[0]]


def _apart_in_numpy(stamps: npt.NDArray[np.int64], begin: int) -> Index:
    """The same, one after the other."""
    chosen = []
    for index, stamp in enumerate(stamps.tolist()):
        if stamp >= begin:
            chosen.append(index)
            begin = stamp + _SPACING
    return np.array(chosen, dtype=np.int64)


def interval(before: Samples, after: Samples) -> int:
    """From the last sample before to the first after, ns."""
    return int(after.stamps[0] - before.stamps[-1])


def is_enough(before: Samples, after: Samples) -> bool:
    """Whether ``after`` reaches far enough to tell."""
    if len(after) < _SIDE:
        return False
    spacing = _spacing(before, interval(before, after))
    return spacing is None or bool(after.stamps[-1] - after.stamps[0] >= (_SIDE - 1) * spacing)


def errors(times: Array, positions: Array) -> Array:
    """By how much each position (n, 3) is off the parabola through the three before; (n - 3,).

    ``times`` (n,), increasing.
    """
    t = [times[k : len(times) - 3 + k] for k in range(4)]
    led = np.zeros((len(times) - 3, 3))
    for k in range(3):
        others = [j for j in range(3) if j != k]
        weight = np.prod([(t[3] - t[j]) / (t[k] - t[j]) for j in others], axis=0)
        led += weight[:, None] * positions[k : len(times) - 3 + k]
    return np.asarray(np.linalg.norm(positions[3:] - led, axis=1))


def _usual(before: Samples) -> int:
    """The usual interval, ns."""
    return int(middle(np.diff(before.stamps)))


def _is_even(before: Samples, after: Samples) -> bool:
    """Whether the intervals on both sides are as usual: a late stamp looks like a jump."""
    intervals = np.concatenate([np.diff(before.stamps[-_SIDE:]), np.diff(after.stamps[:_SIDE])])
    usual = _usual(before)
    return bool((intervals < _EVEN * usual).all() and (_EVEN * intervals > usual).all())


def _spacing(before: Samples, gap: int) -> int | None:
    """How far apart samples beside a gap are looked at, ns; None: it is no gap."""
    usual = _usual(before)
    return max(gap // _TO_A_GAP, usual, _SPACING) if gap > GAP * usual else None


def _pace(samples: Samples) -> float:
    """The usual interval, s."""
    return 1e-9 * middle(np.diff(samples.stamps))


def _bare(samples: Samples) -> Samples:
    return Samples(samples.stamps, samples.poses)


def _places(samples: Samples, last: Index, gap: int, spacing: int | None) -> _Places:
    """Those at which the samples ``last`` (n,) are the last before.

    Of consecutive samples at intervals like ``gap``, or with all samples within a gap left out.
    """
    stamps = samples.stamps
    steps = np.arange(_SIDE)
    if spacing is None:
        index = last[:, None] + np.concatenate([steps - _SIDE + 1, steps + 1])
    else:
        back = stamps[last, None] - spacing * steps[::-1]
        on = stamps[last, None] + gap + spacing * steps
        index = np.concatenate(
            [np.searchsorted(stamps, back, "right") - 1, np.searchsorted(stamps, on)], axis=1
        )
    index = index[(index[:, 0] >= 0) & (index[:, -1] < len(stamps))]
    between = stamps[index[:, _SIDE]] - stamps[index[:, _SIDE - 1]]
    like = (np.diff(index, axis=1) > 0).all(axis=1)
    like &= (between > _LIKE * gap) & (between * _LIKE < gap)
    index = index[like]
    times = (stamps[index] - stamps[index[:, :1]]) * 1e-9
    return _Places(times, samples.poses[index])
