# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The evaluated poses to show: a whole run thinned to a bounded number, and the newest in full."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros.online.results import Evaluations

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses evaluated together: stamps (n,) ns, T_world_body, covariance, T_estworld_body."""

    stamps: npt.NDArray[np.int64]
    ground_truth: Array
    covariance: Array
    estimate: Array

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.stamps)

    def pick(self, index: slice) -> Poses:
        """Return some of them."""
        return Poses(
            self.stamps[index],
            self.ground_truth[index],
            self.covariance[index],
            self.estimate[index],
        )

    def followed_by(self, later: Poses) -> Poses:
        """Return these and the later ones."""
        return Poses(
            np.concatenate([self.stamps, later.stamps]),
            np.concatenate([self.ground_truth, later.ground_truth]),
            np.concatenate([self.covariance, later.covariance]),
            np.concatenate([self.estimate, later.estimate]),
        )


NO_POSES = Poses(
    np.empty(0, dtype=np.int64), np.empty((0, 4, 4)), np.empty((0, 6, 6)), np.empty((0, 4, 4))
)


class Trail:
    """A run in bounded memory.

    Every ``stride``-th pose is kept. When there are more than ``capacity``, every other one of them
    goes and the stride doubles: between half and all of the capacity, evenly spread over the run.
    """

    def __init__(self, capacity: int = 1000, recent: int = 50) -> None:
        """Start empty."""
        self._capacity = capacity
        self._recent_length = recent
        self.clear()

    def clear(self) -> None:
        """Start over."""
        self.run = NO_POSES
        self.recent = NO_POSES
        self._stride = 1
        self._count = 0

    @property
    def count(self) -> int:
        """Number of poses taken in so far."""
        return self._count

    def add(self, evaluations: Evaluations) -> None:
        """Take in the next poses."""
        if not len(evaluations):
            return
        poses = Poses(
            evaluations.stamps,
            evaluations.ground_truth,
            evaluations.covariance,
            evaluations.estimate,
        )
        self.recent = self.recent.followed_by(poses).pick(slice(-self._recent_length, None))
        self.run = self.run.followed_by(
            poses.pick(slice(-self._count % self._stride, None, self._stride))
        )
        self._count += len(poses)
        while len(self.run) > self._capacity:
            self.run = self.run.pick(slice(None, None, 2))
            self._stride *= 2
