# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When the hyperparameters are learned, and from which segments: a function of the data alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.ground_truth import learning
from trajeval_ros.ground_truth.likelihood import Record
from trajeval_ros.ground_truth.models import Model
from trajeval_ros.ground_truth.process import Process
from trajeval_ros.ground_truth.regimes import Learned
from trajeval_ros.ground_truth.segment import Segment
from trajeval_ros.ground_truth.stamps import rounding, stamp_noise
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]

# The hyperparameters are learned when the closed segments that show motion cover so much time (ns)
# for the first time, and again whenever they cover twice as much as then, four times, eight times.
_FIRST = 8_000_000_000
# A robot that does not move teaches nothing; after so much of it (ns) that must do.
_LATEST = 30_000_000_000
# A segment moves when the spread of its coordinates exceeds the noise that is there so much: white
# noise alone has a ratio of one, and of eight samples hardly ever more than this. Where samples are
# so rare that neighbours differ as much as all do, it moves where it turns by more than any noise
# does, rad.
_MOVING = 2.5
_TURNING = 0.5
# Learning costs the same at any rate and after any time: of each segment every k-th sample, so that
# so many are left, and so many segments, evenly over the run.
SAMPLES = 48
SEGMENTS = 16
# Of every second one, so many that follow each other, besides: where the recording is cleaner than
# usual they show it.
NEIGHBOURS = 128
# No clock has ticks too many: where more of the intervals are so much shorter than the usual one,
# stamps are uncertain, and what is between neighbours is theirs.
_SHORT, _OFTEN = 0.9, 0.05
_DIGITS = 7
_ROTATION = 1
# More noise than this (m, rad), or than four times the instrument's accuracy, is improbable.
_SOFT_LIMITS = (2e-3, 5e-3)


class Lesson(NamedTuple):
    """What the hyperparameters are learned from; what they are depends on it alone.

    ``moves``: whether there is motion in it; ``accuracy`` as of `Lessons`; ``before``: what motion
    has taught so far; where there is no orientation none is learned from.
    """

    model: Model
    accuracy: tuple[float, float]
    exact_stamps: bool
    moving: Sequence[Segment]
    segments: Sequence[Segment]
    moves: bool
    before: Process | None
    lacks_orientation: bool = False

    def learned(self) -> Process | None:
        """Return what is most probable: 0.1 s and more; None with too few samples."""
        exact = self.exact_stamps
        stamp_std, shared = (0.0, 0.0) if exact else _stamp_stds(self.moving, self.accuracy)
        translation, rotation = (self._of_group(group, stamp_std) for group in (0, 1))
        if translation is None or rotation is None:
            return None
        return Process.of((translation, rotation), stamp_std, shared)

    def _of_group(self, group: int, stamp_std: float) -> Learned | None:
        columns = slice(3 * group, 3 * group + 3)
        records = [
            _record(segment, columns, stamp_std, _evenly(segment)) for segment in self.segments
        ]
        accuracy = self.accuracy[group]
        soft_limit = max(_SOFT_LIMITS[group], 4.0 * accuracy)
        if group == _ROTATION and self.lacks_orientation:
            return learning.nothing(self.model, records, accuracy, soft_limit)
        theta = None
        if self.before is not None:
            assert self.before.learned is not None
            theta = self.before.learned[group].theta
        neighbours = [] if stamp_std else self._neighbours(columns)
        return learning.learn(
            self.model, records, accuracy, soft_limit, theta, self.moves, neighbours
        )

    def _neighbours(self, columns: slice) -> list[Record | None]:
        """Of every second segment samples that follow each other, where lessons skip some."""
        dense = any(len(segment) > SAMPLES for segment in self.segments)
        if not (self.moves and dense and _regular(self.segments)):
            return []
        return [
            None if index % 2 else _record(segment, columns, 0.0, _middle(segment))
            for index, segment in enumerate(self.segments)
        ]


class Lessons:
    """Collects closed segments, and says when it is time for a lesson."""

    def __init__(
        self, model: Model, accuracy: tuple[float, float], exact_stamps: bool = False
    ) -> None:
        """``accuracy``: the instrument's, in translation (m) and rotation (rad).

        With ``exact_stamps`` no noise of the stamps is looked for.
        """
        self._exact_stamps = exact_stamps
        self._model = model
        self._accuracy = accuracy
        self._moving = _Reservoir()
        self._still = _Reservoir()
        self._due = _FIRST
        self._changed = 0
        self._patience = _FIRST
        self._process: Process | None = None
        self._taught_by_motion = False
        self.lacks_orientation = False
        """Whether the samples are of positions alone."""

    def add(self, segment: Segment) -> Lesson | None:
        """Take a closed segment; return the lesson that is due, which `take` is told the end of."""
        duration = int(segment.samples.stamps[-1] - segment.samples.stamps[0])
        (self._moving if _moves(segment) else self._still).add(segment, duration)
        if self._process is not None and segment.begun and _is_new(segment):
            self._changed += duration
        if self._process is None:
            overdue = self._moving.covered + self._still.covered >= _LATEST
            return self._lesson() if self._moving.covered >= _FIRST or overdue else None
        if self._changed >= self._patience:
            self._patience *= 2
            return self._lesson()
        return self._lesson() if self._moving.covered >= self._due else None

    def take(self, lesson: Lesson, process: Process | None) -> None:
        """Go on from what the ``lesson`` has taught."""
        if process is not None:
            self._process = process
            self._taught_by_motion = lesson.moves

    def learn(self, further: Sequence[Segment] = ()) -> Process | None:
        """Learn from the segments so far and ``further`` ones; None with too few samples."""
        lesson = self._lesson(further)
        process = lesson.learned()
        self.take(lesson, process)
        return process

    def _lesson(self, further: Sequence[Segment] = ()) -> Lesson:
        moving = [*self._moving.segments, *(s for s in further if _moves(s))]
        still = [*self._still.segments, *(s for s in further if not _moves(s))]
        segments = [
            *_thinned(moving, SEGMENTS),
            *_thinned(still, SEGMENTS if not moving else SEGMENTS // 4),
        ]
        while self._due <= self._moving.covered:
            self._due *= 2
        self._changed = 0
        before = self._process if self._taught_by_motion else None
        return Lesson(
            self._model,
            self._accuracy,
            self._exact_stamps,
            moving,
            segments,
            bool(moving),
            before,
            self.lacks_orientation,
        )


class _Reservoir:
    """Some of the segments added, evenly over the run."""

    def __init__(self) -> None:
        """Start empty."""
        self.segments: list[Segment] = []
        self.covered = 0
        self._every = 1
        self._added = 0

    def add(self, segment: Segment, duration: int) -> None:
        """Take one that covers ``duration`` (ns)."""
        self.covered += duration
        if self._added % self._every == 0:
            self.segments.append(segment.unconditioned)
            if len(self.segments) > 2 * SEGMENTS:
                self.segments = self.segments[::2]
                self._every *= 2
        self._added += 1


def _thinned(segments: list[Segment], count: int) -> list[Segment]:
    return segments[:: max(1, -(-len(segments) // count))]


def _moves(segment: Segment) -> bool:
    """Whether the coordinates' spread exceeds what neighbouring samples differ by, or it turns."""
    x = segment.coordinates
    if len(segment) >= 3:
        spread, noise = spread_and_noise(x)
        if any(wide > _MOVING * rough for wide, rough in zip(spread, noise, strict=True)):
            return True
    return bool(np.abs(x[:, 3:]).max() > _TURNING)


def spread_and_noise(x: Array) -> tuple[Sequence[float], Sequence[float]]:
    """How far coordinates (n, 6) are spread, and what neighbours differ by without motion.

    Standard deviations, the largest of translation and of rotation.
    """
    if loops.there():
        spread, noise = np.empty(2), np.empty(2)
        loops.call("segment_spread", loops.doubles(x), len(x), spread, noise)
        return spread.tolist(), noise.tolist()
    spread = x.std(axis=0).reshape(2, 3).max(axis=1)
    noise = np.sqrt(0.5 * np.mean(np.diff(x, axis=0) ** 2, axis=0)).reshape(2, 3).max(axis=1)
    return spread.tolist(), noise.tolist()


def _stamp_stds(segments: Sequence[Segment], accuracy: tuple[float, float]) -> tuple[float, float]:
    """How uncertain stamps are each and together, to a hundredth of a millisecond.

    As in `_record`.
    """
    data = [(segment.times, segment.coordinates.round(_DIGITS)) for segment in segments]
    rounded = rounding([segment.samples.stamps for segment in segments], data)
    # Where stamps are rounded for sure, that is what residuals follow.
    alone = rounded.least or stamp_noise(data, accuracy, rounded.std)
    return round(alone, 5), round(rounded.shared, 5)


def _is_new(segment: Segment) -> bool:
    """Whether its samples were in a regime that its process was not learned from."""
    epoch = segment.epochs[-1]
    learned = epoch.process.learned or ()
    return any(each.is_new(regime) for each, regime in zip(learned, epoch.regimes, strict=True))


def _regular(segments: Sequence[Segment]) -> bool:
    """Whether hardly an interval is shorter than the usual one."""
    intervals = np.concatenate([np.diff(segment.times) for segment in segments])
    return float(np.mean(intervals < _SHORT * median(intervals))) <= _OFTEN


def _evenly(segment: Segment) -> slice:
    return slice(None, None, -(-len(segment) // SAMPLES))


def _middle(segment: Segment) -> slice:
    first = max((len(segment) - NEIGHBOURS) // 2, 0)
    return slice(first, first + NEIGHBOURS)


def _record(segment: Segment, columns: slice, stamp_std: float, shown: slice) -> Record:
    """What the samples ``shown`` of a segment give, to a tenth of a micrometre.

    The search for the optimum amplifies the last digit of its data, and that one depends on how the
    samples were cut into batches; rounded, the data are the same bits, and so is what is learned.
    """
    variances = segment.known_variances(stamp_std)
    known = np.zeros(len(segment))
    if variances is not None:
        known = np.mean(variances[:, columns], axis=-1).round(2 * _DIGITS)
    values = segment.coordinates[:, columns].round(_DIGITS)
    return Record(segment.times[shown], values[shown], known[shown])
