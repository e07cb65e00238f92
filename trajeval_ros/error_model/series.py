# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a chain of `axes` is a likelihood of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Series(NamedTuple):
    """A group's errors at N poses.

    intervals: (N - 1,), s. errors: (3, N). variance: of the ground truth on one axis, (N,).
    measured, moved: factors of the variance of each pose's jitter and of each step's process.
    """

    intervals: Array
    errors: Array
    variance: Array
    measured: Array
    moved: Array
