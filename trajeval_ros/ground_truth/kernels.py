# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stationary covariance functions of time.

Every kernel is written for unit variance and unit length: ``k(t, t') = σ² ρ(|t - t'| / l)``. A new
kernel is one small class with the two methods of :class:`Kernel`, used by the models
of :mod:`trajeval_ros.ground_truth.models`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Kernel(Protocol):
    """A stationary correlation function of the scaled time difference ``u = |t - t'| / l``."""

    def correlation(self, u: Array) -> Array:
        """Return ``ρ(u)``, elementwise, for ``u >= 0``; ``ρ(0) = 1``."""
        ...

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return ``ρ(u)`` and ``-u ρ'(u)``, which is ``∂ρ/∂log l``, elementwise."""
        ...


class SquaredExponential:
    """``ρ(u) = exp(-u²/2)``: infinitely smooth; the paper's choice."""

    def correlation(self, u: Array) -> Array:
        """Return ``exp(-u²/2)``."""
        return np.asarray(np.exp(-0.5 * u * u))

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return ``exp(-u²/2)`` and ``u² exp(-u²/2)``."""
        square = u * u
        correlation = np.exp(-0.5 * square)
        return correlation, square * correlation


class Exponential:
    """``ρ(u) = exp(-u)``: continuous, not differentiable; for correlated noise."""

    def correlation(self, u: Array) -> Array:
        """Return ``exp(-u)``."""
        return np.asarray(np.exp(-u))

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return ``exp(-u)`` and ``u exp(-u)``."""
        correlation = np.exp(-u)
        return correlation, u * correlation


class Matern32:
    """``ρ(u) = (1 + √3 u) exp(-√3 u)``: once differentiable motion."""

    def correlation(self, u: Array) -> Array:
        """Return ``(1 + a) exp(-a)`` with ``a = √3 u``."""
        a = np.sqrt(3.0) * u
        return np.asarray((1.0 + a) * np.exp(-a))

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return ``(1 + a) exp(-a)`` and ``a² exp(-a)`` with ``a = √3 u``."""
        a = np.sqrt(3.0) * u
        decay = np.exp(-a)
        return (1.0 + a) * decay, a * a * decay


class Matern52:
    """``ρ(u) = (1 + √5 u + 5u²/3) exp(-√5 u)``: twice differentiable motion."""

    def correlation(self, u: Array) -> Array:
        """Return ``(1 + a + a²/3) exp(-a)`` with ``a = √5 u``."""
        a = np.sqrt(5.0) * u
        return np.asarray((1.0 + a * (1.0 + a / 3.0)) * np.exp(-a))

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return the correlation and ``a² (1 + a) exp(-a) / 3`` with ``a = √5 u``."""
        a = np.sqrt(5.0) * u
        decay, third = np.exp(-a), a * a / 3.0
        return (1.0 + a + third) * decay, third * (1.0 + a) * decay
