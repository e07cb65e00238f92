# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From the rows of a file to a trajectory: one norm of quaternions, one order, one row a stamp."""

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.files.order import ordered
from trajeval_ros.files.text import Table
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# So many of the quaternions, and as many rows, share a norm that is not 1 ...
_MOST, _FEWEST = 0.95, 30
# ... to this, as the engine does: a share of the norm.
_ALIKE = 1e-2
# Covariances (N, 12) as OpenVINS and rpg write them: two upper triangles, orientation first.
_UPPER = np.triu_indices(3)


def trajectory_of(
    table: Table,
    stamps: Integers,
    finite: Mask,
    positions: Array,
    quaternions: Array | None,
    remarks: tuple[str, ...],
    covariances: Array | None = None,
) -> Trajectory:
    """The trajectory of a table's rows, by stamp.

    ``stamps`` (N,) ns, of which ``finite`` (N,) are; ``positions`` (N, 3); ``quaternions`` (N, 4)
    and ``covariances`` (N, 6, 6), or None.

    Raises:
        TrajectoryFileError: all stamps are the same.
    """
    if len(stamps) > 2 and finite.all() and (stamps == stamps[0]).all():
        raise TrajectoryFileError(
            table.source,
            f"all {len(stamps):,} rows have one stamp, {table.first[0]}: it was never set, or"
            " written with too few digits",
        )
    oriented = quaternions is not None and not _none_is_given(quaternions)
    if quaternions is None or not oriented:
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
        remarks = (*remarks, "positions only: figures that need orientations are left out")
    quaternions, renormed = _normalised(quaternions)
    metres = 1.0 if table.named is None else table.named.metres
    # Of all of them, views: a long file is not to be there twice.
    kept = slice(None) if finite.all() else finite
    return ordered(
        Trajectory(
            stamps=stamps[kept],
            positions=positions[kept] if metres == 1.0 else metres * positions[kept],
            quaternions=quaternions[kept],
            rows=table.rows[kept],
            source=table.source,
            covariances=None if covariances is None else covariances[kept],
            non_finite_stamp_rows=table.rows[~finite],
            has_orientation=oriented,
            remarks=(*table.remarks, *remarks, *renormed),
        )
    )


def _none_is_given(quaternions: Array) -> bool:
    """Whether there are rows (N, 4), and all are NaN or zero: no orientation is meant."""
    if len(quaternions) < _FEWEST:
        return False
    return bool((np.isnan(quaternions).all(axis=1) | (quaternions == 0.0).all(axis=1)).all())


def _normalised(quaternions: Array) -> tuple[Array, tuple[str, ...]]:
    """Quaternions (N, 4) of one norm that is not 1, made 1; what differs in norm stays."""
    with np.errstate(over="ignore", invalid="ignore"):
        norms = np.sqrt(np.einsum("ij,ij->i", quaternions, quaternions))
    known = norms[np.isfinite(norms) & (norms > 0.0)]
    if len(known) < _FEWEST:
        return quaternions, ()
    norm = median(known)
    alike = np.abs(norms / norm - 1.0) <= _ALIKE
    if abs(norm - 1.0) <= _ALIKE or int(alike.sum()) < _MOST * len(known):
        return quaternions, ()
    remark = f"quaternions of norm {norm:.4g}: normalised"
    return quaternions / np.where(alike, norms, 1.0)[:, None], (remark,)


def covariances_of(triangles: Array, quaternions: Array) -> Array:
    """Covariances (N, 6, 6) about fixed axes from two upper triangles (N, 12).

    The first is of the orientation, rad², about the body's axes, as OpenVINS estimates and
    evaluates it; the second of the position, m², in the world's.
    """
    count = len(triangles)
    rotation, position = np.zeros((2, count, 3, 3))
    for matrix, values in ((rotation, triangles[:, :6]), (position, triangles[:, 6:])):
        matrix[:, _UPPER[0], _UPPER[1]] = values
        matrix[:, _UPPER[1], _UPPER[0]] = values
    covariances = np.zeros((count, 6, 6))
    covariances[:, :3, :3] = position
    turnable = np.isfinite(quaternions).all(axis=1) & (np.abs(quaternions).max(axis=1) > 1e-6)
    usable = np.where(turnable[:, None], quaternions, [0.0, 0.0, 0.0, 1.0])
    axes = se3.from_position_quaternion(np.zeros((count, 3)), usable)[:, :3, :3]
    covariances[:, 3:, 3:] = axes @ rotation @ axes.swapaxes(-1, -2)
    return covariances
