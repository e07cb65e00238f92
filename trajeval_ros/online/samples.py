# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses as they arrive on a topic or stand in a file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class PoseSamples:
    """Unchecked poses in the order of their arrival.

    ``stamps`` (n,) ns; ``positions`` (n, 3) m; ``quaternions`` (n, 4) x y z w; ``covariances`` (n,
    6, 6) about the fixed axes of the parent frame, as in a ROS message, or None.
    """

    stamps: Stamps
    positions: Array
    quaternions: Array
    covariances: Array | None = None

    def __post_init__(self) -> None:
        """Raise :class:`ValueError` on shapes that do not fit."""
        n = len(self.stamps)
        shapes = [(self.stamps, (n,)), (self.positions, (n, 3)), (self.quaternions, (n, 4))]
        if self.covariances is not None:
            shapes.append((self.covariances, (n, 6, 6)))
        for array, expected in shapes:
            if array.shape != expected:
                raise ValueError(f"an array of shape {array.shape} where {expected} is expected")

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.stamps)

    def __getitem__(self, index: slice) -> PoseSamples:
        """Return consecutive poses."""
        covariances = None if self.covariances is None else self.covariances[index]
        return PoseSamples(
            self.stamps[index], self.positions[index], self.quaternions[index], covariances
        )
