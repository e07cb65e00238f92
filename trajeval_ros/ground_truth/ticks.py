# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps that are only as fine as the ticks of a coarse clock: whole seconds, hundredths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

SECOND = 1_000_000_000
# What clocks tick at, ns: seconds and their parts, schedulers' ticks of 1/64, 1/100 and 1/250 s. A
# millisecond is as fine as stamps need to be.
_TICKS = tuple(
    round(SECOND * tick)
    for tick in (1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.04, 0.025, 0.02, 1 / 64, 0.01, 0.005, 0.004)
)
# A stamp is on a tick to so much (ns): seconds since 1970 in 64 bits, and what was printed.
_EXACTLY = 2_000
# Ticks matter where they are no less than this share of the usual interval.
_MATTERS = 0.05
# So large a share of the intervals are no whole multiples of the usual one ...
_UNEVEN = 0.1
# ... or so large a share are unlike it, while all stamps are within so many ticks of even ones.
_UNLIKE, _EVENLY = 0.05, 1.3
# So many in a row tell whether they are.
_TELLING = 12


def resolutions(blocks: Stamps) -> Stamps:
    """The coarsest ticks (ns) that all of each block (m, n) are on; 0 for ticks without a say."""
    since = blocks - blocks[:, :1]
    least = _MATTERS * middles(np.diff(blocks))
    found = np.zeros(len(blocks), dtype=np.int64)
    ticks = np.array(_TICKS)
    # Where they are not, the first few tell already.
    likely = _on_ticks(since[:, None, :_TELLING], ticks[:, None]) & (ticks >= least[:, None])
    while len(rows := np.flatnonzero(likely.any(axis=1))):
        first = likely[rows].argmax(axis=1)
        likely[rows, first] = False
        on = _on_ticks(since[rows], ticks[first, None])
        found[rows[on]] = ticks[first[on]]
        likely[rows[on]] = False
    return found


def coarsest(stamps: Stamps, usual: float) -> int:
    """The same of stamps in any order, ``usual`` (ns) being the usual interval."""
    since = stamps - stamps[0]
    for tick in _TICKS:
        if tick < _MATTERS * usual:
            break
        if _on_ticks(since[:_TELLING], tick) and _on_ticks(since, tick):
            return tick
    return 0


def _on_ticks(since: Stamps, tick: int | Stamps) -> Mask:
    off = (since + tick // 2) % tick - tick // 2
    return np.asarray((np.abs(off) <= _EXACTLY).all(axis=-1))


def quantised(blocks: Stamps, ticks: Stamps) -> Mask:
    """Which of the blocks (m, n) were rounded to the ticks (m,), ns, of their `resolutions`.

    By their intervals: samples that are whole ticks apart, some of them missing, do not show it.
    """
    found = np.zeros(len(blocks), dtype=np.bool_)
    some = np.flatnonzero(ticks)
    if not len(some):
        return found
    steps = np.rint(np.diff(blocks[some]) / ticks[some, None]).astype(np.int64)
    usual = np.maximum(middles(steps).astype(np.int64), 1)[:, None]
    found[some] = (steps % usual != 0).mean(axis=1) >= _UNEVEN
    unlike = (steps != usual).mean(axis=1) >= _UNLIKE
    for block in some[unlike & ~found[some]].tolist():
        found[block] = float(np.ptp(_off_even(blocks[block]))) <= _EVENLY * ticks[block]
    return found


def on_even_clock(stamps: Sequence[Stamps], tick: int) -> bool:
    """Whether the ``stamps`` (n,) of segments are those of an even clock, rounded to ``tick`` (ns).

    Segments that overlap are looked at as one; those that together are too short tell nothing.
    """
    runs: list[Stamps] = []
    for each in sorted(stamps, key=lambda each: int(each[0])):
        if runs and each[0] <= runs[-1][-1]:
            runs[-1] = np.union1d(runs[-1], each)
        else:
            runs.append(each)
    long = [run for run in runs if len(run) >= _TELLING]
    return bool(long) and all(np.ptp(_off_even(run)) <= _EVENLY * tick for run in long)


def _off_even(stamps: Stamps) -> npt.NDArray[np.float64]:
    """How far ``stamps`` (n,) are off the even ones nearest to them, ns."""
    index, since = np.arange(len(stamps)), stamps - stamps[0]
    return np.asarray(since - np.polyval(np.polyfit(index, since, 1), index))


def whole_seconds(stamps: Stamps) -> bool:
    """Whether all ``stamps`` (n,) are whole seconds."""
    return bool((stamps % SECOND == 0).all())


def middle(values: npt.NDArray[np.int64] | npt.NDArray[np.float64]) -> float:
    """The median: NumPy's takes ten times as long for few."""
    return float(middles(values))


def middles(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """That of each row of (..., n)."""
    ordered, count = np.sort(values), values.shape[-1]
    return np.asarray(0.5 * (ordered[..., (count - 1) // 2] + ordered[..., count // 2]))
