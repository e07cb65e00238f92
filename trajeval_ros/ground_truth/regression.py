# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gaussian-process regression of a few coordinates over time, grown sample by sample.

The model of each coordinate is ``x(t) = h(t)ᵀβ + f(t) + noise`` with ``h(t) = (1, t)``, an unknown
mean β under a nearly flat prior, and ``f ~ GP(0, σ² ρ)``. With the Cholesky factor ``K = L Lᵀ`` of
the samples' covariance, ``z = L⁻¹ x``, ``G = L⁻¹ H`` and ``v = L⁻¹ k(t)``, all three truncated to
the first n rows,

    A_n = P⁻¹ + Gᵀ G,   β_n = A_n⁻¹ Gᵀ z,   r = h(t) - Gᵀ v, m(t) = vᵀ z + rᵀ β_n,   P(t) = σ² - vᵀ
    v + rᵀ A_n⁻¹ r                  (``docs/method.md``, Ground truth)

is the posterior given the first n samples: the leading block of a Cholesky factor is the factor of
the leading block, so a truncated answer costs no new factorisation.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from trajeval_ros.ground_truth.hyperparameters import GroupHyperparameters
from trajeval_ros.ground_truth.kernels import Kernel

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]

# The posterior variance is a small difference of large numbers, so its last digits show how the
# arithmetic was ordered. To give the same digits however the samples and the queries were cut into
# batches, every BLAS and LAPACK call below has a shape that depends on the position in the segment
# alone: rows in blocks, queries in panels.
_BLOCK = 32
_PANEL = 8

# Standard deviation of the mean's offset, in units of σ, and of its slope, in units of σ/l: flat
# beside the data.
_FLAT = 1e3


def _rounded_up(count: int) -> int:
    """The smallest of 32, 64, 128, ... that holds ``count`` rows."""
    return _BLOCK << max(0, (max(count, 1) - 1) // _BLOCK).bit_length()


class Regression:
    """The posterior of several coordinates that share kernel, hyperparameters and noise."""

    def __init__(
        self, kernel: Kernel, hyperparameters: GroupHyperparameters, coordinates: int
    ) -> None:
        """Start without samples."""
        self._kernel = kernel
        self._variance = hyperparameters.signal_std**2
        self._length = hyperparameters.length_scale
        flat = _FLAT * hyperparameters.signal_std
        self._mean_precision = np.diag([flat**-2, (flat / self._length) ** -2])
        self._count = 0
        self._times = np.empty(0)
        self._factor = np.empty((0, 0))
        self._white = np.empty((0, coordinates + 2))
        self._moments = np.empty((0, 2, coordinates + 2))

    @property
    def count(self) -> int:
        """Number of samples conditioned on."""
        return self._count

    def extend(self, times: Array, values: Array, noise: Array) -> None:
        """Condition on all samples so far; those known already must lead.

        ``times`` (n,) seconds, increasing; ``values`` (n, c); ``noise`` (n,) variances.
        """
        total = len(times)
        self._reserve(_rounded_up(total))
        first = self._count // _BLOCK * _BLOCK
        for start in range(first, total, _BLOCK):
            stop = min(start + _BLOCK, total)
            self._factor_block(start, times[start:stop], values[start:stop], noise[start:stop])
        self._count = total

    def _reserve(self, rows: int) -> None:
        old = len(self._times)
        if rows <= old:
            return
        grow = rows - old
        factor = np.eye(rows, order="F")
        factor[:old, :old] = self._factor
        self._factor = factor
        self._times = np.concatenate([self._times, np.zeros(grow)])
        self._white = np.concatenate([self._white, np.zeros((grow, self._white.shape[1]))])
        self._moments = np.concatenate([self._moments, np.zeros((grow, *self._moments.shape[1:]))])

    def _factor_block(self, start: int, times: Array, values: Array, noise: Array) -> None:
        """Write rows ``start`` to ``start + 32`` of the factor.

        Rows without a sample are rows of the identity.
        """
        here, size = slice(start, start + _BLOCK), len(times)
        self._times[start : start + size] = times
        right = np.zeros((_BLOCK, self._white.shape[1]))
        right[:size, 0], right[:size, 1], right[:size, 2:] = 1.0, times, values
        block = np.eye(_BLOCK)
        block[:size, :size] = self._covariance(times, times)
        block[np.arange(size), np.arange(size)] += noise
        if start:
            cross = np.zeros((start, _BLOCK), order="F")
            cross[:, :size] = self._covariance(self._times[:start], times)
            white = _solve(self._factor[:start, :start], cross)
            block -= white.T @ white
            right -= white.T @ self._white[:start]
            self._factor[here, :start] = white.T
        lower, info = lapack.dpotrf(block, lower=1)
        if info:
            raise np.linalg.LinAlgError("the covariance of the samples is not positive definite")
        self._factor[here, here] = lower
        self._white[here] = _solve(lower, right)
        terms = np.einsum("ni,nj->nij", self._white[here, :2], self._white[here])
        if start:
            terms[0] += self._moments[start - 1]
        else:
            terms[0, :, :2] += self._mean_precision
        self._moments[here] = np.cumsum(terms, axis=0)

    def _covariance(self, first: Array, second: Array) -> Array:
        """``k(first_i, second_j)``; (len(first), len(second))."""
        u = np.abs(first[:, None] - second) / self._length
        return self._variance * self._kernel.correlation(u)

    def posterior(self, times: Array, counts: Counts) -> tuple[Array, Array]:
        """Return mean (q, c) and variance (q,), given the first ``counts`` (q,) >= 1 samples."""
        white, reduced = self._whitened(times, counts)
        solved, answer = self._mean_weights(reduced[:, :2], counts)
        variance = self._variance - _column_sums(white * white)[: len(times)]
        variance += np.einsum("qi,qi->q", reduced[:, :2], solved)
        mean = np.einsum("qi,qic->qc", reduced[:, :2], answer) + reduced[:, 2:]
        return mean, variance

    def covariance(self, times: Array, counts: Counts) -> Array:
        """Return the posterior covariance (q, q), each pair given the larger of its two sets.

        The later error is orthogonal to all that the earlier answer knew, so that is the covariance
        of the errors.
        """
        cap = int(counts.max(initial=0))
        full = np.full(len(times), cap, dtype=np.intp)
        white, _ = self._whitened(times, full)
        pair = np.maximum(counts[:, None], counts)
        result = self._covariance(times, times)
        for count in np.unique(pair):  # few: the counts of neighbouring queries
            rows = white[:count, : len(times)]
            basis = np.stack([np.ones_like(times), times], axis=-1)
            basis = basis - rows.T @ self._white[:count, :2]
            solved = np.linalg.solve(self._moments[count - 1, :, :2], basis.T)
            update = basis @ solved - rows.T @ rows
            chosen = pair == count
            result[chosen] += update[chosen]
        return result

    def _whitened(self, times: Array, counts: Counts) -> tuple[Array, Array]:
        """``v`` (rows, panels of q), zero from row ``counts`` on, and ``(r, vᵀz)`` (q, 2 + c)."""
        rows = _rounded_up(int(counts.max(initial=0)))
        white = np.zeros((rows, -(-len(times) // _PANEL) * _PANEL))
        for size in np.unique([_rounded_up(int(c)) for c in np.unique(counts)]):
            chosen = np.flatnonzero(
                (counts <= size) & (counts > (size // 2 if size > _BLOCK else 0))
            )
            panel = np.zeros((size, -(-len(chosen) // _PANEL) * _PANEL), order="F")
            panel[:, : len(chosen)] = self._covariance(self._times[:size], times[chosen])
            panel = _solve(self._factor[:size, :size], panel)
            white[:size, chosen] = panel[:, : len(chosen)]
        white[:, : len(times)][np.arange(rows)[:, None] >= counts] = 0.0
        columns = self._white[:rows].T
        reduced = np.stack([_column_sums(white * column[:, None]) for column in columns], axis=-1)
        reduced = reduced[: len(times)]
        reduced[:, 0] = 1.0 - reduced[:, 0]
        reduced[:, 1] = times - reduced[:, 1]
        return white, reduced

    def _mean_weights(self, r: Array, counts: Counts) -> tuple[Array, Array]:
        """``A_n⁻¹ r`` (q, 2) and ``β_n`` (q, 2, c), by Cramer's rule on the 2x2 system."""
        moments = self._moments[counts - 1]
        (a, b), d = moments[:, 0, :2].T, moments[:, 1, 1]
        determinant = (a * d - b * b)[:, None]
        solved = np.stack([d * r[:, 0] - b * r[:, 1], a * r[:, 1] - b * r[:, 0]], -1) / determinant
        top, bottom = moments[:, 0, 2:], moments[:, 1, 2:]
        beta = np.stack(
            [d[:, None] * top - b[:, None] * bottom, a[:, None] * bottom - b[:, None] * top], 1
        )
        return solved, beta / determinant[:, None]


def _column_sums(values: Array) -> Array:
    """Sum over the rows of a C-ordered array of whole panels, row after row however many."""
    return np.asarray(np.add.reduce(values, axis=0))


def _solve(lower: Array, right: Array) -> Array:
    """``lower⁻¹ right``."""
    solution, info = lapack.dtrtrs(lower, right, lower=1)
    if info:
        raise np.linalg.LinAlgError("singular Cholesky factor")
    return solution  # type: ignore[no-any-return]
