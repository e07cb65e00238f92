# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``poses.csv`` of an output folder, read again."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.files.trajectory import TrajectoryFileError

Array = npt.NDArray[np.float64]

_AXES = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")


@dataclasses.dataclass(frozen=True, eq=False)
class WrittenPoses:
    """The evaluated poses of a run, in the order of time.

    Attributes:
        stamps: (M,) int64 ns, the estimate's own.
        ground_truth: (M, 4, 4) T_world_body at these stamps.
        estimate: (M, 4, 4), in its own world.
    """

    stamps: npt.NDArray[np.int64]
    ground_truth: Array
    estimate: Array


def read_poses(path: str | os.PathLike[str]) -> WrittenPoses:
    """Read ``poses.csv``.

    Raises:
        TrajectoryFileError: it cannot be read, or is not as `OutputFolder` writes it.
    """
    source = os.fspath(path)
    try:
        header, _, rows = Path(path).read_text(encoding="utf-8").partition("\n")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TrajectoryFileError(source, f"it cannot be read: {reason}") from None
    except UnicodeDecodeError:
        raise TrajectoryFileError(source, "it is not a text file") from None
    names = header.strip().split(",")
    try:
        # By name: later versions may write more columns.
        wanted = [names.index(f"{prefix}_{axis}") for prefix in ("gt", "est") for axis in _AXES]
        first = names.index("stamp_ns")
    except ValueError:
        raise TrajectoryFileError(source, "its columns are not those of poses.csv", 1) from None
    lines = rows.splitlines()
    if not lines:
        raise TrajectoryFileError(source, "there is no pose in it")
    try:
        # As integers: a double does not hold nanoseconds since 1970.
        stamps = np.array(
            [int(line.split(",", first + 1)[first]) for line in lines], dtype=np.int64
        )
        values = np.loadtxt(lines, delimiter=",", usecols=wanted, ndmin=2)
        truth, estimate = (
            se3.from_position_quaternion(part[:, :3], part[:, 3:])
            for part in (values.reshape(-1, 14)[:, :7], values.reshape(-1, 14)[:, 7:])
        )
        if np.any(stamps[1:] <= stamps[:-1]) or not np.isfinite(values).all():
            raise ValueError
    except (ValueError, OverflowError):
        raise TrajectoryFileError(source, "a row of it is not as poses.csv's are") from None
    return WrittenPoses(stamps, truth, estimate)
