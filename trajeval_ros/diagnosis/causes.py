# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likely causes of a large error: what people get wrong about their data, with the evidence.

Each test looks at what its mistake, and nothing else, changes.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros import se3
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.clock import clock_offset
from trajeval_ros.diagnosis.orientation import misread_or_turned
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
    scale = wrong_scale(stamps, ground_truth[:, :3, 3], estimate[:, :3, 3], gauge)
    rotations = ground_truth[:, :3, :3], estimate[:, :3, :3]
    constant = constant_orientation(stamps, *rotations)
    if constant:
        return (*constant, *scale)
    applied = np.eye(4) if extrinsic is None else extrinsic
    turned = misread_or_turned(stamps, *rotations, se3.inverse(applied)[:3, :3].T)
    return (*turned, *scale, *clock_offset(stamps, *rotations, time_offset))
