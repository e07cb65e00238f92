# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stationary covariance functions of time.

Every kernel is written for unit variance and unit length: ``k(t, t') = σ² ρ(|t - t'| / l)``. A new
kernel is one small class with the two methods of :class:`Kernel`, used by the models
of :mod:`trajeval_ros.ground_truth.models`.
"""

from __future__ import annotations

import math
from typing import ClassVar, Protocol

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

    @property
    def curvature(self) -> float:
        """``-ρ''(0)``, the variance of the derivative; 0 for noise, which has none."""
        ...

    def derivative(self, u: Array) -> Array:
        """Return ``ρ'(u)``, elementwise, for ``u >= 0``; zero for noise."""
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

    @property
    def curvature(self) -> float:
        """``-ρ''(0) = 1``."""
        return 1.0

    def derivative(self, u: Array) -> Array:
        """Return ``-u exp(-u²/2)``."""
        return np.asarray(-u * np.exp(-0.5 * u * u))


class Matern:
    """The Matérn kernels of half-integer order, ``ρ(u) = Σ_j c_j aʲ exp(-a)`` with ``a = r u``.

    They are Markov: with a transition matrix ``Φ(u + v) = Φ(u) Φ(v)`` it is ``ρ(u) = e₀ᵀ Φ(u) c``,
    so that the correlations of what is before a moment with what is after it have the rank of Φ.
    """

    rate: ClassVar[float]
    coefficients: ClassVar[tuple[float, ...]]
    slope: ClassVar[tuple[float, ...]]
    """Coefficients ``c_(j-1) - j c_j`` of ``-u ρ'(u)``, without those of 1 and a, which vanish."""

    def correlation(self, u: Array) -> Array:
        """Return ``ρ(u)``, elementwise, for ``u >= 0``."""
        a = self.rate * u
        return np.asarray(_polynomial(self.coefficients, a) * np.exp(-a))

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return ``ρ(u)`` and ``-u ρ'(u)``, elementwise, for ``u >= 0``."""
        a = self.rate * u
        decay = np.exp(-a)
        return _polynomial(self.coefficients, a) * decay, _polynomial(self.slope, a) * a * a * decay

    @property
    def curvature(self) -> float:
        """``-ρ''(0) = r² s₀``, of the first of the slope's coefficients."""
        return self.rate**2 * self.slope[0]

    def derivative(self, u: Array) -> Array:
        """Return ``ρ'(u) = -r a Σ_j s_j aʲ exp(-a)``, elementwise, for ``u >= 0``."""
        a = self.rate * u
        return np.asarray(-self.rate * a * _polynomial(self.slope, a) * np.exp(-a))


class Exponential(Matern):
    """``ρ(u) = exp(-u)``: continuous, not differentiable; for correlated noise."""

    rate = 1.0
    coefficients = (1.0,)

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return ``exp(-u)`` and ``u exp(-u)``."""
        correlation = np.exp(-u)
        return correlation, u * correlation

    @property
    def curvature(self) -> float:
        """None: noise has no derivative, and is no motion."""
        return 0.0

    def derivative(self, u: Array) -> Array:
        """Return zero."""
        return np.zeros_like(u)


class Matern32(Matern):
    """``ρ(u) = (1 + a) exp(-a)`` with ``a = √3 u``: once differentiable motion."""

    rate = math.sqrt(3.0)
    coefficients = (1.0, 1.0)
    slope = (1.0,)


class Matern52(Matern):
    """``ρ(u) = (1 + a + a²/3) exp(-a)`` with ``a = √5 u``: twice differentiable motion."""

    rate = math.sqrt(5.0)
    coefficients = (1.0, 1.0, 1.0 / 3.0)
    slope = (1.0 / 3.0, 1.0 / 3.0)


class Matern72(Matern):
    """``ρ(u) = (1 + a + 2a²/5 + a³/15) exp(-a)``, ``a = √7 u``: thrice differentiable motion."""

    rate = math.sqrt(7.0)
    coefficients = (1.0, 1.0, 2.0 / 5.0, 1.0 / 15.0)
    slope = (1.0 / 5.0, 1.0 / 5.0, 1.0 / 15.0)


def _polynomial(coefficients: tuple[float, ...], a: Array) -> Array:
    value = np.full_like(a, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value *= a
        value += coefficient
    return value
