# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hyperparameters by maximum a posteriori, one set for many segments.

The maximum is sought by Newton's method with the average information in place of the actual
curvature, damped after Levenberg and Marquardt.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.hyperparameters import LEAST_NOISE, Component, GroupHyperparameters
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
# Damping: at first, at least, at most; the factor by which it changes; and what a parameter that
# makes no difference is held with.
_DAMPING = (1e-2, 1e-6, 1e6)
_DAMPING_STEP = 5.0
_HOLD = 1e-4
# What is found is rounded to so many decimals of its logarithms, a tenth of a per cent: the data
# say no more, and the search amplifies the last digit of its arithmetic.
_DECIMALS = 3


class Point:
    """Parameters θ (p,) with their log-posterior, up to a constant."""

    def __init__(self, model: Model, grid: Grid, likelihood: Likelihood, theta: Array) -> None:
        """Work out the value alone."""
        self.theta = theta
        natural, self._jacobian = model.natural(theta, grid)
        prior, self._slope, self._prior_curvature = model.log_prior(theta, grid)
        self._fit = likelihood(natural)
        self.value = self._fit.value + prior

    @cached_property
    def gradient(self) -> Array:
        """The gradient, where the value is finite; (p,)."""
        return np.asarray(self._jacobian.T @ self._fit.gradient + self._slope)

    @cached_property
    def curvature(self) -> Array:
        """About the negative second derivative, positive semidefinite, likewise; (p, p)."""
        information = self._jacobian.T @ self._fit.information @ self._jacobian
        # The information leaves out what the slope adds. In σ and n, every other parameter, only
        # the squares count, and a slope g in their logarithm means a second derivative of 2 g.
        squares = np.zeros(len(self.theta))
        squares[::2] = np.maximum(2.0 * (self._slope - self.gradient)[::2], 0.0)
        return np.asarray(information + np.diag(self._prior_curvature + squares))


class Posterior:
    """The log-posterior of a model's parameters θ (p,) given records."""

    def __init__(self, model: Model, grid: Grid, records: Sequence[Record]) -> None:
        """Take at least one record."""
        self._model = model
        self._grid = grid
        self._likelihood = Likelihood(model.kernels, records)

    def __call__(self, theta: Array) -> Point:
        """Return what is known at ``theta``."""
        return Point(self._model, self._grid, self._likelihood, theta)


def maximum(posterior: Posterior, start: Array, bounds: Array) -> Point:
    """Climb from ``start`` (p,) to a maximum within ``bounds`` (p, 2)."""
    point = posterior(start)
    damping, least, most = _DAMPING
    for _ in range(_MAX_STEPS if math.isfinite(point.value) else 0):
        gain = 0.0
        while gain <= 0.0 and damping < most:
            theta = _step(point, damping, bounds)
            step = theta - point.theta
            expected = float(step @ (point.gradient - 0.5 * point.curvature @ step))
            if not expected > 0.0:
                damping *= _DAMPING_STEP
                continue
            further = posterior(theta)
            gain = further.value - point.value
            if gain > 0.5 * expected:
                damping = max(damping / _DAMPING_STEP, least)
            elif not gain > 0.25 * expected:
                damping *= _DAMPING_STEP
        if gain > 0.0:
            point = further
        if gain * (1.0 + damping) < _LEAST_GAIN:
            break
    return point


def _step(point: Point, damping: float, bounds: Array) -> Array:
    """The next θ; parameters that push against a bound stay."""
    low, high = bounds.T
    free = ~((point.theta <= low) & (point.gradient < 0.0))
    free &= ~((point.theta >= high) & (point.gradient > 0.0))
    damped = point.curvature + np.diag(damping * np.diagonal(point.curvature) + _HOLD)
    step = np.zeros(len(point.theta))
    step[free] = np.linalg.solve(damped[np.ix_(free, free)], point.gradient[free])
    step *= min(_LONGEST_STEP / np.abs(step).max(initial=_LONGEST_STEP), 1.0)
    return np.asarray(np.clip(point.theta + step, low, high))


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
    starts = sorted(starts, key=lambda start: -posterior(start).value)[:_SEARCHES]
    best = max((maximum(posterior, start, bounds) for start in starts), key=lambda p: p.value)
    if not math.isfinite(best.value):
        return None
    theta = np.clip(best.theta.round(_DECIMALS), *bounds.T)
    *pairs, noise = (float(v) for v in np.exp(model.natural(theta, grid)[0]))
    components = tuple(map(Component, pairs[::2], pairs[1::2]))
    noise = max(math.hypot(noise, noise_std), LEAST_NOISE * max(pairs[::2]))
    return GroupHyperparameters(components, noise), theta
