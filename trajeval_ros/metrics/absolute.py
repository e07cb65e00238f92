# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The generalized absolute error with exact residuals (``docs/method.md``, section 4).

With the residuals ``eps_i(g) = Log(T_gt_i^-1 g T_est_i)`` under an alignment g, the absolute
likelihood is the integral of ``N(eps(g); 0, V)`` over the gauge. Its Laplace approximation is

    -1/2 (chi2(g*) + log|V| + log|Lambda| + (6 M - d) log 2 pi),    Lambda = J^T V^-1 J,

at the g* that minimises ``chi2 = eps^T V^-1 eps``, with J the residuals' derivative by the
gauge's d freedoms (see `gauge` for the measure).
"""

import enum
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.metrics.band import BandFactor, BandWhitener
from trajeval_ros.metrics.gauge import SE3, Gauge, Similarity
from trajeval_ros.metrics.gaussian import NOTHING, CovarianceError, GaussianLogLikelihood
from trajeval_ros.metrics.information import Information
from trajeval_ros.metrics.relative import covariance_blocks
from trajeval_ros.metrics.umeyama import align_positions

Array = npt.NDArray[np.float64]


def absolute_residual(ground_truth: Array, aligned: Array) -> Array:
    """``eps_i = Log(T_gt_i^-1 T_i)`` of aligned estimates.

    ground_truth, aligned: (M, 4, 4), in one world. Returns (M, 6), metres and radians, body frame.
    """
    return se3.log(se3.inverse(ground_truth) @ aligned)


def pose_alignment(ground_truth: Array, estimate: Array, gauge: Gauge) -> Similarity:
    """The alignment in which one pose of the estimate has the ground truth's place.

    ground_truth, estimate: (4, 4), of the same instant. In a gauge without roll and pitch, that of
    the yaw nearest the ground truth's. The scale is 1.
    """
    pose = np.eye(4)
    if gauge.dimension == 0:
        return Similarity(pose, 1.0)
    rotation = ground_truth[:3, :3] @ estimate[:3, :3].T
    if 3 not in gauge.free:
        yaw = np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
        rotation = se3.exp_so3(np.array([0.0, 0.0, yaw]))
    pose[:3, :3] = rotation
    pose[:3, 3] = ground_truth[:3, 3] - rotation @ estimate[:3, 3]
    return Similarity(pose, 1.0)


class Ending(enum.StrEnum):
    """How the search for the best alignment ended."""

    CONVERGED = "converged"
    """Another step would gain less than a billionth of a nat, or than round-off."""
    STALLED = "stalled"
    """No step, however short, gains anything, yet the gradient is not zero."""
    ITERATION_LIMIT = "iteration_limit"
    """It was still gaining after the last step allowed."""


@dataclass(frozen=True, slots=True)
class Absolute:
    """The absolute error of a set of poses, under the alignment that makes it likeliest.

    likelihood: the integral over the gauge, by Laplace's approximation.
    alignment: g*, the likelihood-weighted alignment.
    covariance: of the alignment, (7, 7), as in `Gauge.covariance`.
    residual: eps(g*), (M, 6), body frame.
    ending, iterations: of the search.
    """

    likelihood: GaussianLogLikelihood
    alignment: Similarity
    covariance: Array
    residual: Array
    ending: Ending
    iterations: int


_MAX_ITERATIONS = 100
# A converged step may gain this much chi2, or this share of it: the sum's round-off.
_GAIN = 1e-9
_GAIN_SHARE = 1e-13
_MAX_DAMPING = 1e12


@dataclass(frozen=True, slots=True)
class _Problem:
    """Residuals, whitened, as functions of the alignment."""

    ground_truth: Array
    estimate: Array
    factor: BandFactor
    gauge: Gauge
    centre: Array

    def residual(self, alignment: Similarity) -> tuple[Array, Array]:
        aligned = alignment.apply(self.estimate)
        return absolute_residual(self.ground_truth, aligned), aligned

    def chi2(self, alignment: Similarity) -> float:
        residual, _ = self.residual(alignment)
        return float((self.factor.whiten(residual) ** 2).sum())

    def linearize(self, alignment: Similarity) -> Information:
        residual, aligned = self.residual(alignment)
        jacobian = self.gauge.jacobian(residual, aligned, self.centre)
        columns = np.concatenate([jacobian, residual[..., None]], axis=-1)
        none = Information.none(self.gauge.dimension)
        return none.absorb(self.factor.whiten(columns), self.factor.log_det)


def _start(problem: _Problem) -> Similarity:
    """The likelier one of Umeyama's alignment, of positions, and that of the middle pose.

    Where positions do not determine an alignment (a robot at rest), or nearly so, orientations do.
    """
    gauge = problem.gauge
    middle = len(problem.estimate) // 2
    by_pose = pose_alignment(problem.ground_truth[middle], problem.estimate[middle], gauge)
    found = align_positions(problem.estimate[:, :3, 3], problem.ground_truth[:, :3, 3], gauge.name)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = found.rotation, found.translation
    by_position = Similarity(pose, float(found.scale))
    return min(by_position, by_pose, key=problem.chi2)


def _damped(information: Information, damping: float) -> Array:
    """The Levenberg-Marquardt step, scaled by the information's diagonal."""
    dimension = len(information.offset)
    scale = np.sqrt(damping) * np.linalg.norm(information.root, axis=0)
    rows = np.concatenate([np.diag(scale), np.zeros((dimension, 1))], axis=1)
    return information.absorb(rows, 0.0).optimum()


def _minimize(problem: _Problem, alignment: Similarity) -> tuple[Similarity, Ending, int]:
    """Gauss-Newton, damped where a step would not gain."""
    damping = 0.0
    chi2 = problem.chi2(alignment)
    for iteration in range(_MAX_ITERATIONS):
        information = problem.linearize(alignment)
        gain = float((information.offset**2).sum())
        if gain <= _GAIN + _GAIN_SHARE * chi2:
            return alignment, Ending.CONVERGED, iteration
        while True:
            step = _damped(information, damping) if damping else information.optimum()
            proposal = problem.gauge.perturb(alignment, problem.centre, step)
            proposed = problem.chi2(proposal)
            if proposed < chi2:
                break
            damping = max(10.0 * damping, 1e-3)
            if damping > _MAX_DAMPING:
                return alignment, Ending.STALLED, iteration
        alignment, chi2 = proposal, proposed
        damping = damping / 10.0 if damping > 1e-6 else 0.0
    return alignment, Ending.ITERATION_LIMIT, _MAX_ITERATIONS


def absolute(
    ground_truth: Array,
    covariance: Array,
    estimate: Array,
    gauge: Gauge = SE3,
    start: Similarity | None = None,
) -> Absolute:
    """The absolute error of a whole set of poses, fully nonlinear.

    ground_truth, estimate: (M, 4, 4), M > 0, each in a world of its own.
    covariance: as in `relative.covariance_blocks`.
    start: where the search begins; Umeyama's alignment, or a pose's, if not given.

    Raises CovarianceError where the covariance is not positive definite, ValueError where there is
    no pose or one is not finite.
    """
    if len(ground_truth) == 0:
        raise ValueError("there is no pose to align")
    blocks = covariance_blocks(covariance, 0 if covariance.ndim == 3 else covariance.shape[1] - 1)
    centre = ground_truth[:, :3, 3].mean(axis=0)
    problem = _Problem(ground_truth, estimate, BandFactor.of(blocks), gauge, centre)
    best, ending, iterations = _minimize(problem, _start(problem) if start is None else start)
    information = problem.linearize(best)
    return Absolute(
        information.integral(),
        best,
        gauge.covariance(best, centre, information.covariance()),
        problem.residual(best)[0],
        ending,
        iterations,
    )


def _next_anchoring(count: int) -> int:
    """After how many poses the anchor is moved next: 1, 2, 4 ... 64, 128, 192 ..."""
    return (
        1 << count.bit_length()
        if count < _POSES_PER_ANCHOR
        else ((count // _POSES_PER_ANCHOR + 1) * _POSES_PER_ANCHOR)
    )


_POSES_PER_ANCHOR = 64


class RunningAbsolute:
    """The absolute likelihood over a trajectory that arrives batch by batch, in bounded memory.

    Each residual is exact at an anchor, the alignment that was the best when its pose came, and is
    linear in the alignment from there. The first anchor is the alignment of the first pose; after
    1, 2, 4 ... 64, 128, 192 ... poses it moves to the alignment that is best by then, and so does
    the centre of perturbations, to the last pose. What was summed before is carried over to first
    order. So the figures depend on the poses alone, and not on how they are cut into batches.
    """

    def __init__(self, gauge: Gauge = SE3, bandwidth: int = 0) -> None:
        """bandwidth: the block bandwidth of V; 0 where poses' errors are independent."""
        self._gauge = gauge
        self._bandwidth = bandwidth
        self._whitener = BandWhitener(bandwidth, gauge.dimension + 1)
        self._anchor: Similarity | None = None
        self._centre = np.zeros(3)
        self._information = Information.none(gauge.dimension)
        self._count = 0

    @property
    def total(self) -> GaussianLogLikelihood:
        """The log-likelihood so far, d degrees of freedom less than there are errors."""
        return self._information.integral() if self._count else NOTHING

    @property
    def alignment(self) -> Similarity | None:
        """The best alignment so far; None before the first pose."""
        if self._anchor is None:
            return None
        return self._gauge.perturb(self._anchor, self._centre, self._information.optimum())

    @property
    def covariance(self) -> Array | None:
        """The covariance of `alignment`, (7, 7), as in `Gauge.covariance`."""
        alignment = self.alignment
        if alignment is None:
            return None
        return self._gauge.covariance(alignment, self._centre, self._information.covariance())

    def update(self, ground_truth: Array, covariance: Array, estimate: Array) -> None:
        """Take the next poses.

        Arguments as for `RunningRelative.update`, and errors; but where one is raised, some of the
        poses before the wrong one may have been taken.
        """
        blocks = covariance_blocks(covariance, self._bandwidth)
        start = 0
        while start < len(ground_truth):
            piece = slice(start, start + _next_anchoring(self._count) - self._count)
            try:
                self._take(ground_truth[piece], blocks[piece], estimate[piece])
            except CovarianceError as wrong:
                raise CovarianceError(start + wrong.index) from None
            start = piece.stop

    def _take(self, ground_truth: Array, blocks: Array, estimate: Array) -> None:
        if self._anchor is None:
            anchor, centre = (
                pose_alignment(ground_truth[0], estimate[0], self._gauge),
                ground_truth[0, :3, 3].copy(),
            )
        else:
            anchor, centre = self._anchor, self._centre
        aligned = anchor.apply(estimate)
        residual = absolute_residual(ground_truth, aligned)
        if not np.isfinite(residual).all():
            raise ValueError("a pose is not finite")
        jacobian = self._gauge.jacobian(residual, aligned, centre)
        columns = np.concatenate([jacobian, residual[..., None]], axis=-1)
        white, log_det = self._whitener.update(blocks, columns)
        self._information = self._information.absorb(
            white.reshape(-1, columns.shape[-1]), float(log_det.sum())
        )
        self._anchor, self._centre = anchor, centre
        before = self._count
        self._count += len(ground_truth)
        if self._count == _next_anchoring(before):
            self._move_anchor(ground_truth[-1, :3, 3].copy())

    def _move_anchor(self, centre: Array) -> None:
        assert self._anchor is not None
        dimension = self._gauge.dimension
        delta = self._information.optimum()
        change = np.eye(dimension + 1)
        change[:-1, :-1] = self._gauge.rebase(delta, centre - self._centre)
        change[:-1, -1] = delta
        self._anchor = self._gauge.perturb(self._anchor, self._centre, delta)
        self._information = self._information.change(change[:-1, :-1], delta)
        self._whitener.transform(change)
        self._centre = centre
