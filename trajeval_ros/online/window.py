# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The evaluated poses of the last seconds."""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.likelihood.joint import FactorRows, JointFactor

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class EvaluatedPoses:
    """Poses that have been evaluated.

    ``stamps`` (M,) ns on the ground truth's clock; ``ground_truth`` (M, 4, 4) with ``covariance``
    (M, 6, 6), body frame, right perturbation, its body ``twist`` (M, 6), and the stamp (ns) of its
    sample ``nearest`` to each (M,); ``estimate`` (M, 4, 4) in its own world.
    ``cross``, where the ground truth's errors are not taken as independent of each other: for each
    pose, (p, 6, 6), their covariances ``E[ξ_j ξ_iᵀ]`` with the p poses j just before it, oldest
    first.
    """

    stamps: Stamps
    ground_truth: Array
    covariance: Array
    estimate: Array
    cross: tuple[Array, ...] | None = None
    twist: Array | None = None
    nearest: Stamps | None = None

    @property
    def joint_covariance(self) -> Array | FactorRows:
        """The covariance of all poses, as `trajeval_ros.likelihood` takes it."""
        return joint_covariance(self.covariance, self.cross)

    def where(self, mask: Mask) -> EvaluatedPoses:
        """Return some of the poses; ``cross`` of each stays as it is."""
        if mask.all():
            return self
        cross = self.cross and tuple(itertools.compress(self.cross, mask))
        return EvaluatedPoses(
            self.stamps[mask],
            self.ground_truth[mask],
            self.covariance[mask],
            self.estimate[mask],
            cross,
            None if self.twist is None else self.twist[mask],
            None if self.nearest is None else self.nearest[mask],
        )

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.stamps)


def joint_covariance(covariance: Array, cross: tuple[Array, ...] | None) -> Array | FactorRows:
    """``covariance`` (M, 6, 6) itself, or the factor with ``cross`` of :class:`EvaluatedPoses`.

    What ``cross`` says of poses before the first is left out.
    """
    if cross is None:
        return covariance
    inside = [blocks[max(len(blocks) - i, 0) :] for i, blocks in enumerate(cross)]
    return JointFactor().update(covariance, inside)


class Window(NamedTuple):
    """Consecutive poses and the M - 1 steps between them, as in `trajeval_ros.likelihood.relative`.

    ``error`` (M - 1, 6) and ``adjoint`` (M - 1, 6, 6).
    """

    poses: EvaluatedPoses
    error: Array
    adjoint: Array


# Of a pose: ground truth, covariance, estimate, and error and adjoint of the step that ends there.
_SHAPES = ((4, 4), (6, 6), (4, 4), (6,), (6, 6))


class SlidingWindow:
    """The poses no older than ``duration`` (ns) before the newest."""

    def __init__(self, duration: int) -> None:
        """Start empty."""
        self.duration = duration
        self._stamps, self._columns = _room(0)
        self._begin = self._end = 0
        self._cross: deque[Array] = deque()  # of the live poses, if the covariance is joint

    def append(self, poses: EvaluatedPoses, error: Array, adjoint: Array) -> None:
        """Add later poses and drop those that have become too old.

        ``error`` (n, 6) and ``adjoint`` (n, 6, 6) of the step that ends at each; of the very first
        pose they mean nothing.
        """
        count = len(poses)
        if not count:
            return
        if self._end + count > len(self._stamps):
            self._make_room(count)
        here = slice(self._end, self._end + count)
        self._stamps[here] = poses.stamps
        new = (poses.ground_truth, poses.covariance, poses.estimate, error, adjoint)
        for column, values in zip(self._columns, new, strict=True):
            column[here] = values
        self._end += count
        oldest = self._stamps[self._end - 1] - self.duration
        live = self._stamps[self._begin : self._end]
        self._begin += int(np.searchsorted(live, oldest))
        if poses.cross is not None:
            self._cross.extend(poses.cross)
            while len(self._cross) > self._end - self._begin:
                self._cross.popleft()

    def _make_room(self, count: int) -> None:
        """Move the live poses to the front of new arrays at least twice as long as they are."""
        live = slice(self._begin, self._end)
        self._begin, self._end = 0, self._end - self._begin
        stamps, columns = _room(max(64, 2 * (self._end + count)))
        stamps[: self._end] = self._stamps[live]
        for new, old in zip(columns, self._columns, strict=True):
            new[: self._end] = old[live]
        self._stamps, self._columns = stamps, columns

    def contents(self) -> Window:
        """Return what is in the window, as views that nothing is written to any more."""
        live = slice(self._begin, self._end)
        ground_truth, covariance, estimate, error, adjoint = (c[live] for c in self._columns)
        cross = tuple(self._cross) if self._cross else None
        poses = EvaluatedPoses(self._stamps[live], ground_truth, covariance, estimate, cross)
        # The first pose's step began outside.
        return Window(poses, error[1:], adjoint[1:])


def _room(size: int) -> tuple[Stamps, tuple[Array, ...]]:
    """Arrays for the stamps and the rest of so many poses."""
    return np.empty(size, dtype=np.int64), tuple(np.empty((size, *shape)) for shape in _SHAPES)
