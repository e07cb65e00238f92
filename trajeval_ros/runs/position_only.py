# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of positions without orientations, as GNSS and total stations give them.

They are fed with a constant orientation: the process of the positions is the same with any. What
contains an orientation is of the constant one, and is left out; in its place come the likelihoods
of positions, with the lever arm of the antenna as a nuisance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.likelihood.running_positions import PositionError, position_error
from trajeval_ros.online.results import Notice, Results
from trajeval_ros.online.settings import EvaluationSettings
from trajeval_ros.online.summary import alignment_figures, likelihood_figures
from trajeval_ros.online.whole_run import Poses

Figures = dict[str, Any]

# rad, by which orientations that never change differ at most, and those of a robot that turns.
_CONSTANT, _TURNS = 1e-6, 0.2
_ON_LIKELIHOODS = ("inconsistent_likelihoods", "first_order_strained")
_UNDETERMINED = (
    "the motion is not larger than the errors, or along a line alone: the alignment's rotation is"
    " not determined: the lever arm is not told, nor a likelihood if it is not known to 0.3 rad"
)
# Of the conventional figures, what no orientation enters.
_KEPT = ("poses", "pairs", "ate_translation_rmse", "ate_translation", "re_delta", "re_unit")


def is_position_only(truth: Trajectory, estimate: Trajectory) -> bool:
    """Whether one of the two has no orientation: none is written, or one that never changes."""
    if not (truth.has_orientation and estimate.has_orientation):
        return True
    return _turned(truth.quaternions) <= _CONSTANT and _turned(estimate.quaternions) >= _TURNS


def _turned(quaternions: npt.NDArray[np.float64]) -> float:
    """How far orientations (N, 4) are from the first, at most, rad."""
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(quaternions, axis=1)
    good = np.isfinite(norms) & (np.abs(norms - 1.0) < 1e-2)
    known = quaternions[good] / norms[good, None]
    if len(known) == 0:
        return 0.0
    # The chord, unlike the product, has its digits where two are the same; q and -q are one.
    chords = [np.linalg.norm(known + sign * known[0], axis=1) for sign in (-1.0, 1.0)]
    return 4.0 * math.asin(min(0.5 * float(np.minimum(*chords).max()), 1.0))


def without_orientation(summary: Figures) -> Figures:
    """The summary with None for what contains an orientation."""
    result = {key: value for key, value in summary.items() if key != "error_model"}
    for part in ("relative", "absolute"):
        result[part] = _emptied(summary[part])
    if summary.get("window"):
        window = {key: value for key, value in summary["window"].items() if key != "error_model"}
        for part in ("relative", "absolute"):
            if window.get(part):
                window[part] = _emptied(window[part])
        result["window"] = window
    conventional = dict(summary["conventional"])
    for key in conventional:
        if key.endswith("_rmse") and key not in _KEPT:
            conventional[key] = None
    if conventional.get("distributions"):
        conventional["distributions"] = {
            key: None if isinstance(value, dict) and key not in _KEPT else value
            for key, value in conventional["distributions"].items()
        }
    result["conventional"] = conventional
    # The one alignment that needs no orientation.
    result["absolute"]["alignment"] = conventional.get("alignment")
    if summary.get("drift"):
        nothing: Figures = dict.fromkeys(summary["drift"])
        path = summary["drift"].get("path_length")
        result["drift"] = {**nothing, "path_length": path, "sub_trajectories": []}
    result["position_only"] = True
    return result


def results_on_positions(results: Results, alignment: Mapping[str, Any] | None) -> Results:
    """Results without what contains an orientation: errors and likelihoods are not a number.

    ``alignment``: of the positions, as in ``conventional``.
    """
    evaluations = results.evaluations
    nothing = np.full((len(evaluations), 6), np.nan)
    similarity = None
    if alignment is not None and alignment.get("pose") is not None:
        pose = np.array(alignment["pose"])
        similarity = Similarity(
            se3.from_position_quaternion(pose[:3], pose[3:]), float(alignment["scale"])
        )
    return replace(
        results,
        evaluations=replace(
            evaluations,
            relative_error=nothing,
            absolute_error=nothing,
            relative_log_likelihood=np.full(len(evaluations), np.nan),
        ),
        notices=notices_on_positions(results.notices),
        absolute_log_likelihood=None,
        alignment=similarity or results.alignment,
    )


def with_positions(summary: Figures, poses: Poses, settings: EvaluationSettings) -> Figures:
    """The summary `without_orientation` with what the positions of evaluated poses tell.

    Of the run and of its last `window`; ``lever_arm``: where the ground truth's point is in the
    estimate's body; None where the motion does not show it.
    """
    result = {**summary, "lever_arm": None}
    if len(poses.stamps) < 2:
        return result
    found = _error(poses, settings)
    count = len(poses.stamps)
    result["relative"] = {**summary["relative"], **_relative(found, count)}
    result["absolute"] = {**summary["absolute"], **_absolute(found, count, settings)}
    result["absolute"]["alignment"] = alignment_figures(found.alignment, None, settings.gauge)
    if found.shows_lever_arm:
        arm, std = found.lever_arm, found.lever_arm_std
        result["lever_arm"] = {"value": arm.tolist(), "std": std.tolist()}
    newest = poses.stamps >= poses.stamps[-1] - settings.window
    if summary.get("window") and newest.sum() > 1:
        some = _error(poses.where(newest), settings)
        window = dict(summary["window"])
        window["relative"] = {**(window["relative"] or {}), **_relative(some, int(newest.sum()))}
        window["absolute"] = {
            **(window["absolute"] or {}),
            **_absolute(some, int(newest.sum()), settings),
        }
        result["window"] = window
    return result


def _error(poses: Poses, settings: EvaluationSettings) -> PositionError:
    turn = poses.ground_truth[:, :3, :3]
    world = turn @ poses.covariance[:, :3, :3] @ np.swapaxes(turn, 1, 2)
    return position_error(poses.ground_truth[:, :3, 3], world, poses.estimate, settings.gauge)


def _relative(found: PositionError, poses: int) -> Figures:
    return {
        **likelihood_figures(found.relative, poses),
        "translation_rmse": found.step_rmse,
    }


def _absolute(found: PositionError, poses: int, settings: EvaluationSettings) -> Figures:
    """Under a gauge with the world's translation, RE is AE to first order."""
    figures = likelihood_figures(found.absolute, poses)
    first_order = found.relative if 0 in settings.gauge.free else None
    return {
        **figures,
        "translation_rmse": found.rmse,
        "log_likelihood_nonlinear": figures["log_likelihood"],
        "log_likelihood_first_order": None if first_order is None else first_order.log_likelihood,
    }


def comparisons_on_positions(
    comparisons: Iterable[Comparison], summaries: Mapping[str, Mapping[str, Any]]
) -> tuple[Comparison, ...]:
    """Comparisons without what contains an orientation, where either has none."""
    alone = {name for name, summary in summaries.items() if summary.get("position_only")}
    nothing: dict[str, Any] = dict.fromkeys(("ate_rotation", "re_translation", "re_rotation"))
    return tuple(
        replace(each, **nothing) if alone & {each.a, each.b} else each for each in comparisons
    )


def notices_on_positions(notices: tuple[Notice, ...]) -> tuple[Notice, ...]:
    """Those that are not about likelihoods of orientations; what an undetermined one costs here."""
    return tuple(
        replace(notice, text=_UNDETERMINED) if notice.code == "alignment_undetermined" else notice
        for notice in notices
        if notice.code not in _ON_LIKELIHOODS
    )


def _emptied(figures: Figures) -> Figures:
    return {
        key: _emptied(value) if isinstance(value, dict) else value if type(value) is str else None
        for key, value in figures.items()
    }
