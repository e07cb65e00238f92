# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is told of a run in which the ground truth, or the estimate, has no orientation.

GNSS and total stations give positions, fed with a constant orientation: the process of the
positions is the same with any. What contains an orientation is of that constant one, and is left
out; in its place come the likelihoods of positions, with the lever arm of the antenna as a
nuisance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from trajeval_ros.likelihood.running_positions import PositionError
from trajeval_ros.online.results import Evaluations, Notice, Results
from trajeval_ros.online.window import EvaluatedPoses

Array = npt.NDArray[np.float64]

_ON_LIKELIHOODS = ("inconsistent_likelihoods", "first_order_strained")
_UNDETERMINED = (
    "the motion is not larger than the errors, or along a line alone: the alignment's rotation is"
    " not determined: the lever arm is not told, nor a likelihood if it is not known to 0.3 rad"
)


def world_covariance(poses: EvaluatedPoses) -> Array:
    """The covariances of the ground truth's positions in the world's axes, (M, 3, 3)."""
    turn = poses.ground_truth[:, :3, :3]
    return np.asarray(turn @ poses.covariance[:, :3, :3] @ np.swapaxes(turn, 1, 2))


def evaluations_on_positions(
    evaluations: Evaluations, before: tuple[Array, Array] | None, found: PositionError | None
) -> Evaluations:
    """Evaluations without what contains an orientation.

    Errors of translation are under the alignment and the lever arm that are likeliest by now, in
    the estimate's axes; of the relative log-likelihood there is the run's, by the last pose.
    before: the position and the estimate, (4, 4), of the pose before the first.
    """
    count = len(evaluations)
    relative, absolute = np.full((count, 6), np.nan), np.full((count, 6), np.nan)
    total, nothing = np.full(count, np.nan), np.full(count, np.nan)
    if found is not None and count:
        positions, estimate = evaluations.ground_truth[:, :3, 3], evaluations.estimate
        axes = found.alignment.pose[:3, :3] @ estimate[:, :3, :3]
        residual = found.residual(positions, estimate)
        absolute[:, :3] = -_in_axes(axes, residual)
        if before is not None:
            first = found.residual(before[0][None], before[1][None])
            relative[:, :3] = -_in_axes(axes, np.diff(np.concatenate([first, residual]), axis=0))
        else:
            relative[1:, :3] = -_in_axes(axes[1:], np.diff(residual, axis=0))
        if found.relative is not None:
            total[-1] = found.relative.log_likelihood
    return replace(
        evaluations,
        relative_error=relative,
        absolute_error=absolute,
        chi2=nothing,
        log_det=nothing,
        log_likelihood=nothing,
        relative_log_likelihood=total,
    )


def rows_of(results: Results) -> Evaluations:
    """What of a batch goes to ``poses.csv``: of positions alone, what no later pose changes."""
    evaluations = results.evaluations
    if not results.position_only:
        return evaluations
    covariance = evaluations.covariance.copy()
    covariance[:, 3:, :] = covariance[:, :, 3:] = np.nan
    return replace(
        evaluations, covariance=covariance, relative_error=np.full((len(evaluations), 6), np.nan)
    )


def notices_on_positions(notices: tuple[Notice, ...]) -> tuple[Notice, ...]:
    """Those that are not about likelihoods of orientations; what an undetermined one costs here."""
    return tuple(
        notice._replace(text=_UNDETERMINED) if notice.code == "alignment_undetermined" else notice
        for notice in notices
        if notice.code not in _ON_LIKELIHOODS
    )


def _in_axes(rotation: Array, vectors: Array) -> Array:
    """Vectors (n, 3) of the world in axes (n, 3, 3)."""
    return np.asarray(np.einsum("nji,nj->ni", rotation, vectors))
