# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hyperparameters by maximum likelihood, one set for many segments.

The likelihood of a segment is the one with its linear mean integrated out (restricted likelihood):
with ``Π = K⁻¹ - K⁻¹ H (Hᵀ K⁻¹ H)⁻¹ Hᵀ K⁻¹`` and n samples of c coordinates,

    log p = -½ tr(xᵀ Π x) - ½ c (log|K| + log|Hᵀ K⁻¹ H| + (n - 2) log 2π), ∂ log p/∂θ = ½ tr((Π x xᵀ
    Π - c Π) ∂K/∂θ)                              (``docs/method.md``, Ground truth).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack
from scipy.optimize import minimize

from trajeval_ros.ground_truth.hyperparameters import GroupHyperparameters
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
    kernel: Kernel, log_parameters: Array, records: Sequence[Record]
) -> tuple[float, Array]:
    """Return the summed restricted log-likelihood and its gradient in ``log (σ, l, n)``, (3,)."""
    signal, length, noise = np.exp(log_parameters)
    value, gradient = 0.0, np.zeros(3)
    for record in records:
        u = np.abs(record.times[:, None] - record.times) / length
        correlation = signal**2 * kernel.correlation(u)
        covariance = correlation.copy()
        covariance.flat[:: len(u) + 1] += noise**2 + record.variances
        term, outer = _restricted(covariance, record)
        value += term
        slope = signal**2 * kernel.scaled_slope(u)
        gradient += [
            np.vdot(outer, correlation),
            0.5 * np.vdot(outer, slope),
            noise**2 * np.trace(outer),
        ]
    return value, gradient


def _restricted(covariance: Array, record: Record) -> tuple[float, Array]:
    """Return a record's log-likelihood and ``Π x xᵀ Π - c Π``; (n, n)."""
    count, coordinates = record.values.shape
    lower, info = lapack.dpotrf(covariance, lower=1)
    if info:
        return -np.inf, np.zeros_like(covariance)
    inverse, _ = lapack.dpotri(lower, lower=1)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    middle = record.times - record.times.mean()
    basis = np.stack([np.ones_like(middle), middle], axis=-1)
    weighted = inverse @ basis
    information = basis.T @ weighted
    projection = inverse - weighted @ np.linalg.solve(information, weighted.T)
    alpha = projection @ record.values
    log_det = 2.0 * np.log(np.diagonal(lower)).sum() + np.linalg.slogdet(information)[1]
    value = -0.5 * (
        np.vdot(record.values, alpha) + coordinates * (log_det + (count - 2) * np.log(2.0 * np.pi))
    )
    return float(value), alpha @ alpha.T - coordinates * projection


def learn(
    kernel: Kernel, records: Sequence[Record], noise_floor: float
) -> GroupHyperparameters | None:
    """Return the hyperparameters that maximise the likelihood of ``records``.

    None without enough data.

    Bounds: ``n`` from ``noise_floor`` up; ``l`` from a third of the median sample interval to twice
    the longest record, beyond which σ and l only act together; ``σ`` from the noise floor to a
    thousand times the data.
    """
    records = [record for record in records if len(record.times) > 3]
    if not records:
        return None
    span = max(float(np.ptp(record.times)) for record in records)
    step = float(np.median(np.concatenate([np.diff(record.times) for record in records])))
    spread = max(
        noise_floor,
        float(np.sqrt(np.mean([np.var(record.values, axis=0).mean() for record in records]))),
    )
    bounds = [
        (np.log(noise_floor), np.log(1e3 * spread)),
        (np.log(step / 3.0), np.log(2.0 * span)),
        (np.log(noise_floor), np.log(max(10.0 * noise_floor, spread))),
    ]
    start = np.array([np.log(spread), np.log(0.5 * span), np.log(2.0 * noise_floor)])
    start = np.clip(start, *np.transpose(bounds))

    def objective(log_parameters: Array) -> tuple[float, Array]:
        value, gradient = log_likelihood(kernel, log_parameters, records)
        return -value, -gradient

    found = minimize(
        objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 60}
    )
    signal, length, noise = (float(v) for v in np.exp(found.x))
    return GroupHyperparameters(signal, length, noise)
