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

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.factors import DenseFactor, Factor, MarkovFactor, rounded_up
from trajeval_ros.ground_truth.hyperparameters import DEGREES_OF_FREEDOM, GroupHyperparameters
from trajeval_ros.ground_truth.kernel_sum import KernelSlope, KernelSum
from trajeval_ros.ground_truth.kernels import Kernel

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]

# Standard deviation of the mean in units of the signal's: flat beside the data.
_FLAT = 1e3
# The variance is known to this many units of round-off of k(t, t), and is never less than that.
_ROUND_OFF = 64.0 * np.finfo(np.float64).eps


class Regression:
    """The posterior of G groups of c coordinates.

    Those of a group share hyperparameters and noise, all share the kernels.
    """

    def __init__(
        self,
        kernels: tuple[Kernel, ...],
        groups: tuple[GroupHyperparameters, ...],
        coordinates: int,
    ) -> None:
        """Start without samples."""
        self._kernel = KernelSum(kernels, groups)
        self._variance = self._kernel.variance
        factor = MarkovFactor if self._kernel.is_markov else DenseFactor
        self._factor: Factor = factor(self._kernel, coordinates)
        self._sums = np.empty((len(groups), 0, 2 + coordinates))  # A, gᵀ z, Σ zᵀ z, row by row

    @property
    def count(self) -> int:
        """Number of samples conditioned on."""
        return self._factor.count

    def extend(self, times: Array, values: Array, noise: Array) -> None:
        """Condition on all samples so far; those known already must lead.

        ``times`` (n,) seconds, increasing; ``values`` (n, G, c); ``noise`` (n, G) variances.
        """
        if len(times) > self.count:
            self._sum_up(self._factor.extend(times, values, noise))

    def _sum_up(self, first: int) -> None:
        """Add up the sums from row ``first`` on."""
        white = self._factor.white[:, first : self.count]
        square = (white[..., 1:] ** 2).sum(axis=-1, keepdims=True)
        terms = np.concatenate([white[..., :1] * white, square], axis=-1)
        if first:
            terms[:, 0] += self._sums[:, first - 1]
        else:
            terms[:, 0, 0] += 1.0 / (_FLAT**2 * self._variance)
        further = np.cumsum(terms, axis=1)
        self._sums = np.concatenate([self._sums[:, :first], further], axis=1)

    def posterior(self, times: Array, counts: Counts) -> tuple[Array, Array]:
        """Return mean (q, G, c) and ``P / s²`` (q, G), given the first ``counts`` (q,) samples.

        There is at least one.
        """
        mean, variance = self._given(times, counts, (self._kernel,))
        return mean[0], variance[0]

    def motion(self, times: Array, counts: Counts) -> tuple[Array, Array]:
        """Return the same of the process and of the motion's derivative; (2, q, G, c), (2, q, G).

        The second is the first with ``∂k/∂t`` for k; the correlated noise, which has no derivative,
        is not motion.
        """
        return self._given(times, counts, (self._kernel, self._kernel.slope))

    def _given(
        self, times: Array, counts: Counts, asked: tuple[KernelSum | KernelSlope, ...]
    ) -> tuple[Array, Array]:
        products, explained = self._factor.products(times, counts, asked)
        sums = self._sums[:, None, counts - 1]
        ones = np.array([[what.one] for what in asked])
        prior = np.stack([what.variance for what in asked])[..., None]
        r, information = ones - products[..., 0], sums[..., 0]
        mean = products[..., 1:] + (r / information)[..., None] * sums[..., 1:-1]
        variance = np.swapaxes(prior, 0, 1) - explained + r * r / information
        variance = np.maximum(variance, _ROUND_OFF * np.swapaxes(prior, 0, 1))
        return mean.transpose(1, 2, 0, 3), variance.transpose(1, 2, 0)

    def squares(self, counts: Counts) -> Array:
        """``Σ q`` over a group's coordinates, given the first ``counts`` (q,) samples; (q, G)."""
        sums = self._sums[:, counts - 1]
        return np.asarray(sums[..., -1] - (sums[..., 1:-1] ** 2).sum(axis=-1) / sums[..., 0]).T

    def innovations(self, first: int) -> tuple[Array, Array]:
        """Return what samples from row ``first`` >= 1 on add to ``Σ q`` and ``log|K| + log A``.

        (G, n - first) both. The first is the square of what the sample is beyond its prediction
        from those before it, in standard deviations, over the group's coordinates; half of the
        second, the logarithm of the standard deviation of one.
        """
        squares = self.squares(np.arange(first, self.count + 1)).T
        information = np.log(self._sums[:, first - 1 :, 0])
        pivots = 2.0 * np.log(self._factor.pivots[:, first : self.count])
        return np.diff(squares), pivots + np.diff(information)

    def cross_variances(self, times: Array, known: int, counts: Counts) -> list[Array]:
        """Return the posterior covariances over ``s²`` of each time with all those before it.

        ``times`` (k + q,), k = ``known``; ``counts`` (q,) >= 1 of the last q. Each (k + i, G), i =
        0 ... q - 1, given the later one's first ``counts`` samples, its set being the larger: the
        later error is orthogonal to all that the earlier answer knew, so that is the covariance
        of the errors. With ``u = L⁻ᵀ (v_j + g r_j / A)`` it is ``k(t_i, t_j) + r_j / A - k(t_i)ᵀ
        u``, for any number of t_i.
        """
        white = self._factor.whitened(times[known:], counts)
        rows = white.shape[2]
        ones = self._factor.white[:, :rows, 0]
        drawn = (1.0 - np.einsum("gqi,gi->gq", white, ones)) / self._sums[:, counts - 1, 0]
        right = white + drawn[..., None] * ones[:, None]
        right *= np.arange(rows) < counts[:, None]
        weights = self._factor.weights(right, counts)
        samples = self._kernel(np.abs(times[:, None] - self._factor.times[:rows]))
        prior = self._kernel(np.abs(times[:, None] - times[known:]))
        found = []
        for j, count in enumerate(counts):
            size = rounded_up(int(count))
            weight = np.ascontiguousarray(weights[:, j, :size, None])
            explained = (samples[:, : known + j, :size] @ weight)[..., 0]
            found.append((prior[:, : known + j, j] + drawn[:, j, None] - explained).T)
        return found


def scale(squares: Array, counts: Counts, coordinates: int, least: npt.ArrayLike) -> Array:
    """``s²`` of so many coordinates with ``Σ q = squares`` (...), ``least`` or more; (...)."""
    freedom = coordinates * (counts - 1)
    return np.asarray(
        np.maximum((DEGREES_OF_FREEDOM + squares) / (DEGREES_OF_FREEDOM + freedom), least)
    )
