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
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.hyperparameters import GroupHyperparameters
from trajeval_ros.ground_truth.kernels import Kernel, Matern

Array = npt.NDArray[np.float64]
_AnyKernel = TypeVar("_AnyKernel", bound=Kernel)


class Cross(Protocol):
    """The covariance of something asked with the samples."""

    @property
    def one(self) -> float:
        """What it is of a constant: the unknown mean's part in it."""
        ...

    def cross(self, apart: Array) -> Array:
        """Of queries ``apart`` (a, b) seconds later than the samples; (G, a, b)."""
        ...

    def future(self, apart: Array) -> Array:
        """``future`` of queries ``apart`` (a, b) seconds, not negative, after; (G, a, b, r)."""
        ...


class KernelSum:
    """``k(u) = Σ_k σ_k² ρ_k(u / l_k)`` of G groups, which share the kernels."""

    one = 1.0

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

    def cross(self, apart: Array) -> Array:
        """``k`` of queries and samples, the queries ``apart`` (a, b) seconds later; (G, a, b)."""
        return self(np.abs(apart))

    @property
    def slope(self) -> KernelSlope:
        """The covariance of the motion's derivative with the samples."""
        return KernelSlope(self)

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

    def parts(self) -> Iterator[tuple[Kernel, Array, Array]]:
        """Each kernel with its ``σ²`` and ``l``, (G, 1, 1) both."""
        return zip(self._kernels, self._variances, self._lengths, strict=True)

    def _scaled(
        self, kernels: Iterable[_AnyKernel], apart: Array
    ) -> Iterator[tuple[_AnyKernel, Array, Array]]:
        """Each kernel with its ``σ²`` (G, 1, 1) and ``apart / l`` (G, a, b)."""
        for kernel, variance, length in zip(kernels, self._variances, self._lengths, strict=True):
            yield kernel, variance, apart / length


class KernelSlope:
    """``∂k(t, t')/∂t`` of the kernels that are motion; noise has no derivative and is left out.

    It is the covariance of the motion's derivative at t with a sample at t'.
    """

    one = 0.0

    def __init__(self, kernel: KernelSum) -> None:
        """Take a sum of kernels."""
        self._kernel = kernel
        self.variance: Array = np.sum(
            [
                v[:, 0, 0] * each.curvature / length[:, 0, 0] ** 2
                for each, v, length in kernel.parts()
            ],
            axis=0,
        )
        """Of the derivative, ``-k''(0)`` of each group; (G,)."""

    def cross(self, apart: Array) -> Array:
        """``sign(u) k'(|u|)`` of queries ``apart`` (a, b) seconds after the samples; (G, a, b)."""
        total = np.zeros((len(self.variance), *apart.shape))
        for each, variance, length in self._kernel.parts():
            total += variance / length * each.derivative(np.abs(apart) / length)
        return np.asarray(total * np.sign(apart))

    def future(self, apart: Array) -> Array:
        """The derivative of the sum's ``future``; (G, a, b, r)."""
        return np.concatenate(
            [
                (variance / length)[..., None] * each.future_derivative(apart / length)
                for each, variance, length in self._kernel.parts()
                if isinstance(each, Matern)
            ],
            axis=-1,
        )
