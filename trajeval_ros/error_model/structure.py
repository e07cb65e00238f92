# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where a search for a process's parameters begins: by the structure function of the errors.

``D(τ) = ½ E |y(t + τ) - y(t)|²`` on one axis is, of the three processes,

    drift     j² + ½ w² τ
    velocity  j² + ½ w² τ + σ² T² (τ/T - 1 + e^(-τ/T))
    wander    j² + σ² (1 - e^(-τ/T))

so that, at each T, the variances are those of non-negative least squares. The expectations are
clipped means that begin at medians: a lost track is in few of the differences.
"""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.error_model.process import NUMBERS, Kind
from trajeval_ros.error_model.series import Series
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]

# The median of χ² with three degrees of freedom.
_MEDIAN = 2.366
# One in a thousand lies beyond; clipped so often.
_RARE = 16.27
_CLIPPED = 3
# Lags grow by this; the longest is this share of the poses. So many times T are tried.
_GROWTH = 1.6
_LONGEST = 0.25
# Poses that are so many times further apart than their number says have a gap between them.
_GAP = 1.5
_TIMES = 12
# A start has at least this share in variance of what the shortest differences are, for its
# logarithm has no slope at nothing.
_LEAST = 0.03
_STARTS = 2

RULES: Array = np.array(
    [_MEDIAN, _RARE, _CLIPPED, _GROWTH, _LONGEST, _GAP, _LEAST, _STARTS], dtype=np.float64
)
"""These, as `structure.c` takes them, which knows how many times are tried."""


def starts(kind: Kind, series: Series) -> list[Array]:
    """Parameters (p,) to begin at, the likeliest first."""
    if loops.there():
        count, places = series.errors.shape[1], np.empty((_STARTS, 4))
        given = map(loops.doubles, (series.errors, series.intervals, series.variance, RULES))
        how = NUMBERS[kind], count
        some = loops.call("structure_starts", *how, *given, places, np.empty(2 * count))
        return list(places[:some, : len(kind.names)])
    lags, found = structure(series)
    shortest = float(lags[0])
    least = np.array([_LEAST * found[0], 2.0 * _LEAST * found[0] / shortest, 0.0])
    weight = 1.0 / np.maximum(found, 1e-6 * found.max() + 1e-300) / np.sqrt(lags)
    one, half = np.ones_like(lags), 0.5 * lags
    if kind is Kind.DRIFT:
        variances, _ = _nonnegative(np.stack([one, half], axis=-1)[None], found, weight)
        return [0.5 * np.log(np.maximum(variances[0], least[:2]))]
    times = np.geomspace(2.0 * shortest, max(2.0 * lags[-1], 8.0 * shortest), _TIMES)
    h = lags / times[:, None]
    if kind is Kind.VELOCITY:
        risen = times[:, None] ** 2 * (h + np.expm1(-h))
        design = np.stack([one + 0.0 * h, half + 0.0 * h, risen], axis=-1)
    else:
        design = np.stack([one + 0.0 * h, -np.expm1(-h)], axis=-1)
        least = least[[0, 2]]
    variances, cost = _nonnegative(design, found, weight)
    # Something of the process, at the least, as it would be the tenth of what there is.
    least = np.broadcast_to(least, variances.shape).copy()
    least[:, -1] = 0.1 * found[-1] / np.maximum(design[:, -1, -1], 1e-300)
    logs = 0.5 * np.log(np.maximum(variances, least))
    wider = np.concatenate([[np.inf], cost, [np.inf]])
    minima = np.flatnonzero((cost <= wider[:-2]) & (cost <= wider[2:]))
    best = minima[np.argsort(cost[minima])][:_STARTS]
    return [np.array([*logs[i], np.log(times[i])]) for i in best]


def structure(series: Series) -> tuple[Array, Array]:
    """Lags, s, and D there less the ground truth's own variance, not below a share of itself."""
    count = series.errors.shape[1]
    interval = median(series.intervals)
    steps = [1]
    while steps[-1] * _GROWTH < max(_LONGEST * count, 3):
        steps.append(max(steps[-1] + 1, int(steps[-1] * _GROWTH)))
    known = median(series.variance)
    times = np.concatenate([[0.0], np.cumsum(series.intervals)])
    raw = _variances(series.errors, times, np.array(steps), _GAP * interval)
    lags = interval * np.array(steps[: len(raw)], float)
    raw = 0.5 * raw
    return lags, np.maximum(np.maximum(raw - known, 0.1 * raw), 1e-14)


def _variances(errors: Array, times: Array, steps: npt.NDArray[np.int64], gap: float) -> Array:
    """The variance on one axis of the differences over each of so many ``steps``; fewer at the end.

    errors: (3, N). times: (N,), s. gap: as long as a step is at most, s.
    """
    found = np.empty(len(steps))
    if loops.there():
        lengths = loops.doubles(times), steps, gap * steps
        given = loops.doubles(errors), *lengths, _MEDIAN, _RARE, _CLIPPED
        work = np.empty(len(times))
        return found[: loops.call("structure", len(times), len(steps), *given, found, work)]
    for i, lag in enumerate(steps):
        apart = errors[:, lag:] - errors[:, :-lag]
        squares = np.einsum("xn,xn->n", apart, apart)
        squares = squares[times[lag:] - times[:-lag] < gap * lag]
        if not len(squares):
            return found[:i]
        variance = median(squares) / _MEDIAN
        for _ in range(_CLIPPED):
            variance = float(np.minimum(squares, _RARE * variance).mean()) / 3.0
        found[i] = variance
    return found


def _nonnegative(design: Array, values: Array, weight: Array) -> tuple[Array, Array]:
    """Non-negative least squares of each design (m, n, k ≤ 3), and the weighted squares left."""
    scaled, target = design * weight[:, None], values * weight
    normal = np.swapaxes(scaled, 1, 2) @ scaled
    right = scaled.swapaxes(1, 2) @ target
    size = design.shape[2]
    best, cost = np.zeros(design.shape[::2]), np.full(len(design), np.inf)
    if loops.there():
        given = loops.doubles(normal), loops.doubles(right), float(target @ target)
        loops.call("nonnegative", len(design), size, *given, best, cost)
        return best, cost
    for count in range(1, size + 1):
        for chosen in itertools.combinations(range(size), count):
            index = np.array(chosen)
            part = normal[:, index[:, None], index]
            part = part + 1e-12 * np.einsum("mii->m", part)[:, None, None] * np.eye(count)
            solution = np.linalg.solve(part, right[:, index, None])[..., 0]
            rest = float(target @ target) - np.einsum("mi,mi->m", solution, right[:, index])
            better = (solution >= 0.0).all(axis=1) & (rest < cost)
            cost[better] = rest[better]
            best[better] = 0.0
            best[np.ix_(better, index)] = solution[better]
    return best, cost
