# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Root mean squares of errors, from sums."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.alignment.rotation_moments import RotationMoments
from trajeval_ros.alignment.umeyama import Moments

Array = npt.NDArray[np.float64]


class MeanSquares:
    """Root mean squares of errors (M, 6)."""

    def __init__(self) -> None:
        """Start without errors."""
        self._count = 0
        self._sums = np.zeros(2)

    def update(self, errors: Array) -> None:
        """Add errors (M, 6)."""
        self._count += len(errors)
        self._sums += (errors**2).reshape(len(errors), 2, 3).sum(axis=(0, 2))

    def roots(self) -> tuple[float | None, float | None]:
        """Return the translation's (m) and the rotation's (rad)."""
        if not self._count:
            return None, None
        translation, rotation = np.sqrt(self._sums / self._count)
        return float(translation), float(rotation)


class ResidualMoments:
    """Root mean squares of ``T_gt⁻¹ g T_est`` under any alignment g, in constant memory."""

    def __init__(self) -> None:
        """Start without poses."""
        self._positions = Moments.empty()
        self._rotations = RotationMoments()

    def update(self, ground_truth: Array, estimate: Array) -> None:
        """Add poses (M, 4, 4)."""
        self._positions = self._positions.updated(estimate[:, :3, 3], ground_truth[:, :3, 3])
        self._rotations.update(estimate[:, :3, :3] @ np.swapaxes(ground_truth[:, :3, :3], -1, -2))

    def roots(self, alignment: Similarity) -> tuple[float, float]:
        """Return the RMS distance (m) and angle (rad) under ``alignment``."""
        moments, rotation = self._positions, alignment.pose[:3, :3]
        scaled = alignment.scale * rotation
        # Of y - (s R x + t): the mean, and the factor of the spread about it.
        mean = moments.mean_target - scaled @ moments.mean_source - alignment.pose[:3, 3]
        spread = moments.factor[:, 3:] - moments.factor[:, :3] @ scaled.T
        square = float(mean @ mean) + float(np.vdot(spread, spread)) / moments.count
        return math.sqrt(square), math.sqrt(self._rotations.mean_square_angle(rotation))
