# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of poses one step apart, for the conventional relative error.

The pairs are consecutive and do not overlap: each begins where the one before ended, the first
at the first pose. A pair ends at the first pose

- `s`: stamped at or after ``delta`` seconds since its beginning,
- `f`: ``delta`` poses (frames) on,
- `m`: where the path travelled since its beginning, the sum of the distances from pose to
  pose, has reached ``delta`` metres; it starts again from zero for the next pair.

`m` is evo's ``filter_pairs_by_path`` with ``all_pairs=False``, `f` its ``filter_pairs_by_index``.
Evo has no step in seconds. No pair is dropped for being longer than asked for, in a gap for
instance; `StepPairs.longest` tells.
"""

import math
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
StepUnit = Literal["s", "m", "f"]

STEP_UNITS: tuple[StepUnit, ...] = ("s", "m", "f")


class _Start(NamedTuple):
    """What is known of the pair under way: the pose it began at, and what came since.

    ``path``: m; with `f` the poses since.
    """

    stamp: int
    ground_truth: Array
    estimate: Array
    path: float
    last_position: Array


class StepPairs:
    """Forms the pairs as poses come; in constant memory and whatever the batches.

    Args:
        delta: the step, s, m or f, above zero.
        unit: `s`, `m` or `f`.
        path_of_ground_truth: whether `m` is measured along the ground truth; else along the
            estimate.

    Raises:
        ValueError: a delta that is not positive and finite, or no whole number of frames; or an
            unknown unit.
    """

    def __init__(self, delta: float, unit: StepUnit, path_of_ground_truth: bool = False) -> None:
        if not (math.isfinite(delta) and delta > 0):
            raise ValueError(f"delta must be positive and finite, got {delta}")
        if unit not in STEP_UNITS:
            raise ValueError(f"unknown unit {unit!r}: one of {', '.join(STEP_UNITS)}")
        if unit == "f" and delta != int(delta):
            raise ValueError(f"delta must be a whole number of frames, got {delta}")
        self._delta = delta
        self._unit = unit
        self._path_of_ground_truth = path_of_ground_truth
        self._start: _Start | None = None
        self.longest: float | None = None
        """The longest step of a pair so far, s, m or f; None before the first pair."""

    def update(
        self, stamps: Stamps, ground_truth: Array, estimate: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Add poses; the pairs that they complete.

        Args:
            stamps: (M,) ns, strictly increasing, from one call to the next too.
            ground_truth: (M, 4, 4).
            estimate: (M, 4, 4).

        Returns:
            Ground truth at the begin and the end, estimate at the begin and the end of each of
            the K completed pairs, each (K, 4, 4).
        """
        if len(stamps) == 0:
            return ground_truth, ground_truth, estimate, estimate
        walked = (ground_truth if self._path_of_ground_truth else estimate)[:, :3, 3]
        if self._start is None:
            self._start = _Start(int(stamps[0]), ground_truth[0], estimate[0], 0.0, walked[0])
            stamps, ground_truth, estimate = stamps[1:], ground_truth[1:], estimate[1:]
            walked = walked[1:]
        start = self._start
        # The pose where the pair under way began comes first, so index 0 is carried over.
        stamps = np.concatenate(([start.stamp], stamps))
        ground_truth = np.concatenate((start.ground_truth[np.newaxis], ground_truth))
        estimate = np.concatenate((start.estimate[np.newaxis], estimate))
        positions = np.concatenate((start.last_position[np.newaxis], walked))
        steps = np.linalg.norm(np.diff(positions, axis=0), axis=-1)

        if self._unit == "s":
            ends, lengths, path = self._ends_by_time(stamps)
        elif self._unit == "f":
            ends, lengths, path = self._ends_by_number(len(steps), int(start.path))
        else:
            ends, lengths, path = self._ends_by_path(steps, start.path)
        if lengths:
            self.longest = max(lengths + ([] if self.longest is None else [self.longest]))
        begins = [0, *ends[:-1]] if ends else []
        last = ends[-1] if ends else 0
        self._start = _Start(
            int(stamps[last]),
            ground_truth[last].copy(),
            estimate[last].copy(),
            path,
            positions[-1].copy(),
        )
        return ground_truth[begins], ground_truth[ends], estimate[begins], estimate[ends]

    def _ends_by_time(self, stamps: Stamps) -> tuple[list[int], list[float], float]:
        """Indices (K,) into stamps where a pair ends, its steps in s, and an unused path."""
        delta_ns = max(round(self._delta * 1e9), 1)
        ends: list[int] = []
        # Where a pair begins depends on where the one before ended: a loop over pairs.
        end = 0
        while (end := int(np.searchsorted(stamps, stamps[end] + delta_ns))) < len(stamps):
            ends.append(end)
        seconds = np.diff(stamps[[0, *ends]]) * 1e-9
        return ends, seconds.tolist(), 0.0

    def _ends_by_number(self, count: int, since: int) -> tuple[list[int], list[float], float]:
        """Indices (K,) of poses where a pair ends, its steps in frames, and the poses since.

        ``count`` poses come after index 0, ``since`` of the pair under way came before.
        """
        delta = int(self._delta)
        ends = list(range(delta - since, count + 1, delta))
        left = count - ends[-1] if ends else since + count
        return ends, [float(delta)] * len(ends), float(left)

    def _ends_by_path(self, steps: Array, path: float) -> tuple[list[int], list[float], float]:
        """Indices (K,) of poses where a pair ends, its path in m, and the path since the last.

        ``steps[j]`` leads to pose j + 1, and ``path`` has been travelled before the first.
        """
        ends: list[int] = []
        lengths: list[float] = []
        # A loop over pairs, as by time. The running sum is the one of one addition after the
        # other from the pair's beginning, as evo's is, so that ties fall alike; it looks ahead
        # in chunks, so that the sums of all pairs together cost a pass or two over the steps.
        begin, chunk = 0, 64
        while begin < len(steps):
            sums = np.cumsum(np.concatenate(([path], steps[begin : begin + chunk])))[1:]
            reached = int(np.searchsorted(sums, self._delta))
            if reached < len(sums):
                ends.append(begin + reached + 1)
                lengths.append(float(sums[reached]))
                path = 0.0
                begin += reached + 1
                chunk = max(16, 2 * (reached + 1))
            else:
                path = float(sums[-1])
                begin += len(sums)
        return ends, lengths, path
