# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hyperparameters by maximum a posteriori, one set for many segments.

The likelihood of a segment has its constant mean and its scale integrated out: with
``Π = K⁻¹ - K⁻¹ 1 (1ᵀ K⁻¹ 1)⁻¹ 1ᵀ K⁻¹``, n samples of c coordinates, ``q = tr(xᵀ Π x)``,
``d = c (n - 1)`` and ν degrees of freedom, it is a multivariate Student t,

    log p = log Γ((ν + d)/2) - log Γ(ν/2) - d/2 log(νπ)
            - ½ c (log|K| + log 1ᵀ K⁻¹ 1) - ½ (ν + d) log(1 + q/ν),
    ∂ log p/∂θ = ½ tr((w Π x xᵀ Π - c Π) ∂K/∂θ),   w = (ν + d)/(ν + q)

(``docs/method.md``, Ground truth). One segment with a motion of its own, or with an outlier, does
not carry the others away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack
from scipy.optimize import minimize

from trajeval_ros.ground_truth.hyperparameters import (
    DEGREES_OF_FREEDOM,
    Component,
    GroupHyperparameters,
)
from trajeval_ros.ground_truth.kernels import Kernel
from trajeval_ros.ground_truth.models import Grid, Model

Array = npt.NDArray[np.float64]

# Stands for minus infinity, which the search cannot do with.
_IMPOSSIBLE = 1e10
# The posterior has several maxima: the best of so many searches is taken.
_SEARCHES = 2
_MAX_ITERATIONS = 80
# What is found is rounded to so many decimals of its logarithms, a tenth of a per cent: the data
# say no more, and the search amplifies the last digit of its arithmetic.
_DECIMALS = 3


@dataclass(frozen=True, slots=True)
class Record:
    """What one segment gives to learn from.

    ``times`` (n,) s; ``values`` (n, c); ``variances`` (n,), known ones that add to the noise.
    """

    times: Array
    values: Array
    variances: Array


def log_likelihood(
    kernels: tuple[Kernel, ...], log_parameters: Array, records: Sequence[Record]
) -> tuple[float, Array]:
    """Return the sum of the records' log-likelihoods, and its gradient.

    ``log_parameters`` (2k + 1,): log σ and log l of each of k kernels, and at last log n.
    """
    signals, lengths = np.exp(log_parameters[:-1:2]), np.exp(log_parameters[1:-1:2])
    noise = math.exp(log_parameters[-1]) ** 2
    value, gradient = 0.0, np.zeros(len(log_parameters))
    for record in records:
        apart = np.abs(record.times[:, None] - record.times)
        parts = [
            tuple(s**2 * values for values in k.with_slope(apart / length))
            for k, s, length in zip(kernels, signals, lengths, strict=True)
        ]
        covariance = np.add.reduce([part for part, _ in parts])
        covariance.flat[:: len(apart) + 1] += noise + record.variances
        term, outer = _record_likelihood(covariance, record)
        value += term
        slopes = [np.vdot(outer, m) for part, slope in parts for m in (part, 0.5 * slope)]
        gradient += [*slopes, noise * np.trace(outer)]
    return value, gradient


def _record_likelihood(covariance: Array, record: Record) -> tuple[float, Array]:
    """Return a record's log-likelihood and ``w Π x xᵀ Π - c Π``; (n, n)."""
    count, coordinates = record.values.shape
    lower, info = lapack.dpotrf(covariance, lower=1)
    if info:
        return -math.inf, np.zeros_like(covariance)
    inverse, _ = lapack.dpotri(lower, lower=1)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    weighted = inverse.sum(axis=1)
    information = float(weighted.sum())
    projection = inverse - np.outer(weighted, weighted) / information
    alpha = projection @ record.values
    # Here and below: the last digit of np.vdot, and of np.log of a diagonal, depends on where in
    # memory the arrays lie, and the search would amplify it.
    square, freedom = math.fsum((record.values * alpha).ravel()), coordinates * (count - 1)
    nu = DEGREES_OF_FREEDOM
    log_det = 2.0 * math.fsum(map(math.log, np.diagonal(lower))) + math.log(information)
    value = (
        math.lgamma(0.5 * (nu + freedom))
        - math.lgamma(0.5 * nu)
        - 0.5 * freedom * math.log(nu * math.pi)
        - 0.5 * coordinates * log_det
        - 0.5 * (nu + freedom) * math.log1p(square / nu)
    )
    weight = (nu + freedom) / (nu + square)
    return value, weight * (alpha @ alpha.T) - coordinates * projection


def log_posterior(
    model: Model, grid: Grid, theta: Array, records: Sequence[Record]
) -> tuple[float, Array]:
    """Return the records' log-likelihood plus the model's log-prior, and the gradient in θ."""
    natural, jacobian = model.natural(theta, grid)
    value, gradient = log_likelihood(model.kernels, natural, records)
    prior, slope = model.log_prior(theta, grid)
    return value + prior, jacobian.T @ gradient + slope


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
    bounds = model.bounds(grid)

    def objective(theta: Array) -> tuple[float, Array]:
        value, gradient = log_posterior(model, grid, theta, floored)
        return (-value, -gradient) if math.isfinite(value) else (_IMPOSSIBLE, np.zeros(len(theta)))

    starts = model.starts(grid) if before is None else [before]
    starts = [np.clip(start, *np.transpose(bounds)) for start in starts]
    starts.sort(key=lambda start: objective(start)[0])
    options = {"maxiter": _MAX_ITERATIONS, "ftol": 1e-12}
    searches = (
        minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        for start in starts[:_SEARCHES]
    )
    best = min(searches, key=lambda result: float(result.fun))
    if not best.fun < _IMPOSSIBLE:
        return None
    theta = np.clip(best.x.round(_DECIMALS), *np.transpose(bounds))
    *pairs, noise = (float(v) for v in np.exp(model.natural(theta, grid)[0]))
    components = tuple(map(Component, pairs[::2], pairs[1::2]))
    return GroupHyperparameters(components, math.hypot(noise, noise_std)), theta
