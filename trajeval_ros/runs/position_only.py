# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of positions without orientations, as GNSS and total stations give them.

They are fed with a constant orientation. The positions after alignment are right; what contains an
orientation is of the constant one, and is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.results import Notice

Figures = dict[str, Any]

# rad, by which orientations that never change differ at most, and those of a robot that turns.
_CONSTANT, _TURNS = 1e-6, 0.2
_ON_LIKELIHOODS = ("inconsistent_likelihoods", "first_order_strained")
# Of the conventional figures, what no orientation enters.
_KEPT = ("poses", "pairs", "ate_translation_rmse", "ate_translation", "re_delta", "re_unit")


def is_position_only(truth: Trajectory, estimate: Trajectory) -> bool:
    """Whether one of the two has no orientation: none is written, or one that never changes."""
    if not (truth.has_orientation and estimate.has_orientation):
        return True
    turned = {id(one): _turned(one.quaternions) for one in (truth, estimate)}
    return turned[id(truth)] <= _CONSTANT and turned[id(estimate)] >= _TURNS


def _turned(quaternions: npt.NDArray[np.float64]) -> float:
    """How far orientations (N, 4) are from the first, at most, rad."""
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(quaternions, axis=1)
    known = quaternions[np.isfinite(norms) & (np.abs(norms - 1.0) < 1e-2)]
    if len(known) == 0:
        return 0.0
    rotations = se3.from_position_quaternion(np.zeros((len(known), 3)), known)[:, :3, :3]
    turns = se3.log_so3(rotations[0].T @ rotations)
    return float(np.linalg.norm(turns, axis=1).max())


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
    """Those that are not about likelihoods of orientations."""
    return tuple(notice for notice in notices if notice.code not in _ON_LIKELIHOODS)


def _emptied(figures: Figures) -> Figures:
    return {
        key: _emptied(value) if isinstance(value, dict) else value if type(value) is str else None
        for key, value in figures.items()
    }
