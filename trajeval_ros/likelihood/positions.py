# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likelihood of an estimate against positions without orientations.

The ground truth is a point of the body, an antenna or a prism, at ``l`` in the body's frame. Under
an alignment g = (R, t, s) the residuals are three numbers a pose, ::

    r_i(g, l) = p_i - (s R p_est_i + t) - R R_est_i l,        r ~ N(0, V)

with l a nuisance that the estimate's own orientation turns. The absolute likelihood is the integral
of ``N(r(g, l); 0, V)`` over the gauge, as for poses (`absolute`), and over l under a prior, by
Laplace at the likeliest g and l.

The relative one is that of the displacements ``r_i - r_{i-1}`` from each pose to the next. They do
not contain the world's translation; its rotation (and scale), and l, are integrated out. To first
order the two are one: with D the differences, ``|D V D^T| = |V| |1^T V^-1 1| |D D^T| / |1^T 1|``
a coordinate, ``|D D^T| = 1^T 1 = M``, and ``D^T (D V D^T)^-1 D`` is what of V^-1 is left once the
translation is projected out.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack, se3
from trajeval_ros.alignment.gauge import Gauge, Similarity
from trajeval_ros.alignment.umeyama import Alignment, align_positions
from trajeval_ros.likelihood.gaussian import CovarianceError
from trajeval_ros.likelihood.information import Information

Array = npt.NDArray[np.float64]

LEVER_ARM_STD = 10.0
"""Of l's prior, m, an axis: an antenna is on the robot."""

_MAX_ITERATIONS = 50
# chi2 does not fall any more by this share, or by this much.
_GAIN, _GAIN_SHARE = 1e-9, 1e-14


class PositionState(NamedTuple):
    """A place where the residuals are linear about: an alignment, and the lever arm, (3,)."""

    alignment: Similarity
    lever_arm: Array


class PositionProblem(NamedTuple):
    """Residuals as a function of the alignment and the lever arm.

    positions: (M, 3), about their ``origin`` in the world.

    covariance: (M, 3, 3); factor: of each. estimate: (M, 4, 4). centre: of the gauge's
    perturbations, (3,), from the origin.
    """

    origin: Array
    positions: Array
    covariance: Array
    factor: Array
    estimate: Array
    gauge: Gauge
    centre: Array

    @staticmethod
    def of(positions: Array, covariance: Array, estimate: Array, gauge: Gauge) -> PositionProblem:
        """Of positions in the world, as in `running_positions.position_error`.

        Raises CovarianceError where a covariance is not positive definite.
        """
        # Coordinates of a country are large, and differences of them small.
        origin = positions.mean(axis=0)
        factor = factors(covariance)
        return PositionProblem(
            origin, positions - origin, covariance, factor, estimate, gauge, np.zeros(3)
        )

    def start(self) -> PositionState:
        """Umeyama's alignment of the positions, and no lever arm."""
        source, target = self.estimate[:, :3, 3], self.positions
        return started(align_positions(source, target, self.gauge.name), self.gauge, -self.origin)

    def residual(self, state: PositionState) -> tuple[Array, Array, Array]:
        """R, (M, 3); the aligned positions of the body, and what the lever arm adds to them."""
        aligned = state.alignment.apply(self.estimate)
        arm = (aligned[:, :3, :3] @ state.lever_arm[:, None])[..., 0]
        return self.positions - aligned[:, :3, 3] - arm, aligned, arm

    def columns(self, state: PositionState) -> Array:
        """``[J r]``, (M, 3, d + 4): the residual's derivatives by the gauge and by l, and r."""
        residual, aligned, arm = self.residual(state)
        body = aligned[:, :3, 3] - self.centre
        columns = np.zeros((len(residual), 3, 11))
        columns[..., :3] = -np.eye(3)
        columns[..., 3:6] = se3.hat(body + arm)
        columns[..., 6] = -body
        columns[..., 7:10] = -aligned[:, :3, :3]
        columns[..., 10] = residual
        return columns[..., [*self.gauge.free, 7, 8, 9, 10]]

    def whitened(self, columns: Array) -> Array:
        """``L^-1 X`` of X (M, 3, c); (3 M, c)."""
        white = np.linalg.solve(self.factor, columns)
        return np.asarray(white.reshape(-1, columns.shape[-1]))

    def linearized(self, state: PositionState) -> Information:
        """What the residuals, linear about a state, say of its change."""
        log_det = 2.0 * float(np.log(np.einsum("mii->mi", self.factor)).sum())
        found = Information.none(self.gauge.dimension + 3)
        found = found.absorb(*prior(self.gauge, state))
        return found.absorb(self.whitened(self.columns(state)), log_det)

    def chi2(self, state: PositionState) -> float:
        """What is minimised."""
        residual, _, _ = self.residual(state)
        return float((self.whitened(residual[..., None]) ** 2).sum()) + prior_chi2(state)

    def moved(self, state: PositionState, delta: Array) -> PositionState:
        """The state changed by (d + 3,)."""
        return moved(self.gauge, self.centre, state, delta)


def started(found: Alignment, gauge: Gauge, unmoved: Array) -> PositionState:
    """The state of an alignment of positions; ``unmoved``: its translation in the gauge `none`."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = found.rotation, found.translation
    if gauge.dimension == 0:
        pose[:3, 3] = unmoved
    return PositionState(Similarity(pose, float(found.scale)), np.zeros(3))


def prior(gauge: Gauge, state: PositionState) -> tuple[Array, float]:
    """What l's prior says of a change of it: whitened columns, (3, d + 4), and log|V|."""
    rows = np.zeros((3, gauge.dimension + 4))
    rows[:, -4:-1] = np.eye(3) / LEVER_ARM_STD
    rows[:, -1] = state.lever_arm / LEVER_ARM_STD
    return rows, 6.0 * float(np.log(LEVER_ARM_STD))


def prior_chi2(state: PositionState) -> float:
    """What l is off its prior by."""
    return float(state.lever_arm @ state.lever_arm) / LEVER_ARM_STD**2


def moved(gauge: Gauge, centre: Array, state: PositionState, delta: Array) -> PositionState:
    """The state changed by (d + 3,), the gauge's perturbation being about a centre."""
    step = delta[:-3].copy()
    if gauge.has_scale:
        step[-1] = max(step[-1], -0.9)
    return PositionState(gauge.perturb(state.alignment, centre, step), state.lever_arm + delta[-3:])


def factors(covariance: Array) -> Array:
    """``L`` of covariances, (M, 3, 3). Raises CovarianceError where one is none."""
    try:
        return np.asarray(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        for index, matrix in enumerate(covariance):
            try:
                np.linalg.cholesky(matrix)
            except np.linalg.LinAlgError:
                raise CovarianceError(index) from None
        raise


class Searchable(Protocol):
    """Residuals whose likeliest state can be sought."""

    def start(self) -> PositionState:
        """Where the search begins."""

    def linearized(self, state: PositionState) -> Information:
        """What the residuals, linear about a state, and the prior of l say of its change."""

    def chi2(self, state: PositionState) -> float:
        """What is minimised."""

    def moved(self, state: PositionState, delta: Array) -> PositionState:
        """The state changed by (d + 3,)."""


def searched(problem: Searchable) -> PositionState:
    """The likeliest state, by damped Gauss-Newton steps."""
    state = problem.start()
    chi2, damping = problem.chi2(state), 0.0
    for _ in range(_MAX_ITERATIONS):
        information = problem.linearized(state)
        while True:
            proposal = problem.moved(state, _step(information, damping))
            proposed = problem.chi2(proposal)
            if proposed < chi2 or damping > 1e12:
                break
            damping = max(10.0 * damping, 1e-6)
        gained = chi2 - proposed
        if not gained > _GAIN + _GAIN_SHARE * chi2:
            return proposal if gained > 0.0 else state
        state, chi2, damping = proposal, proposed, damping / 10.0 if damping > 1e-5 else 0.0
    return state


def _step(information: Information, damping: float) -> Array:
    """The best change, held back; nothing along what is not determined at all."""
    diagonal = np.linalg.norm(information.root, axis=0)
    size = float(np.sqrt(max(damping, 1e-15))) * np.where(diagonal > 0.0, diagonal, 1.0)
    rows = np.concatenate([np.diag(size), np.zeros((len(size), 1))], axis=1)
    return information.absorb(rows, 0.0).optimum()


def whitened(here: Array, before: Array, columns: Array) -> tuple[Array, float]:
    """``L^-1 X`` and ``log |L L^T|`` of a block-tridiagonal covariance.

    here: (N, 3, 3). before: (N - 1, 3, 3), of each with the one before it. columns: X, (N, 3, c).

    Raises CovarianceError where it is not positive definite.
    """
    size = 3 * len(here)
    # In LAPACK's lower band storage: element (j + k, j) in row k.
    band = np.zeros((6, size))
    for column in range(3):
        for row in range(column, 3):
            band[row - column, column::3] = here[:, row, column]
        for row in range(3):
            band[3 + row - column, column : size - 3 : 3] = before[:, row, column]
    factor, wrong = lapack.dpbtrf(band, lower=1)
    if wrong:
        raise CovarianceError((wrong - 1) // 3)
    white, _ = lapack.dtbtrs(factor, columns.reshape(size, -1), uplo="L")
    return np.asarray(white), 2.0 * float(np.log(factor[0]).sum())
