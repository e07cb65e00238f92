# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What has been found that is not the estimator's fault, set; and an estimate's world moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

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
        for own in {"extrinsic", f"{name}.extrinsic"} & set(values):
            changed[own] = (*position.tolist(), *quaternion.tolist())
    if "scale" in what:
        scale, path = model["scale"]["value"], estimate.latest_path
        scaled = path and replace(path, positions=path.positions * scale)
        estimate = replace(estimate, positions=estimate.positions * scale, latest_path=scaled)
    return estimate, changed


def moved(estimate: Trajectory, pose: npt.NDArray[np.float64]) -> Trajectory:
    """Return an estimate whose world is moved by ``pose`` (4, 4): T becomes ``pose @ T``.

    Rows that are no pose are none afterwards: a quaternion keeps its norm, zero or not a number.
    """
    x, y, z, w = se3.to_position_quaternion(pose)[1]
    # The product of quaternions, as a matrix that acts on x y z w.
    product = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
    rotation = pose[:3, :3]
    covariances = estimate.covariances
    if covariances is not None:
        both = np.kron(np.eye(2), rotation)
        covariances = both @ covariances @ both.T
    path = estimate.latest_path
    if path is not None:
        path = replace(
            path,
            positions=path.positions @ rotation.T + pose[:3, 3],
            quaternions=path.quaternions @ product.T,
        )
    return replace(
        estimate,
        positions=estimate.positions @ rotation.T + pose[:3, 3],
        quaternions=estimate.quaternions @ product.T,
        covariances=covariances,
        latest_path=path,
    )
