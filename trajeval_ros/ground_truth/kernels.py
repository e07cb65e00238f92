# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stationary covariance functions of time.

Every kernel is written for unit variance and unit length: ``k(t, t') = σ² ρ(|t - t'| / l)``. A new
kernel is one small class with the two methods of :class:`Kernel`, entered in :data:`SUMS`.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Kernel(Protocol):
    """A stationary correlation function of the scaled time difference ``u = |t - t'| / l``."""

    def correlation(self, u: Array) -> Array:
        """Return ``ρ(u)``, elementwise, for ``u >= 0``; ``ρ(0) = 1``."""
        ...

    def scaled_slope(self, u: Array) -> Array:
        """Return ``-u ρ'(u)``, which is ``∂ρ/∂log l``, elementwise."""
        ...


class SquaredExponential:
    """``ρ(u) = exp(-u²/2)``: infinitely smooth; the paper's choice."""

    def correlation(self, u: Array) -> Array:
        """Return ``exp(-u²/2)``."""
        return np.asarray(np.exp(-0.5 * u * u))

    def scaled_slope(self, u: Array) -> Array:
        """Return ``u² exp(-u²/2)``."""
        square = u * u
        return np.asarray(square * np.exp(-0.5 * square))


class Matern32:
    """``ρ(u) = (1 + √3 u) exp(-√3 u)``: once differentiable motion."""

    def correlation(self, u: Array) -> Array:
        """Return ``(1 + a) exp(-a)`` with ``a = √3 u``."""
        a = np.sqrt(3.0) * u
        return np.asarray((1.0 + a) * np.exp(-a))

    def scaled_slope(self, u: Array) -> Array:
        """Return ``a² exp(-a)`` with ``a = √3 u``."""
        a = np.sqrt(3.0) * u
        return np.asarray(a * a * np.exp(-a))


class Matern52:
    """``ρ(u) = (1 + √5 u + 5u²/3) exp(-√5 u)``: twice differentiable motion."""

    def correlation(self, u: Array) -> Array:
        """Return ``(1 + a + a²/3) exp(-a)`` with ``a = √5 u``."""
        a = np.sqrt(5.0) * u
        return np.asarray((1.0 + a * (1.0 + a / 3.0)) * np.exp(-a))

    def scaled_slope(self, u: Array) -> Array:
        """Return ``a² (1 + a) exp(-a) / 3`` with ``a = √5 u``."""
        a = np.sqrt(5.0) * u
        return np.asarray(a * a * (1.0 + a) * np.exp(-a) / 3.0)


SUMS: MappingProxyType[str, tuple[Kernel, ...]] = MappingProxyType(
    {
        "matern52": (Matern52(), Matern32()),
        "matern32": (Matern32(),),
        "squared_exponential": (SquaredExponential(),),
    }
)
"""The covariance functions by the name of the parameter ``gp.kernel``: sums of kernels."""
