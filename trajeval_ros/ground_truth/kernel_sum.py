# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The covariance function of several groups of coordinates, a sum of kernels each.

A sum of Matérn kernels is Markov: with the transition matrix Φ of all of them,

    k(s, t) = past(m - s) · future(t - m),    s <= m <= t,    past(v + w) = past(v) Φ(w),

for rows ``past`` and ``future`` of as many numbers as Φ has rows. They are sums of products of
positive numbers, so they are as accurate as k itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.hyperparameters import GroupHyperparameters
from trajeval_ros.ground_truth.kernels import Kernel, Matern

Array = npt.NDArray[np.float64]
_AnyKernel = TypeVar("_AnyKernel", bound=Kernel)


class KernelSum:
    """``k(u) = Σ_k σ_k² ρ_k(u / l_k)`` of G groups, which share the kernels."""

    def __init__(
        self, kernels: tuple[Kernel, ...], groups: tuple[GroupHyperparameters, ...]
    ) -> None:
        """Take the kernels that the groups have components for."""
        components = [group.components for group in groups]
        self._kernels = kernels[: len(components[0])]
        variances = np.array([[c.std**2 for c in parts] for parts in components]).T
        lengths = np.array([[c.length_scale for c in parts] for parts in components]).T
        self._variances, self._lengths = variances[..., None, None], lengths[..., None, None]
        self.variance: Array = variances.sum(axis=0)
        """``k(0)`` of each group; (G,)."""
        matern = [kernel for kernel in self._kernels if isinstance(kernel, Matern)]
        self.is_markov = len(matern) == len(self._kernels)
        """Whether ``past``, ``future`` and ``transition`` are defined."""
        self._matern = matern if self.is_markov else []
        self.rank = sum(len(kernel.coefficients) for kernel in self._matern)
        """Number of rows of Φ."""

    def __call__(self, apart: Array) -> Array:
        """``k``, elementwise, of times ``apart`` (a, b) seconds; (G, a, b)."""
        total = np.zeros((len(self.variance), *apart.shape))
        for kernel, variance, u in self._scaled(self._kernels, apart):
            part = kernel.correlation(u)
            part *= variance
            total += part
        return total

    def past(self, apart: Array) -> Array:
        """``past`` of times ``apart`` (a, b) seconds, not negative; (G, a, b, r)."""
        return np.concatenate(
            [kernel.past(u) for kernel, _, u in self._scaled(self._matern, apart)], axis=-1
        )

    def future(self, apart: Array) -> Array:
        """``future`` of times ``apart`` (a, b) seconds, not negative; (G, a, b, r)."""
        return np.concatenate(
            [
                variance[..., None] * kernel.future(u)
                for kernel, variance, u in self._scaled(self._matern, apart)
            ],
            axis=-1,
        )

    def transition(self, apart: Array) -> Array:
        """``Φ`` of times ``apart`` (a, b) seconds, not negative; (G, a, b, r, r)."""
        result = np.zeros((len(self.variance), *apart.shape, self.rank, self.rank))
        begin = 0
        for kernel, _, u in self._scaled(self._matern, apart):
            here = slice(begin, begin + len(kernel.coefficients))
            result[..., here, here] = kernel.transition(u)
            begin = here.stop
        return result

    def _scaled(
        self, kernels: Iterable[_AnyKernel], apart: Array
    ) -> Iterator[tuple[_AnyKernel, Array, Array]]:
        """Each kernel with its ``σ²`` (G, 1, 1) and ``apart / l`` (G, a, b)."""
        for kernel, variance, length in zip(kernels, self._variances, self._lengths, strict=True):
            yield kernel, variance, apart / length
