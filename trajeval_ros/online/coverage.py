# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much of the run an estimate is there for, in time and along the way; in bounded memory."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_SECOND = 1_000_000_000
# Without a pose for so many of the usual intervals, and for so long (s), an estimate is lost: the
# keyframes of a robot that stands come that rarely, its frames do not.
_INTERVALS = 10.0
_SHORTEST = 1.0
# Intervals are counted by their length, 8 bins an octave: their median is known to 5 %.
_PER_OCTAVE = 8
_BINS = 63 * _PER_OCTAVE
# The longest intervals are kept.
_MOST_INTERVALS = 512
# A way is measured from one point to the next this many standard deviations of a sample away, so
# that a robot that stands goes nowhere; what noise adds to a step of this length is a hundredth.
_STEP = 10.0
_TOGETHER = 256


class _Waiting:
    """Rows that wait for more: so many cost hardly more than one."""

    def __init__(self) -> None:
        self._parts: list[tuple[npt.NDArray[Any], ...]] = []
        self._count = 0

    def add(self, *columns: npt.NDArray[Any]) -> bool:
        """Take rows, (n, ...) of each column; say whether there are enough."""
        self._parts.append(columns)
        self._count += len(columns[0])
        return self._count >= _TOGETHER

    def taken(self) -> list[npt.NDArray[Any]]:
        """The columns of all rows, which wait no longer; none of no rows."""
        parts, self._parts, self._count = self._parts, [], 0
        return [np.concatenate(column) for column in zip(*parts, strict=True)]


class Odometer:
    """The way that a trajectory has gone: its length, and its course in so many points at most."""

    def __init__(self, sample_std: float, capacity: int = 4096) -> None:
        """Start at no point; ``sample_std`` (m): what a position is good to."""
        self._step = _STEP * sample_std
        self._capacity = capacity
        self._stride = 1
        self._count = 0
        self._anchor: Array | None = None
        # Made once: a run's memory does not grow.
        self._stamps = np.zeros(capacity + 1, dtype=np.int64)
        self._lengths = np.zeros(capacity + 1)
        self._positions = np.zeros((capacity + 1, 3))
        self._used = 0
        self._last: tuple[int, Array] | None = None
        self._length = 0.0
        self._waiting = _Waiting()

    @property
    def length(self) -> float:
        """How long it is so far, m."""
        self._take_in()
        return self._length

    def add(self, stamps: Stamps, positions: Array) -> None:
        """Take ``stamps`` (n,), later than all before, and the ``positions`` (n, 3) there."""
        if len(stamps) and self._waiting.add(stamps, positions):
            self._take_in()

    def _take_in(self) -> None:
        waited = self._waiting.taken()
        if not waited:
            return
        stamps, positions = waited
        self._last = int(stamps[-1]), positions[-1].copy()
        if self._anchor is None:
            self._anchor = positions[0].copy()
            self._keep(stamps[:1], np.zeros(1), positions[:1])
        steps = _steps if loops.there() else _steps_in_numpy
        chosen, away = steps(loops.doubles(positions), self._step, self._anchor)
        if len(chosen):
            lengths = np.cumsum(np.concatenate([[self._length], away]))[1:]
            self._length = float(lengths[-1])
            self._keep(stamps[chosen], lengths, positions[chosen])

    def _keep(self, stamps: Stamps, lengths: Array, positions: Array) -> None:
        """Keep one in so many of the next points (n,), and fewer of all where they are too many."""
        begin = 0
        while begin < len(stamps):
            first = begin + -self._count % self._stride
            room = self._capacity + 1 - self._used
            some = slice(first, first + room * self._stride, self._stride)
            end = self._used + len(stamps[some])
            for known, new in zip(self._kept, (stamps, lengths, positions), strict=True):
                known[self._used : end] = new[some]
            self._used = end
            taken = len(stamps)
            if end > self._capacity:
                taken = min(first + (room - 1) * self._stride + 1, taken)
                self._used = (end + 1) // 2
                for known in self._kept:
                    known[: self._used] = known[:end:2].copy()
            self._count += taken - begin
            begin = taken
            if end > self._capacity:
                self._stride *= 2

    @property
    def _kept(self) -> tuple[npt.NDArray[Any], ...]:
        return self._stamps, self._lengths, self._positions

    def way(self) -> Way:
        """The way so far, with the newest point."""
        self._take_in()
        kept = slice(self._used)
        stamps, lengths = self._stamps[kept].copy(), self._lengths[kept].copy()
        positions = self._positions[kept].copy()
        if self._last is not None and self._last[0] > stamps[-1]:
            stamps = np.append(stamps, self._last[0])
            lengths = np.append(lengths, self._length)
            positions = np.concatenate([positions, [self._last[1]]])
        return Way(stamps, lengths, positions)


def _steps(positions: Array, step: float, anchor: Array) -> tuple[Stamps, Array]:
    """Which of ``positions`` (n, 3) are further than ``step`` from the one before, and how far.

    At first from the ``anchor`` (3,), which moves on.
    """
    chosen, away = np.empty(len(positions), dtype=np.int64), np.empty(len(positions))
    count = np.empty(1, dtype=np.int64)
    loops.call("thinned_by_distance", positions, len(positions), step, anchor, chosen, away, count)
    return chosen[: count[0]], away[: count[0]]


def _steps_in_numpy(positions: Array, step: float, anchor: Array) -> tuple[Stamps, Array]:
    """The same, one after the other: how far a sample is depends on where the last step ended."""
    chosen, away = [], []
    x, y, z = anchor.tolist()
    for number, (u, v, w) in enumerate(positions.tolist()):
        # A power of a float that is too large raises, a product is infinite, as in C.
        a, b, c = u - x, v - y, w - z
        distance = math.sqrt(a * a + b * b + c * c)
        if distance > step:
            chosen.append(number)
            away.append(distance)
            x, y, z = u, v, w
    anchor[:] = x, y, z
    return np.array(chosen, dtype=np.int64), np.array(away)


class Way(NamedTuple):
    """``stamps`` (N,) ns, with the ``lengths`` (N,) m up to them and the ``positions`` (N, 3)."""

    stamps: Stamps
    lengths: Array
    positions: Array

    def between(self, begin: int, end: int) -> float:
        """The way from one stamp to another, m."""
        if not len(self.stamps):
            return 0.0
        seconds = (self.stamps - self.stamps[0]) * 1e-9
        asked = (np.array([begin, end]) - self.stamps[0]) * 1e-9
        first, last = np.interp(asked, seconds, self.lengths)
        return float(last - first)


class Presence:
    """When an estimate's poses came."""

    def __init__(self) -> None:
        """Start without a pose."""
        self.first: int | None = None
        self.last: int | None = None
        self._counts = np.zeros(_BINS, dtype=np.int64)
        self._longest: Stamps = np.empty((0, 2), dtype=np.int64)
        self._waiting = _Waiting()
        self._counted: int | None = None  # the newest that does not wait

    def add(self, stamps: Stamps) -> None:
        """Take ``stamps`` (n,) ns, increasing; those that are not later than all before, too."""
        if self.last is not None and len(stamps) and stamps[0] <= self.last:
            self._take_in()
            count = int(np.searchsorted(stamps, self.last, side="right"))
            for stamp in stamps[:count].tolist():
                self._insert(stamp)
            stamps = stamps[count:]
        if not len(stamps):
            return
        self.first = int(stamps[0]) if self.first is None else self.first
        self.last = int(stamps[-1])
        if self._waiting.add(stamps):
            self._take_in()

    def _take_in(self) -> None:
        waited = self._waiting.taken()
        if not waited:
            return
        before = [] if self._counted is None else [np.array([self._counted])]
        ends = np.concatenate([*before, *waited])
        self._counted = int(ends[-1])
        steps = np.diff(ends)
        bins = np.floor(_PER_OCTAVE * np.log2(np.maximum(steps, 1))).astype(np.int64)
        self._counts += np.bincount(np.minimum(bins, _BINS - 1), minlength=_BINS)
        found = np.concatenate([self._longest, np.stack([ends[:-1], ends[1:]], axis=1)])
        order = np.argsort(found[:, 0] - found[:, 1], kind="stable")[:_MOST_INTERVALS]
        self._longest = found[order]

    def _insert(self, stamp: int) -> None:
        """Divide the interval in which a late pose lies, if it is one of the longest."""
        inside = (self._longest[:, 0] < stamp) & (stamp < self._longest[:, 1])
        if inside.any():
            begin, end = self._longest[inside][0].tolist()
            parts = np.array([[begin, stamp], [stamp, end]], dtype=np.int64)
            self._longest = np.concatenate([self._longest[~inside], parts])

    @property
    def usual_interval(self) -> float | None:
        """The median interval, s; None with fewer than two poses."""
        self._take_in()
        total = int(self._counts.sum())
        if not total:
            return None
        middle = int(np.searchsorted(np.cumsum(self._counts), (total + 1) // 2))
        return float(2.0 ** ((middle + 0.5) / _PER_OCTAVE) / _SECOND)

    def losses(self, begin: int, end: int) -> Stamps:
        """The stretches (K, 2) of ``begin`` to ``end`` (ns) without the estimate, in their order.

        What comes before its first pose and after its last counts too.
        """
        if self.first is None or self.last is None:
            return np.array([[begin, end]], dtype=np.int64)
        ends = np.array([[begin, self.first], [self.last, end]], dtype=np.int64)
        self._take_in()
        spans = np.clip(np.concatenate([self._longest, ends]), begin, end)
        least = max(_SHORTEST, _INTERVALS * (self.usual_interval or 0.0))
        lost = spans[(spans[:, 1] - spans[:, 0]) * 1e-9 > least]
        return np.asarray(lost[np.argsort(lost[:, 0], kind="stable")])


def coverage(way: Way, presence: Presence) -> dict[str, object]:
    """The figures ``coverage`` of the summary: of the ground truth's ``way``, what is covered.

    Shares of 1, s and m; None before there is a ground truth with a duration.
    """
    names = ("time", "distance", "duration", "path_length", "lost_time", "lost_distance")
    if len(way.stamps) < 2:
        return {**dict.fromkeys(names), "losses": 0, "longest_loss": None}
    begin, end = int(way.stamps[0]), int(way.stamps[-1])
    losses = presence.losses(begin, end)
    duration, path = (end - begin) * 1e-9, float(way.lengths[-1])
    lost = math.fsum(((losses[:, 1] - losses[:, 0]) * 1e-9).tolist())
    missed = math.fsum(way.between(*loss) for loss in losses.tolist())
    longest = max(losses.tolist(), key=lambda loss: loss[1] - loss[0], default=None)
    return {
        "time": 1.0 - lost / duration,
        "distance": 1.0 - missed / path if path > 0.0 else None,
        "duration": duration,
        "path_length": path,
        "lost_time": lost,
        "lost_distance": missed,
        "losses": len(losses),
        "longest_loss": None
        if longest is None
        else {
            "begin": longest[0],
            "end": longest[1],
            "duration": (longest[1] - longest[0]) * 1e-9,
            "seconds_from_start": (longest[0] - begin) * 1e-9,
        },
    }
