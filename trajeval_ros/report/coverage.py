# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When messages came, in bounded memory: counts over time, and the longest gaps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Stamps = npt.NDArray[np.int64]

SECOND = 1_000_000_000
# So many stamps are looked at together: a look costs the same for one.
_TOGETHER = 2048
_MOST = 1 << 16
# A stamp this far from the one before is believed when the next one confirms it: one message
# stamped 1970 must not stretch the time axis over half a century.
_LEAP = 3600 * SECOND


class Gap(NamedTuple):
    """A stretch without messages, between two stamps in nanoseconds."""

    start: int
    end: int

    @property
    def seconds(self) -> float:
        """Length of the gap."""
        return (self.end - self.start) / SECOND


class Coverage:
    """Counts of one topic's stamps in equal bins of time, and its longest gaps."""

    def __init__(self, capacity: int = 2048, gaps: int = 256, width: int = SECOND // 16) -> None:
        self._capacity = capacity
        self._most_gaps = gaps
        # Bin b holds the stamps with stamp // width == first + b.
        self._width = width
        self._first = 0
        self._counts: Stamps = np.zeros(0, np.int64)
        self._gaps: list[Gap] = []
        self._earliest: int | None = None
        self._latest: int | None = None
        self._last: int | None = None
        self._unconfirmed: int | None = None
        self._waiting: list[Stamps] = []
        self._number_waiting = 0

    def add(self, stamps: Stamps) -> None:
        """Take in stamps as they come, in any order."""
        # Those of a whole run, too, a part at a time.
        for begin in range(0, len(stamps), _MOST):
            some = np.asarray(stamps[begin : begin + _MOST], np.int64)
            self._waiting.append(some)
            self._number_waiting += len(some)
            if self._number_waiting >= _TOGETHER:
                self._take()

    def _take(self) -> None:
        """Look at those that wait."""
        if not self._waiting:
            return
        stamps = np.concatenate(self._waiting)
        self._waiting, self._number_waiting = [], 0
        believed = self._believed(stamps)
        if len(believed) == 0:
            return
        self._count(believed)
        self._find_gaps(believed)

    def _believed(self, stamps: Stamps) -> Stamps:
        if len(stamps) == 0:
            return stamps
        before = stamps[0] if self._last is None else self._last
        # Differences in floating point: int64 ones may overflow on a stamp from a broken header.
        steps = np.abs(np.diff(stamps.astype(np.float64), prepend=np.float64(before)))
        if self._unconfirmed is None and np.all(steps <= _LEAP):
            self._last = int(stamps[-1])
            return stamps
        # One after the other: whether a leap is believed depends on what was believed before it.
        kept = []
        last = int(before)
        for stamp in stamps.tolist():
            near = abs(stamp - last) <= _LEAP
            confirmed = self._unconfirmed is not None and abs(stamp - self._unconfirmed) <= _LEAP
            if near or confirmed:
                kept.append(stamp)
                last = stamp
                self._unconfirmed = None
            else:
                self._unconfirmed = stamp
        self._last = last
        return np.array(kept, np.int64)

    def _count(self, stamps: Stamps) -> None:
        low, high = int(stamps.min()), int(stamps.max())
        if len(self._counts):
            low = min(low, self._first * self._width)
            high = max(high, (self._first + len(self._counts)) * self._width - 1)
        width = self._width
        while high // width - low // width >= self._capacity:
            width *= 2
        first = low // width
        counts = np.zeros(high // width - first + 1, np.int64)
        # Widths are powers of two of the first, so an old bin lies in one new bin.
        old = (self._first + np.arange(len(self._counts))) * self._width // width - first
        np.add.at(counts, old, self._counts)
        np.add.at(counts, stamps // width - first, 1)
        self._width, self._first, self._counts = width, first, counts

    def _find_gaps(self, stamps: Stamps) -> None:
        reached = stamps[0] if self._latest is None else self._latest
        ends = np.maximum.accumulate(np.concatenate([[reached], stamps]))
        steps = np.diff(ends)
        longest = np.argsort(-steps, kind="stable")[: self._most_gaps]
        found = [Gap(int(ends[i]), int(ends[i + 1])) for i in longest if steps[i] > 0]
        candidates = sorted([*self._gaps, *found], key=lambda gap: gap.start - gap.end)
        self._gaps = candidates[: self._most_gaps]
        self._latest = int(ends[-1])
        earliest = int(stamps.min())
        self._earliest = earliest if self._earliest is None else min(self._earliest, earliest)

    @property
    def earliest(self) -> int | None:
        """Smallest stamp, or None before the first one."""
        self._take()
        return self._earliest

    @property
    def latest(self) -> int | None:
        """Largest stamp, or None before the first one."""
        self._take()
        return self._latest

    @property
    def total(self) -> int:
        """Number of stamps taken in."""
        self._take()
        return int(self._counts.sum())

    def rate(self) -> tuple[Stamps, npt.NDArray[np.float64]]:
        """Edges of the bins in nanoseconds, (B + 1,), and the rate in each in hertz, (B,)."""
        self._take()
        bins = np.arange(len(self._counts) + 1, dtype=np.int64)
        edges: Stamps = (self._first + bins) * np.int64(self._width)
        rates = np.asarray(self._counts * (SECOND / self._width), dtype=np.float64)
        return edges, rates

    def gaps(self, longer_than: float) -> list[Gap]:
        """Gaps longer than this many seconds, in time order; the longest ones if there are many."""
        self._take()
        return sorted(
            (gap for gap in self._gaps if gap.seconds > longer_than), key=lambda gap: gap.start
        )
