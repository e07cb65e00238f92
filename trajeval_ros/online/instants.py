# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conventional errors at the ground truth's own instants, where it is sparser than the estimate.

Between control points, or samples at 1 Hz of a handheld motion, the ground truth at an estimate's
stamp is mostly interpolation, and a figure that knows no uncertainty takes its error for the
estimate's. The estimate is the one that is known well in between: so it is interpolated, and the
ground truth is not.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import Gauge
from trajeval_ros.conventional.running import RunningConventional
from trajeval_ros.conventional.step_pairs import StepUnit

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# The poses around an instant are at most this share of the time to the sample before it apart.
_DENSER = 0.5
# Of the time that is evaluated, the part in which the ground truth has to be that sparse; and the
# fewest instants for a figure.
_MOST, _FEWEST = 0.5, 4
# Samples that wait for estimates, up to twice as many. What is sparse never comes near.
_CAPACITY = 20_000


class Instants:
    """The figures at the ground truth's samples, whatever the batches are in which poses come."""

    def __init__(self, gauge: Gauge, delta: float, unit: StepUnit) -> None:
        """Start without samples and poses."""
        # Made when it is needed: it is not small, and few ground truths need it.
        self._of: tuple[Gauge, float, StepUnit] = gauge, delta, unit
        self._conventional: RunningConventional | None = None
        self.count = 0
        self._samples: list[tuple[Stamps, Array]] = []
        self._waiting = 0
        self._sample_before: int | None = None
        self._last: tuple[int, Array] | None = None
        self._sparse = 0
        self._evaluated = 0

    @property
    def are_told(self) -> bool:
        """Whether the ground truth is sparser than the estimate, and these are the figures."""
        return self.count >= _FEWEST and self._sparse >= _MOST * self._evaluated

    @property
    def figures(self) -> RunningConventional | None:
        """The figures, where they are told."""
        return self._conventional if self.are_told else None

    def add_ground_truth(self, stamps: Stamps, poses: Array) -> None:
        """Take samples (N,), ns, increasing, (N, 4, 4), that no pose before needs."""
        self._samples.append((stamps, poses))
        self._waiting += len(stamps)
        if self._waiting > 2 * _CAPACITY:
            self._keep(slice(-_CAPACITY, None))

    def _keep(self, rows: slice) -> None:
        """Let some of the samples wait, as arrays of their own."""
        stamps, poses = self._joined()
        self._samples = [(stamps[rows].copy(), poses[rows].copy())]
        self._waiting = len(self._samples[0][0])

    def _joined(self) -> tuple[Stamps, Array]:
        if len(self._samples) != 1:
            stamps = np.concatenate([np.empty(0, np.int64), *(each for each, _ in self._samples)])
            poses = np.concatenate([np.empty((0, 4, 4)), *(each for _, each in self._samples)])
            self._samples = [(stamps, poses)]
        return self._samples[0]

    def add_estimate(self, stamps: Stamps, poses: Array) -> None:
        """Take evaluated poses (M,), ns on the ground truth's clock, increasing, (M, 4, 4)."""
        if self._last is not None:
            stamps = np.concatenate([[self._last[0]], stamps])
            poses = np.concatenate([self._last[1][None], poses])
        if not len(stamps):
            return
        self._last = int(stamps[-1]), poses[-1]
        self._evaluated += int(stamps[-1] - stamps[0])
        instants, truth, gaps = self._taken(int(stamps[0]), int(stamps[-1]))
        if not len(instants) or len(stamps) < 2:
            return
        after = np.searchsorted(stamps, instants).clip(1, len(stamps) - 1)
        begin, end = stamps[after - 1], stamps[after]
        denser = (end - begin) <= _DENSER * gaps
        if not denser.any():
            return
        self._sparse += int(gaps[denser].sum())
        begin, end, after = begin[denser], end[denser], after[denser]
        weight = (instants[denser] - begin) / (end - begin)
        step = se3.log(se3.compose(se3.inverse(poses[after - 1]), poses[after]))
        between = se3.compose(poses[after - 1], se3.exp(weight[:, None] * step))
        if self._conventional is None:
            self._conventional = RunningConventional(*self._of)
        self._conventional.update(instants[denser], truth[denser], between)
        self.count += int(denser.sum())

    def _taken(self, first: int, last: int) -> tuple[Stamps, Array, Stamps]:
        """The samples after ``first`` up to ``last``, and how far each is from the one before."""
        stamps, poses = self._joined()
        count = int(np.searchsorted(stamps, last, side="right"))
        before = [] if self._sample_before is None else [self._sample_before]
        ends = np.concatenate([np.array(before, np.int64), stamps[:count]])
        if count:
            self._sample_before = int(stamps[count - 1])
        gaps = np.diff(ends)
        # The first of all has none before it.
        taken = slice(count - len(gaps), count)
        later = stamps[taken] > first
        found = stamps[taken][later], poses[taken][later], gaps[later]
        self._keep(slice(count, None))
        return found
