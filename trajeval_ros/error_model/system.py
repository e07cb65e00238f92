# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The regression of an estimate's error on its process, and what is asked of it.

With m = 6 k states a pose, k components each of translation and rotation, each on three axes,

    z_i = s_i[:6] + K_i θ + r_i,   r_i ~ N(0, R_i);     s_(i+1) = F_i s_i + w_i,   w_i ~ N(0, Q_i).

`information` answers in NumPy, `band` in C. Arrays of the steps have the step as their last axis.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

AXES = 3
PREDICTED = 6
"""Rows of an error, and the states that it is seen by."""


class System(NamedTuple):
    """N poses and the steps between them.

    covariance: V (N, 6, 6), and jitter, the variances by group (N, 2), beside it: R. nuisances
    (N, 6, c) and gauge (N, 6, d): K. errors: z (N, 6). travel: what headings turn, (N - 1, 3).
    moves, noise, precision: F, Q and Q⁻¹ of each group, (2, k, k, N - 1). prior: the precision of
    the first states, (2, k, k), zero where they are free. process_log_det: of all states'
    covariance by the process, free ones left out.
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
    process_log_det: float

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


class Slopes(NamedTuple):
    """By the p parameters of each group.

    noise: of Q, (p, 2, k, k, N - 1). moves: of F by the last one, (2, k, k, N - 1). prior: of the
    prior, (p, 2, k, k).
    """

    noise: Array
    moves: Array
    prior: Array


class Told(NamedTuple):
    """What the data say, θ being what it is with the covariance that it has.

    states: (N, m). scores: ``R⁻¹ (z - s - K θ)``, (N, 6), and felt, those of the steps' moves,
    ``Q⁻¹ w``, (N - 1, m). Sums over the three axes of each group:

    squares, informed: of the scores of poses, the squares and the variances; (2, N). moves, moved:
    of those of steps, the products and the covariance; (2, k, k, N - 1). crossed: of the last
    component of the states with the scores of the steps that follow, the products less the
    covariance; (2, k, N - 1). first: the variance of this component at the first pose, (2,). The
    last two are nothing of a process without a time.
    """

    states: Array
    scores: Array
    felt: Array
    squares: Array
    informed: Array
    moves: Array
    moved: Array
    crossed: Array
    first: Array


class Regressed(Protocol):
    """A system with its states integrated out.

    normal: the normal equations of K and z without them, (c + d + 1, c + d + 1). log_det: of the
    covariance of the errors, what is free projected out.
    """

    normal: Array
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
