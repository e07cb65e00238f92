# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The EuRoC format: a row is ``stamp[ns], px, py, pz, qw, qx, qy, qz`` and maybe more.

``state_groundtruth_estimate0/data.csv`` has 17 columns (velocity and IMU biases follow, which
are not read), ``vicon0/data.csv`` has 8, ``leica0/data.csv`` 4, VINS-Mono's results 11.
"""

from trajeval_ros.files.names import Columns
from trajeval_ros.files.rows import trajectory_of
from trajeval_ros.files.stamps import NANOSECONDS, read_stamps
from trajeval_ros.files.text import Layout, PathLike, read_table
from trajeval_ros.files.trajectory import Trajectory

_COLUMNS = {
    8: "stamp px py pz qw qx qy qz",
    17: "stamp px py pz qw qx qy qz, velocity, gyroscope and accelerometer bias",
}
_NAMED = Columns((0,), NANOSECONDS, (1, 2, 3), 1.0, (5, 6, 7, 4))
_LAYOUT = Layout(_COLUMNS, also={4: "stamp px py pz"}, at_least=8, named=_NAMED)


def read_euroc(path: PathLike) -> Trajectory:
    """Read a trajectory; the quaternions' order becomes x y z w.

    Raises:
        TrajectoryFileError: the file cannot be read, is empty, a row of it has fewer than 8
            numbers or is no row of numbers, or a stamp is not a whole number of nanoseconds.
    """
    table = read_table(path, _LAYOUT)
    stamps, finite, remarks = read_stamps(table, NANOSECONDS)
    count = table.values.shape[1]
    if count == 4:
        return trajectory_of(table, stamps, finite, table.values[:, 1:4], None, remarks)
    if table.named is None and count not in _COLUMNS:
        remarks = (*remarks, f"{count - 8} columns after the first 8 are not read")
    order = [5, 6, 7, 4] if table.named is None else [4, 5, 6, 7]
    quaternions = table.values[:, order]
    return trajectory_of(table, stamps, finite, table.values[:, 1:4], quaternions, remarks)
