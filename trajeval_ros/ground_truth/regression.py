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

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.ground_truth.factors import (
    DenseFactor,
    Factor,
    MarkovFactor,
    Observed,
    rounded_up,
)
from trajeval_ros.ground_truth.hyperparameters import DEGREES_OF_FREEDOM, GroupHyperparameters
from trajeval_ros.ground_truth.kernel_sum import KernelSum, MarkovSum
from trajeval_ros.ground_truth.kernels import Kernel
from trajeval_ros.ground_truth.recursion import RecursiveFactor

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]

# Standard deviation of the mean in units of the signal's: flat beside the data.
FLAT = 1e3
ROUND_OFF = float(64.0 * np.finfo(np.float64).eps)
"""The variance is known to so much of ``k(t, t)``, and is never less than that."""


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
        self._start(KernelSum.of(kernels, groups), coordinates)

    @classmethod
    def of(cls, kernel: KernelSum, coordinates: int) -> Regression:
        """The same with the kernels' sum."""
        regression = cls.__new__(cls)
        regression._start(kernel, coordinates)
        return regression

    def _start(self, kernel: KernelSum, coordinates: int) -> None:
        self._kernel = kernel
        self._variance = self._kernel.variances[0, :, 0]
        self._factor = _factor(self._kernel, least_information(self._variance), coordinates)

    @property
    def groups(self) -> int:
        """G."""
        return len(self._variance)

    @property
    def is_in_c(self) -> bool:
        """Whether it is factored in C."""
        return isinstance(self._factor, RecursiveFactor)

    @property
    def addresses(self) -> tuple[int, ...]:
        """Those of its factor, where it `is_in_c`."""
        assert isinstance(self._factor, RecursiveFactor)
        return self._factor.addresses

    @property
    def count(self) -> int:
        """Number of samples conditioned on."""
        return self._factor.count

    def extend(self, samples: Observed) -> None:
        """Condition on all samples so far; those known already must lead.

        Raises LinAlgError where their covariance is not positive definite; none is taken then.
        """
        if len(samples.times) > self.count:
            self._factor.extend(samples)

    def take(self, name: str, times: Array, *further: loops.Argument) -> int:
        """The same by a loop, where it `is_in_c`; as `RecursiveFactor.take`."""
        assert isinstance(self._factor, RecursiveFactor)
        return self._factor.take(name, times, *further)

    def posterior(self, times: Array, counts: Counts) -> tuple[Array, Array]:
        """Return mean (q, G, c) and ``P / s²`` (q, G), given the first ``counts`` (q,) samples.

        There is at least one.
        """
        mean, variance, _ = posteriors([(self, times, counts)])
        return mean[0], variance[0]

    def motion(self, times: Array, counts: Counts) -> tuple[Array, Array]:
        """Return the same of the process and of its motion's derivative; as `posteriors`."""
        mean, variance, _ = posteriors([(self, times, counts)], kinds=2)
        return mean, variance

    def squares(self, counts: Counts) -> Array:
        """``Σ q`` over a group's coordinates, given the first ``counts`` (q,) samples; (q, G)."""
        return self._factor.sums[:, counts - 1, -1].T

    def square(self, counts: tuple[int, int]) -> Array:
        """The same of each group given its own first samples; ``counts`` of its halves; (G,)."""
        sums, half = self._factor.sums, self.groups // 2
        return np.concatenate(
            [sums[:half, counts[0] - 1, -1], sums[half:, counts[1] - 1, -1]],
        )

    def innovations(self, first: int) -> Array:
        """Return what samples from row ``first`` >= 1 on add to ``Σ q`` and ``log|K| + log A``.

        (G, n - first, 2). The first is the square of what the sample is beyond its prediction
        from those before it, in standard deviations, over the group's coordinates; half of the
        second, the logarithm of the standard deviation of one.
        """
        return self._factor.innovations(first)

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
        ones = np.zeros(white.shape[::2])
        ones[:, : self.count] = self._factor.white[:, : min(rows, self.count), 0]
        drawn = (1.0 - np.einsum("gqi,gi->gq", white, ones)) / self._factor.sums[:, counts - 1, 0]
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


def least_information(variances: Array) -> Array:
    """What is known of a group's mean before all samples; ``variances`` (G,): ``k(0)``."""
    return np.asarray(1.0 / (FLAT**2 * variances))


def _factor(kernel: KernelSum, information: Array, coordinates: int) -> Factor:
    """One without samples, of the kind that the kernel and the machine let be fastest."""
    if not isinstance(kernel, MarkovSum):
        return DenseFactor(kernel, information, coordinates)
    kind = RecursiveFactor if loops.there() else MarkovFactor
    return kind(kernel, information, coordinates)


def posteriors(
    asked: Sequence[tuple[Regression, Array, Counts]], kinds: int = 1
) -> tuple[Array, Array, Array]:
    """Return means (k, q, G, c), ``P / s²`` (k, q, G) and ``Σ q`` (q, G) of all queries.

    Of regressions with the same kernels and number of groups, each at ``times`` (q,), given its
    first ``counts`` (q,) >= 1 samples. With ``kinds`` of 2 that of the motion's derivative, too: it
    is the same with ``∂k/∂t`` for k; the correlated noise, which has no derivative, is not motion.
    """
    each = [r._factor.products(times, counts, kinds) for r, times, counts in asked]
    found, explained = (np.concatenate(some, axis=2) for some in zip(*each, strict=True))
    sums = np.concatenate([r._factor.sums[:, n - 1] for r, _, n in asked], axis=1)
    sizes = [len(times) for _, times, _ in asked]
    prior = np.stack([r._kernel.variances[:kinds, :, 0] for r, _, _ in asked], axis=2)
    prior = np.repeat(prior, sizes, axis=2)
    ones = np.array([1.0, 0.0])[:kinds, None, None]  # what a constant has of either
    r, information = ones - found[..., 0], sums[..., 0]
    mean = found[..., 1:] + (r / information)[..., None] * sums[..., 1:-1]
    variance = np.maximum(prior - explained + r * r / information, ROUND_OFF * prior)
    return np.swapaxes(mean, 1, 2), np.swapaxes(variance, 1, 2), sums[..., -1].T


def scale(squares: Array, counts: Counts, coordinates: int, least: npt.ArrayLike) -> Array:
    """``s²`` of so many coordinates with ``Σ q = squares`` (...), ``least`` or more; (...)."""
    freedom = coordinates * (counts - 1)
    return np.asarray(
        np.maximum((DEGREES_OF_FREEDOM + squares) / (DEGREES_OF_FREEDOM + freedom), least)
    )
