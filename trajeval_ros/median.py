# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The median without NumPy's masked arrays, whose loading is a hundredth of a short run."""

from typing import Any

import numpy as np
import numpy.typing as npt


def median(values: npt.NDArray[Any]) -> float:
    """That of numbers (n,); NaN where one is none, and of nothing.

    NumPy's function takes more time for a few hundred than they do.
    """
    if not len(values):
        return float("nan")
    middle = len(values) // 2
    parted = np.partition(values, (max(middle - 1, 0), middle, len(values) - 1))
    if len(values) % 2 or np.isnan(parted[-1]):
        return float(parted[-1 if np.isnan(parted[-1]) else middle])
    return 0.5 * (float(parted[middle - 1]) + float(parted[middle]))
