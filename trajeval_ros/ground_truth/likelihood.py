# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How probable hyperparameters make many segments, the slope of that, and its information.

The likelihood of a segment has its constant mean and its scale integrated out: with
``Π = K⁻¹ - K⁻¹ 1 (1ᵀ K⁻¹ 1)⁻¹ 1ᵀ K⁻¹``, n samples of c coordinates, ``q = tr(xᵀ Π x)``,
``d = c (n - 1)`` and ν degrees of freedom, it is a multivariate Student t,

    log p = log Γ((ν + d)/2) - log Γ(ν/2) - d/2 log(νπ)
            - ½ c (log|K| + log 1ᵀ K⁻¹ 1) - ½ (ν + d) log(1 + q/ν),
    ∂ log p/∂θ = ½ tr((w Π x xᵀ Π - c Π) ∂K/∂θ),   w = (ν + d)/(ν + q)

and with the average information, half-way between the observed and the expected one, which needs
no products of matrices,

    ½ w (tr(xᵀ Π ∂K/∂θ_i Π ∂K/∂θ_j Π x) - tr(xᵀ Π ∂K/∂θ_i Π x) tr(xᵀ Π ∂K/∂θ_j Π x) / (ν + q))

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

from trajeval_ros.ground_truth.hyperparameters import DEGREES_OF_FREEDOM
from trajeval_ros.ground_truth.kernels import Kernel

Array = npt.NDArray[np.float64]

# Records shorter than the longest are filled up with samples so far off (s) that no kernel reaches.
_FAR = 1e9


@dataclass(frozen=True, slots=True)
class Record:
    """What one segment gives to learn from.

    ``times`` (n,) s; ``values`` (n, c); ``variances`` (n,), known ones that add to the noise.
    """

    times: Array
    values: Array
    variances: Array


@dataclass(frozen=True, slots=True)
class _Solution:
    """Of every record, n samples: ``inverse`` K⁻¹, the lower triangles (n, n); ``ones`` K⁻¹ 1 (n,).

    ``information`` 1ᵀ K⁻¹ 1; ``alpha`` Π x (n, c); ``log_det`` of K and of the mean.
    """

    inverse: Array
    ones: Array
    information: Array
    alpha: Array
    log_det: Array


class Likelihood:
    """The sum of the log-likelihoods of many records, as a function of the hyperparameters.

    These are ``log_parameters`` (2k + 1,): log σ and log l of each of k kernels, and at last log n.
    """

    def __init__(self, kernels: tuple[Kernel, ...], records: Sequence[Record]) -> None:
        """Take at least one record; all have the same number of coordinates."""
        self._kernels = kernels
        self._counts = np.array([len(record.times) for record in records])
        size = int(self._counts.max())
        coordinates = records[0].values.shape[1]
        times = np.tile(_FAR * np.arange(1.0, size + 1.0), (len(records), 1))
        self._variances = np.zeros((len(records), size))
        self._right = np.zeros((len(records), size, 1 + coordinates))  # 1 and x; 0 beyond the end
        for row, record in enumerate(records):
            sampled = slice(len(record.times))
            times[row, sampled] = record.times
            self._variances[row, sampled] = record.variances
            self._right[row, sampled, 0] = 1.0
            self._right[row, sampled, 1:] = record.values
        self._coordinates = coordinates
        self._freedom = coordinates * (self._counts - 1)
        # Of symmetric matrices the lower triangle, packed row after row: half the work.
        rows, columns = np.tril_indices(size)
        self._lower = rows * size + columns
        self._diagonal = np.flatnonzero(rows == columns)
        self._unpacked = np.empty((size, size), dtype=np.intp)
        self._unpacked[rows, columns] = self._unpacked[columns, rows] = np.arange(len(rows))
        self._apart = np.abs(times[:, rows] - times[:, columns])

    def __call__(self, log_parameters: Array) -> tuple[float, Array]:
        """Return the log-likelihood and its gradient; minus infinity where K is not definite."""
        parts, noise = self._parts(log_parameters)
        solution = self._solve(parts, noise)
        if solution is None:
            return -math.inf, np.zeros(len(log_parameters))
        nu = DEGREES_OF_FREEDOM
        squares = (self._right[..., 1:] * solution.alpha).sum(axis=(1, 2))
        value = 0.0
        for d, square, log_det in zip(self._freedom, squares, solution.log_det, strict=True):
            value += (
                math.lgamma(0.5 * (nu + d))
                - math.lgamma(0.5 * nu)
                - 0.5 * d * math.log(nu * math.pi)
                - 0.5 * self._coordinates * log_det
                - 0.5 * (nu + d) * math.log1p(square / nu)
            )
        weights = (nu + self._freedom) / (nu + squares)
        ones = solution.ones[..., None] / solution.information[:, None, None]
        left = np.concatenate([weights[:, None, None] * solution.alpha, ones], axis=2)
        right = np.concatenate(
            [solution.alpha, self._coordinates * solution.ones[..., None]], axis=2
        )
        outer = left @ right.swapaxes(1, 2)
        outer -= self._coordinates * solution.inverse
        outer = self._packed(outer)
        trace = float(np.take(outer, self._diagonal, axis=1).sum())
        outer[:, self._diagonal] *= 0.5  # every other entry stands for two
        slopes = [
            s for part, slope in parts for s in (2.0 * np.vdot(outer, part), np.vdot(outer, slope))
        ]
        return float(value), np.array([*slopes, noise * trace])

    def information(self, log_parameters: Array) -> Array:
        """Return the average information, where K is positive definite; (2k + 1, 2k + 1)."""
        parts, noise = self._parts(log_parameters)
        solution = self._solve(parts, noise)
        assert solution is not None
        alpha, ones = solution.alpha, solution.ones[:, :, None]
        slopes = [m for part, slope in parts for m in (2.0 * part, slope)]
        turned = [self._full(slope) @ alpha for slope in slopes]  # ∂K/∂θ Π x
        left = np.concatenate([*turned, 2.0 * noise * alpha], axis=2)
        right = self._full(self._packed(solution.inverse)) @ left
        right -= ones * (ones.swapaxes(1, 2) @ left / solution.information[:, None, None])
        # Records, samples, parameters, coordinates.
        left, right = (m.reshape(*alpha.shape[:2], -1, self._coordinates) for m in (left, right))
        squares = (left * alpha[:, :, None]).sum(axis=(1, 3))  # xᵀ Π ∂K/∂θ Π x
        spread = DEGREES_OF_FREEDOM + (self._right[..., 1:] * alpha).sum(axis=(1, 2))
        weights = 0.5 * (DEGREES_OF_FREEDOM + self._freedom) / spread
        left *= weights[:, None, None, None]
        first = np.einsum("mnic,mnjc->ij", left, right, optimize=True)
        return np.asarray(first - (squares * (weights / spread)[:, None]).T @ squares)

    def _parts(self, log_parameters: Array) -> tuple[list[tuple[Array, Array]], float]:
        """Each kernel's part of K and its slope in log l, packed; and n²."""
        signals, lengths = np.exp(log_parameters[:-1:2]), np.exp(log_parameters[1:-1:2])
        parts = []
        for kernel, signal, length in zip(self._kernels, signals, lengths, strict=True):
            correlation, slope = kernel.with_slope(self._apart * (1.0 / length))
            correlation *= signal**2
            slope *= signal**2
            parts.append((correlation, slope))
        return parts, math.exp(log_parameters[-1]) ** 2

    def _solve(self, parts: list[tuple[Array, Array]], noise: float) -> _Solution | None:
        """Invert every record's K; None where one is not positive definite."""
        covariance = np.add.reduce([part for part, _ in parts])
        covariance[:, self._diagonal] += noise + self._variances
        records, size = self._variances.shape
        flat = np.zeros((records, size * size))
        flat[:, self._lower] = covariance
        inverse = flat.reshape(records, size, size)
        solved, diagonals = np.empty_like(self._right), np.empty((records, size))
        for i, matrix in enumerate(inverse):
            # LAPACK counts by columns: to it this is the upper triangle. It overwrites the matrix.
            factor, info = lapack.dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
            if info:
                return None
            diagonals[i] = factor.diagonal()
            solved[i], _ = lapack.dpotrs(factor, self._right[i], lower=0)
            lapack.dpotri(factor, lower=0, overwrite_c=1)
            if self._counts[i] < size:
                inverse[i, self._counts[i] :] = 0.0
        sampled, ones, alpha = self._right[..., 0], solved[..., 0], solved[..., 1:]
        information = ones.sum(axis=1)
        mean = (ones[..., None] * self._right[..., 1:]).sum(axis=1) / information[:, None]
        alpha = alpha - ones[..., None] * mean[:, None]
        log_det = 2.0 * (sampled * np.log(diagonals)).sum(axis=1) + np.log(information)
        return _Solution(inverse, ones, information, alpha, log_det)

    def _packed(self, matrices: Array) -> Array:
        """The lower triangles of (n, n) each."""
        return np.take(matrices.reshape(len(matrices), -1), self._lower, axis=1, mode="clip")

    def _full(self, packed: Array) -> Array:
        """The symmetric matrices, (n, n) each."""
        return np.take(packed, self._unpacked, axis=1, mode="clip")
