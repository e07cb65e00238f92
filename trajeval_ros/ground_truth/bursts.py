# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Samples stamped close together after a late one: stamped on arrival, or taken at those times.

Their stamps do not tell, the poses do while the body moves. Over an interval ``τ``, much less than
the usual ``h``, a body of velocity v (of the samples before) goes ``v τ`` if the stamps are right,
and about ``v h`` if they are of arrival. Of the steps d of all bursts, with ``e = v (h - τ)``,

    f = Σ (d - v τ)·e / Σ e·e

is zero or one. Where samples are taken at random intervals, bursts are no fault of theirs.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.ground_truth.faults import Faults
from trajeval_ros.ground_truth.segment import Samples

Array = npt.NDArray[np.float64]

# An interval so much shorter than usual after one so much longer, or after another one.
_BURST, _LATE = 0.2, 1.8
# What is usual is known from so many intervals before, of at least so many.
_USUAL, _FEWEST = 32, 8
# The velocity is that of so many steps, which take no less than this share of the usual time.
_STEPS, _LEAST_TIME = 8, 0.5
# The poses say that stamps are of arrival where f is above this, and above nothing by so many of
# its standard deviations.
_SHARE, _CLEAR = 0.3, 2.5


class Bursts:
    """Counts them, and asks the poses; of translation and rotation each."""

    def __init__(self, faults: Faults) -> None:
        """``faults``: where they are noted."""
        self._faults = faults
        # Of all bursts: (d - v τ)·e, its square, and e·e.
        self._sums = np.zeros((3, 2))

    def look(self, samples: Samples, new: int) -> None:
        """The last ``new`` of ``samples``, beside 33 before them or all that there are."""
        stamps = samples.stamps
        intervals = stamps[1:] - stamps[:-1]
        old = max(len(intervals) - new, _FEWEST)
        new = len(intervals) - old
        if new <= 0:
            return
        after, before = intervals[-new:], intervals[-new - 1 : -1]
        # What is usual costs more than the rest, and is no longer than the longest.
        if not after.min() < _BURST * intervals.max():
            return
        padded = np.concatenate([np.full(_USUAL, np.nan), intervals])
        windows = np.lib.stride_tricks.sliding_window_view(padded[:-1], _USUAL)[old:]
        usual = np.nanmedian(windows, axis=1)
        burst = (after < _BURST * usual) & ((before > _LATE * usual) | (before < _BURST * usual))
        for stamp in stamps[-new:][burst].tolist():
            self._faults.add("stamp_bursts", stamp, stamp)
        if burst.any():
            places = old + np.flatnonzero(burst)
            self._ask(samples, places, usual[burst] * 1e-9)

    def _ask(self, samples: Samples, places: npt.NDArray[np.intp], usual: Array) -> None:
        """What the poses say of the intervals ``places`` (n,), ``usual`` (n,) s long else."""
        known = places > _STEPS
        places, usual = places[known], usual[known]
        times = (samples.stamps - samples.stamps[0]) * 1e-9
        poses = samples.poses
        turns = np.swapaxes(poses[:-1, :3, :3], 1, 2) @ poses[1:, :3, :3]
        steps = np.stack([np.diff(poses[:, :3, 3], axis=0), se3.log_so3(turns)], axis=1)
        gone = np.concatenate([np.zeros((1, 2, 3)), np.cumsum(steps, axis=0)])
        # The samples up to the one before the late one.
        last, first = places - 1, places - 1 - _STEPS
        took = np.maximum(times[last] - times[first], _LEAST_TIME * _STEPS * usual)
        velocity = (gone[last] - gone[first]) / took[:, None, None]
        short = (times[places + 1] - times[places])[:, None, None]
        expected = velocity * (usual[:, None, None] - short)
        told = ((steps[places] - velocity * short) * expected).sum(axis=2)
        self._sums += [told.sum(axis=0), (told**2).sum(axis=0), (expected**2).sum(axis=(0, 2))]
        shares, squares, sizes = self._sums
        self._faults.bursts_told = any(
            share > _CLEAR * math.sqrt(square) and share > _SHARE * size
            for share, square, size in zip(shares, squares, sizes, strict=True)
        )
