# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The EuRoC format: a row is ``stamp[ns], px, py, pz, qw, qx, qy, qz`` and maybe more.

``state_groundtruth_estimate0/data.csv`` has 17 columns (velocity and IMU biases follow, which
are not read), ``vicon0/data.csv`` has 8.
"""

from trajeval_ros.files.text import PathLike, read_table, stamps_from_nanoseconds
from trajeval_ros.files.trajectory import Trajectory

_COLUMNS = {
    8: "stamp px py pz qw qx qy qz",
    17: "stamp px py pz qw qx qy qz, velocity, gyroscope and accelerometer bias",
}


def read_euroc(path: PathLike) -> Trajectory:
    """Read a trajectory; the quaternions' order becomes x y z w.

    Raises:
        TrajectoryFileError: the file cannot be read, is empty, a row of it is not 8 or 17
            numbers, or a stamp is not a whole number of nanoseconds.
    """
    table = read_table(path, _COLUMNS)
    stamps, finite = stamps_from_nanoseconds(table)
    return Trajectory(
        stamps=stamps[finite],
        positions=table.values[finite, 1:4],
        quaternions=table.values[finite][:, [5, 6, 7, 4]],
        rows=table.rows[finite],
        source=table.source,
        non_finite_stamp_rows=table.rows[~finite],
    )
