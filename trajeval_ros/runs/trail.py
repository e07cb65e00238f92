# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The evaluated poses to show: a whole run thinned to a bounded number, and the newest in full."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.online.results import Evaluations

Array = npt.NDArray[np.float64]

DEVIATIONS = 3.0
"""An ellipsoid's half axes in standard deviations: in three dimensions 97 % lie inside."""
SMALLEST = 1e-6
"""m, the least size of a marker: RViz refuses one of zero."""


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


NO_POSES = Poses(
    np.empty(0, dtype=np.int64), np.empty((0, 4, 4)), np.empty((0, 6, 6)), np.empty((0, 4, 4))
)


# So many poses are taken in at once.
_TOGETHER = 256


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
        self._run = self._recent = NO_POSES
        self._waiting: list[Poses] = []
        self._taken = self._count = 0
        self._stride = 1

    @property
    def count(self) -> int:
        """Number of poses taken in so far."""
        return self._count

    @property
    def run(self) -> Poses:
        """Those that are kept of the whole run."""
        self._take_in()
        return self._run

    @property
    def recent(self) -> Poses:
        """The newest."""
        self._take_in()
        return self._recent

    def add(self, evaluations: Evaluations) -> None:
        """Take in the next poses; they wait for others, as a batch costs hardly more than one."""
        if not len(evaluations):
            return
        poses = Poses(
            evaluations.stamps,
            evaluations.ground_truth,
            evaluations.covariance,
            evaluations.estimate,
        )
        self._waiting.append(poses)
        self._count += len(poses)
        if self._count - self._taken >= _TOGETHER:
            self._take_in()

    def _take_in(self) -> None:
        if not self._waiting:
            return
        poses = _joined(self._waiting)
        kept = poses.pick(slice(-self._taken % self._stride, None, self._stride))
        self._recent = _joined([self._recent, poses]).pick(slice(-self._recent_length, None))
        self._run = _joined([self._run, kept])
        self._waiting, self._taken = [], self._count
        while len(self._run) > self._capacity:
            self._run = self._run.pick(slice(None, None, 2))
            self._stride *= 2


def _joined(parts: list[Poses]) -> Poses:
    """One after the other."""
    return Poses(
        np.concatenate([part.stamps for part in parts]),
        np.concatenate([part.ground_truth for part in parts]),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.estimate for part in parts]),
    )


def ellipsoids(poses: Array, covariance: Array) -> tuple[Array, Array, Array]:
    """The uncertainty of positions as ellipsoids in the world.

    poses: (n, 4, 4) T_world_body. covariance: (n, 6, 6), right perturbation, body frame. Returns
    positions (n, 3), the axes' directions as quaternions xyzw (n, 4) and the standard deviations
    along them (n, 3): with R of the quaternion, ``R diag(s²) Rᵀ`` is the position's covariance in
    the world's axes.
    """
    fixed = se3.covariance_to_fixed_axes(covariance, poses)[:, :3, :3]
    variances, axes = np.linalg.eigh(fixed)
    # A rotation, not a reflection: a direction and its opposite are the same axis.
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    turned = np.array(poses)
    turned[:, :3, :3] = axes
    positions, quaternions = se3.to_position_quaternion(turned)
    return positions, quaternions, np.sqrt(np.maximum(variances, 0.0))
