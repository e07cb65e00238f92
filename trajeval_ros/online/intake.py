# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is let in: finite poses with a rotation, in the order of their stamps.

One that comes after later ones is let in where its owner says that it still has a place.

A pose is judged by itself and by the poses of its own topic that came before, so what is let in
does not depend on how two topics interleave. One wrong stamp must not cost the poses after it: a
stamp that leaps ahead is held back until the next pose tells whether time really went on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.likelihood.gaussian import is_indefinite
from trajeval_ros.online.accounting import Account, Reason
from trajeval_ros.online.axes import AS_GIVEN, turned
from trajeval_ros.online.results import TopicHealth
from trajeval_ros.online.samples import PoseSamples

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Places = npt.NDArray[np.int64]
Late = Callable[[int, int], bool]
"""Whether a pose that came after later ones can still be taken at its stamp (ns); the second is the
stamp of the newest."""

# A stamp further than this (ns) after the one before is held back until it is confirmed ...
LEAP = 500_000_000
# ... or, where no further pose comes at all, believed up to this far.
_LONGEST_LEAP = 3_600_000_000_000
# A first stamp of zero was set where the next comes within this (ns): time that begins at zero.
_LONGEST_FIRST_STEP = 10_000_000_000
LARGEST_COORDINATE = 1e9
_NORM_TOLERANCE = 1e-2
_ZERO_NORM = 1e-6
# Of a norm that is off by so much of what is tolerated, round-off says nothing else.
_SURELY = 0.999


class Accepted(NamedTuple):
    """Checked poses: ``stamps`` (n,) increasing, ``poses`` (n, 4, 4).

    ``covariances`` (n, 6, 6) of the right perturbation, body frame, or None.
    """

    stamps: Stamps
    poses: Array
    covariances: Array | None


class _Arrived(NamedTuple):
    """Poses with their ``places`` (n,) in the order in which the topic's came."""

    samples: PoseSamples
    places: Places

    def where(self, mask: Mask) -> _Arrived:
        return self if mask.all() else _Arrived(_select(self.samples, mask), self.places[mask])


class Intake:
    """The gate of one topic."""

    def __init__(self, use_covariance: bool, axes: str = AS_GIVEN) -> None:
        """Covariances are checked and passed on if ``use_covariance``; ``axes``: of the poses."""
        self.account = Account()
        self._use_covariance = use_covariance
        self._axes = axes
        self._last: int | None = None
        self._held: _Arrived | None = None
        self.first: int | None = None

    @property
    def held(self) -> int:
        """Number of poses held back: 0 or 1."""
        return 0 if self._held is None else 1

    @property
    def last(self) -> int | None:
        """Stamp of the newest pose let in."""
        return self._last

    def health(self, used: int, pending: int) -> TopicHealth:
        """Return the topic's account, with what became of the poses let in."""
        account = self.account
        return TopicHealth(
            account.received,
            used,
            pending,
            account.rejected,
            self.first,
            self.last,
            account.first_rejected,
        )

    def accept(self, samples: PoseSamples, late: Late | None = None) -> Accepted:
        """Return what may pass of the new ``samples``, by stamp; count the rest.

        Without ``late`` none passes that is not later than all before.
        """
        samples = turned(samples, self._axes)
        if self._is_plain(samples):
            self.account.received += len(samples)
            self._let_in(int(samples.stamps[-1]))
            return self._convert(samples)
        places = self.account.received + np.arange(len(samples))
        self.account.received += len(samples)
        valid = np.ones(len(samples), dtype=np.bool_)
        for reason, wrong in self._faults(samples):
            found = places[wrong & valid]
            if len(found):
                self.account.reject(reason, len(found), int(found[0]))
                valid &= ~wrong
        return self._convert(self._in_order(_Arrived(samples, places).where(valid), late))

    def _is_plain(self, samples: PoseSamples) -> bool:
        """Whether all may pass as they are: by one look in C, without which they are asked each."""
        if not loops.there() or self._held is not None or self._last is None or not len(samples):
            return False
        if self._use_covariance and samples.covariances is not None:
            return False
        return bool(
            loops.call(
                "intake_plain",
                np.ascontiguousarray(samples.stamps),
                loops.doubles(samples.positions),
                loops.doubles(samples.quaternions),
                len(samples),
                self._last,
                LEAP,
                LARGEST_COORDINATE,
                _SURELY * _NORM_TOLERANCE,
            )
        )

    @property
    def held_stamp(self) -> int | None:
        """Stamp of the pose held back."""
        return None if self._held is None else int(self._held.samples.stamps[0])

    def confirm(self, now: int) -> Accepted:
        """Let in the pose held back if its stamp is not after ``now`` (ns): it leaps nowhere."""
        stamp = self.held_stamp
        if self._held is None or stamp is None or stamp > now or stamp == 0:
            return self._convert(_NOTHING)
        held, self._held = self._held, None
        self._let_in(stamp)
        return self._convert(held.samples)

    def conclude(self) -> Accepted:
        """No more poses will come: let in the pose held back, unless its stamp is too far off."""
        held, self._held = self._held, None
        if held is None:
            return self._convert(_NOTHING)
        stamp = int(held.samples.stamps[0])
        leap = 0 if self._last is None else stamp - self._last
        if leap > _LONGEST_LEAP:
            self._reject(Reason.STAMP_JUMP, held.places[0])
            return self._convert(_NOTHING)
        self._let_in(stamp)
        return self._convert(held.samples)

    def _faults(self, samples: PoseSamples) -> list[tuple[Reason, Mask]]:
        """Masks (n,) of the poses that are wrong in themselves; the first that applies counts."""
        with np.errstate(over="ignore", invalid="ignore"):
            norm = np.linalg.norm(samples.quaternions, axis=-1)
            values = samples.positions.sum(axis=-1) + samples.quaternions.sum(axis=-1)
            finite = np.isfinite(values) | (
                np.isfinite(samples.positions).all(axis=-1)
                & np.isfinite(samples.quaternions).all(axis=-1)
            )
            faults = [
                (Reason.NON_FINITE, ~finite),
                (Reason.NEGATIVE_STAMP, samples.stamps < 0),
                (
                    Reason.IMPLAUSIBLE_POSITION,
                    (np.abs(samples.positions) > LARGEST_COORDINATE).any(axis=-1),
                ),
                (Reason.ZERO_QUATERNION, norm < _ZERO_NORM),
                (Reason.UNNORMALIZED_QUATERNION, ~(np.abs(norm - 1.0) <= _NORM_TOLERANCE)),
            ]
        if self._use_covariance and samples.covariances is not None:
            faults.append((Reason.INVALID_COVARIANCE, _invalid(samples.covariances)))
        return faults

    def _in_order(self, arrived: _Arrived, late: Late | None) -> PoseSamples:
        """Keep increasing stamps, and late ones that still have a place; hold back a leap."""
        samples, stamps = arrived.samples, arrived.samples.stamps
        if len(stamps) == 0:
            return samples
        if self._held is None and self._last is not None:
            before = np.concatenate([[self._last], stamps[:-1]])
            if ((stamps > before) & (stamps - before <= LEAP)).all():
                self._let_in(int(stamps[-1]))
                return samples
        return self._in_order_one_by_one(arrived, late)

    def _in_order_one_by_one(self, arrived: _Arrived, late: Late | None) -> PoseSamples:
        """The same where something is wrong with the order; those before a pose judge it."""
        held, arrived = self._held, _joined(self._held, arrived)
        samples, places = arrived.samples, arrived.places
        keep: list[int] = []
        kept: set[int] = set()
        waiting = None if held is None else 0
        for i in range(0 if held is None else 1, len(samples)):
            stamp = int(samples.stamps[i])
            if waiting is not None and stamp == samples.stamps[waiting]:
                self._reject(Reason.DUPLICATE_STAMP, places[i])
                continue
            if self._last is not None and stamp <= self._last:
                if stamp == self._last:
                    self._reject(Reason.DUPLICATE_STAMP, places[i])
                elif late is None or stamp in kept or not late(stamp, self._last):
                    self._reject(Reason.OUT_OF_ORDER, places[i])
                else:
                    keep.append(i)
                    kept.add(stamp)
                continue
            if waiting is not None:
                before = int(samples.stamps[waiting])
                if stamp < before and late is not None and self._confirms(stamp, before):
                    keep.append(waiting)
                    kept.add(before)
                    self._let_in(before)
                    waiting = None
                    if late(stamp, before):
                        keep.append(i)
                        kept.add(stamp)
                    else:
                        self._reject(Reason.OUT_OF_ORDER, places[i])
                    continue
                if stamp < before:
                    self._reject(Reason.STAMP_JUMP, places[waiting])
                elif before == 0 and stamp > _LONGEST_FIRST_STEP:
                    self._reject(Reason.ZERO_STAMP, places[waiting])
                else:
                    keep.append(waiting)
                    kept.add(before)
                    self._let_in(before)
                waiting = None
            if self._last is None or stamp - self._last > LEAP:
                waiting = i
            else:
                keep.append(i)
                kept.add(stamp)
                self._let_in(stamp)
        index = np.arange(len(samples))
        self._held = None if waiting is None else arrived.where(index == waiting)
        return _by_stamp(_select(samples, np.isin(index, keep)))

    def _confirms(self, stamp: int, leaped: int) -> bool:
        """Whether a pose that comes after one that ``leaped`` (ns) leaps nearly as far."""
        return self._last is not None and stamp - self._last > LEAP and leaped - stamp <= LEAP

    def _reject(self, reason: Reason, place: np.int64) -> None:
        self.account.reject(reason, 1, int(place))

    def _let_in(self, stamp: int) -> None:
        if self.first is None:
            self.first = stamp
        self._last = stamp

    def _convert(self, samples: PoseSamples) -> Accepted:
        poses = se3.from_position_quaternion(samples.positions, samples.quaternions)
        covariances = None
        if self._use_covariance:
            given = samples.covariances
            given = np.zeros((len(samples), 6, 6)) if given is None else given
            covariances = se3.covariance_from_fixed_axes(_semi_definite(given), poses)
        return Accepted(samples.stamps, poses, covariances)


_NOTHING = PoseSamples(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 4)))


def _invalid(covariances: Array) -> Mask:
    """Not finite, or not positive semi-definite but for round-off."""
    finite: Mask = np.asarray(np.isfinite(covariances).all(axis=(-1, -2)))
    invalid = ~finite
    invalid[finite] = is_indefinite(covariances[finite])
    return invalid


def _semi_definite(covariances: Array) -> Array:
    """The covariances (n, 6, 6) without what round-off made negative of their eigenvalues."""
    symmetric = 0.5 * (covariances + np.swapaxes(covariances, -1, -2))
    values, vectors = np.linalg.eigh(symmetric)
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(vectors, -1, -2))


def _select(samples: PoseSamples, mask: Mask) -> PoseSamples:
    if mask.all():
        return samples
    covariances = None if samples.covariances is None else samples.covariances[mask]
    return PoseSamples(
        samples.stamps[mask], samples.positions[mask], samples.quaternions[mask], covariances
    )


def _by_stamp(samples: PoseSamples) -> PoseSamples:
    if (samples.stamps[1:] > samples.stamps[:-1]).all():
        return samples
    order = np.argsort(samples.stamps)
    covariances = None if samples.covariances is None else samples.covariances[order]
    return PoseSamples(
        samples.stamps[order], samples.positions[order], samples.quaternions[order], covariances
    )


def _joined(held: _Arrived | None, arrived: _Arrived) -> _Arrived:
    if held is None:
        return arrived
    first, second = held.samples, arrived.samples
    covariances = None
    if first.covariances is not None or second.covariances is not None:
        parts = [
            np.zeros((len(part), 6, 6)) if part.covariances is None else part.covariances
            for part in (first, second)
        ]
        covariances = np.concatenate(parts)
    samples = PoseSamples(
        np.concatenate([first.stamps, second.stamps]),
        np.concatenate([first.positions, second.positions]),
        np.concatenate([first.quaternions, second.quaternions]),
        covariances,
    )
    return _Arrived(samples, np.concatenate([held.places, arrived.places]))
