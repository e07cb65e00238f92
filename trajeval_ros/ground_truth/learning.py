# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hyperparameters by maximum a posteriori, one set for many segments.

The maximum is sought by Fisher scoring, Newton's method with the expected curvature in place of the
actual one, damped after Levenberg and Marquardt.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.hyperparameters import Component, GroupHyperparameters
from trajeval_ros.ground_truth.likelihood import Likelihood, Record
from trajeval_ros.ground_truth.models import Grid, Model

Array = npt.NDArray[np.float64]

# The posterior has several maxima: the best of so many searches is taken.
_SEARCHES = 2
# A search ends when a step gains less than this (nats), or after so many steps.
_LEAST_GAIN = 1e-3
_MAX_STEPS = 50
# No parameter, a logarithm, changes more than this in one step.
_LONGEST_STEP = 2.0
_DAMPING = (1e-6, 1e6)
# The curvature need not be exact: so many records tell it for all.
_CURVATURE_RECORDS = 4
# What is found is rounded to so many decimals of its logarithms, a tenth of a per cent: the data
# say no more, and the search amplifies the last digit of its arithmetic.
_DECIMALS = 3


class Posterior:
    """The log-posterior of a model's parameters θ (p,) given records."""

    def __init__(self, model: Model, grid: Grid, records: Sequence[Record]) -> None:
        """Take at least one record."""
        self._model = model
        self._grid = grid
        self._likelihood = Likelihood(model.kernels, records)
        some = records[:: -(-len(records) // _CURVATURE_RECORDS)]
        self._share = len(records) / len(some)
        self._likelihood_of_some = Likelihood(model.kernels, some)

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return the log-posterior, up to a constant, and its gradient (p,)."""
        natural, jacobian = self._model.natural(theta, self._grid)
        value, gradient = self._likelihood(natural)
        prior, slope, _ = self._model.log_prior(theta, self._grid)
        return value + prior, jacobian.T @ gradient + slope

    def curvature(self, theta: Array) -> Array:
        """Return about the negative expected second derivative, where it is finite; (p, p)."""
        natural, jacobian = self._model.natural(theta, self._grid)
        information = self._share * self._likelihood_of_some.information(natural)
        *_, prior = self._model.log_prior(theta, self._grid)
        return np.asarray(jacobian.T @ information @ jacobian + np.diag(prior))


@dataclass(frozen=True, slots=True)
class _Point:
    theta: Array
    value: float
    gradient: Array


def maximum(posterior: Posterior, start: Array, bounds: Array) -> _Point:
    """Climb from ``start`` (p,) to a maximum within ``bounds`` (p, 2)."""
    point = _Point(start, *posterior(start))
    damping = 1e-2
    for _ in range(_MAX_STEPS):
        curvature = posterior.curvature(point.theta)
        gain = 0.0
        while gain <= 0.0 and damping < _DAMPING[1]:
            theta = _step(point, curvature, damping, bounds)
            value, gradient = posterior(theta)
            gain = value - point.value
            damping = max(damping / 10.0, _DAMPING[0]) if gain > 0.0 else damping * 10.0
        if gain > 0.0:
            point = _Point(theta, value, gradient)
        if gain < _LEAST_GAIN:
            break
    return point


def _step(point: _Point, curvature: Array, damping: float, bounds: Array) -> Array:
    """The next θ; parameters that push against a bound stay."""
    low, high = bounds.T
    free = ~((point.theta <= low) & (point.gradient < 0.0))
    free &= ~((point.theta >= high) & (point.gradient > 0.0))
    damped = curvature + np.diag(damping * (np.diagonal(curvature) + 1e-3))
    step = np.zeros(len(point.theta))
    step[free] = np.linalg.solve(damped[np.ix_(free, free)], point.gradient[free])
    return np.asarray(
        np.clip(point.theta + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP), low, high)
    )


def learn(
    model: Model,
    records: Sequence[Record],
    noise_std: float,
    soft_limit: float,
    before: Array | None = None,
) -> tuple[GroupHyperparameters, Array] | None:
    """Return the hyperparameters that are most probable given ``records``; None without data.

    ``noise_std``: the instrument's accuracy, which adds to the learned noise; ``soft_limit``: more
    noise than this is improbable; ``before``: the θ learned from less data, near which alone it
    then searches. Also returns θ.
    """
    records = [record for record in records if len(record.times) > 3]
    if not records:
        return None
    grid = Grid.of([r.times for r in records], [r.values for r in records], noise_std, soft_limit)
    floored = [Record(r.times, r.values, r.variances + noise_std**2) for r in records]
    bounds = np.array(model.bounds(grid))
    posterior = Posterior(model, grid, floored)
    starts = np.clip(model.starts(grid) if before is None else [before], *bounds.T)
    starts = sorted(starts, key=lambda start: -posterior(start)[0])[:_SEARCHES]
    best = max((maximum(posterior, start, bounds) for start in starts), key=lambda p: p.value)
    if not math.isfinite(best.value):
        return None
    theta = np.clip(best.theta.round(_DECIMALS), *bounds.T)
    *pairs, noise = (float(v) for v in np.exp(model.natural(theta, grid)[0]))
    components = tuple(map(Component, pairs[::2], pairs[1::2]))
    return GroupHyperparameters(components, math.hypot(noise, noise_std)), theta
