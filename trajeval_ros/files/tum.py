# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The TUM format: a row is ``stamp[s] tx ty tz qx qy qz qw``, separated by blanks or commas."""

import os

import numpy as np

from trajeval_ros.files.text import PathLike, read_table, stamps_from_seconds
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError

_COLUMNS = {8: "stamp tx ty tz qx qy qz qw"}


def read_tum(path: PathLike) -> Trajectory:
    """Read a trajectory; stamps are exact to the nanosecond.

    Raises:
        TrajectoryFileError: the file cannot be read, is empty, or a row of it is not eight
            numbers.
    """
    table = read_table(path, _COLUMNS)
    stamps, finite = stamps_from_seconds(table)
    return Trajectory(
        stamps=stamps[finite],
        positions=table.values[finite, 1:4],
        quaternions=table.values[finite, 4:8],
        rows=table.rows[finite],
        source=table.source,
        non_finite_stamp_rows=table.rows[~finite],
    )


def write_tum(path: PathLike, trajectory: Trajectory) -> None:
    """Write a trajectory; `read_tum` returns the same stamps and doubles.

    Raises:
        TrajectoryFileError: the file cannot be written.
    """
    values = np.concatenate((trajectory.positions, trajectory.quaternions), axis=1).tolist()
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for stamp, row in zip(trajectory.stamps.tolist(), values, strict=True):
        seconds, nanoseconds = divmod(abs(stamp), 1_000_000_000)
        sign = "-" if stamp < 0 else ""
        lines.append(f"{sign}{seconds}.{nanoseconds:09d} {' '.join(map(repr, row))}")
    try:
        with open(path, "w", encoding="utf-8", newline="\n") as file:
            file.write("\n".join(lines) + "\n")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TrajectoryFileError(os.fspath(path), f"it cannot be written: {reason}") from None
