# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gaussian-process regression of a few coordinates over time, grown sample by sample.

The model of each coordinate is ``x(t) = β + f(t) + noise``, an unknown mean β under a nearly flat
prior, and ``f ~ GP(0, k)``; the covariance of all is known up to a scale ``s²`` near one, with a
prior of ν degrees of freedom. With the Cholesky factor ``K = L Lᵀ`` of the samples' covariance, ``z
= L⁻¹ x``, ``g = L⁻¹ 1`` and ``v = L⁻¹ k(t)``, all truncated to the first n rows,

    A = p + gᵀ g,   β = gᵀ z / A,   r = 1 - gᵀ v,   q = zᵀ z - (gᵀ z)² / A,
    m(t) = vᵀ z + r β,   s² = (ν + Σ q) / (ν + c (n - 1)),   P(t) = s² (k(t,t) - vᵀ v + r² / A)

is the posterior given the first n samples, c coordinates together giving the scale
(``docs/method.md``, Ground truth): the leading block of a Cholesky factor is the factor of the
leading block, so a truncated answer costs no new factorisation.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from trajeval_ros.ground_truth.hyperparameters import (
    DEGREES_OF_FREEDOM,
    Component,
    GroupHyperparameters,
)
from trajeval_ros.ground_truth.kernels import Kernel

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]

# The posterior variance is a small difference of large numbers, so its last digits show how the
# arithmetic was ordered. To give the same digits however the samples and the queries were cut into
# batches, every BLAS and LAPACK call below has a shape that depends on the position in the segment
# alone: rows in blocks, queries in panels.
_BLOCK = 32
_PANEL = 8

# Standard deviation of the mean in units of the signal's: flat beside the data.
_FLAT = 1e3
# The variance is known to this many units of round-off of k(t, t), and is never less than that.
_ROUND_OFF = 64.0 * np.finfo(np.float64).eps


def _rounded_up(count: int) -> int:
    """The smallest of 32, 64, 128, ... that holds ``count`` rows."""
    return _BLOCK << max(0, (max(count, 1) - 1) // _BLOCK).bit_length()


def _by_size(counts: Counts) -> Iterator[tuple[int, Counts]]:
    """The sizes of `_rounded_up`, and which of the counts (q,) need which."""
    for size in np.unique([_rounded_up(int(c)) for c in np.unique(counts)]):
        least = size // 2 if size > _BLOCK else 0
        yield int(size), np.flatnonzero((counts <= size) & (counts > least))


class Regression:
    """The posterior of several coordinates that share kernels, hyperparameters and noise."""

    def __init__(
        self,
        kernels: tuple[Kernel, ...],
        hyperparameters: GroupHyperparameters,
        coordinates: int,
    ) -> None:
        """Start without samples."""
        self._components = hyperparameters.components
        self._kernels = kernels[: len(self._components)]
        self._variance = sum(c.std**2 for c in self._components)
        self._mean_precision = 1.0 / (_FLAT**2 * self._variance)
        self._count = 0
        self._times = np.empty(0)
        self._factor = np.empty((0, 0))
        self._white = np.empty((0, 1 + coordinates))  # g, z
        self._sums = np.empty((0, 2 + coordinates))  # A, gᵀ z, Σ zᵀ z, row after row

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
        self._sums = np.concatenate([self._sums, np.zeros((grow, self._sums.shape[1]))])

    def _factor_block(self, start: int, times: Array, values: Array, noise: Array) -> None:
        """Write rows ``start`` to ``start + 32`` of the factor.

        Rows without a sample are rows of the identity.
        """
        here, size = slice(start, start + _BLOCK), len(times)
        self._times[start : start + size] = times
        right = np.zeros((_BLOCK, self._white.shape[1]))
        right[:size, 0], right[:size, 1:] = 1.0, values
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
        self._white[here] = white = _solve(lower, right)
        square = (white[:, 1:] ** 2).sum(axis=1, keepdims=True)
        terms = np.concatenate([white[:, :1] * white, square], axis=1)
        if start:
            terms[0] += self._sums[start - 1]
        else:
            terms[0, 0] += self._mean_precision
        self._sums[here] = np.cumsum(terms, axis=0)

    def _covariance(self, first: Array, second: Array) -> Array:
        """``k(first_i, second_j)``; (len(first), len(second))."""
        apart = np.abs(first[:, None] - second)
        return sum_of_kernels(self._kernels, self._components, apart)

    def posterior(self, times: Array, counts: Counts) -> tuple[Array, Array]:
        """Return mean (q, c) and ``P / s²`` (q,), given the first ``counts`` (q,) >= 1 samples."""
        white, r, mean = self._whitened(times, counts)
        sums = self._sums[counts - 1]
        information = sums[:, 0]
        mean = mean + (r / information)[:, None] * sums[:, 1:-1]
        variance = self._variance - _column_sums(white * white)[: len(times)] + r * r / information
        return mean, np.maximum(variance, _ROUND_OFF * self._variance)

    def squares(self, counts: Counts) -> Array:
        """``Σ q`` over the coordinates, given the first ``counts`` (q,) samples; (q,)."""
        sums = self._sums[counts - 1]
        return np.asarray(sums[:, -1] - (sums[:, 1:-1] ** 2).sum(axis=1) / sums[:, 0])

    def covariance(self, times: Array, counts: Counts) -> Array:
        """Return the posterior covariance over ``s²`` (q, q), given the larger of two sets.

        The later error is orthogonal to all that the earlier answer knew, so that is the covariance
        of the errors.
        """
        full = np.full(len(times), counts.max(initial=1), dtype=np.intp)
        white = self._whitened(times, full)[0][:, : len(times)]
        pair = np.maximum(counts[:, None], counts)
        result = self._covariance(times, times)
        for count in np.unique(pair):  # few: the counts of neighbouring queries
            rows = white[:count]
            r = 1.0 - self._white[:count, 0] @ rows
            update = np.outer(r, r) / self._sums[count - 1, 0] - rows.T @ rows
            chosen = pair == count
            result[chosen] += update[chosen]
        return result

    def cross_variances(self, times: Array, known: int, counts: Counts) -> list[Array]:
        """Return the posterior covariances over ``s²`` of each time with all those before it.

        ``times`` (k + q,), k = ``known``; ``counts`` (q,) >= 1 of the last q. Each (k + i,), i = 0
        ... q - 1, given the later one's first ``counts`` samples, its set being the larger: the
        later error is orthogonal to all that the earlier answer knew, so that is the covariance
        of the errors. With ``u = L⁻ᵀ (v_j + g r_j / A)`` it is ``k(t_i, t_j) + r_j / A - k(t_i)ᵀ
        u``, for any number of t_i.
        """
        white, r, _ = self._whitened(times[known:], counts)
        information = self._sums[counts - 1, 0]
        drawn = r / information
        rows = len(white)
        right = white[:, : len(counts)] + self._white[:rows, :1] * drawn
        right[np.arange(rows)[:, None] >= counts] = 0.0
        samples = self._covariance(times, self._times[:rows])
        prior = self._covariance(times, times[known:])
        found = []
        for size, chosen in _by_size(counts):
            panel = np.zeros((size, -(-len(chosen) // _PANEL) * _PANEL), order="F")
            panel[:, : len(chosen)] = right[:size, chosen]
            weights, _ = lapack.dtrtrs(self._factor[:size, :size], panel, lower=1, trans=1)
            for j, weight in zip(chosen, weights.T, strict=False):
                explained = samples[: known + j, :size] @ weight
                found.append((j, prior[: known + j, j] + drawn[j] - explained))
        return [row for _, row in sorted(found, key=lambda entry: int(entry[0]))]

    def _whitened(self, times: Array, counts: Counts) -> tuple[Array, Array, Array]:
        """``v`` (rows, panels of q), zero from row ``counts`` on; ``r`` (q,); ``vᵀ z`` (q, c)."""
        rows = _rounded_up(int(counts.max(initial=0)))
        white = np.zeros((rows, -(-len(times) // _PANEL) * _PANEL))
        for size, chosen in _by_size(counts):
            panel = np.zeros((size, -(-len(chosen) // _PANEL) * _PANEL), order="F")
            panel[:, : len(chosen)] = self._covariance(self._times[:size], times[chosen])
            panel = _solve(self._factor[:size, :size], panel)
            white[:size, chosen] = panel[:, : len(chosen)]
        white[:, : len(times)][np.arange(rows)[:, None] >= counts] = 0.0
        columns = self._white[:rows].T
        products = np.stack([_column_sums(white * column[:, None]) for column in columns], axis=-1)
        products = products[: len(times)]
        return white, 1.0 - products[:, 0], products[:, 1:]


def scale(squares: Array, counts: Counts, coordinates: int, least: float) -> Array:
    """``s²`` of so many coordinates with ``Σ q = squares`` (q,), ``least`` or more; (q,)."""
    freedom = coordinates * (counts - 1)
    return np.asarray(
        np.maximum((DEGREES_OF_FREEDOM + squares) / (DEGREES_OF_FREEDOM + freedom), least)
    )


def sum_of_kernels(
    kernels: tuple[Kernel, ...], components: tuple[Component, ...], apart: Array
) -> Array:
    """``Σ σ² ρ(apart / l)``, elementwise; ``apart`` in seconds."""
    total = np.zeros_like(apart)
    for kernel, component in zip(kernels, components, strict=True):
        if component.std > 0.0:
            total += component.std**2 * kernel.correlation(apart / component.length_scale)
    return total


def _column_sums(values: Array) -> Array:
    """Sum over the rows of a C-ordered array of whole panels, row after row however many."""
    return np.asarray(np.add.reduce(values, axis=0))


def _solve(lower: Array, right: Array) -> Array:
    """``lower⁻¹ right``."""
    solution, info = lapack.dtrtrs(lower, right, lower=1)
    if info:
        raise np.linalg.LinAlgError("singular Cholesky factor")
    return solution  # type: ignore[no-any-return]
