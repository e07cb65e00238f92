# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The errors that an ATE is of, pose by pose, from a summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity

Array = npt.NDArray[np.float64]


def ate_errors(
    conventional: Mapping[str, Any], ground_truth: Array, estimate: Array
) -> tuple[Array, Array]:
    """Return the absolute errors in translation (m) and rotation (rad), (M,) each.

    ``conventional``: that part of a summary, whose ``alignment`` they are under; ``ground_truth``
    and ``estimate`` (M, 4, 4). NaN where the summary has no ATE.
    """
    nothing = np.full(len(ground_truth), np.nan)
    if conventional.get("ate_translation_rmse") is None:
        return nothing, nothing.copy()
    pose = np.array(conventional["alignment"]["pose"])
    alignment = Similarity(
        se3.from_position_quaternion(pose[:3], pose[3:]), conventional["alignment"]["scale"]
    )
    moved = alignment.apply(estimate)
    translation = np.linalg.norm(ground_truth[:, :3, 3] - moved[:, :3, 3], axis=-1)
    if conventional.get("ate_rotation_rmse") is None:
        return translation, nothing
    turns = ground_truth[:, :3, :3].swapaxes(-1, -2) @ moved[:, :3, :3]
    return translation, np.linalg.norm(se3.log_so3(turns), axis=-1)
