# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What has been found that is not the estimator's fault, set; and an estimate's world moved."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.diagnosis.fitted import beyond_doubt
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.parameters import Value
from trajeval_ros.online.settings import EstimateSettings

Array = npt.NDArray[np.float64]

# What each of them is made of.
_PARTS = {"clock_offset": ("clock",), "extrinsic": ("lever arm", "mounting"), "scale": ("scale",)}


class Corrected(NamedTuple):
    """An estimate with what is not its fault put right, and the values of parameters that change.

    applied, doubted: the names of what was set, and of what is not beyond doubt and was not.
    """

    estimate: Trajectory
    changed: dict[str, Value]
    applied: tuple[str, ...]
    doubted: tuple[str, ...]


def corrected(
    estimate: Trajectory,
    name: str,
    settings: EstimateSettings,
    values: Mapping[str, Value],
    model: Mapping[str, Any],
    what: Sequence[str],
) -> Corrected:
    """Return an estimate with ``what`` the error model says beyond doubt put right.

    ``settings`` are the estimate's, as the ``values`` say; ``model`` is as in ``summary.json``;
    ``what``: of ``clock_offset``, ``extrinsic`` and ``scale``.
    """
    changed: dict[str, Value] = {}
    told = beyond_doubt(model)
    if "clock_offset" in what and "clock" in told:
        offset = 1e-9 * settings.time_offset + model["clock_offset"]["value"]
        changed[f"{name}.time_offset"] = offset
    if "extrinsic" in what:
        known = settings.extrinsic
        found = extrinsic_of(model, told) @ se3.from_position_quaternion(
            np.array(known[:3]), np.array(known[3:])
        )
        position, quaternion = se3.to_position_quaternion(found)
        for own in {"extrinsic", f"{name}.extrinsic"} & set(values):
            changed[own] = (*position.tolist(), *quaternion.tolist())
    if "scale" in what and "scale" in told:
        scale, path = model["scale"]["value"], estimate.latest_path
        scaled = path and replace(path, positions=path.positions * scale)
        estimate = replace(estimate, positions=estimate.positions * scale, latest_path=scaled)
    parts = {each: _PARTS[each] for each in what}
    if "rotation" not in model["extrinsic"] and "extrinsic" in parts:
        parts["extrinsic"] = ("lever arm",)
    applied, doubted = [], []
    for each, of in parts.items():
        there = [part for part in of if part in told]
        if len(there) == len(of):
            applied.append(each)
            continue
        applied += there
        doubted += [part for part in of if part not in told] if there else [each]
    return Corrected(estimate, changed, tuple(applied), tuple(doubted))


def extrinsic_of(model: Mapping[str, Any], names: Collection[str]) -> Array:
    """The extrinsic (4, 4) with lever arm or mounting, where ``names`` has them, and no more."""
    pose = np.array(model["extrinsic"]["pose"])
    extrinsic = se3.from_position_quaternion(pose[:3], pose[3:])
    if "mounting" not in names:
        extrinsic[:3, :3] = np.eye(3)
    if "lever arm" not in names:
        extrinsic[:3, 3] = 0.0
    return extrinsic


def moved(estimate: Trajectory, pose: Array) -> Trajectory:
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
