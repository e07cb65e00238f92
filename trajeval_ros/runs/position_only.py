# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of positions without orientations, as GNSS and total stations give them.

What is told of each is `trajeval_ros.online.positions`'s.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from trajeval_ros import se3
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.fitted import clock_causes, lever_arm_causes, told_lever_arm
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.engine import Engine

if TYPE_CHECKING:
    from trajeval_ros.comparison.compare import Comparison


def note_orientations(
    engine: Engine, truth: Trajectory, estimates: Mapping[str, Trajectory]
) -> None:
    """Tell an engine, before it is fed, which of the trajectories have no orientation."""
    if not truth.has_orientation:
        engine.note_without_orientation(None)
    for name, estimate in estimates.items():
        if not estimate.has_orientation:
            engine.note_without_orientation(name)


def causes_on_positions(
    engine: Engine, name: str, summary: Mapping[str, Any], model: Mapping[str, Any] | None
) -> tuple[Cause, ...]:
    """What positions tell of lever arm and clock; ``model``: the run's error model, if any."""
    own = engine.settings.estimates[name]
    found: tuple[Cause, ...] = ()
    arm = told_lever_arm(summary.get("lever_arm"), model)
    if arm is not None:
        found = lever_arm_causes(arm, se3.inverse(own.from_body))
    if model is not None:
        found = (*found, *clock_causes(model, 1e-9 * own.time_offset))
    return found


def comparisons_on_positions(
    comparisons: Iterable[Comparison], summaries: Mapping[str, Mapping[str, Any]]
) -> tuple[Comparison, ...]:
    """Comparisons without what contains an orientation, where either has none."""
    alone = {name for name, summary in summaries.items() if summary.get("position_only")}
    nothing: dict[str, Any] = dict.fromkeys(("ate_rotation", "re_translation", "re_rotation"))
    return tuple(
        replace(each, **nothing) if alone & {each.a, each.b} else each for each in comparisons
    )
