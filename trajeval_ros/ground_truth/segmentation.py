# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the stream of ground-truth samples is cut into overlapping segments, and how they hand over.

At any time one segment is the current one. When it has half of what makes it complete (more exactly
the share that does not overlap), its successor is opened, with a few earlier samples for context,
and a hand-over begins: a *progress* grows from 0 to 1 over the samples that follow, measured in
time and number of samples. It is linear in time between samples, so it is known at t from the first
sample after t, whatever comes later; and it is continuous, so that the blend of the two segments'
answers is, too, across gaps as well. At 1 the old segment is closed.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, islice
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.ground_truth.segment import Samples, Segment
from trajeval_ros.ground_truth.stamps import HISTORY

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

# Local coordinates wrap around at a rotation of pi from the segment's first sample. The hand-over
# begins at the first angle and is complete at the second, so a body that spins gets shorter
# segments.
_TURN_BEGIN = 1.2
_TURN_END = 2.4


class SegmentShape(NamedTuple):
    """When a segment is complete: ``duration`` (ns) and ``min_samples``, or ``max_samples``.

    ``overlap`` is the share of a segment that it has in common with the next.
    """

    duration: int
    overlap: float
    min_samples: int
    max_samples: int

    @property
    def lead(self) -> int:
        """Samples before the hand-over with which a successor is opened."""
        return max(1, round(self.overlap * self.min_samples / 2))


class HandOver:
    """The progress of one hand-over, sample by sample."""

    def __init__(self, stamp: int) -> None:
        """Begin at the sample stamped ``stamp``."""
        self._stamps = np.array([stamp], dtype=np.int64)
        self._progress = np.zeros(1)
        self._addresses: tuple[int, int, int] | None = None

    @property
    def begin(self) -> int:
        """Stamp at which it begins."""
        return int(self._stamps[0])

    @property
    def end(self) -> int:
        """Stamp of the newest sample."""
        return int(self._stamps[-1])

    @property
    def last(self) -> float:
        """Progress at the newest sample."""
        return float(self._progress[-1])

    def append(self, stamps: Stamps, progress: Array) -> None:
        """Add the progress at later samples."""
        self._addresses = None
        self._stamps = np.concatenate([self._stamps, stamps])
        self._progress = np.concatenate([self._progress, progress])

    @property
    def addresses(self) -> tuple[int, int, int]:
        """How many samples it has, and where their stamps and the progress lie until more come."""
        if self._addresses is None:
            self._addresses = (
                len(self._stamps),
                loops.address(self._stamps),
                loops.address(self._progress),
            )
        return self._addresses

    def weight(self, stamps: Stamps) -> Array:
        """Weight of the new segment at ``stamps``: ``p²(3 - 2p)`` of the progress p."""
        p = np.interp(stamps - self._stamps[0], self._stamps - self._stamps[0], self._progress)
        return np.asarray(p * p * (3.0 - 2.0 * p))


@dataclass(frozen=True, slots=True)
class Blended:
    """A segment, which counts from 0, with the hand-overs at its ends; None where there is none."""

    index: int
    segment: Segment
    incoming: HandOver | None
    outgoing: HandOver | None

    def weight(self, stamps: Stamps) -> Array:
        """The segment's weight at ``stamps`` (q,); the weights of all segments sum to one."""
        weight = np.ones(len(stamps))
        if self.incoming is not None:
            weight = weight * self.incoming.weight(stamps)
        if self.outgoing is not None:
            weight = weight * (1.0 - self.outgoing.weight(stamps))
        return weight

    def shares(self, stamps: Stamps) -> tuple[Indices, Array]:
        """Which of ``stamps`` (q,), not decreasing, it has weight at, and its weights."""
        first, end = 0, len(stamps)
        if self.incoming is not None:
            first = int(np.searchsorted(stamps, self.incoming.begin, side="right"))
        if self.outgoing is not None and self.outgoing.last >= 1.0:
            end = int(np.searchsorted(stamps, self.outgoing.end))
        if first >= end:
            return np.empty(0, dtype=np.intp), np.empty(0)
        weight = self.weight(stamps[first:end])
        asked = np.flatnonzero(weight > 0.0)
        return first + asked, weight[asked]


class Segmentation:
    """The retained segments, oldest first; the owner of those still open."""

    def __init__(self, shape: SegmentShape) -> None:
        """Start without segments."""
        self._shape = shape
        self._segments: list[Segment] = []
        self._handovers: list[HandOver] = []  # one between every two neighbours
        self._first_incoming: HandOver | None = None
        self._trigger = (0, 0.0)  # samples and angle of the old segment when its hand-over began
        self.opened = 0

    def __iter__(self) -> Iterator[Blended]:
        """Iterate over the retained segments with their hand-overs."""
        return self.since(0)

    def since(self, index: int) -> Iterator[Blended]:
        """Iterate over those from the one with that ``index`` on."""
        oldest = self.opened - len(self._segments)
        first = max(index - oldest, 0)
        incoming = (
            self._handovers[first - 1 :] if first else [self._first_incoming, *self._handovers]
        )
        outgoing = [*self._handovers[first:], None]
        return map(Blended, count(oldest + first), self._segments[first:], incoming, outgoing)

    def between(self, begin: int, end: int) -> Iterator[Blended]:
        """Iterate over those that may have weight between the stamps ``begin`` and ``end`` (ns)."""
        complete = len(self._handovers) - self._handing_over
        oldest = self.opened - len(self._segments)
        first = bisect_right(self._handovers, begin, hi=complete, key=lambda each: each.end)
        last = bisect_left(self._handovers, end, lo=first, key=lambda each: each.begin)
        return islice(self.since(oldest + first), last - first + 1)

    @property
    def retained(self) -> int:
        """Number of segments that are there."""
        return len(self._segments)

    @property
    def first_open(self) -> int:
        """The index of the oldest segment that is not closed."""
        return self.opened - len(self.open)

    @property
    def open(self) -> list[Segment]:
        """The segments that are not closed yet."""
        return self._segments[-2 if self._handing_over else -1 :]

    @property
    def _handing_over(self) -> bool:
        return bool(self._handovers) and self._handovers[-1].last < 1.0

    def append(self, samples: Samples) -> Iterator[Segment]:
        """Add later samples; yield each segment as soon as it is closed by them."""
        while len(samples):
            if not self._segments:
                self._segments.append(Segment(samples[:1]))
                self.opened += 1
                samples = samples[1:]
            elif self._handing_over:
                samples, complete = self._continue_handover(samples)
                if complete:
                    yield self._segments[-2]
            else:
                samples = self._continue_alone(samples)

    def cut(self, samples: Samples) -> Iterator[Segment]:
        """Add later samples with which nothing before has to do; yield as `append` does.

        The segments that are open end with their last sample, and nothing answers between that and
        the first one here.
        """
        if self._segments:
            closed = self.open
            after = int(closed[-1].samples.stamps[-1]) + 1
            if self._handing_over:
                self._handovers[-1].append(np.array([after]), np.ones(1))
            handover = HandOver(after)
            handover.append(samples.stamps[:1], np.ones(1))
            self._handovers.append(handover)
            self._segments.append(Segment(samples[:1]))
            self.opened += 1
            samples = samples[1:]
            yield from closed
        yield from self.append(samples)

    def _continue_alone(self, samples: Samples) -> Samples:
        """Feed the open segment up to the sample at which a hand-over begins; return the rest."""
        segment, shape = self._segments[-1], self._shape
        ahead = samples[: shape.max_samples]
        coordinates, begins, angle = (_alone if loops.there() else _alone_in_numpy)(
            segment, ahead, shape
        )
        taken = len(coordinates)
        segment.append(ahead[:taken], coordinates)
        if begins:
            self._trigger = (len(segment), angle)
            self._handovers.append(HandOver(int(ahead.stamps[taken - 1])))
            lead = len(segment) - shape.lead - 1
            before = segment.before + segment.samples[: max(lead, 0)]
            self._segments.append(Segment(segment.samples[-shape.lead - 1 :], before[-HISTORY:]))
            self.opened += 1
        return samples[taken:]

    def _continue_handover(self, samples: Samples) -> tuple[Samples, bool]:
        """Feed both segments to the end of the hand-over; return the rest, and whether it ended."""
        old, new, handover, shape = (
            self._segments[-2],
            self._segments[-1],
            self._handovers[-1],
            self._shape,
        )
        ahead = samples[: shape.max_samples]
        coordinates, progress = (_handing_over if loops.there() else _handing_over_in_numpy)(
            old, ahead, handover, self._trigger, shape
        )
        taken = len(progress)
        taken_in = ahead[:taken]
        handover.append(taken_in.stamps, progress)
        old.append(taken_in, coordinates)
        new.append(taken_in)
        return samples[taken:], handover.last >= 1.0

    def forget(self, before: int) -> None:
        """Drop the closed segments that have no weight at ``before`` (ns) or later."""
        over = 0
        while over < len(self._handovers) and self._handovers[over].last >= 1.0:
            if self._handovers[over].end > before:
                break
            over += 1
        if over:
            self._first_incoming = self._handovers[over - 1]
            del self._handovers[:over], self._segments[:over]


def _alone(segment: Segment, ahead: Samples, shape: SegmentShape) -> tuple[Array, bool, float]:
    """How the open segment goes on: the coordinates (k, 6) of the samples that it takes.

    And whether a hand-over begins with the last of them, and its angle there.
    """
    share, count = 1.0 - shape.overlap, len(ahead)
    coordinates = segment.room_after(count)
    taken, angle = np.empty(2, dtype=np.int64), np.empty(1)
    loops.call(
        "segment_alone",
        segment.reference,
        np.ascontiguousarray(ahead.stamps),
        loops.doubles(ahead.poses),
        count,
        segment.start,
        len(segment),
        share * shape.duration,
        share * shape.min_samples,
        share * shape.max_samples,
        _TURN_BEGIN,
        coordinates,
        taken,
        angle,
    )
    number, begins = taken.tolist()
    return coordinates[1 : 1 + number], bool(begins), float(angle[0])


def _alone_in_numpy(
    segment: Segment, ahead: Samples, shape: SegmentShape
) -> tuple[Array, bool, float]:
    """The same."""
    share = 1.0 - shape.overlap
    size = len(segment) + np.arange(1, len(ahead) + 1)
    long_enough = ahead.stamps - segment.start >= share * shape.duration
    ready = long_enough & (size >= share * shape.min_samples)
    ready |= size >= share * shape.max_samples
    coordinates = segment.following(ahead.poses[: _through_first(ready)])
    angle = _angles(coordinates)
    taken = _through_first(angle >= _TURN_BEGIN)
    last = float(angle[taken - 1])
    return coordinates[:taken], bool(ready[taken - 1]) or last >= _TURN_BEGIN, last


def _handing_over(
    old: Segment,
    ahead: Samples,
    handover: HandOver,
    trigger: tuple[int, float],
    shape: SegmentShape,
) -> tuple[Array, Array]:
    """How a hand-over goes on: the old segment's coordinates (k, 6), and the progress (k,).

    Of the samples up to its end; ``trigger``: the samples and the angle with which it began.
    """
    begun, angle = trigger
    count = len(ahead)
    coordinates, progress = old.room_after(count), np.empty(count)
    taken = np.empty(1, dtype=np.int64)
    loops.call(
        "segment_handover",
        old.reference,
        np.ascontiguousarray(ahead.stamps),
        loops.doubles(ahead.poses),
        count,
        handover.begin,
        len(old) - begun,
        shape.overlap * shape.duration,
        shape.overlap * shape.min_samples,
        float(max(shape.max_samples - begun, 1)),
        angle,
        max(_TURN_END - angle, 0.1),
        handover.last,
        coordinates,
        progress,
        taken,
    )
    number = int(taken[0])
    return coordinates[1 : 1 + number], progress[:number]


def _handing_over_in_numpy(
    old: Segment,
    ahead: Samples,
    handover: HandOver,
    trigger: tuple[int, float],
    shape: SegmentShape,
) -> tuple[Array, Array]:
    """The same."""
    begun, angle = trigger
    size = len(old) - begun + np.arange(1, len(ahead) + 1)
    by_time = (ahead.stamps - handover.begin) / (shape.overlap * shape.duration)
    by_size = size / (shape.overlap * shape.min_samples)
    by_room = size / max(shape.max_samples - begun, 1)
    progress = np.maximum(np.minimum(by_time, by_size), by_room)
    coordinates = old.following(ahead.poses[: _through_first(progress >= 1.0)])
    by_turn = (_angles(coordinates) - angle) / max(_TURN_END - angle, 0.1)
    progress = np.maximum(progress[: len(coordinates)], by_turn)
    progress = np.maximum.accumulate(np.clip(progress, handover.last, 1.0))
    taken = _through_first(progress >= 1.0)
    return coordinates[:taken], progress[:taken]


def _angles(coordinates: Array) -> Array:
    return np.asarray(np.linalg.norm(coordinates[:, 3:], axis=-1))


def _through_first(condition: Mask) -> int:
    """So many of the entries as end with the first true one; all where none is."""
    return int(np.argmax(condition)) + 1 if condition.any() else len(condition)
