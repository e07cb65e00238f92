# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Millimetres for metres, or a trajectory of no known scale: by a Sim(3) alignment."""

from __future__ import annotations

import itertools

import numpy as np

from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.rotations import SECOND, Array, Stamps

# A scale further from 1 than this, that removes this share of the error. The scale of good odometry
# wanders by 15 % within 13 s, so shorter runs show a gross one only. At rest there is none: the
# error left over must be this small a share of the motion.
_SCALE = 0.05
_GROSS_SCALE = 0.5
_SCALE_SPAN = 15.0
_GAIN = 0.6
_MOVING = 0.3
_UNITS = {"millimetres": 1000, "centimetres": 100}


def wrong_scale(
    stamps: Stamps, ground_truth: Array, estimate: Array, gauge: str
) -> tuple[Cause, ...]:
    """Millimetres for metres, or a trajectory of no known scale."""
    if gauge in ("none", "sim3"):
        return ()
    similar = align_positions(estimate, ground_truth, "sim3")
    rigid = align_positions(estimate, ground_truth, "se3")
    scale = float(similar.scale)
    long = stamps[-1] - stamps[0] >= _SCALE_SPAN * SECOND
    least = np.log1p(_SCALE if long else _GROSS_SCALE)
    motion = float(np.sqrt(ground_truth.var(axis=0).sum()))
    left_over = min(_GAIN * rigid.rmse, _MOVING * motion)
    if not (scale > 0 and abs(np.log(scale)) > least and similar.rmse < left_over):
        return ()
    evidence = f"aligned with the scale {scale:.4g} the error falls from {rigid.rmse:.3g} m"
    evidence += f" to {similar.rmse:.3g} m"
    for (unit, number), title in itertools.product(_UNITS.items(), ("estimate", "ground truth")):
        factor = 1.0 / number if title == "estimate" else float(number)
        if abs(np.log10(scale / factor)) < 0.1:
            return (
                Cause(
                    unit,
                    f"the {title} is in {unit}: {evidence}",
                    f"divide the {title}'s positions by {number}",
                ),
            )
    return (Cause("scale", f"the estimate's scale is not 1: {evidence}", "set gauge=sim3"),)
