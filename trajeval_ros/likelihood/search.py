# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The search for the likeliest alignment: Gauss-Newton from a closed-form start.

See `absolute` for what is minimised.
"""

import enum
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Gauge, Similarity
from trajeval_ros.alignment.umeyama import (
    Alignment,
    align_positions,
    largest_trace_about,
    nearest_rotation,
)
from trajeval_ros.likelihood import independent
from trajeval_ros.likelihood.band import BandFactor
from trajeval_ros.likelihood.information import Information
from trajeval_ros.likelihood.joint import FactorRows

Array = npt.NDArray[np.float64]


class Ending(enum.StrEnum):
    """How the search for the best alignment ended."""

    CONVERGED = "converged"
    """Another step would gain less than a billionth of a nat, or than round-off."""
    STALLED = "stalled"
    """No step, however short, gains anything, yet the gradient is not zero."""
    ITERATION_LIMIT = "iteration_limit"
    """It was still gaining after the last step allowed."""


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


_MAX_ITERATIONS = 100
# Another step is not worth it if it would lower chi2 by less than this, or by this share.
_GAIN = 1e-9
_GAIN_SHARE = 1e-15
# A step that would lower it by less than this share, and does not, fails for round-off.
_ROUND_OFF = 1e-11
_MAX_DAMPING = 1e12


# So many poses at a time.
_PIECE = 4096


class Problem(NamedTuple):
    """Residuals, whitened, as functions of the alignment.

    ground_truth, estimate: (M, 4, 4). factor: of their covariance; or, of poses independent of each
    other where the loops are there, their covariances, (M, 6, 6). gauge: what is searched.
    centre: of the gauge's perturbations, (3,).
    """

    ground_truth: Array
    estimate: Array
    factor: BandFactor | FactorRows | Array
    gauge: Gauge
    centre: Array

    def residual(self, alignment: Similarity) -> tuple[Array, Array]:
        """The residuals, (M, 6), and the aligned estimates, (M, 4, 4)."""
        aligned = alignment.apply(self.estimate)
        return absolute_residual(self.ground_truth, aligned), aligned

    def residuals(self, alignment: Similarity) -> Array:
        """All residuals alone, (M, 6)."""
        found = np.empty((len(self.estimate), 6))
        for begin in range(0, len(found), _PIECE):
            here = slice(begin, begin + _PIECE)
            aligned = alignment.apply(self.estimate[here])
            found[here] = absolute_residual(self.ground_truth[here], aligned)
        return found

    def chi2(self, alignment: Similarity) -> float:
        """What is minimised."""
        if isinstance(self.factor, np.ndarray):
            poses = self.ground_truth, self.estimate, self.factor
            return independent.chi2(poses, alignment)
        return sum(
            float((factor.whiten(piece.residual(alignment)[0]) ** 2).sum())
            for piece, factor in self._pieces(self.factor)
        )

    def linearize(self, alignment: Similarity) -> Information:
        """What the residuals, linear about an alignment, say of its perturbation."""
        information = Information.none(self.gauge.dimension)
        if isinstance(self.factor, np.ndarray):
            poses = self.ground_truth, self.estimate, self.factor
            return independent.absorbed(information, poses, alignment, self.gauge, self.centre)
        for piece, factor in self._pieces(self.factor):
            residual, aligned = piece.residual(alignment)
            jacobian = self.gauge.jacobian(residual, aligned, self.centre)
            columns = np.concatenate([jacobian, residual[..., None]], axis=-1)
            information = information.absorb(factor.whiten(columns), factor.log_det)
        return information

    def _pieces(
        self, factor: BandFactor | FactorRows
    ) -> "Iterator[tuple[Problem, BandFactor | FactorRows]]":
        """Poses that are independent of each other a few at a time: a run may be long."""
        if isinstance(factor, FactorRows):
            yield self, factor
            return
        for here, part in factor.pieces(_PIECE):
            truth, estimate = self.ground_truth[here], self.estimate[here]
            yield self._replace(ground_truth=truth, estimate=estimate), part


# The scale never falls below this share of itself in one step.
_LEAST_SCALE = 0.1


def log_scale_std(gauge: Gauge, information: Information) -> float:
    """The standard deviation of the scale's logarithm, all other freedoms being unknown too."""
    if not gauge.has_scale:
        return 0.0
    # The scale is the last unknown, and the root upper triangular.
    root = abs(float(information.root[-1, -1]))
    return 1.0 / root if root > 0.0 else float("inf")


def best_perturbation(gauge: Gauge, information: Information) -> Array:
    """The best perturbation, (d,); the scale's is zero where nothing determines it."""
    if not gauge.has_scale:
        return information.optimum()
    if not np.isfinite(log_scale_std(gauge, information)):
        return np.append(information.leading(information.dimension - 1).optimum(), 0.0)
    delta = information.optimum()
    delta[-1] = max(delta[-1], _LEAST_SCALE - 1.0)
    return delta


def start_alignment(problem: Problem, *others: Similarity) -> Similarity:
    """Where to begin: the likeliest of Umeyama's alignment, the middle pose's, and others.

    Where positions do not determine an alignment (a robot at rest), or nearly so, orientations do:
    nothing depends on where the worlds have their origins, and how they are turned.
    """
    gauge = problem.gauge
    middle = len(problem.estimate) // 2
    by_pose = pose_alignment(problem.ground_truth[middle], problem.estimate[middle], gauge)
    source, target = problem.estimate[:, :3, 3], problem.ground_truth[:, :3, 3]
    found = align_positions(source, target, gauge.name)
    if len(found.unobserved_axes):
        found = _by_orientations(problem, found, source.mean(axis=0), target.mean(axis=0))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = found.rotation, found.translation
    by_position = Similarity(pose, float(found.scale))
    return min(*others, by_position, by_pose, key=problem.chi2)


def _by_orientations(problem: Problem, found: Alignment, source: Array, target: Array) -> Alignment:
    """What positions leave open of a rotation as orientations have it in the mean.

    source, target: the positions' means, (3,), which stay on each other.
    """
    turns = problem.ground_truth[:, :3, :3] @ np.swapaxes(problem.estimate[:, :3, :3], -1, -2)
    if len(found.unobserved_axes) == 1:
        rotation = largest_trace_about(found.unobserved_axes[0], found.rotation, turns.mean(axis=0))
    else:
        rotation = nearest_rotation(turns.mean(axis=0))
    translation = target - found.scale * rotation @ source
    return replace(found, rotation=rotation, translation=translation)


def _damped(gauge: Gauge, information: Information, damping: float) -> Array:
    """The Levenberg-Marquardt step, scaled by what is known of a freedom of its kind.

    Of translations, of rotations, and of the scale: the world's axes do not matter.
    """
    known = (information.root**2).sum(axis=0)
    kinds = np.array(gauge.free) // 3
    for kind in set(kinds.tolist()):
        known[kinds == kind] = known[kinds == kind].mean()
    scale = np.sqrt(damping * known)
    rows = np.concatenate([np.diag(scale), np.zeros((len(scale), 1))], axis=1)
    return best_perturbation(gauge, information.absorb(rows, 0.0))


def minimize(
    problem: Problem, alignment: Similarity
) -> tuple[Similarity, Information, Ending, int]:
    """Gauss-Newton, damped where a step would not gain.

    Returns the best alignment, what the residuals, linear about it, say of its perturbation, how
    the search ended and after how many iterations.
    """
    damping = 0.0
    chi2 = problem.chi2(alignment)
    information = problem.linearize(alignment)
    for iteration in range(_MAX_ITERATIONS):
        gain = float((information.offset**2).sum())
        if gain <= _GAIN + _GAIN_SHARE * chi2:
            return alignment, information, Ending.CONVERGED, iteration
        while True:
            step = _damped(problem.gauge, information, damping)
            proposal = problem.gauge.perturb(alignment, problem.centre, step)
            proposed = problem.chi2(proposal)
            if proposed < chi2:
                break
            damping = max(10.0 * damping, 1e-3)
            if gain <= _ROUND_OFF * chi2:
                return alignment, information, Ending.CONVERGED, iteration
            if damping > _MAX_DAMPING:
                return alignment, information, Ending.STALLED, iteration
        alignment, chi2 = proposal, proposed
        information = problem.linearize(alignment)
        damping = damping / 10.0 if damping > 1e-6 else 0.0
    return alignment, information, Ending.ITERATION_LIMIT, _MAX_ITERATIONS
