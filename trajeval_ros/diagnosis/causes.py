# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likely causes of a large error: what people get wrong about their data, with the evidence.

Each test looks at what its mistake, and nothing else, changes.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.clock import clock_offset
from trajeval_ros.diagnosis.orientation import as_written
from trajeval_ros.diagnosis.rotations import FEWEST, Array, Stamps
from trajeval_ros.diagnosis.scale import wrong_scale
from trajeval_ros.diagnosis.unchanging import constant_orientation, stuck


def likely_causes(
    stamps: Stamps,
    ground_truth: Array,
    estimate: Array,
    gauge: str,
    *,
    time_offset: float = 0.0,
    extrinsic: Array | None = None,
) -> tuple[Cause, ...]:
    """Return what is likely wrong; nothing for data that are only inaccurate.

    ``stamps`` (B,) ns, ``ground_truth`` and ``estimate`` (B, 4, 4), each in a world of its own, at
    instants where the ground truth is known well; as they were evaluated, with ``time_offset`` (s)
    added to the estimate's stamps and its poses moved by ``extrinsic``, T_gtbody_estbody (4, 4).
    An advice is the value to set, whatever is set now.
    """
    if len(stamps) < FEWEST:
        return ()
    still = stuck(ground_truth, estimate)
    if still:
        return still
    constant = constant_orientation(stamps, ground_truth[:, :3, :3], estimate[:, :3, :3])
    if constant:
        scale = wrong_scale(stamps, ground_truth[:, :3, 3], estimate[:, :3, 3], gauge)
        return (*constant, *scale)
    applied = np.eye(4) if extrinsic is None else extrinsic
    written, ground_truth, estimate = as_written(stamps, ground_truth, estimate, gauge, applied)
    # What is left is looked for in the poses as they were meant.
    scale = wrong_scale(stamps, ground_truth[:, :3, 3], estimate[:, :3, 3], gauge)
    rotations = ground_truth[:, :3, :3], estimate[:, :3, :3]
    return (*written, *scale, *clock_offset(stamps, *rotations, time_offset))
