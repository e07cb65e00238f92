# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rotations between two instants of a trajectory, and the turn that relates two of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

SECOND = 1_000_000_000

FEWEST = 30
"""Poses, or pairs of them, below which nothing is said."""

STEP = 0.5
"""s between the poses of a pair, so that the rotation between them stands above the noise."""

# Root mean square rotation of a pair, rad, below which there is nothing to compare.
_TURNING = 0.03


def angles(rotation: Array) -> Array:
    """How far each rotation (B, 3, 3) is from the first, rad."""
    turned = se3.log_so3(rotation[0].T @ rotation)
    return np.asarray(np.linalg.norm(turned, axis=-1))


def distances(position: Array) -> Array:
    """How far each position (B, 3) is from the first, m."""
    return np.asarray(np.linalg.norm(position - position[0], axis=-1))


def pairs(stamps: Stamps, step: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Indices of poses at least ``step`` seconds apart, and not much more."""
    later = np.searchsorted(stamps, stamps + round(step * SECOND))
    first = np.flatnonzero(later < len(stamps))
    second = later[first]
    near = stamps[second] - stamps[first] < round(3 * step * SECOND)
    return first[near], second[near]


def between(rotation: Array, first: npt.NDArray[np.intp], second: npt.NDArray[np.intp]) -> Array:
    """Rotation vectors from the first to the second of each pair, body frame, (P, 3)."""
    return se3.log_so3(rotation[first].swapaxes(-1, -2) @ rotation[second])


def turns(stamps: Stamps, rotation: Array) -> bool:
    """Whether orientations change within a step by more than noise."""
    steps = between(rotation, *pairs(stamps, STEP))
    return len(steps) >= FEWEST and bool(np.sqrt((steps**2).sum(axis=1).mean()) >= _TURNING)


def quaternion(rotation: Array) -> list[float]:
    """x, y, z, w of a rotation (3, 3)."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return [float(value) + 0.0 for value in se3.to_position_quaternion(pose)[1]]


class TurnFit(NamedTuple):
    """The turn B (3, 3) that explains rotations best, and the shares it leaves unexplained."""

    turn: Array
    as_is: float
    turned: float
    axes: int


def fit_turn(truth: Array, other: Array) -> TurnFit:
    """Wahba's problem: B minimising ``sum |truth_k - B other_k|²`` over rotation vectors (P, 3)."""
    u, singular, vt = np.linalg.svd(truth.T @ other)
    sign = np.sign(np.linalg.det(u @ vt))
    turn = u @ np.diag([1.0, 1.0, sign]) @ vt
    size = float(np.sqrt((truth**2).sum()))

    def share(unexplained: Array) -> float:
        # Of no rotation at all nothing can be explained.
        return float(np.linalg.norm(unexplained)) / size if size > 0.0 else 1.0

    return TurnFit(
        turn=turn,
        as_is=share(truth - other),
        turned=share(truth - other @ turn.T),
        axes=int((singular > 0.02 * singular[0]).sum()),
    )
