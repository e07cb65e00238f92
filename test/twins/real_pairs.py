# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Real estimates with their ground truth, associated."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from trajeval_ros import se3
from trajeval_ros.files.tum import read_tum

Array = npt.NDArray[np.float64]

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
SECOND = 1_000_000_000


def real_pair(directory: str, name: str) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """Stamps, ground truth and estimate, associated by the nearest stamp."""
    paths = [DATA / directory / f"{each}.txt" for each in ("groundtruth", name)]
    if not all(path.is_file() for path in paths):
        pytest.skip(f"the real data is not here: {paths[0].parent}")
    truth, other = map(read_tum, paths)
    nearest = np.searchsorted(truth.stamps, other.stamps).clip(1, len(truth) - 1)
    nearest -= other.stamps - truth.stamps[nearest - 1] < truth.stamps[nearest] - other.stamps
    near = np.abs(truth.stamps[nearest] - other.stamps) < SECOND // 100
    known, scored = [
        se3.from_position_quaternion(each.positions[rows], each.quaternions[rows])
        for each, rows in ((truth, nearest[near]), (other, near))
    ]
    return other.stamps[near], known, scored
