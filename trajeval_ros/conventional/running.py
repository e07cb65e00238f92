# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ATE and RE as everyone knows them, in constant memory.

Per pose, with the alignment ``(Q, t, s)`` of `umeyama` in the gauge:

- ATE, translation: ``|t_gt - (s Q t_est + t)|``, m,
- ATE, rotation: the angle of ``R_gt^T Q R_est``, rad.

Per pair of poses (i, j) one step apart, `step_pairs`, with ``q = R_gt_i^T (t_gt_j - t_gt_i)``
and p the same of the estimate:

- RE, translation: ``|s p - q|``, m, the translation part of ``(T_gt_i^-1 T_gt_j)^-1 (T_est_i^-1
  T_est_j)`` with the estimate scaled,
- RE, rotation: the angle of its rotation part, rad.

These are evo's APE and RPE (`translation_part`, `rotation_angle_rad`) after ``align``, and equal
to them to 1e-9 on the same poses. The RMSEs are closed forms of running sums over the whole run;
ATE's rotation is one to 1e-10 relative (`rotation_moments`). Mean, median, standard deviation,
minimum and maximum of what depends on an alignment that is not known before the end have no such
form. They are exact up to `CAPACITY` poses or pairs, and of every 2nd, 4th, ... pose or pair from
then on, evenly over the run; `Distributions` says of how many. What needs no alignment keeps all
but its median exact. Exact is up to the round-off of the errors themselves: a standard deviation
keeps its digits beside a mean that is far larger.

In `sim3` a step in metres is measured along the ground truth (evo's ``pairs_from_reference``):
the estimate's metre is not known before the end. In the other gauges it is measured along the
estimate, evo's default.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.rotation_moments import RotationMoments
from trajeval_ros.alignment.umeyama import Alignment, Degeneracy, Gauge, Moments, align
from trajeval_ros.conventional.distributions import (
    CAPACITY,
    Distributions,
    EvenSample,
    RunningMoments,
    distribution,
)
from trajeval_ros.conventional.step_pairs import StepPairs, StepUnit

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# Poses wait for each other until so many have come or a figure is asked for: the cost of a
# batch hardly depends on its size.
_BATCH, _MOST = 256, 1024

# The motion that shows a rotation is larger than the errors by this factor, per axis.
_SHOWN = 1.5
ENOUGH_TO_ALIGN = 20
"""Poses before which nothing is said of an alignment that is not determined."""


class ConventionalFigures(NamedTuple):
    """RMS errors over all poses and pairs so far; None where there is not enough data.

    Attributes:
        poses: number of poses.
        pairs: number of pairs one step apart.
        alignment: of all poses, estimate's world to ground truth's; None before the first.
        ate_translation_rmse: m. None with fewer poses than an alignment needs, or in `sim3`
            where the scale is not observed.
        ate_rotation_rmse: rad. None also where a rotation of the alignment is not observed, or
            known from no more than noise.
        re_translation_rmse: m. None also in `sim3` where the scale is not observed.
        re_rotation_rmse: rad.
        re_longest_step: the longest step of a pair, s, m or f. One far longer than the step asked
            for lies in a gap.
    """

    poses: int
    pairs: int
    alignment: Alignment | None
    ate_translation_rmse: float | None
    ate_rotation_rmse: float | None
    re_translation_rmse: float | None
    re_rotation_rmse: float | None
    re_longest_step: float | None


class RunningConventional:
    """The conventional figures of a run, updated as it goes on.

    Whatever the batches are, the figures are the same, except for round-off.

    Args:
        gauge: of the alignment.
        delta: RE's step, s, m or f (frames), above zero.
        unit: `s`, `m` or `f`.

    Raises:
        ValueError: an unknown gauge or unit, or a delta that is not positive and finite.
    """

    def __init__(self, gauge: Gauge, delta: float, unit: StepUnit) -> None:
        # Refuses an unknown gauge now rather than at the first figure.
        align(Moments.of(np.zeros((1, 3)), np.zeros((1, 3))), gauge)
        self._gauge: Gauge = gauge
        self._pairs = StepPairs(delta, unit, path_of_ground_truth=gauge == "sim3")
        self._last_stamp: int | None = None
        self._waiting: list[tuple[Stamps, Array, Array]] = []
        self._waiting_poses = 0

        self._positions = Moments.empty()
        self._rotations = RotationMoments()
        self._pose_sample = EvenSample(CAPACITY, 15)
        # Triangular, (2, 2): factor.T @ factor = sum over pairs of (p, q)^T (p, q).
        self._steps_factor = np.zeros((2, 2))
        self._re_translation = RunningMoments()
        self._re_rotation = RunningMoments()
        self._pair_sample = EvenSample(CAPACITY, 7)

    def update(self, stamps: Stamps, ground_truth: Array, estimate: Array) -> None:
        """Add poses.

        Args:
            stamps: (M,) ns, strictly increasing, from one call to the next too.
            ground_truth: (M, 4, 4) at these stamps, in the ground truth's world.
            estimate: (M, 4, 4) at these stamps, in the estimate's world.

        Raises:
            ValueError: shapes that do not fit, stamps that do not increase, poses that are not
                finite. Nothing has been added then.
        """
        count = len(stamps)
        if stamps.shape != (count,) or not ground_truth.shape == estimate.shape == (count, 4, 4):
            raise ValueError(
                "stamps, ground_truth and estimate must be (M,), (M, 4, 4) and (M, 4, 4), got "
                f"{stamps.shape}, {ground_truth.shape} and {estimate.shape}"
            )
        if count == 0:
            return
        if (self._last_stamp is not None and stamps[0] <= self._last_stamp) or np.any(
            stamps[1:] <= stamps[:-1]
        ):
            raise ValueError("stamps must increase strictly")
        if not (np.isfinite(ground_truth).all() and np.isfinite(estimate).all()):
            raise ValueError("ground_truth and estimate must be finite")
        self._last_stamp = int(stamps[-1])
        # A whole run, too, a part at a time.
        for begin in range(0, count, _MOST):
            some = slice(begin, begin + _MOST)
            part = stamps[some].copy(), ground_truth[some].copy(), estimate[some].copy()
            self._waiting.append(part)
            self._waiting_poses += len(part[0])
            if self._waiting_poses >= _BATCH:
                self._take_in()

    def figures(self) -> ConventionalFigures:
        """The RMS errors so far; a fraction of a millisecond."""
        self._take_in()
        alignment = align(self._positions, self._gauge) if self._positions.count else None
        pairs = self._re_rotation.count
        scale = None if alignment is None else _known_scale(alignment)
        ate_rotation = None
        if alignment is not None and _rotation_is_known(alignment, self._positions):
            ate_rotation = self._rotations.mean_square_angle(alignment.rotation) ** 0.5
        re_translation = None
        if pairs > 0 and scale is not None:
            residuals = self._steps_factor @ np.array([scale, -1.0])
            re_translation = float(np.linalg.norm(residuals)) / pairs**0.5
        return ConventionalFigures(
            poses=self._positions.count,
            pairs=pairs,
            alignment=alignment,
            ate_translation_rmse=(
                alignment.rmse if alignment is not None and _is_aligned(alignment) else None
            ),
            ate_rotation_rmse=ate_rotation,
            re_translation_rmse=re_translation,
            re_rotation_rmse=(self._re_rotation.mean_square**0.5 if pairs > 0 else None),
            re_longest_step=self._pairs.longest,
        )

    @property
    def is_rotation_undetermined(self) -> bool:
        """Whether there are poses enough, and their motion does not show the rotation."""
        self._take_in()
        if self._positions.count < ENOUGH_TO_ALIGN:
            return False
        alignment = align(self._positions, self._gauge)
        return _is_aligned(alignment) and not _rotation_is_known(alignment, self._positions)

    def distributions(self) -> Distributions:
        """The errors' distributions so far; some milliseconds."""
        self._take_in()
        alignment = align(self._positions, self._gauge) if self._positions.count else None
        pairs = self._re_rotation.count
        ate_translation = ate_rotation = re_translation = re_rotation = None
        poses = self._pose_sample.rows
        if alignment is not None and _is_aligned(alignment):
            moved = alignment.transform_positions(poses[:, 3:6])
            ate_translation = distribution(np.linalg.norm(poses[:, :3] - moved, axis=-1))
        if alignment is not None and _rotation_is_known(alignment, self._positions):
            errors = alignment.rotation @ poses[:, 6:].reshape(-1, 3, 3)
            ate_rotation = distribution(np.linalg.norm(se3.log_so3(errors), axis=-1))
        steps = self._pair_sample.rows
        scale = None if alignment is None else _known_scale(alignment)
        if pairs > 0 and scale is not None:
            lengths = np.linalg.norm(scale * steps[:, :3] - steps[:, 3:6], axis=-1)
            re_translation = distribution(
                lengths, None if self._gauge == "sim3" else self._re_translation
            )
        if pairs > 0:
            re_rotation = distribution(steps[:, 6], self._re_rotation)
        return Distributions(
            ate_translation=ate_translation,
            ate_rotation=ate_rotation,
            re_translation=re_translation,
            re_rotation=re_rotation,
            sampled_poses=len(poses),
            sampled_pairs=len(steps),
        )

    def _take_in(self) -> None:
        """Move the waiting poses into the sums."""
        if not self._waiting:
            return
        stamps, ground_truth, estimate = (
            np.concatenate(parts) for parts in zip(*self._waiting, strict=True)
        )
        self._waiting.clear()
        self._waiting_poses = 0
        rotations = estimate[:, :3, :3] @ np.swapaxes(ground_truth[:, :3, :3], -1, -2)
        self._positions = self._positions.updated(estimate[:, :3, 3], ground_truth[:, :3, 3])
        self._rotations.update(rotations)
        self._pose_sample.update(
            np.concatenate(
                (ground_truth[:, :3, 3], estimate[:, :3, 3], rotations.reshape(-1, 9)), axis=1
            )
        )
        self._take_in_pairs(*self._pairs.update(stamps, ground_truth, estimate))

    def _take_in_pairs(self, gt_i: Array, gt_j: Array, est_i: Array, est_j: Array) -> None:
        """Add the completed pairs, each (K, 4, 4), to RE's sums."""
        if len(gt_i) == 0:
            return
        q, gt_turn = _step(gt_i, gt_j)
        p, est_turn = _step(est_i, est_j)
        angles = np.linalg.norm(se3.log_so3(np.swapaxes(gt_turn, -1, -2) @ est_turn), axis=-1)
        rows = np.stack((p.ravel(), q.ravel()), axis=-1)
        self._steps_factor = np.asarray(
            np.linalg.qr(np.concatenate((self._steps_factor, rows)), mode="r")
        )
        self._re_translation = self._re_translation.updated(np.linalg.norm(p - q, axis=-1))
        self._re_rotation = self._re_rotation.updated(angles)
        self._pair_sample.update(np.concatenate((p, q, angles[:, np.newaxis]), axis=1))


def _step(begin: Array, end: Array) -> tuple[Array, Array]:
    """Translation (K, 3) and rotation (K, 3, 3) of ``T_begin^-1 T_end``."""
    back = np.swapaxes(begin[:, :3, :3], -1, -2)
    difference = end[:, :3, 3] - begin[:, :3, 3]
    return np.einsum("kab,kb->ka", back, difference), back @ end[:, :3, :3]


def _is_aligned(alignment: Alignment) -> bool:
    """Whether there are poses enough for the position errors after alignment to mean anything.

    A line or a point will do: which of the best rotations is taken does not change them.
    """
    return alignment.degeneracy is not Degeneracy.TOO_FEW_POINTS and alignment.scale_observed


def _rotation_is_known(alignment: Alignment, positions: Moments) -> bool:
    """Whether the positions show the alignment's rotation.

    Where a body hardly moves, or along a line alone, what is left of the errors after alignment is
    as large as the motion across the axis that is hardest to see, and the rotation about that axis
    comes from the noise: of two clouds of points it is anything.
    """
    if alignment.degeneracy is Degeneracy.TOO_FEW_POINTS or len(alignment.unobserved_axes):
        return False
    if alignment.gauge == "none":
        return True
    extent = positions.target_extent[0 if alignment.gauge == "yaw_translation" else 1]
    # Errors that no turn explains, whatever the gauge is free to turn.
    rigid = alignment if alignment.gauge == "se3" else align(positions, "se3")
    left_over = min(alignment.rmse, rigid.rmse) / math.sqrt(3.0)
    return bool(extent >= _SHOWN * left_over)


def _known_scale(alignment: Alignment) -> float | None:
    """The scale of the gauge; None where the poses have not shown it yet."""
    if alignment.gauge != "sim3":
        return 1.0
    return alignment.scale if _is_aligned(alignment) else None
