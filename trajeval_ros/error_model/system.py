# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The regression of an estimate's error on its process, and what is asked of it.

With m = 6 k states a pose, k components each of translation and rotation, each on three axes,

    z_i = s_i[:6] + K_i θ + r_i,   r_i ~ N(0, R_i);     s_(i+1) = F_i s_i + w_i,   w_i ~ N(0, Q_i).

`information` answers in NumPy, `band` in C. Arrays of the steps have the step as their last axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

AXES = 3
PREDICTED = 6
"""Rows of an error, and the states that it is seen by."""


@dataclass(frozen=True, slots=True)
class System:
    """N poses and the steps between them.

    covariance: V (N, 6, 6), and jitter, the variances by group (N, 2), beside it: R. nuisances
    (N, 6, c) and gauge (N, 6, d): K. errors: z (N, 6). travel: what headings turn, (N - 1, 3).
    moves, noise, precision: F, Q and Q⁻¹ of each group, (2, k, k, N - 1). prior: the precision of
    the first states, (2, k, k), zero where they are free.
    """

    covariance: Array
    jitter: Array
    nuisances: Array
    gauge: Array
    errors: Array
    travel: Array
    moves: Array
    noise: Array
    precision: Array
    prior: Array

    @property
    def columns(self) -> Array:
        """K, (N, 6, c + d)."""
        if not self.gauge.shape[2]:
            return self.nuisances
        return np.concatenate([self.nuisances, self.gauge], axis=2)

    @property
    def both(self) -> Array:
        """K and z, (N, 6, c + d + 1)."""
        return np.concatenate([self.columns, self.errors[..., None]], axis=2)

    @property
    def predicted(self) -> int:
        """The first pose that is predicted: the second where the first error is free."""
        return int(not self.prior[:, 0, 0].all())


@dataclass(frozen=True, slots=True)
class Slopes:
    """By the p parameters of each group.

    noise: of Q, (p, 2, k, k, N - 1). moves: of F by the last one, (2, k, k, N - 1). prior: of the
    prior, (p, 2, k, k).
    """

    noise: Array
    moves: Array
    prior: Array


@dataclass(frozen=True, slots=True)
class Told:
    """What the data say, θ being what it is with the covariance that it has.

    states: (N, m). scores: ``R⁻¹ (z - s - K θ)``, (N, 6). Sums over the three axes of each group:

    weight, known, squares: of R⁻¹, of the scores' covariance, of their squares; (2, N).
    moved, earlier: the covariance of the moves, and of the states with those that follow; moves,
    mixed: the products of these as estimated; (2, k, k, N - 1). first: the covariance of the first
    states, (2, k, k).
    """

    states: Array
    scores: Array
    weight: Array
    known: Array
    squares: Array
    moved: Array
    earlier: Array
    moves: Array
    mixed: Array
    first: Array


class Regressed(Protocol):
    """A system with its states integrated out.

    normal: the normal equations of K and z without them, (c + d + 1, c + d + 1). noise_log_det,
    log_det: of all R, and of the information of the states.
    """

    normal: Array
    noise_log_det: float
    log_det: float

    def told(self, theta: Array, root: Array) -> Told:
        """What the data say at θ (c + d,), with ``root root`` transposed its covariance."""

    def average(self, told: Told, slopes: Slopes) -> tuple[Array, Array]:
        """Twice the average information before θ is integrated out, and what both have in common.

        (2p, 2p) and (c + d, 2p), the parameters by group.
        """

    def whitened(self) -> Array:
        """K and z less what those before predict, whitened; (N, 6, c + d + 1), or (N - 1, ...)."""


def inverse(blocks: Array) -> tuple[Array, float]:
    """The inverses of symmetric (..., k, k, n), k ≤ 2, and the sum of their log-determinants.

    Raises numpy.linalg.LinAlgError where one is not positive definite.
    """
    if blocks.shape[-2] == 1:
        determinant, adjugate = blocks[..., 0, 0, :], np.ones_like(blocks)
    else:
        determinant = blocks[..., 0, 0, :] * blocks[..., 1, 1, :] - blocks[..., 0, 1, :] ** 2
        adjugate = np.empty_like(blocks)
        adjugate[..., 0, 0, :], adjugate[..., 1, 1, :] = blocks[..., 1, 1, :], blocks[..., 0, 0, :]
        adjugate[..., 0, 1, :] = adjugate[..., 1, 0, :] = -blocks[..., 0, 1, :]
    if not (determinant > 0.0).all():
        raise np.linalg.LinAlgError("a step without noise")
    return adjugate / determinant[..., None, None, :], float(np.log(determinant).sum())
