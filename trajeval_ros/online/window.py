# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The evaluated poses of the last seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class EvaluatedPoses:
    """Poses that have been evaluated.

    ``stamps`` (M,) ns on the ground truth's clock; ``ground_truth`` (M, 4, 4) with ``covariance``
    (M, 6, 6), body frame, right perturbation; ``estimate`` (M, 4, 4) in its own world.
    """

    stamps: Stamps
    ground_truth: Array
    covariance: Array
    estimate: Array

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.stamps)


class SlidingWindow:
    """The poses no older than ``duration`` (ns) before the newest."""

    def __init__(self, duration: int) -> None:
        """Start empty."""
        self.duration = duration
        self._stamps = np.empty(0, dtype=np.int64)
        self._rows = np.empty((0, 68))
        self._begin = self._end = 0

    def append(self, poses: EvaluatedPoses) -> None:
        """Add later poses and drop those that have become too old."""
        count = len(poses)
        if not count:
            return
        if self._end + count > len(self._stamps):
            self._make_room(count)
        here = slice(self._end, self._end + count)
        self._stamps[here] = poses.stamps
        self._rows[here, :16] = poses.ground_truth.reshape(count, 16)
        self._rows[here, 16:52] = poses.covariance.reshape(count, 36)
        self._rows[here, 52:] = poses.estimate.reshape(count, 16)
        self._end += count
        oldest = self._stamps[self._end - 1] - self.duration
        live = self._stamps[self._begin : self._end]
        self._begin += int(np.searchsorted(live, oldest))

    def _make_room(self, count: int) -> None:
        """Move the live rows to the front of a buffer at least twice as long as they are."""
        live = slice(self._begin, self._end)
        size = max(64, 2 * (self._end - self._begin + count))
        stamps, rows = np.empty(size, dtype=np.int64), np.empty((size, 68))
        self._end -= self._begin
        stamps[: self._end], rows[: self._end] = self._stamps[live], self._rows[live]
        self._stamps, self._rows, self._begin = stamps, rows, 0

    def poses(self) -> EvaluatedPoses:
        """Return a copy of the window's poses."""
        live = slice(self._begin, self._end)
        rows, count = self._rows[live].copy(), self._end - self._begin
        return EvaluatedPoses(
            self._stamps[live].copy(),
            rows[:, :16].reshape(count, 4, 4),
            rows[:, 16:52].reshape(count, 6, 6),
            rows[:, 52:].reshape(count, 4, 4),
        )
