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

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Gauge, Similarity
from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.likelihood.gaussian import CovarianceError, GaussianLogLikelihood
from trajeval_ros.likelihood.information import Information

Array = npt.NDArray[np.float64]

LEVER_ARM_STD = 10.0
"""Of l's prior, m, an axis: an antenna is on the robot."""

_MAX_ITERATIONS = 50
# chi2 does not fall any more by this share, or by this much.
_GAIN, _GAIN_SHARE = 1e-9, 1e-14
# What is known no better than this, rad or 1, is not determined.
_UNDETERMINED = 0.3
# The motion that shows a rotation is larger than the errors by this factor, per axis.
_SHOWN = 1.5
_STRETCHES = (40, 20)


@dataclass(frozen=True, slots=True)
class PositionError:
    """The errors of a set of positions, under the alignment and lever arm that are likeliest.

    The covariance is the larger of that of the ground truth's noise alone and that which the
    scatter of the scores over forty and over twenty stretches shows (White): an estimate has errors
    of its own. Of fewer than three poses for each unknown there is no such scatter, and it is that
    of the noise times chi2 a degree of freedom. Of an estimate that drifts through the whole run it
    is too small all the same.

    absolute, relative: their likelihoods; None where the motion does not determine the alignment:
    the integral over it would be of what Laplace's approximation does not hold for.
    alignment: g*. lever_arm: l*, (3,), m, in the body's frame. covariance: of the gauge's freedoms,
    about ``centre``, and of l, (d + 3, d + 3).
    shows_lever_arm: whether l is what it seems. The likelihood takes the estimate's own motion to
    be exact; where that is no larger than the errors, it is noise that turns the alignment, and l
    with it.
    residual: r(g*, l*), (M, 3), world axes. step_residual: its differences, (M - 1, 3).
    """

    absolute: GaussianLogLikelihood | None
    relative: GaussianLogLikelihood | None
    alignment: Similarity
    lever_arm: Array
    centre: Array
    covariance: Array
    shows_lever_arm: bool
    residual: Array
    step_residual: Array

    @property
    def lever_arm_std(self) -> Array:
        """(3,), m; near 10 where the motion does not show it."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)[-3:]))


@dataclass(frozen=True, slots=True)
class PositionState:
    """A place where the residuals are linear about: an alignment, and the lever arm, (3,)."""

    alignment: Similarity
    lever_arm: Array


@dataclass(frozen=True, slots=True)
class PositionProblem:
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
        """Of positions in the world, as in :func:`position_error`.

        Raises CovarianceError where a covariance is not positive definite.
        """
        # Coordinates of a country are large, and differences of them small.
        origin = positions.mean(axis=0)
        factor = _factors(covariance)
        return PositionProblem(
            origin, positions - origin, covariance, factor, estimate, gauge, np.zeros(3)
        )

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

    def prior(self, state: PositionState) -> tuple[Array, float]:
        """What the prior says of a change of l: whitened columns, and log|V|."""
        rows = np.zeros((3, self.gauge.dimension + 4))
        rows[:, -4:-1] = np.eye(3) / LEVER_ARM_STD
        rows[:, -1] = state.lever_arm / LEVER_ARM_STD
        return rows, 6.0 * float(np.log(LEVER_ARM_STD))

    def linearized(self, state: PositionState) -> Information:
        """What the residuals, linear about a state, say of its change."""
        log_det = 2.0 * float(np.log(np.einsum("mii->mi", self.factor)).sum())
        found = Information.none(self.gauge.dimension + 3)
        found = found.absorb(*self.prior(state))
        return found.absorb(self.whitened(self.columns(state)), log_det)

    def chi2(self, state: PositionState) -> float:
        """What is minimised."""
        residual, _, _ = self.residual(state)
        arm = float(state.lever_arm @ state.lever_arm) / LEVER_ARM_STD**2
        return float((self.whitened(residual[..., None]) ** 2).sum()) + arm

    def moved(self, state: PositionState, delta: Array) -> PositionState:
        """The state changed by (d + 3,)."""
        step = delta[:-3].copy()
        if self.gauge.has_scale:
            step[-1] = max(step[-1], -0.9)
        alignment = self.gauge.perturb(state.alignment, self.centre, step)
        return PositionState(alignment, state.lever_arm + delta[-3:])


def position_error(
    positions: Array, covariance: Array, estimate: Array, gauge: Gauge
) -> PositionError:
    """The error of poses against positions.

    positions: (M, 3), M > 1, m. covariance: (M, 3, 3) of their errors, world axes, independent of
    each other. estimate: (M, 4, 4), in a world of its own, of the body that l is fixed to.

    Raises CovarianceError where a covariance is not positive definite, ValueError where there are
    fewer than two poses or one is not finite.
    """
    if len(positions) < 2:
        raise ValueError("there are not two poses")
    if not (np.isfinite(positions).all() and np.isfinite(estimate).all()):
        raise ValueError("a pose is not finite")
    problem = PositionProblem.of(positions, covariance, estimate, gauge)
    state = searched(problem)
    information = problem.linearized(state)
    residual, _, _ = problem.residual(state)
    determined = _is_determined(gauge, information)
    pose = state.alignment.pose.copy()
    pose[:3, 3] += problem.origin
    return PositionError(
        information.integral() if determined else None,
        _relative(problem, state) if determined else None,
        Similarity(pose, state.alignment.scale),
        state.lever_arm,
        problem.origin,
        _covariance(problem, state, information),
        determined and _is_shown(problem, state),
        residual,
        np.diff(residual, axis=0),
    )


def _factors(covariance: Array) -> Array:
    try:
        return np.asarray(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        for index, matrix in enumerate(covariance):
            try:
                np.linalg.cholesky(matrix)
            except np.linalg.LinAlgError:
                raise CovarianceError(index) from None
        raise


def searched(problem: PositionProblem) -> PositionState:
    """The likeliest state, from Umeyama's alignment by damped Gauss-Newton steps."""
    gauge = problem.gauge
    found = align_positions(problem.estimate[:, :3, 3], problem.positions, gauge.name)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = found.rotation, found.translation
    if gauge.dimension == 0:
        pose[:3, 3] = -problem.origin
    state = PositionState(Similarity(pose, float(found.scale)), np.zeros(3))
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


def _is_determined(gauge: Gauge, information: Information) -> bool:
    """Whether rotation and scale of the alignment are known to a third of a radian, or of one."""
    if not np.diagonal(information.root).all():
        return False
    std = np.sqrt(np.diagonal(information.covariance()))
    turns = [place for place, free in enumerate(gauge.free) if free >= 3]
    return bool((std[turns] < _UNDETERMINED).all())


def _is_shown(problem: PositionProblem, state: PositionState) -> bool:
    """Whether the body moves by more than the errors along what shows the free rotations."""
    gauge = problem.gauge
    if not any(free >= 3 for free in gauge.free):
        return True
    residual, aligned, _ = problem.residual(state)
    # A turn about the vertical shows along one horizontal axis, any turn along two.
    body, place = (
        (aligned[:, :2, 3], 0) if gauge.name == "yaw_translation" else (aligned[:, :3, 3], 1)
    )
    extent = np.linalg.svd(body - body.mean(axis=0), compute_uv=False)[place]
    return bool(extent >= _SHOWN * np.linalg.norm(residual) / np.sqrt(3.0))


def _covariance(problem: PositionProblem, state: PositionState, information: Information) -> Array:
    dimension = information.dimension
    if not np.diagonal(information.root).all():
        return np.full((dimension, dimension), np.inf)
    plain = information.covariance()
    white = problem.whitened(problem.columns(state))
    scores = white[:, :-1] * white[:, -1:]
    larger = np.ones(dimension)
    if len(problem.positions) // 3 <= dimension:
        freedom = max(len(white) - dimension, 1)
        larger = np.maximum(larger, float((white[:, -1] ** 2).sum()) / freedom)
    for wanted in _STRETCHES:
        stretches = min(wanted, len(problem.positions) // 3)
        if stretches <= dimension:
            break
        edges = 3 * np.linspace(0, len(problem.positions), stretches + 1).astype(int)[:-1]
        moved = np.add.reduceat(scores, edges, axis=0) @ plain
        variance = (moved**2).sum(axis=0) * stretches / (stretches - dimension)
        larger = np.maximum(larger, variance / np.diagonal(plain))
    larger = np.sqrt(larger)
    return np.asarray(plain * np.outer(larger, larger))


def _relative(problem: PositionProblem, state: PositionState) -> GaussianLogLikelihood:
    """The likelihood of the displacements, first order about a state."""
    columns = np.diff(problem.columns(state), axis=0)
    free = [place for place, free in enumerate(problem.gauge.free) if free >= 3]
    dimension = problem.gauge.dimension
    kept = [*free, *range(dimension, dimension + 4)]
    here, before = problem.covariance[1:] + problem.covariance[:-1], -problem.covariance[1:-1]
    try:
        white, of_steps = whitened(here, before, columns[..., kept])
    except CovarianceError as wrong:
        # Of a step, which ends at the pose after it.
        raise CovarianceError(min(wrong.index + 1, len(columns))) from None
    rows, log_det = problem.prior(state)
    found = Information.none(len(kept) - 1).absorb(rows[:, kept], log_det)
    return found.absorb(white, of_steps).integral()


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
