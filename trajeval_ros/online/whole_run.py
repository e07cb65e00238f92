# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures that need every pose of a run at once, and so are of files and not of a node."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.conventional.sub_trajectories import (
    Box,
    Drift,
    Steps,
    all_pairs,
    boxes,
    growth,
    is_noise,
    kitti_drift,
    path_along,
)
from trajeval_ros.likelihood.absolute import absolute
from trajeval_ros.online.settings import EvaluationSettings
from trajeval_ros.online.window import joint_covariance

Array = npt.NDArray[np.float64]
Figures = dict[str, Any]

# Of BOX_QUANTILES.
_QUANTILES = ("min", "p5", "q1", "median", "q3", "p95", "max")


class Poses(NamedTuple):
    """Every evaluated pose of a run: what its `Evaluations` held.

    Attributes:
        stamps: (M,) ns.
        ground_truth: (M, 4, 4).
        covariance: (M, 6, 6).
        estimate: (M, 4, 4).
        sampled: (M,) where the ground truth was sampled as usual, not in a gap.
        cross: the covariances between poses, where they are joint.
    """

    stamps: npt.NDArray[np.int64]
    ground_truth: Array
    covariance: Array
    estimate: Array
    sampled: npt.NDArray[np.bool_]
    cross: tuple[Array, ...] = ()

    def where(self, mask: npt.NDArray[np.bool_]) -> Poses:
        """Some of them, as independent ones."""
        return Poses(
            self.stamps[mask],
            self.ground_truth[mask],
            self.covariance[mask],
            self.estimate[mask],
            self.sampled[mask],
        )


def whole_run(
    summary: Figures, poses: Poses, settings: EvaluationSettings, *, spread: bool = True
) -> Figures:
    """Return the summary of a run with the figures that need all of its poses.

    ``absolute.log_likelihood_nonlinear``, and ``drift``, whose ``sub_trajectories`` are none
    without ``spread``.
    """
    nonlinear = None
    if len(poses.stamps) > 1:
        joint = joint_covariance(poses.covariance, poses.cross or None)
        found = absolute(poses.ground_truth, joint, poses.estimate, settings.gauge).likelihood
        nonlinear = None if found is None else found.log_likelihood
    return {
        **summary,
        "absolute": {**summary["absolute"], "log_likelihood_nonlinear": nonlinear},
        "drift": drift(poses, settings, spread=spread),
    }


def grown(poses: Poses, settings: EvaluationSettings) -> dict[str, tuple[Box, ...]]:
    """How errors grow with the length of the sub-trajectory, over "time" (s) and "distance" (m).

    Of the poses outside the gaps; none where there is no length, or, in `sim3`, no scale.
    """
    known = _known(poses.sampled)
    stamps, truth, estimate = poses.stamps[known], poses.ground_truth[known], poses.estimate[known]
    if len(stamps) < 2:
        return {"time": (), "distance": ()}
    scale = 1.0
    if settings.gauge.has_scale:
        alignment = align_positions(estimate[:, :3, 3], truth[:, :3, 3], "sim3")
        if not alignment.scale_observed:
            return {"time": (), "distance": ()}
        scale = float(alignment.scale)
    still = is_noise(stamps, truth, poses.covariance[known])
    return {
        "time": growth((stamps - stamps[0]) * 1e-9, truth, estimate, scale),
        "distance": () if still else growth(path_along(truth), truth, estimate, scale),
    }


def _known(sampled: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_] | slice:
    """What to index with; all of a long run need not be there twice."""
    return slice(None) if sampled.all() else sampled


def drift(poses: Poses, settings: EvaluationSettings, *, spread: bool = True) -> Figures:
    """The conventional figures over sub-trajectories, of the poses outside the gaps.

    What is divided by a path, or goes along it, is None where the path is the ground truth's noise;
    and all is None in `sim3` where the scale is not observed. ``spread``: with the quantiles over
    ``sub_trajectories`` of each length, which is most of the work.
    """
    known = _known(poses.sampled)
    stamps, truth, estimate = poses.stamps[known], poses.ground_truth[known], poses.estimate[known]
    nothing: Figures = dict.fromkeys(("path_length", "all_pairs", "kitti"))
    nothing["sub_trajectories"] = []
    if len(stamps) < 2:
        return nothing
    scale = None
    if settings.gauge.has_scale:
        alignment = align_positions(estimate[:, :3, 3], truth[:, :3, 3], "sim3")
        if not alignment.scale_observed:
            return nothing
        scale = float(alignment.scale)
    delta, unit = settings.relative_delta, settings.relative_unit
    found = {**nothing, "all_pairs": _pairs(all_pairs(stamps, truth, estimate, delta, unit, scale))}
    if is_noise(stamps, truth, poses.covariance[known]):
        return found
    metre = 1.0 if scale is None else scale
    benchmark = kitti_drift(truth, estimate, metre)
    return {
        **found,
        "path_length": float(path_along(truth)[-1]),
        "kitti": None
        if benchmark is None
        else {
            **_over(benchmark.overall),
            "lengths": [_over(each) for each in benchmark.by_length],
        },
        "sub_trajectories": [_box(box) for box in boxes(truth, estimate, metre)] if spread else [],
    }


def _pairs(steps: Steps) -> Figures:
    translation, rotation = (
        float(np.sqrt(np.mean(errors**2))) if len(errors) else None
        for errors in (steps.translation, steps.rotation)
    )
    return {
        "pairs": steps.count,
        "re_translation_rmse": translation,
        "re_rotation_rmse": rotation,
    }


def _over(drift: Drift) -> Figures:
    length = {} if drift.length is None else {"length": drift.length}
    return {
        **length,
        "subsequences": drift.subsequences,
        "translation": drift.translation,
        "rotation": drift.rotation,
    }


def _box(box: Box) -> Figures:
    return {
        "length": box.length,
        "subsequences": box.subsequences,
        "translation": dict(zip(_QUANTILES, box.translation, strict=True)),
        "rotation": dict(zip(_QUANTILES, box.rotation, strict=True)),
    }
