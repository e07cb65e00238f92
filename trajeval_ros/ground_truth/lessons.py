# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When the hyperparameters are learned, and from which segments: a function of the data alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth import learning
from trajeval_ros.ground_truth.hyperparameters import GroupHyperparameters, Hyperparameters
from trajeval_ros.ground_truth.likelihood import Record
from trajeval_ros.ground_truth.models import Model
from trajeval_ros.ground_truth.segment import Segment

Array = npt.NDArray[np.float64]

# The hyperparameters are learned when the closed segments that show motion cover so much time (ns)
# for the first time, and again whenever they cover twice as much as then, four times, eight times.
_FIRST = 8_000_000_000
_LESSONS = 4
# A robot that does not move teaches nothing; after so much of it (ns) that must do.
_LATEST = 30_000_000_000
# A segment moves when the spread of its coordinates exceeds the instrument's accuracy so much.
_MOVING = 5.0
# Learning costs the same at any rate and after any time: of each segment every k-th sample, so that
# so many are left, and so many segments, evenly over the run.
SAMPLES = 48
SEGMENTS = 16
_DIGITS = 7
# More noise than this (m, rad), or than four times the instrument's accuracy, is improbable.
_SOFT_LIMITS = (2e-3, 5e-3)


class Lessons:
    """Collects closed segments, and learns when they suffice."""

    def __init__(self, model: Model, accuracy: tuple[float, float]) -> None:
        """``accuracy``: the instrument's, in translation (m) and rotation (rad)."""
        self._model = model
        self._accuracy = accuracy
        self._moving: list[Segment] = []
        self._still: list[Segment] = []
        self._covered = 0
        self._stood = 0
        self._taken = 0
        self._theta: tuple[Array | None, Array | None] = (None, None)

    def add(self, segment: Segment) -> Hyperparameters | None:
        """Take a closed segment; return what has been learned, if it was time to."""
        if self._taken == _LESSONS:
            return None
        duration = int(segment.samples.stamps[-1] - segment.samples.stamps[0])
        if self._moves(segment):
            self._moving.append(segment)
            self._covered += duration
        elif not self._taken:
            self._still.append(segment)
            self._stood += duration
        due = self._covered >= _FIRST << self._taken
        overdue = not self._taken and self._covered + self._stood >= _LATEST
        return self.learn() if due or overdue else None

    def _moves(self, segment: Segment) -> bool:
        spread = np.std(segment.coordinates, axis=0).reshape(2, 3).max(axis=1)
        return bool((spread > _MOVING * np.array(self._accuracy)).any())

    def learn(self, further: list[Segment] | None = None) -> Hyperparameters | None:
        """Learn from the segments so far and ``further`` ones; None with too few samples."""
        moving = self._moving + [s for s in further or [] if self._moves(s)]
        segments = moving or self._still + (further or [])
        segments = segments[:: max(1, -(-len(segments) // SEGMENTS))]
        translation = self._learn_group(0, segments)
        rotation = self._learn_group(1, segments)
        if translation is None or rotation is None:
            return None
        # What a robot at rest has taught is no place to search near once it moves.
        self._theta = (translation[1], rotation[1]) if moving else (None, None)
        self._taken += 1
        self._still = []
        if self._taken == _LESSONS:
            self._moving = []
        return Hyperparameters(translation[0], rotation[0])

    def _learn_group(
        self, group: int, segments: list[Segment]
    ) -> tuple[GroupHyperparameters, Array] | None:
        columns = slice(3 * group, 3 * group + 3)
        records = [_record(segment, columns) for segment in segments]
        accuracy = self._accuracy[group]
        soft_limit = max(_SOFT_LIMITS[group], 4.0 * accuracy)
        return learning.learn(self._model, records, accuracy, soft_limit, self._theta[group])


def _record(segment: Segment, columns: slice) -> Record:
    """What a segment gives, to a tenth of a micrometre.

    The search for the optimum amplifies the last digit of its data, and that one depends on how the
    samples were cut into batches; rounded, the data are the same bits, and so is what is learned.
    """
    every = slice(None, None, -(-len(segment) // SAMPLES))
    variances = segment.variances
    known = np.zeros(len(segment))
    if variances is not None:
        known = np.mean(variances[:, columns], axis=-1).round(2 * _DIGITS)
    values = segment.coordinates[:, columns].round(_DIGITS)
    return Record(segment.times[every], values[every], known[every])
