# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the error model has found that is not the estimator's fault, set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trajeval_ros import se3
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.parameters import Value
from trajeval_ros.online.settings import EstimateSettings


def corrected(
    estimate: Trajectory,
    name: str,
    settings: EstimateSettings,
    values: Mapping[str, Value],
    model: Mapping[str, Any],
    what: Sequence[str],
) -> tuple[Trajectory, dict[str, Value]]:
    """Return an estimate and all parameters' values with ``what`` the error model says put right.

    ``settings`` are the estimate's, as the ``values`` say; ``model`` is as in ``summary.json``;
    ``what``: of ``clock_offset``, ``extrinsic`` and ``scale``.
    """
    changed = dict(values)
    if "clock_offset" in what:
        offset = 1e-9 * settings.time_offset + model["clock_offset"]["value"]
        changed[f"{name}.time_offset"] = offset
    if "extrinsic" in what:
        known, found = (
            se3.from_position_quaternion(np.array(pose[:3]), np.array(pose[3:]))
            for pose in (settings.extrinsic, model["extrinsic"]["pose"])
        )
        position, quaternion = se3.to_position_quaternion(found @ known)
        own = "extrinsic" if "extrinsic" in values else f"{name}.extrinsic"
        changed[own] = (*position.tolist(), *quaternion.tolist())
    if "scale" in what:
        estimate = replace(estimate, positions=estimate.positions * model["scale"]["value"])
    return estimate, changed
