# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hyperparameters by maximum likelihood, one set for many segments.

The likelihood of a segment has its constant mean and its scale integrated out: with ``Π = K⁻¹ - K⁻¹
1 (1ᵀ K⁻¹ 1)⁻¹ 1ᵀ K⁻¹``, n samples of c coordinates, ``q = tr(xᵀ Π x)``, ``d = c (n - 1)``, and ν
degrees of freedom, it is a multivariate Student t,

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

Array = npt.NDArray[np.float64]


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
            (s**2 * k.correlation(apart / length), s**2 * k.scaled_slope(apart / length))
            for k, s, length in zip(kernels, signals, lengths, strict=True)
        ]
        covariance = sum(part for part, _ in parts)
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
    square, freedom = float(np.vdot(record.values, alpha)), coordinates * (count - 1)
    nu = DEGREES_OF_FREEDOM
    log_det = 2.0 * float(np.log(np.diagonal(lower)).sum()) + math.log(information)
    value = (
        math.lgamma(0.5 * (nu + freedom))
        - math.lgamma(0.5 * nu)
        - 0.5 * freedom * math.log(nu * math.pi)
        - 0.5 * coordinates * log_det
        - 0.5 * (nu + freedom) * math.log1p(square / nu)
    )
    weight = (nu + freedom) / (nu + square)
    return value, weight * (alpha @ alpha.T) - coordinates * projection


def learn(
    kernels: tuple[Kernel, ...], records: Sequence[Record], noise_floor: float
) -> GroupHyperparameters | None:
    """Return the hyperparameters that maximise the likelihood of ``records``.

    None without enough data. Bounds: n from ``noise_floor`` up; l from half the median sample
    interval to a minute; σ to a hundred times the spread of the data.
    """
    records = [record for record in records if len(record.times) > 3]
    if not records:
        return None
    step = float(np.median(np.concatenate([np.diff(record.times) for record in records])))
    variance = np.mean([np.var(record.values, axis=0).mean() for record in records])
    spread = max(10.0 * noise_floor, math.sqrt(float(variance)))
    signal_bounds = (math.log(noise_floor), math.log(100.0 * spread))
    length_bounds = (math.log(0.5 * step), math.log(60.0))
    noise_bounds = (math.log(noise_floor), math.log(spread))
    bounds = [*[signal_bounds, length_bounds] * len(kernels), noise_bounds]

    def objective(log_parameters: Array) -> tuple[float, Array]:
        value, gradient = log_likelihood(kernels, log_parameters, records)
        return (-value, -gradient) if math.isfinite(value) else (1e10, np.zeros(len(bounds)))

    starts = [
        np.clip(start, *np.transpose(bounds)) for start in _starts(len(kernels), step, spread)
    ]
    first = min(starts, key=lambda start: objective(start)[0])
    options = {"maxiter": 60}
    found = minimize(objective, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    *kernel_parameters, noise = (float(v) for v in np.exp(found.x))
    components = tuple(
        Component(*pair)
        for pair in zip(kernel_parameters[::2], kernel_parameters[1::2], strict=True)
    )
    return GroupHyperparameters(components, noise)


def _starts(kernels: int, step: float, spread: float) -> list[Array]:
    """Where the search may begin: smooth or rough motion, fast or slow, clean or noisy samples."""
    starts = []
    for length in (4.0 * step, 1.5):
        for rough_length in (6.0 * step, 5.0):
            for noise in (1e-4, 3e-3, 3e-2):
                rough = [math.log(0.15 * spread), math.log(rough_length)] * (kernels - 1)
                starts.append(
                    np.array([math.log(spread), math.log(length), *rough, math.log(noise * spread)])
                )
    return starts
