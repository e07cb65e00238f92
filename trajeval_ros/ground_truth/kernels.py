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


class Matern:
    """The Matérn kernels of half-integer order, ``ρ(u) = Σ_j c_j aʲ exp(-a)`` with ``a = r u``.

    They are Markov: with a transition matrix ``Φ(u + v) = Φ(u) Φ(v)`` it is ``ρ(u) = e₀ᵀ Φ(u) c``,
    so that the correlations of what is before a moment with what is after it have the rank of Φ.
    """

    rate: ClassVar[float]
    coefficients: ClassVar[tuple[float, ...]]

    def correlation(self, u: Array) -> Array:
        """Return ``ρ(u)``, elementwise, for ``u >= 0``."""
        a = self.rate * u
        polynomial: Array | float = self.coefficients[-1]
        for coefficient in self.coefficients[-2::-1]:
            polynomial = polynomial * a + coefficient
        return np.asarray(polynomial * np.exp(-a))

    def past(self, u: Array) -> Array:
        """Return ``Φ(u)ᵀ e₀``, (..., r): ``aⁱ exp(-a)``."""
        a = self.rate * u
        terms = [np.exp(-a)]
        for _ in self.coefficients[1:]:
            terms.append(a * terms[-1])
        return np.stack(terms, axis=-1)

    def future(self, u: Array) -> Array:
        """Return ``Φ(u) c``, (..., r): ``Σ_j c_j binom(j, i) a^(j - i) exp(-a)``."""
        powers, size = self.past(u), len(self.coefficients)
        weights = np.zeros((size, size))
        for j, coefficient in enumerate(self.coefficients):
            for i in range(j + 1):
                weights[j - i, i] = coefficient * math.comb(j, i)
        return np.asarray(powers @ weights)

    def transition(self, u: Array) -> Array:
        """Return ``Φ(u)``, (..., r, r): ``binom(j, i) a^(j - i) exp(-a)``, for ``u >= 0``."""
        powers, size = self.past(u), len(self.coefficients)
        result = np.zeros((*u.shape, size, size))
        for j in range(size):
            for i in range(j + 1):
                result[..., i, j] = math.comb(j, i) * powers[..., j - i]
        return result


class Exponential(Matern):
    """``ρ(u) = exp(-u)``: continuous, not differentiable; for correlated noise."""

    rate = 1.0
    coefficients = (1.0,)

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return ``exp(-u)`` and ``u exp(-u)``."""
        correlation = np.exp(-u)
        return correlation, u * correlation


class Matern32(Matern):
    """``ρ(u) = (1 + √3 u) exp(-√3 u)``: once differentiable motion."""

    rate = math.sqrt(3.0)
    coefficients = (1.0, 1.0)

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return ``(1 + a) exp(-a)`` and ``a² exp(-a)`` with ``a = √3 u``."""
        a = self.rate * u
        decay = np.exp(-a)
        return (1.0 + a) * decay, a * a * decay


class Matern52(Matern):
    """``ρ(u) = (1 + √5 u + 5u²/3) exp(-√5 u)``: twice differentiable motion."""

    rate = math.sqrt(5.0)
    coefficients = (1.0, 1.0, 1.0 / 3.0)

    def with_slope(self, u: Array) -> tuple[Array, Array]:
        """Return the correlation and ``a² (1 + a) exp(-a) / 3`` with ``a = √5 u``."""
        a = self.rate * u
        decay, third = np.exp(-a), a * a / 3.0
        return (1.0 + a + third) * decay, third * (1.0 + a) * decay
