# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a person asks of a run first.

How sure the errors are, and where it is worst; how well the ground truth is known; how good the
estimate is without what is not its fault. Of the poses outside the ground truth's gaps, with the
alignment that is ATE's.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.comparison.common import Evaluated
from trajeval_ros.comparison.errors import Errors, errors_of, steps
from trajeval_ros.comparison.interval import interval_of
from trajeval_ros.conventional.running import ConventionalFigures, RunningConventional
from trajeval_ros.diagnosis.fitted import (
    beyond_doubt,
    lever_arm_is_beyond_doubt,
    lever_arm_to_set,
    told_lever_arm,
)
from trajeval_ros.error_model.nuisances import Ask, Nuisances
from trajeval_ros.median import median
from trajeval_ros.online.results import Evaluations
from trajeval_ros.online.settings import EvaluationSettings
from trajeval_ros.runs.corrections import extrinsic_of
from trajeval_ros.runs.error_models import poses_of

Array = npt.NDArray[np.float64]
Figures = dict[str, Any]

# Of the poses, the ground truth must be known at their right stamps.
_MOST_OF_THEM = 0.95
_PIECE = 1024

RMSES = ("ate_translation", "ate_rotation", "re_translation", "re_rotation")


def with_headline(
    summary: Figures,
    evaluations: Evaluations,
    offset: int,
    start: int,
    settings: EvaluationSettings,
    known: ConventionalFigures,
) -> Figures:
    """Return a summary with its ``headline``.

    ``evaluations``: all of the run; ``offset`` (ns) is what is added to the estimate's
    stamps, and ``start`` (ns) the beginning of the run, both on the ground truth's clock;
    ``known``: the summary's conventional figures.
    """
    if not evaluations.sampled.any():
        return {**summary, "headline": None}
    whole = poses_of(evaluations, offset)
    truth, conventional = whole.truth, summary["conventional"]
    evaluated = Evaluated("", truth.stamps, truth.poses, whole.estimate)
    gauge, delta, unit = (
        settings.gauge.name,
        settings.relative_delta,
        settings.relative_unit,
    )
    # Not those of positions; and of a ground truth sparser than the estimate they are at its own
    # instants.
    alike = not summary.get("position_only") and conventional["at"] == "estimate"
    known_here = known if alike and known.poses == len(evaluated) else None
    errors = errors_of(evaluated, *steps(evaluated, delta, unit), gauge, delta, unit, known_here)
    stds = [_largest_std(truth.covariances[:, part, part]) for part in (slice(3), slice(3, 6))]
    worst = _worst(errors, truth.stamps, stds[0], start)
    if worst is not None and conventional.get("ate_rotation_rmse") is None:
        worst["rotation"] = None
    model = summary.get("error_model")
    arm = told_lever_arm(summary.get("lever_arm"), model)
    without = None
    if model is not None and not summary.get("position_only"):
        without = _without(model, conventional, evaluated, truth.at, settings)
    elif arm is not None and lever_arm_is_beyond_doubt(arm):
        without = _without_lever_arm(arm, evaluated, settings)
    headline = {
        "intervals": _intervals(errors, conventional),
        "without": without,
        "worst": worst,
        "ground_truth": {
            "translation_std": median(stds[0]),
            "rotation_std": None if summary.get("position_only") else median(stds[1]),
            "share_in_gaps": 1.0 - len(truth.stamps) / len(evaluations),
        },
    }
    return {**summary, "headline": headline}


def _largest_std(covariances: Array) -> Array:
    """Along the least certain axis; (N,)."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariances)[:, -1]))


def _intervals(errors: Errors, conventional: Mapping[str, Any]) -> Figures:
    """95 % intervals of the figures that there are, and why there is none."""
    found: Figures = {}
    for name in RMSES:
        series, rmse = getattr(errors, name), conventional.get(f"{name}_rmse")
        if series is not None and rmse is not None and len(series):
            interval = interval_of(series)
            reason = None if interval.reason is None else str(interval.reason)
            found[f"{name}_rmse"] = {"interval": interval.of(rmse), "reason": reason}
    return found


def _worst(errors: Errors, stamps: npt.NDArray[np.int64], std: Array, start: int) -> Figures | None:
    """The pose that is furthest off beyond two standard deviations of the ground truth."""
    translation, rotation = errors.ate_translation, errors.ate_rotation
    if translation is None:
        return None
    place = int(np.argmax(translation - 2.0 * std))
    return {
        "stamp": int(stamps[place]),
        "seconds_from_start": (int(stamps[place]) - start) * 1e-9,
        "translation": float(translation[place]),
        "rotation": None if rotation is None else float(rotation[place]),
        "ground_truth_std": float(std[place]),
    }


def _without(
    model: Mapping[str, Any],
    conventional: Mapping[str, Any],
    evaluated: Evaluated,
    ask: Ask,
    settings: EvaluationSettings,
) -> Figures | None:
    """The conventional figures once what is beyond doubt is put right.

    None where nothing is, or where they are not of the same poses.
    """
    names = beyond_doubt(model)
    if not names or conventional.get("at") != "estimate":
        return None
    right = _nuisances(model, names)
    stamps = right.stamps(evaluated.stamps)
    running = _running(settings)
    known = 0
    # All of a long run need not be there twice.
    for begin in range(0, len(stamps), _PIECE):
        here = slice(begin, begin + _PIECE)
        truth, estimate = ask(stamps[here]), right.corrected(evaluated.estimate[here])
        valid = truth.valid
        known += int(np.count_nonzero(valid))
        running.update(stamps[here][valid], truth.poses[valid], estimate[valid])
    if known < _MOST_OF_THEM * len(stamps):
        return None
    return {"of": list(names), **_figures(running)}


def _without_lever_arm(
    arm: Mapping[str, Any], evaluated: Evaluated, settings: EvaluationSettings
) -> Figures:
    """The conventional figures of positions once the lever arm is put right."""
    to_antenna = np.eye(4)
    to_antenna[:3, 3] = lever_arm_to_set(arm)
    running = _running(settings)
    running.update(evaluated.stamps, evaluated.ground_truth, evaluated.estimate @ to_antenna)
    found = _figures(running)
    nothing = {f"{name}_rmse": None for name in RMSES[1:]}
    return {"of": ["lever arm"], **found, **nothing}


def _running(settings: EvaluationSettings) -> RunningConventional:
    gauge, delta, unit = settings.gauge.name, settings.relative_delta, settings.relative_unit
    return RunningConventional(gauge, delta, unit)


def _figures(running: RunningConventional) -> Figures:
    figures = running.figures()
    return {
        "poses": figures.poses,
        **{f"{name}_rmse": getattr(figures, f"{name}_rmse") for name in RMSES},
    }


def _nuisances(model: Mapping[str, Any], names: Collection[str]) -> Nuisances:
    """Those of the model that are named, and nothing of the others."""
    return Nuisances(
        model["clock_offset"]["value"] if "clock" in names else 0.0,
        model["clock_rate"]["value"] if "clock rate" in names else 0.0,
        extrinsic_of(model, names),
        model["scale"]["value"] if "scale" in names else 1.0,
    )
