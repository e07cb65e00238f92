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
from itertools import compress
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.ground_truth.hyperparameters import LEAST_NOISE
from trajeval_ros.ground_truth.likelihood import Likelihood, Record
from trajeval_ros.ground_truth.models import Grid, Model
from trajeval_ros.ground_truth.regimes import USUAL, Learned, Regime, natural_in

Array = npt.NDArray[np.float64]

# The posterior has several maxima: the best of so many searches is taken.
_SEARCHES = 2
# A search ends when a step gains less than this (nats), or after so many steps.
_LEAST_GAIN = 1e-3
MAX_STEPS = 50
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
# Motions and noises, powers of two, that a segment's regime may have besides the usual ones. It is
# taken where it is so many nats more probable, and the search is made with what was found.
_MOTIONS = (0, *range(-16, -2, 2), 3, 5)
_NOISES = (-2, 2, 4)
_CLEARLY = 10.0
# Noise is sought that is so much larger (of its logarithm) than what was found, by differences of
# the samples up to this order, where the first ones are so many times as large.
_LOUDER, _ORDERS, _RESOLVED = 0.7, 4, 5.0
# They are looked for where a segment's mean square, standardised, is off one by more than this.
_MISFIT = 3.0
# So many times what the samples are spread by a σ may be in any case.
_SPREADS = 3.0
# The regimes are looked for with what the search found, and the search is made anew, so often.
_ROUNDS = 2


class Point:
    """Parameters θ (p,) with their log-posterior, up to a constant."""

    def __init__(
        self,
        model: Model,
        grid: Grid,
        regimes: Sequence[Regime],
        likelihood: Likelihood,
        theta: Array,
    ) -> None:
        """Work out the value alone; ``likelihood``: of sets of records, each in its regime."""
        self.theta = theta
        natural = [model.natural(regime.of(theta), grid) for regime in regimes]
        prior, self._slope, self._prior_curvature = model.log_prior(theta, grid)
        self._jacobians = np.array([jacobian for _, jacobian in natural])
        self._fit = likelihood(np.array([values for values, _ in natural]))
        self.value = self._fit.value + prior

    @cached_property
    def gradient(self) -> Array:
        """The gradient, where the value is finite; (p,)."""
        slopes = self._fit.gradient[:, None] @ self._jacobians
        return np.asarray(self._slope + slopes.sum(axis=(0, 1)))

    @cached_property
    def curvature(self) -> Array:
        """About the negative second derivative, positive semidefinite, likewise; (p, p)."""
        turned = self._jacobians.swapaxes(1, 2) @ self._fit.information @ self._jacobians
        # The information leaves out what the slope adds. In σ and n, every other parameter, only
        # the squares count, and a slope g in their logarithm means a second derivative of 2 g.
        squares = np.zeros(len(self.theta))
        squares[::2] = np.maximum(2.0 * (self._slope - self.gradient)[::2], 0.0)
        return np.asarray(turned.sum(axis=0) + np.diag(self._prior_curvature + squares))


class Posterior:
    """The log-posterior of a model's parameters θ (p,) given records, each in a regime."""

    def __init__(
        self,
        model: Model,
        grid: Grid,
        records: Sequence[Record],
        regimes: Sequence[Regime] | None = None,
    ) -> None:
        """Take at least one record; without ``regimes``, all in the usual one."""
        self._model = model
        self._grid = grid
        self.data = records
        each = regimes or [USUAL] * len(records)
        self._regimes = sorted(set(each))
        sets = [self._regimes.index(regime) for regime in each]
        self._likelihood = Likelihood(model.kernels, records, sets)

    def __call__(self, theta: Array) -> Point:
        """Return what is known at ``theta``."""
        return Point(self._model, self._grid, self._regimes, self._likelihood, theta)

    def value(self, theta: Array) -> float:
        """The log-posterior at ``theta``, up to a constant."""
        found = self.climbed(theta, np.empty((0, 2)), 0)
        return self(theta).value if found is None else found.value

    def climbed(self, start: Array, bounds: Array, steps: int) -> Found | None:
        """So many steps of `maximum` by one call of C; None where it has none of the model."""
        if self._in_c is None:
            return None
        theta, value = start.copy(), np.empty(1)
        climb = np.array([*_DAMPING, _DAMPING_STEP, _HOLD, _LONGEST_STEP, _LEAST_GAIN])
        arguments, room = self._in_c
        loops.call(
            "lesson_climb",
            *arguments,
            np.ascontiguousarray(bounds),
            len(start),
            climb,
            steps,
            theta,
            value,
            np.empty(room),
        )
        return Found(theta, float(value[0]))

    @cached_property
    def _in_c(self) -> tuple[tuple[loops.Argument, ...], int] | None:
        """What the loop is told of the records and the model, and how much room it needs."""
        known = self._likelihood.in_c
        if known is None:
            return None
        records, room = known
        numbers, sets = self._model.numbers(self._grid), len(self._regimes)
        model = (
            np.array(self._regimes),
            sets,
            numbers.weights,
            len(numbers.weights),
            numbers.share,
            numbers.time,
            numbers.prior,
        )
        size = 2 * len(self._model.kernels) + 1
        return (*records, *model), room + sets * size * (size + 2)


class Found(NamedTuple):
    """Where a climb has ended: θ (p,) and the log-posterior there."""

    theta: Array
    value: float


def maximum(posterior: Posterior, start: Array, bounds: Array) -> Found:
    """Climb from ``start`` (p,) to a maximum within ``bounds`` (p, 2)."""
    return posterior.climbed(start, bounds, MAX_STEPS) or climbed(posterior, start, bounds)


def climbed(posterior: Posterior, start: Array, bounds: Array, steps: int = MAX_STEPS) -> Found:
    """`maximum` in NumPy, after so many steps at most."""
    point = posterior(start)
    damping, least, most = _DAMPING
    for _ in range(steps if math.isfinite(point.value) else 0):
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
    return Found(point.theta, point.value)


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
    accuracy: float,
    soft_limit: float,
    before: Array | None = None,
    moving: bool = True,
    neighbours: Sequence[Record | None] = (),
) -> Learned | None:
    """Return what is most probable given ``records``; None without data.

    ``accuracy``: the instrument's, which adds to the learned noise; ``soft_limit``: more noise than
    this is improbable; ``before``: the θ learned from less data, near which alone it then searches.
    Without ``moving`` the records show noise alone, and the motion to come is taken to be common.
    ``neighbours``: of each record, samples that follow each other, which may show less noise than
    is usual; or None.
    """
    enough = [len(record.times) > 3 for record in records]
    records = list(compress(records, enough))
    if not records:
        return None
    grid = Grid.of([r.times for r in records], [r.values for r in records], accuracy, soft_limit)
    floored = [_floored(record, accuracy) for record in records]
    bounds = np.array(model.bounds(grid))
    # Slow motion is as well described by a smaller σ and a shorter length scale, and a larger one
    # would bring noise with it, for round-off, that the instrument does not have.
    largest = math.log(max(_SPREADS * grid.spread, accuracy / LEAST_NOISE))
    bounds[:-1:2, 1] = np.minimum(bounds[:-1:2, 1], largest)
    if moving:
        starts = model.starts(grid) if before is None else [before]
        starts = [np.clip(start, *bounds.T) for start in starts]
    else:
        common = model.common(grid)
        common[-1] = math.log(max(_differences(records, 1)[0], math.exp(bounds[-1, 0])))
        bounds[:-1] = common[:-1, None]
        bounds[-1, 1] = max(bounds[-1, 1], common[-1] + 1.0)
        starts = [common]
    point, regimes = _searched(model, grid, floored, starts, bounds)
    if not math.isfinite(point.value):
        return None
    if before is not None:
        point = _noisier(model, grid, Posterior(model, grid, floored, regimes), point, bounds)
    theta = np.clip(point.theta.round(_DECIMALS), *bounds.T)
    known = list(zip(compress(neighbours, enough), regimes, strict=False))
    close = [_floored(record, accuracy) for record, _ in known if record is not None]
    if close:
        there = [regime for record, regime in known if record is not None]
        theta = _cleaner(model, grid, Posterior(model, grid, close, there), theta, bounds)
    return Learned(model, grid, theta, accuracy, frozenset(regimes))


def _floored(record: Record, accuracy: float) -> Record:
    return Record(record.times, record.values, record.variances + accuracy**2)


def _noisier(model: Model, grid: Grid, records: Posterior, point: Found, bounds: Array) -> Found:
    """Where the search ends, or far above where noise larger than usual is clearly more probable.

    A few segments may take such noise for rough motion, and near what they taught the noise is not
    found again. White noise is no larger than the samples' differences of any order say; motion
    that samples do not resolve looks like it, in differences of every order.
    """
    first, *higher = _differences(records.data, _ORDERS)
    most = max(min([first, *higher]), math.exp(bounds[-1, 0]))
    least = max(math.log(grid.soft_limit), point.theta[-1] + _LOUDER)
    if first < _RESOLVED * most or math.log(most) <= least:
        return point
    starts = [np.clip([*start[:-1], math.log(most)], *bounds.T) for start in model.starts(grid)]
    start = max(starts, key=records.value)
    found = maximum(records, start, bounds)
    is_better = found.theta[-1] > least and found.value > point.value + _CLEARLY
    return found if is_better else point


def _cleaner(model: Model, grid: Grid, neighbours: Posterior, theta: Array, bounds: Array) -> Array:
    """θ with the noise that ``neighbours`` show, where that is less, and less than is usual.

    The motion stays as it is: from neighbours it would learn the noise that is correlated, too. And
    what they show of noise that is usual is the smaller part of it.
    """
    held = bounds.copy()
    held[:-1] = theta[:-1, None]
    found = maximum(neighbours, theta, held)
    cleaner = np.clip(found.theta.round(_DECIMALS), *held.T)
    # The prior of noise that is less than usual rises with it.
    unusual = model.log_prior(cleaner, grid)[1][-1] > 0.0
    return cleaner if unusual and cleaner[-1] < theta[-1] else theta


def nothing(
    model: Model, records: Sequence[Record], accuracy: float, soft_limit: float
) -> Learned | None:
    """What stands where there is nothing to learn from: no motion, and the instrument's noise."""
    records = [record for record in records if len(record.times) > 3]
    if not records:
        return None
    grid = Grid.of([r.times for r in records], [r.values for r in records], accuracy, soft_limit)
    return Learned(model, grid, np.array(model.bounds(grid))[:, 0].round(_DECIMALS), accuracy)


def _searched(
    model: Model, grid: Grid, records: Sequence[Record], starts: Sequence[Array], bounds: Array
) -> tuple[Found, list[Regime]]:
    """The best that is found from ``starts``, and the regime of each record there."""
    regimes = [USUAL] * len(records)
    if len(starts) == 1:
        regimes = _regimes(model, grid, records, starts[0])
    for rounds_left in reversed(range(_ROUNDS)):
        posterior = Posterior(model, grid, records, regimes)
        if len(starts) > _SEARCHES:
            starts = sorted(starts, key=lambda start: -posterior.value(start))[:_SEARCHES]
        found = [maximum(posterior, start, bounds) for start in starts]
        best = max(found, key=lambda point: point.value)
        if not rounds_left or not math.isfinite(best.value):
            break
        again = _regimes(model, grid, records, best.theta)
        if again == regimes:
            break
        regimes, starts = again, [best.theta]
    return best, regimes


def _differences(records: Sequence[Record], orders: int) -> list[float]:
    """The white noise that explains the samples' differences of each order from the first on."""
    orders = min(orders, max(len(record.times) for record in records) - 1)
    found = []
    for order in range(1, orders + 1):
        differences = np.concatenate([np.diff(r.values, order, axis=0).ravel() for r in records])
        square = float(np.mean(differences**2)) / math.comb(2 * order, order)
        found.append(math.sqrt(square))
    return found


def _regimes(model: Model, grid: Grid, records: Sequence[Record], theta: Array) -> list[Regime]:
    """The regime of each record, given what is usual: another one where that does not fit."""
    usual = Likelihood(model.kernels, records)(model.natural(theta, grid)[0])
    misfit = (usual.fits > _MISFIT) | (usual.fits < 1.0 / _MISFIT)
    doubtful = np.flatnonzero(misfit).tolist()
    found = [USUAL] * len(records)
    if not len(doubtful):
        return found

    def values(tried: Sequence[Sequence[Regime]]) -> Array:
        """Of the doubtful records, in so many regimes each; (regimes, records)."""
        regimes = list(dict.fromkeys(regime for row in tried for regime in row))
        sets = [[regimes.index(regime) for regime in row] for row in tried]
        each = [records[i] for i in doubtful]
        fit = Likelihood(model.kernels, each, sets)(natural_in(model, theta, grid, regimes))
        prior = np.array([regime.log_prior for regime in regimes])
        return np.asarray(fit.values.reshape(len(tried), -1) + prior[sets])

    # The motion first, then the noise with it.
    motions = values([[Regime(motion)] * len(doubtful) for motion in _MOTIONS])
    most = [_MOTIONS[i] for i in motions.argmax(axis=0)]
    noises = values([[Regime(motion, noise) for motion in most] for noise in _NOISES])
    both = np.vstack([motions.max(axis=0), noises])
    best = both.argmax(axis=0)
    clear = both.max(axis=0) > usual.values[doubtful] + _CLEARLY
    for i, (record, motion) in enumerate(zip(doubtful, most, strict=True)):
        if clear[i]:
            found[record] = Regime(motion, (0, *_NOISES)[best[i]])
    return found
