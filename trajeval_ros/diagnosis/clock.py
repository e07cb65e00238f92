# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An offset between the two clocks: by angular speed, which no frame changes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.diagnosis.cause import Cause, too_early
from trajeval_ros.diagnosis.rotations import FEWEST, SECOND, Array, Stamps, between, pairs
from trajeval_ros.median import median

# Offsets of the clocks: looked for up to, named from, and only where angular speeds correlate this
# well and what the correlation lacks of 1 falls to this share.
_LONGEST_OFFSET = 3.0
_SHORTEST_OFFSET = 0.03
_CORRELATION = 0.7
_CORRELATION_LACK = 0.3
# Angular speeds that spread by less (rad/s) are one.
_STEADY = 1e-9


def clock_offset(
    stamps: Stamps, ground_truth: Array, estimate: Array, applied: float
) -> tuple[Cause, ...]:
    """An offset between the two clocks, from the angular speeds.

    ``applied`` (s) has been added to the estimate's stamps already.
    """
    step = median(np.diff(stamps)) / SECOND
    if not 0.0 < step <= 0.25:
        return ()
    count = int((stamps[-1] - stamps[0]) / SECOND / step)
    longest = int(_LONGEST_OFFSET / step)
    if not 4 * longest < count < 1_000_000:
        return ()
    first, second = pairs(stamps, 3 * step)
    if len(first) < FEWEST:
        return ()
    middle = (stamps[first] + stamps[second] - 2 * stamps[0]) / (2.0 * SECOND)
    length = (stamps[second] - stamps[first]) / SECOND
    grid = np.arange(count) * step
    truth, other = (
        np.interp(grid, middle, np.linalg.norm(between(r, first, second), axis=1) / length)
        for r in (ground_truth, estimate)
    )
    # Where nothing was scored, interpolation is no evidence.
    scored = np.abs(grid - middle[np.searchsorted(middle[:-1], grid)]) < 2 * step
    lags = np.arange(-longest, longest + 1)
    correlation = np.array([_correlation(truth, other, scored, int(lag)) for lag in lags])
    best = int(np.argmax(correlation))
    if not 0 < best < len(lags) - 1:
        return ()
    # The vertex of the parabola through the best lag and its neighbours.
    before, here, after = correlation[best - 1 : best + 2]
    bend = before - 2 * here + after
    vertex = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    offset = float(lags[best] + vertex) * step
    lack = (1.0 - here) / max(1.0 - correlation[longest], 1e-3)
    if abs(offset) < _SHORTEST_OFFSET or here < _CORRELATION or lack > _CORRELATION_LACK:
        return ()
    whole = applied + offset
    known = f" (estimate.time_offset is {applied:g})" if applied else ""
    return (
        Cause(
            "clock_offset",
            f"{too_early(whole, 3)}{known}: the angular speeds correlate to"
            f" {here:.3f} when {whole:+.3f} s are added to them,"
            f" to {correlation[longest]:.3f} as they stand",
            f"set estimate.time_offset={whole:.3f}",
        ),
    )


def _correlation(truth: Array, other: Array, scored: npt.NDArray[np.bool_], lag: int) -> float:
    """Correlation of the estimate with the ground truth ``lag`` steps later."""
    count = len(truth)
    here = slice(max(0, -lag), min(count, count - lag))
    there = slice(max(0, lag), min(count, count + lag))
    both = scored[here] & scored[there]
    a, b = other[here][both], truth[there][both]
    if len(a) < FEWEST or min(a.std(), b.std()) < _STEADY:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])
