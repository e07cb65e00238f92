# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is learned: which kernels add up, what their hyperparameters depend on, what is probable.

A model has free parameters θ and turns them into the *natural* ones, log σ and log l of each kernel
and log n of the white noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.kernels import (
    Exponential,
    Kernel,
    Matern32,
    Matern52,
    SquaredExponential,
)

Array = npt.NDArray[np.float64]
Bounds = list[tuple[float, float]]

_LONGEST = 60.0  # s; beyond, σ and l act only together


@dataclass(frozen=True, slots=True)
class Grid:
    """What the data are like: sample ``interval`` (s), ``spread`` and the possible noise."""

    interval: float
    spread: float
    least_noise: float
    soft_limit: float

    @staticmethod
    def of(
        times: Sequence[Array], values: Sequence[Array], noise_std: float, soft_limit: float
    ) -> Grid:
        """Describe segments: ``times`` (n,) s and ``values`` (n, c) of each."""
        interval = float(np.median(np.concatenate([np.diff(t) for t in times])))
        centred = np.concatenate([v - v[0] for v in values])
        spread = max(math.sqrt(float(np.mean(centred**2))), 10.0 * noise_std, 1e-9)
        return Grid(interval, spread, min(noise_std, 1e-5), soft_limit)


class Model(Protocol):
    """A sum of kernels and noise with p free parameters θ (p,)."""

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """The kernels that add up."""
        ...

    def natural(self, theta: Array, grid: Grid) -> tuple[Array, Array]:
        """Return (log σ, log l) of each kernel and log n, (2k + 1,), and their Jacobian."""
        ...

    def log_prior(self, theta: Array, grid: Grid) -> tuple[float, Array, Array]:
        """Return the log-prior, its gradient, and its negative second derivatives; (p,) each."""
        ...

    def bounds(self, grid: Grid) -> Bounds:
        """Return the bounds of θ."""
        ...

    def starts(self, grid: Grid) -> list[Array]:
        """Return where the search may begin."""
        ...


@dataclass(frozen=True, slots=True)
class OneKernel:
    """One kernel and white noise; θ = log (σ, l, n); no prior. The paper's model."""

    kernel: Kernel

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """The one kernel."""
        return (self.kernel,)

    def natural(self, theta: Array, grid: Grid) -> tuple[Array, Array]:
        """Return θ itself."""
        return theta, np.eye(3)

    def log_prior(self, theta: Array, grid: Grid) -> tuple[float, Array, Array]:
        """Return zero."""
        return 0.0, np.zeros(3), np.zeros(3)

    def bounds(self, grid: Grid) -> Bounds:
        """From far below to far above what the data show."""
        return [
            (math.log(1e-4 * grid.spread), math.log(100.0 * grid.spread)),
            (math.log(0.5 * grid.interval), math.log(_LONGEST)),
            (math.log(grid.least_noise), math.log(grid.spread)),
        ]

    def starts(self, grid: Grid) -> list[Array]:
        """Fast or slow motion, clean or noisy samples."""
        lengths, noises = (4.0 * grid.interval, 1.5), (1e-4, 3e-3, 3e-2)
        return [
            np.log([grid.spread, length, noise * grid.spread])
            for length, noise in product(lengths, noises)
        ]


@dataclass(frozen=True, slots=True)
class SmoothAndRough:
    """Smooth motion, rough motion and partly correlated noise; θ = log (σ_a, l_a, σ_b, l_b, n_0).

    Matérn 5/2 (σ_a, l_a) plus Matérn 3/2 (σ_b, l_b): which of them rules between two samples is for
    the data to say. Noise of variance n² has a share C correlated over a time of κ sample intervals
    h, as a motion-capture system's filters have it. From thinned samples the noise cannot be told
    from motion between them, so it has a prior: no more than the instrument's noise and so much of
    what the motion does within h,

        n² = n_0² + f² (0.62 q_b h³ + 0.45 q_a h⁵),   q_b = 4 σ_b² (√3/l_b)³,   q_a = 16/3 σ_a²
        (√5/l_a)⁵,

    q being the spectral density of the white noise that drives the Matérn process. The constants
    come from ``benchmarks/calibration.py`` (``docs/calibration.md``).
    """

    correlated_share: float = 0.7
    correlation_intervals: float = 0.7
    motion_share: float = 0.015
    length_prior: tuple[float, float] = (math.log(1.2), 0.7)
    noise_prior_std: float = 0.25
    shortest: float = 1.5  # of l_a and l_b, in sample intervals

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """Smooth, rough, correlated noise."""
        return (Matern52(), Matern32(), Exponential())

    def natural(self, theta: Array, grid: Grid) -> tuple[Array, Array]:
        """Add the two parts of the noise."""
        s_a, l_a, s_b, l_b, n_0 = np.exp(theta)
        h, f = grid.interval, self.motion_share
        smooth = f**2 * 0.45 * h**5 * 16.0 / 3.0 * s_a**2 * (math.sqrt(5.0) / l_a) ** 5
        rough = f**2 * 0.62 * h**3 * 4.0 * s_b**2 * (math.sqrt(3.0) / l_b) ** 3
        variance = n_0**2 + smooth + rough
        slope = np.array([2 * smooth, -5 * smooth, 2 * rough, -3 * rough, 2 * n_0**2]) / variance
        log_noise = 0.5 * math.log(variance)
        correlated = log_noise + 0.5 * math.log(self.correlated_share)
        white = log_noise + 0.5 * math.log(1.0 - self.correlated_share)
        natural = np.array(
            [*theta[:4], correlated, math.log(self.correlation_intervals * h), white]
        )
        jacobian = np.zeros((7, 5))
        jacobian[:4, :4] = np.eye(4)
        jacobian[4] = jacobian[6] = 0.5 * slope
        return natural, jacobian

    def log_prior(self, theta: Array, grid: Grid) -> tuple[float, Array, Array]:
        """Normal in log l_a; falling off in log n_0 above the soft limit."""
        gradient, curvature = np.zeros(5), np.zeros(5)
        centre, std = self.length_prior
        length = (theta[1] - centre) / std
        gradient[1] = -length / std
        noise = max(theta[4] - math.log(grid.soft_limit), 0.0) / self.noise_prior_std
        gradient[4] = -noise / self.noise_prior_std
        curvature[1] = 1.0 / std**2
        curvature[4] = (noise > 0.0) / self.noise_prior_std**2
        return -0.5 * (length**2 + noise**2), gradient, curvature

    def bounds(self, grid: Grid) -> Bounds:
        """From far below to far above what the data show."""
        signal = (math.log(1e-4 * grid.spread), math.log(100.0 * grid.spread))
        length = (math.log(self.shortest * grid.interval), math.log(_LONGEST))
        highest = max(grid.spread, 10.0 * grid.least_noise)
        return [signal, length, signal, length, (math.log(grid.least_noise), math.log(highest))]

    def starts(self, grid: Grid) -> list[Array]:
        """Fast or slow smooth motion, fast or slow rough motion, clean or noisy samples."""
        lengths = (4.0 * grid.interval, 1.5)
        rough = ((6.0 * grid.interval, 2.0), (5.0, 2.0))
        noises = (3e-5, 4e-4, 3e-3)
        return [
            np.log([grid.spread, l_a, grid.spread * math.exp(-less), l_b, noise])
            for l_a, (l_b, less), noise in product(lengths, rough, noises)
        ]


MODELS: MappingProxyType[str, Model] = MappingProxyType(
    {
        "matern52": SmoothAndRough(),
        "matern32": OneKernel(Matern32()),
        "squared_exponential": OneKernel(SquaredExponential()),
    }
)
"""The models by the name of the parameter ``gp.kernel``."""
