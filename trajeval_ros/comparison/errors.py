# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of two estimates at the same instants and over the same steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import Gauge
from trajeval_ros.comparison.common import Evaluated, Indices
from trajeval_ros.conventional.running import ConventionalFigures, RunningConventional
from trajeval_ros.conventional.step_pairs import StepUnit
from trajeval_ros.conventional.sub_trajectories import errors_between

Array = npt.NDArray[np.float64]

# A step that takes longer than this, in steps, has a gap in it.
_LONGEST_STEP = 1.5
_PIECE = 1024


class Errors(NamedTuple):
    """Conventional errors of one estimate, of (M,) poses and (K,) steps; None where unknown.

    m and rad, as ``conventional/running.py`` defines them, aligned over these poses.
    """

    ate_translation: Array | None
    ate_rotation: Array | None
    re_translation: Array | None
    re_rotation: Array


def steps(evaluated: Evaluated, delta: float, unit: StepUnit) -> tuple[Indices, Indices]:
    """Begin and end, (K,) each, of all steps: from every pose to the first one a step later.

    In m along the ground truth, the same for whatever estimate; in f by number. A step that is more
    than half too long is left out: it has a gap in it.
    """
    if unit == "s":
        place = (evaluated.stamps - evaluated.stamps[:1]) * 1e-9
        # As exact as the stamps are: neither 0.1 + 0.2 nor a jitter of ns lengthens a step.
        delta_low = delta - 1e-9
    elif unit == "f":
        place, delta_low = np.arange(len(evaluated), dtype=np.float64), delta
    else:
        walked = np.linalg.norm(np.diff(evaluated.ground_truth[:, :3, 3], axis=0), axis=-1)
        place = np.concatenate(([0.0], np.cumsum(walked)))[: len(evaluated)]
        delta_low = delta
    end = np.maximum(np.searchsorted(place, place + delta_low), np.arange(len(place)) + 1)
    begin = np.flatnonzero(end < len(place))
    end = end[begin]
    short = place[end] - place[begin] <= _LONGEST_STEP * delta
    return begin[short].astype(np.int64), end[short].astype(np.int64)


def errors_of(
    evaluated: Evaluated,
    begin: Indices,
    end: Indices,
    gauge: Gauge,
    delta: float,
    unit: StepUnit,
    known: ConventionalFigures | None = None,
) -> Errors:
    """The errors of an estimate, and of its steps from `begin` to `end`, (K,) each.

    `known`: the figures of these very poses, where somebody has them.

    Raises:
        ValueError: an unknown gauge or unit, or a delta that is not positive and finite.
    """
    if known is None:
        running = RunningConventional(gauge, delta, unit)
        running.update(evaluated.stamps, evaluated.ground_truth, evaluated.estimate)
        known = running.figures()
    alignment = known.alignment
    ate_translation = ate_rotation = re_translation = None
    if alignment is not None and known.ate_translation_rmse is not None:
        moved = alignment.transform_positions(evaluated.estimate[:, :3, 3])
        ate_translation = np.linalg.norm(moved - evaluated.ground_truth[:, :3, 3], axis=-1)
    if alignment is not None and known.ate_rotation_rmse is not None:
        ate_rotation = _angles(evaluated, alignment.rotation)
    scale = 1.0 if alignment is None else float(alignment.scale)
    of_steps = errors_between(evaluated.ground_truth, evaluated.estimate, begin, end, scale)
    if alignment is not None and (gauge != "sim3" or known.re_translation_rmse is not None):
        re_translation = of_steps.translation
    return Errors(ate_translation, ate_rotation, re_translation, of_steps.rotation)


def _angles(evaluated: Evaluated, rotation: Array) -> Array:
    """Of the estimate turned by an alignment's ``rotation`` from the ground truth, (M,)."""
    angles = np.empty(len(evaluated))
    # All of a long run need not be there twice.
    for begin in range(0, len(angles), _PIECE):
        here = slice(begin, begin + _PIECE)
        back = evaluated.ground_truth[here, :3, :3].swapaxes(-1, -2)
        turn = back @ rotation @ evaluated.estimate[here, :3, :3]
        angles[here] = np.linalg.norm(se3.log_so3(turn), axis=-1)
    return angles
