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
from functools import cache
from itertools import product
from types import MappingProxyType
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.kernels import (
    Exponential,
    Kernel,
    Matern32,
    Matern52,
    Matern72,
    SquaredExponential,
)
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Bounds = list[tuple[float, float]]

_LONGEST = 60.0  # s; beyond, σ and l act only together


class Grid(NamedTuple):
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
        interval = median(np.concatenate([np.diff(t) for t in times]))
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

    def numbers(self, grid: Grid) -> Numbers:
        """Return what `natural` and `log_prior` have of it."""
        ...

    def bounds(self, grid: Grid) -> Bounds:
        """Return the bounds of θ."""
        ...

    def starts(self, grid: Grid) -> list[Array]:
        """Return where the search may begin."""
        ...

    def common(self, grid: Grid) -> Array:
        """Return what motion is like that is not known yet."""
        ...


class Numbers(NamedTuple):
    """A model as ``lesson.c`` takes it.

    ``weights`` (k, 2): of the noise's variance ``n_0² + Σ w σ² l^-m`` m and w, of the first k
    kernels; ``share``: what is correlated of it, over ``time`` (s); ``prior`` (8,): the place of a
    length in θ, its logarithm's mean and standard deviation; of log n_0 from where to where it is
    usual, its standard deviations below and above, and how many of these the tail is off. Without a
    prior the place is -1.
    """

    weights: Array
    share: float
    time: float
    prior: Array


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

    def numbers(self, grid: Grid) -> Numbers:
        """Return white noise alone."""
        return Numbers(np.empty((0, 2)), 0.0, 1.0, np.array([-1.0, *[1.0] * 7]))

    def bounds(self, grid: Grid) -> Bounds:
        """From far below to far above what the data show."""
        return [
            (math.log(1e-4 * grid.spread), math.log(100.0 * grid.spread)),
            (math.log(0.5 * grid.interval), math.log(_LONGEST)),
            (math.log(grid.least_noise), math.log(grid.spread)),
        ]

    def common(self, grid: Grid) -> Array:
        """As motion in common is, over a second and more."""
        length = max(1.0, 2.0 * grid.interval)
        return np.log([0.3, length, grid.least_noise])

    def starts(self, grid: Grid) -> list[Array]:
        """Fast or slow motion, clean or noisy samples."""
        lengths, noises = (4.0 * grid.interval, 1.5), (1e-4, 3e-3, 3e-2)
        return [
            np.log([grid.spread, length, noise * grid.spread])
            for length, noise in product(lengths, noises)
        ]


class _Motion(NamedTuple):
    """A Matérn process of order m/2, driven by white noise of spectral density c σ² (√m/l)ᵐ.

    ``order`` m, ``density`` c, ``share`` w.
    """

    kernel: Kernel
    order: int
    density: float
    share: float


@dataclass(frozen=True, slots=True)
class MotionAndNoise:
    """Motion of three degrees of smoothness, and partly correlated noise.

    θ = log (σ, l) of Matérn 5/2, 7/2 and 3/2, and log n_0: which of the three rules between two
    samples is for the data to say. Noise of variance n² has a share C correlated over a time of κ
    sample intervals h, as a motion-capture system's filters have it. From thinned samples the noise
    cannot be told from motion between them, so part of it is so much of what the motion does in h,

        n² = n_0² + f² Σ_k w_k q_k hᵐ,   q_k = c_k σ_k² (√m/l_k)ᵐ,   m = 5, 7, 3,

    q being the spectral density of the white noise that drives a Matérn process, and n_0 has a
    prior: flat in log n_0 from a fifth of the soft limit to the limit, falling off on both sides,
    at last by a power only where it is large.
    Where rough motion can stand for the noise, the likelihood hardly falls as n_0 goes to zero, and
    the errors between the samples would be many times as large as such a process says: samples have
    to show that they are cleaner than usual. The constants come from ``performance/calibration.py``
    (``docs/calibration.md``).
    """

    correlated_share: float = 0.7
    correlation_intervals: float = 0.7
    motion_share: float = 0.012
    smooth_length: tuple[float, float] = (math.log(1.2), 0.7)  # of log l of Matérn 7/2, normal
    usual_noise: float = 0.2  # in soft limits
    noise_stds: tuple[float, float] = (0.4, 0.25)  # of log n_0, below what is usual and above
    noise_tail: float = 3.0  # standard deviations above, from which on the density is a power
    shortest: float = 1.5  # of l, in sample intervals
    motions: ClassVar[tuple[_Motion, ...]] = (
        _Motion(Matern52(), 5, 16.0 / 3.0, 0.45),
        _Motion(Matern72(), 7, 32.0 / 5.0, 0.36),
        _Motion(Matern32(), 3, 4.0, 0.62),
    )

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """Motion, smooth and rough motion, correlated noise."""
        return (*(motion.kernel for motion in self.motions), Exponential())

    def natural(self, theta: Array, grid: Grid) -> tuple[Array, Array]:
        """Add the parts of the noise."""
        pairs, n_0 = np.exp(theta[:-1]).tolist(), math.exp(theta[-1])
        within = [
            self.motion_share**2
            * motion.share
            * motion.density
            * std**2
            * (math.sqrt(motion.order) * grid.interval / length) ** motion.order
            for motion, std, length in zip(self.motions, pairs[::2], pairs[1::2], strict=True)
        ]
        variance = n_0**2 + math.fsum(within)
        log_noise = 0.5 * math.log(variance)
        noises = [
            log_noise + 0.5 * math.log(self.correlated_share),
            math.log(self.correlation_intervals * grid.interval),
            log_noise + 0.5 * math.log(1.0 - self.correlated_share),
        ]
        slopes = [
            0.5 * (slope * v) / variance
            for motion, v in zip(self.motions, within, strict=True)
            for slope in (2.0, -motion.order)
        ]
        jacobian = _identity(len(theta)).copy()
        jacobian[-3] = jacobian[-1] = [*slopes, n_0**2 / variance]
        return np.array([*theta[:-1].tolist(), *noises]), jacobian

    def log_prior(self, theta: Array, grid: Grid) -> tuple[float, Array, Array]:
        """Normal in log l of Matérn 7/2; flat in log n_0 where it is usual, with normal tails."""
        gradient, curvature = np.zeros(len(theta)), np.zeros(len(theta))
        centre, std = self.smooth_length
        length = (theta[3] - centre) / std
        gradient[3], curvature[3] = -length / std, 1.0 / std**2
        highest = math.log(grid.soft_limit)
        usual = min(max(theta[-1], highest + math.log(self.usual_noise)), highest)
        std = self.noise_stds[int(theta[-1] > usual)]
        noise = (theta[-1] - usual) / std
        # Satellites know a position to centimetres or metres: of that much noise a few segments
        # have to be enough evidence, so the tail above falls off by a power only.
        tail = min(noise, self.noise_tail)
        gradient[-1], curvature[-1] = -tail / std, float(tail == noise != 0.0) / std**2
        improbable = 0.5 * tail**2 + tail * (noise - tail)
        return -0.5 * length**2 - improbable, gradient, curvature

    def numbers(self, grid: Grid) -> Numbers:
        """Return the constants above."""
        weights = [
            (
                motion.order,
                self.motion_share**2
                * motion.share
                * motion.density
                * (math.sqrt(motion.order) * grid.interval) ** motion.order,
            )
            for motion in self.motions
        ]
        highest = math.log(grid.soft_limit)
        usual = highest + math.log(self.usual_noise), highest
        prior = (3, *self.smooth_length, *usual, *self.noise_stds, self.noise_tail)
        time = self.correlation_intervals * grid.interval
        return Numbers(np.array(weights, float), self.correlated_share, time, np.array(prior))

    def bounds(self, grid: Grid) -> Bounds:
        """From far below to far above what the data show."""
        signal = (math.log(1e-4 * grid.spread), math.log(100.0 * grid.spread))
        length = (math.log(self.shortest * grid.interval), math.log(_LONGEST))
        highest = max(grid.spread, 10.0 * grid.least_noise)
        noise = (math.log(grid.least_noise), math.log(highest))
        return [signal, length] * len(self.motions) + [noise]

    def common(self, grid: Grid) -> Array:
        """As motion in common is, over a second and more."""
        length = max(1.2, 2.0 * grid.interval)
        return np.log([0.1, length, 0.3, length, 0.02, length, grid.least_noise])

    def starts(self, grid: Grid) -> list[Array]:
        """Fast or slow smooth motion, fast or slow rougher motion, clean or noisy samples."""
        lengths = (4.0 * grid.interval, 1.5)
        rougher = ((6.0 * grid.interval, math.exp(-2.0)), (5.0, math.exp(-2.0)))
        noises = (3e-5, 4e-4, 3e-3, 5e-2)
        s = grid.spread
        return [
            np.log([s * less, rough, s, smooth, s * less**2, rough, noise])
            for smooth, (rough, less), noise in product(lengths, rougher, noises)
        ]


@cache
def _identity(parameters: int) -> Array:
    """Two rows more than parameters; not to be written to."""
    return np.eye(parameters + 2, parameters)


MODELS: MappingProxyType[str, Model] = MappingProxyType(
    {
        "matern52": MotionAndNoise(),
        "matern32": OneKernel(Matern32()),
        "squared_exponential": OneKernel(SquaredExponential()),
    }
)
"""The models by the name of the parameter ``gp.kernel``."""
