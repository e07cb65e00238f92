# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likely causes of a large error: what people get wrong about their data, with the evidence.

Each test looks at what its mistake, and nothing else, changes.
"""

from __future__ import annotations

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.clock import clock_offset
from trajeval_ros.diagnosis.orientation import misread_or_turned
from trajeval_ros.diagnosis.rotations import FEWEST, Array, Stamps
from trajeval_ros.diagnosis.scale import wrong_scale
from trajeval_ros.diagnosis.unchanging import constant_orientation, stuck


def likely_causes(
    stamps: Stamps, ground_truth: Array, estimate: Array, gauge: str
) -> tuple[Cause, ...]:
    """Return what is likely wrong; nothing for data that are only inaccurate.

    ``stamps`` (B,) ns, ``ground_truth`` and ``estimate`` (B, 4, 4), each in a world of its own, at
    instants where the ground truth is known well.
    """
    if len(stamps) < FEWEST:
        return ()
    still = stuck(ground_truth, estimate)
    if still:
        return still
    scale = wrong_scale(stamps, ground_truth[:, :3, 3], estimate[:, :3, 3], gauge)
    rotations = ground_truth[:, :3, :3], estimate[:, :3, :3]
    constant = constant_orientation(stamps, *rotations)
    if constant:
        return (*constant, *scale)
    return (*misread_or_turned(stamps, *rotations), *scale, *clock_offset(stamps, *rotations))
