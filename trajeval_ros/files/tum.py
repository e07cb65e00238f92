# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The TUM format: a row is ``stamp[s] tx ty tz qx qy qz qw``, separated by blanks or commas."""

import os

import numpy as np

from trajeval_ros.files.names import Columns
from trajeval_ros.files.rows import covariances_of, trajectory_of
from trajeval_ros.files.stamps import SECONDS, read_stamps
from trajeval_ros.files.text import Layout, PathLike, read_table
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError
from trajeval_ros.online.samples import PoseSamples

_NAMED = Columns((0,), SECONDS, (1, 2, 3), 1.0, (4, 5, 6, 7))
_WITH_COVARIANCE = 20
_LAYOUT = Layout(
    {8: "stamp tx ty tz qx qy qz qw"},
    also={
        4: "stamp tx ty tz",
        _WITH_COVARIANCE: "and two covariances, of orientation and position",
    },
    named=_NAMED,
    index=True,
)


def read_tum(path: PathLike) -> Trajectory:
    """Read a trajectory; stamps are exact to the nanosecond.

    Twelve columns more are the upper triangles of two covariances, the orientation's first, as
    OpenVINS writes them.

    Raises:
        TrajectoryFileError: the file cannot be read, is empty, or a row of it is not eight
            numbers.
    """
    table = read_table(path, _LAYOUT)
    stamps, finite, remarks = read_stamps(table, SECONDS)
    quaternions, covariances = table.values[:, 4:8], None
    if table.values.shape[1] == 4:
        return trajectory_of(table, stamps, finite, table.values[:, 1:4], None, remarks)
    if table.values.shape[1] == _WITH_COVARIANCE:
        covariances = covariances_of(table.values[:, 8:], quaternions)
        remarks = (*remarks, "columns 9 to 20 are covariances, of orientation and position")
    positions = table.values[:, 1:4]
    return trajectory_of(table, stamps, finite, positions, quaternions, remarks, covariances)


def write_tum(path: PathLike, trajectory: Trajectory) -> None:
    """Write a trajectory; `read_tum` returns the same stamps and doubles.

    Raises:
        TrajectoryFileError: the file cannot be written.
    """
    try:
        with open(path, "w", encoding="utf-8", newline="\n") as file:
            file.write(tum_text(trajectory.samples))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TrajectoryFileError(os.fspath(path), f"it cannot be written: {reason}") from None


def tum_text(poses: PoseSamples) -> str:
    """What a file of these poses has in it."""
    values = np.concatenate((poses.positions, poses.quaternions), axis=1).tolist()
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for stamp, row in zip(poses.stamps.tolist(), values, strict=True):
        seconds, nanoseconds = divmod(abs(stamp), 1_000_000_000)
        sign = "-" if stamp < 0 else ""
        lines.append(f"{sign}{seconds}.{nanoseconds:09d} {' '.join(map(repr, row))}")
    return "\n".join(lines) + "\n"
