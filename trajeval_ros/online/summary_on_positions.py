# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary of a run of positions alone: what contains an orientation is None."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trajeval_ros.alignment.gauge import Gauge
from trajeval_ros.likelihood.figures import p_value_of
from trajeval_ros.likelihood.running_positions import PositionError, position_error
from trajeval_ros.online.positions import world_covariance
from trajeval_ros.online.summary import alignment_figures, likelihood_figures
from trajeval_ros.online.window import Window

Figures = dict[str, Any]

# Of the conventional figures, what no orientation enters.
_KEPT = ("poses", "pairs", "ate_translation_rmse", "ate_translation", "re_delta", "re_unit")


def on_positions(
    summary: Mapping[str, Any], found: PositionError | None, *, truth_turns: bool
) -> Figures:
    """The summary with None for what contains an orientation, and with what positions tell.

    ``truth_turns``: whether the ground truth has orientations, and the estimate has none.
    ``lever_arm``: where the ground truth's point is in the estimate's body; None where the motion
    does not show it. ``found``: of all evaluated poses; None with fewer than two.
    """
    result = {**summary, "position_only": True, "lever_arm": None}
    for part in ("relative", "absolute"):
        result[part] = _emptied(summary[part])
    if not truth_turns:
        result["ground_truth"] = _of_positions(summary["ground_truth"])
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
    if found is None:
        return result
    poses = int(summary["estimate"]["evaluated"])
    result["relative"] |= _relative(found, poses)
    result["absolute"] |= _absolute(found, poses)
    freedom = found.gauge.dimension
    known = found.covariance[:freedom, :freedom]
    covariance = found.gauge.covariance(found.alignment, found.centre, known)
    result["absolute"]["alignment"] = alignment_figures(found.alignment, covariance, found.gauge)
    result["absolute"]["consistency"] = found.consistency
    if found.shows_lever_arm:
        arm, std = found.lever_arm, found.lever_arm_std
        result["lever_arm"] = {"value": arm.tolist(), "std": std.tolist()}
    return result


def without_rotation(summary: Mapping[str, Any]) -> Figures:
    """The summary of two trajectories that both never turn: no error of a rotation is told.

    Their orientations are most likely none; what needs some is of the positions all the same.
    """
    conventional = dict(summary["conventional"])
    for key in ("ate_rotation_rmse", "re_rotation_rmse"):
        conventional[key] = None
    if conventional.get("distributions"):
        nothing = dict.fromkeys(("ate_rotation", "re_rotation"))
        conventional["distributions"] = {**conventional["distributions"], **nothing}
    return {**summary, "conventional": conventional}


def window_on_positions(summary: Mapping[str, Any], window: Window, gauge: Gauge) -> Figures:
    """A summary's ``window`` likewise."""
    poses, count = window.poses, len(window.poses)
    result = {**summary, **{part: _emptied(summary[part]) for part in ("relative", "absolute")}}
    if count < 2:
        return result
    truth, covariance = poses.ground_truth[:, :3, 3], world_covariance(poses)
    of_window = position_error(truth, covariance, poses.estimate, gauge)
    for part, told, likelihood in (
        ("relative", _relative(of_window, count), of_window.relative),
        ("absolute", _absolute(of_window, count), of_window.absolute),
    ):
        result[part] = {**result[part], **told, "p_value": p_value_of(likelihood)}
    return result


def drift_on_positions(drift: Mapping[str, Any]) -> Figures:
    """Of the figures over sub-trajectories the path alone."""
    nothing: Figures = dict.fromkeys(drift)
    return {**nothing, "path_length": drift.get("path_length"), "sub_trajectories": []}


def _of_positions(truth: Mapping[str, Any]) -> Figures:
    """Of the process, what is of the positions."""
    result = dict(truth)
    if truth.get("fit") is not None:
        fit = dict(truth["fit"])
        result["fit"] = {**fit, **dict.fromkeys(key for key in fit if key.startswith("rotation"))}
    if truth.get("hyperparameters") is not None:
        result["hyperparameters"] = {**truth["hyperparameters"], "rotation": None}
    return result


def _relative(found: PositionError, poses: int) -> Figures:
    return {**likelihood_figures(found.relative, poses), "translation_rmse": found.step_rmse}


def _absolute(found: PositionError, poses: int) -> Figures:
    """Under a gauge with the world's translation, RE is AE to first order."""
    told = likelihood_figures(found.absolute, poses)
    first_order = found.relative if 0 in found.gauge.free else None
    return {
        **told,
        "translation_rmse": found.rmse,
        "log_likelihood_nonlinear": told["log_likelihood"],
        "log_likelihood_first_order": None if first_order is None else first_order.log_likelihood,
    }


def _emptied(figures: Mapping[str, Any]) -> Figures:
    return {
        key: _emptied(value) if isinstance(value, dict) else value if type(value) is str else None
        for key, value in figures.items()
    }
