# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The KITTI format: a row is the first three rows of ``T_world_camera``.

The stamps are in a file of their own, a row of seconds each; without it the poses are a tenth of a
second apart, as the benchmark's are.
"""

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.matrices import quaternions_of
from trajeval_ros.files.rows import trajectory_of
from trajeval_ros.files.stamps import SECONDS, read_stamps
from trajeval_ros.files.text import Layout, PathLike, Table, read_table
from trajeval_ros.files.trajectory import Integers, Trajectory, TrajectoryFileError

_INTERVAL = 100_000_000


def read_kitti(path: PathLike, times: PathLike | None = None) -> Trajectory:
    """Read a trajectory; its rotations become quaternions.

    A matrix that is not a rotation to 1e-2 (a zero or scaled one, a mirror image) gets the
    quaternion (0, 0, 0, 0), and one with an element that is not finite NaN: both are kept here
    and recognised as bad poses by the engine, as in the formats that have quaternions.

    Args:
        path: the file of poses, 12 columns.
        times: the file of stamps, one column; None: 10 Hz, from zero.

    Raises:
        TrajectoryFileError: one of the files cannot be read, is empty or has another number of
            columns, or they have different numbers of rows.
    """
    table = read_table(path, Layout({12: "r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz"}))
    stamps, finite, remarks = _stamps(table, times)
    matrices = table.values.reshape(-1, 3, 4)
    quaternions = quaternions_of(matrices[:, :, :3])
    return trajectory_of(table, stamps, finite, matrices[:, :, 3], quaternions, remarks)


def _stamps(
    table: Table, times: PathLike | None
) -> tuple[Integers, npt.NDArray[np.bool_], tuple[str, ...]]:
    """The stamps (N,) ns of the rows, which are finite, and remarks."""
    count = len(table.rows)
    if times is None:
        return _INTERVAL * np.arange(count, dtype=np.int64), np.ones(count, dtype=np.bool_), ()
    stamp_table = read_table(times, Layout({1: "seconds"}))
    if len(stamp_table.rows) != count:
        raise TrajectoryFileError(
            stamp_table.source,
            f"{len(stamp_table.rows):,} stamps for the {count:,} poses of {table.source}: there"
            " must be one a pose, in the same order; is it of this sequence, and whole?",
        )
    stamps, finite, remarks = read_stamps(stamp_table, SECONDS)
    return stamps, finite, (*stamp_table.remarks, *remarks)
