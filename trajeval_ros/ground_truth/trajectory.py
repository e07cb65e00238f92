# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth as a continuous-time stochastic trajectory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.ground_truth.at_once import Answers
from trajeval_ros.ground_truth.faults import Faults
from trajeval_ros.ground_truth.fit import Fit, Fits
from trajeval_ros.ground_truth.hyperparameters import Hyperparameters
from trajeval_ros.ground_truth.joint import JointCovariance, Part
from trajeval_ros.ground_truth.lessons import Lesson, Lessons
from trajeval_ros.ground_truth.models import MODELS
from trajeval_ros.ground_truth.process import AS_LEARNED, Process
from trajeval_ros.ground_truth.segment import (
    Answer,
    Asked,
    Samples,
    Segment,
    Twists,
    answers,
)
from trajeval_ros.ground_truth.segmentation import Blended, Segmentation, SegmentShape

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# A gap is an interval between two samples longer than this (ns) and than three times the median of
# those before it.
_GAP = 100_000_000
_GAP_INTERVALS = 64
# So many segments answer at once, and are there meanwhile where they rest.
_AT_ONCE = 16
_TOO_EARLY = "a query lies before the retained segments"


class Settings(NamedTuple):
    """The fixed choices.

    ``kernel``: the name of a model; ``hyperparameters``: those of every segment, or a process that
    was learned before, to which each segment adapts; None: they are learned, and
    ``translation_std`` (m) and ``rotation_std`` (rad), the instrument's accuracy, add to the noise.
    ``exact_stamps``: no noise of the stamps is learned.
    """

    kernel: str
    hyperparameters: Hyperparameters | Process | None
    translation_std: float
    rotation_std: float
    shape: SegmentShape
    exact_stamps: bool = False


@dataclass(frozen=True, slots=True)
class Posterior:
    """Stochastic poses ``T Exp(ξ)``, ``ξ ~ N(0, Σ)``.

    ``poses`` (q, 4, 4) T_world_body; ``covariances`` (q, 6, 6), body frame.

    ``sampled`` (q,): the samples around lie as close together as usual, so that there is no gap.
    ``nearest`` (q,): the stamp of the sample nearest to each, of two the earlier, ns.

    ``cross``, if it is asked for: for each pose i, (p, 6, 6), the covariances ``E[ξ_j ξ_iᵀ]`` with
    the p poses j just before it, of earlier calls as well, oldest first; with all others it is
    zero. ``twists``, if they are asked for.
    """

    poses: Array
    covariances: Array
    sampled: Mask
    nearest: Stamps
    cross: tuple[Array, ...] | None = None
    twists: Twists | None = None

    def __getitem__(self, index: npt.NDArray[np.intp]) -> Posterior:
        """Some of the poses, without ``cross``."""
        twists = self.twists
        if twists is not None:
            twists = Twists(twists.means[index], twists.covariances[index])
        return Posterior(
            self.poses[index],
            self.covariances[index],
            self.sampled[index],
            self.nearest[index],
            None,
            twists,
        )


class GroundTruth:
    """Overlapping Gaussian-process segments (``docs/method.md``, Ground truth)."""

    def __init__(
        self, settings: Settings, faults: Faults | None = None, *, beside: bool = False
    ) -> None:
        """Start without samples; ``faults``: where those of the segments are noted.

        ``beside``: the owner sees to each :attr:`lesson`, and what it is for waits until `teach`.
        """
        self._beside = beside
        # Closed segments that wait for the lesson, and how many were open when each was closed.
        self._closed: deque[tuple[Segment, int]] = deque()
        self._lesson: tuple[Lesson, int] | None = None  # and the first segment it is for
        self._fits = Fits(Faults() if faults is None else faults)
        model = MODELS[settings.kernel]
        self._accuracy = (settings.translation_std, settings.rotation_std)
        self._segmentation = Segmentation(settings.shape)
        self._lessons: Lessons | None = None
        self._processes: deque[tuple[int, Process]] = deque()  # each from a segment's index on
        if settings.hyperparameters is None:
            self._lessons = Lessons(model, self._accuracy, settings.exact_stamps)
        else:
            given = settings.hyperparameters
            if isinstance(given, Hyperparameters):
                given = Process(model.kernels, given, self._accuracy)
            self._use(given, 0)
        self._stamps = np.empty(0, dtype=np.int64)
        self._cuts = np.empty((0, 2), dtype=np.int64)  # the samples before and after each
        self._begin: int | None = None
        self._settled = 0  # the segments before this one are closed and conditioned
        self._resting = 0  # those before this one rest

    def note_without_orientation(self) -> None:
        """The samples' orientations are none: nothing is learned from them."""
        if self._lessons is not None:
            self._lessons.lacks_orientation = True

    @property
    def begin(self) -> int | None:
        """Stamp before which nothing can be asked any more; None while all is retained."""
        return self._begin

    @property
    def hyperparameters(self) -> Hyperparameters | None:
        """The hyperparameters of the newest segments, None until they are known."""
        return self._processes[-1][1].hyperparameters if self._processes else None

    @property
    def fit(self) -> Fit | None:
        """How the process fits, None before it is known."""
        return self._fits.fit

    @property
    def segments(self) -> int:
        """Number of segments opened so far."""
        return self._segmentation.opened

    @property
    def stamps(self) -> Stamps:
        """Stamps of the retained samples, increasing; (n,)."""
        return self._stamps

    def append(self, samples: Samples, cuts: Sequence[int] = ()) -> None:
        """Add samples, each later than all before.

        ``cuts``: the stamps (ns) of those with which nothing before has to do, so that nothing is
        modelled across.
        """
        last = self._stamps[-1:]
        self._stamps = np.concatenate([self._stamps, samples.stamps])
        edges = [int(np.searchsorted(samples.stamps, cut)) for cut in cuts]
        before = np.concatenate([last, samples.stamps])
        for edge in edges:
            if edge + len(last):
                pair = before[edge + len(last) - 1], samples.stamps[edge]
                self._cuts = np.concatenate([self._cuts, [pair]])
        self._add(self._segmentation.append(samples[: edges[0] if edges else len(samples)]))
        for begin, end in pairwise([*edges, len(samples)]):
            self._add(self._segmentation.cut(samples[begin:end]))

    def _add(self, closed_ones: Iterable[Segment]) -> None:
        """Condition segments as they are closed, and learn from them."""
        self._closed.extend((closed, self._segmentation.opened) for closed in closed_ones)
        self._go_on()

    def _go_on(self) -> None:
        """Condition closed segments up to one that makes a lesson due, and learn from them."""
        while self._closed and self._lesson is None:
            closed, opened = self._closed.popleft()
            self._advance(closed)
            if closed.begun:
                self._fits.add(closed)
            lesson = None if self._lessons is None else self._lessons.add(closed)
            if lesson is not None:
                self._lesson = lesson, opened
                if not self._beside:
                    self.teach(lesson, lesson.learned())

    @property
    def lesson(self) -> Lesson | None:
        """The lesson that is due, if one is."""
        return None if self._lesson is None else self._lesson[0]

    def teach(self, lesson: Lesson, process: Process | None) -> None:
        """Take what the :attr:`lesson` has taught."""
        assert self._lessons is not None
        assert self._lesson is not None
        assert self._lesson[0] is lesson
        first, self._lesson = self._lesson[1], None
        self._lessons.take(lesson, process)
        if process is not None:
            self._use(process, first)
        self._go_on()

    @property
    def known_until(self) -> int | None:
        """Stamp (ns) up to which no query waits for the :attr:`lesson`; None: none waits."""
        if self._lesson is None:
            return None
        waiting = next(self._segmentation.since(self._lesson[1]), None)
        return None if waiting is None or waiting.incoming is None else waiting.incoming.begin

    def conclude(self) -> None:
        """No more samples will come: learn from what there is, if that has not been done."""
        while self._lesson is not None:
            lesson, _ = self._lesson
            self.teach(lesson, lesson.learned())
        if self._lessons is not None and not self._processes:
            learned = self._lessons.learn(self._segmentation.open)
            if learned is not None:
                self._use(learned, 0)

    def _use(self, process: Process, first: int) -> None:
        """Take ``process`` for the segments from the ``first`` on; the first one for all."""
        self._processes.append((first if self._processes else 0, process))

    def _process(self, index: int) -> Process:
        """The process of a segment, by its index."""
        return next(p for first, p in reversed(self._processes) if first <= index)

    def _advance(self, through: Segment | None = None) -> None:
        """Condition the segments up to ``through`` on their samples; all without it.

        A new one goes on where the one before is.
        """
        if not self._processes:
            return
        before: Segment | None = None
        settled = self._settled
        for blended in self._segmentation.since(self._settled - 1):
            if self._lesson is not None and blended.index >= self._lesson[1]:
                break
            segment, settled = blended.segment, blended.index + 1
            if not segment.begun:
                process = self._process(blended.index)
                regimes = AS_LEARNED
                if before is not None and blended.incoming is not None:
                    regimes = before.regimes(process, blended.incoming.begin)
                segment.begin(process, regimes)
            segment.advance()
            before = segment
            if segment is through:
                break
        self._settled = min(self._segmentation.first_open, settled)

    def posterior(
        self,
        stamps: Stamps,
        until: Stamps,
        joint: JointCovariance | None = None,
        twists: bool = False,
    ) -> Posterior:
        """Return the poses at ``stamps`` (q,), given the samples stamped up to ``until`` (q,).

        ``stamps`` lie between the first and the last retained sample; ``until >= stamps``, and a
        sample lies between the two. With ``joint``, the poses asked for with it before: the answers
        tell the covariance of the errors at different times, too; then both increase, from call to
        call as well. With ``twists``, the body twists, too; where two segments hand over, theirs by
        their weights. Raises :class:`ValueError` while the hyperparameters are not known.
        """
        if not self._processes:
            raise ValueError("the hyperparameters are not known yet")
        self._advance()
        order = np.argsort(stamps, kind="stable")
        ends = stamps[order[[0, -1]]].tolist() if len(stamps) else [0, 0]
        asked = [each for each in self._segmentation.between(*ends) if each.segment.begun]
        if joint is None and all(each.segment.is_asked_in_c for each in asked):
            cross = None
            poses, covariances, mixed = self._at_once(asked, stamps, until, order, twists)
        else:
            poses, covariances, mixed, cross = self._one_by_one(
                asked, stamps, until, order, joint, twists
            )
        return Posterior(
            poses,
            covariances,
            self._sampled(stamps),
            self._nearest(stamps),
            cross,
            mixed if twists else None,
        )

    def _at_once(
        self, asked: Sequence[Blended], stamps: Stamps, until: Stamps, order: Stamps, twists: bool
    ) -> tuple[Array, Array, Twists | None]:
        """Poses, covariances and twists of the ``asked`` segments, some at a time, by C."""
        together = any(process.stamp_shared for _, process in self._processes)
        answers = Answers(stamps, until, order, twists or together)
        for begin in range(0, len(asked), _AT_ONCE):
            some = asked[begin : begin + _AT_ONCE]
            with _awake(some):
                answers.add(some)
        if not answers.are_whole:
            raise ValueError(_TOO_EARLY)
        covariances = answers.covariances
        if answers.twists is not None and together:
            covariances = covariances + _of_shared_stamps(answers.shared, answers.twists.means)
        return answers.poses, covariances, answers.twists

    def _one_by_one(
        self,
        asked: Sequence[Blended],
        stamps: Stamps,
        until: Stamps,
        order: Stamps,
        joint: JointCovariance | None,
        twists: bool,
    ) -> tuple[Array, Array, Twists | None, tuple[Array, ...] | None]:
        """The same, and covariances of different poses, by NumPy or for ``joint``."""
        with _awake(asked):
            parts = [part for each in asked for part in _parts(each, order, stamps[order], until)]
            together = any(part.epoch.process.stamp_shared for part in parts)
            found = answers(
                [Asked(p.segment, p.epoch, stamps[p.asked], until[p.asked]) for p in parts],
                twists or together,
            )
            poses, covariances, mixed = _blend(len(stamps), parts, found)
            cross = None
            if joint is not None and len(stamps):
                cross = joint.extend(stamps, until, covariances, parts, found)
        if together and mixed is not None:
            shared = np.zeros(len(stamps))
            for part in parts:
                shared[part.asked] += part.share * part.epoch.process.stamp_shared
            covariances = covariances + _of_shared_stamps(shared, mixed.means)
        return poses, covariances, mixed, cross

    def rest(self, before: int, samples: int) -> None:
        """Let segments answer queries before ``before`` (ns) by being conditioned anew.

        But for those of the newest ``samples``.
        """
        if len(self._stamps) <= samples or self._lesson is not None:
            return
        before = min(before, int(self._stamps[-samples]))
        for blended in self._segmentation.since(self._resting):
            if blended.outgoing is None or blended.outgoing.end > before:
                break
            if blended.index >= self._settled - 1:
                break
            blended.segment.rest()
            self._resting = blended.index + 1

    def is_cut(self, stamps: Stamps) -> Mask:
        """Which of ``stamps`` (q,) lie where nothing is modelled, between samples before and after.

        As far back as samples are retained.
        """
        place = np.searchsorted(self._cuts[:, 1], stamps, side="right")
        within = place < len(self._cuts)
        if not within.any():
            return within
        begin = self._cuts[np.minimum(place, len(self._cuts) - 1), 0]
        return np.asarray(within & (stamps > begin))

    def _sampled(self, stamps: Stamps) -> Mask:
        """Which of ``stamps`` (q,) do not lie in a gap, by the samples up to the next one."""
        last = len(self._stamps) - 1
        after = np.clip(np.searchsorted(self._stamps, stamps), 1, last) if last else None
        if after is None:
            return np.ones(len(stamps), dtype=np.bool_)
        sampled = self._stamps[after] - self._stamps[after - 1] <= _GAP
        sampled |= self._stamps[after] == stamps
        rare = np.flatnonzero(~sampled)
        if len(rare):
            intervals, before = np.diff(self._stamps), after[rare] - 1
            sampled[rare] = intervals[before] <= 3.0 * _usual(intervals, before)
        return np.asarray(sampled)

    def _nearest(self, stamps: Stamps) -> Stamps:
        """Of `Posterior`; ``stamps`` (q,) lie between two samples."""
        after = np.minimum(np.searchsorted(self._stamps, stamps), len(self._stamps) - 1)
        before = np.maximum(after - 1, 0)
        next_one, last_one = self._stamps[after], self._stamps[before]
        return np.asarray(np.where(next_one - stamps < stamps - last_one, next_one, last_one))

    def forget(self, before: int) -> None:
        """Drop what no query at ``before`` (ns) or later needs; nothing while a lesson is due."""
        if not self._processes or self._lesson is not None:
            return
        self._advance()
        self._begin = before if self._begin is None else max(before, self._begin)
        self._segmentation.forget(before)
        oldest = self._segmentation.opened - self._segmentation.retained
        while len(self._processes) > 1 and self._processes[1][0] <= oldest:
            self._processes.popleft()
        keep = int(np.searchsorted(self._stamps, before, side="right")) - 2 - _GAP_INTERVALS
        keep = max(keep, 0)
        self._stamps = self._stamps[keep:]
        self._cuts = self._cuts[self._cuts[:, 1] > before]


@contextmanager
def _awake(asked: Sequence[Blended]) -> Iterator[None]:
    """Let segments that rest answer meanwhile."""
    resting = [each.segment for each in asked if each.segment.rests]
    for segment in resting:
        segment.advance()
    try:
        yield
    finally:
        for segment in resting:
            segment.rest()


def _parts(blended: Blended, order: Stamps, sorted_stamps: Stamps, until: Stamps) -> Iterator[Part]:
    """What a segment's epochs answer of queries (q,): ``sorted_stamps`` are theirs by ``order``."""
    places, share = blended.shares(sorted_stamps)
    if not len(places):
        return
    segment, asked = blended.segment, order[places]
    if len(segment.epochs) == 1:
        yield Part((blended.index, 0), segment, segment.epochs[0], asked, share)
        return
    counts = segment.counts(until[asked])
    firsts = np.array([epoch.first for epoch in segment.epochs])
    numbers = np.searchsorted(firsts, np.maximum(counts, 1), side="right") - 1
    for number in np.unique(numbers).tolist():
        here = numbers == number
        index = (blended.index, number)
        yield Part(index, segment, segment.epochs[number], asked[here], share[here])


def _blend(count: int, parts: list[Part], found: Answer) -> tuple[Array, Array, Twists | None]:
    """The poses (q, 4, 4), covariances (q, 6, 6) and twists of so many queries.

    One segment answers a query, or the two of a hand-over: it ends before the next one begins.
    """
    asked = np.concatenate([np.empty(0, dtype=np.intp), *(part.asked for part in parts)])
    share = np.concatenate([np.empty(0), *(part.share for part in parts)])
    total = np.bincount(asked, share, count)
    if (np.abs(total - 1.0) > 1e-6).any():
        raise ValueError(_TOO_EARLY)
    first = np.empty(count, dtype=np.intp)
    first[asked[::-1]] = np.arange(len(asked))[::-1]  # of two, the last one written
    second = np.flatnonzero(first[asked] != np.arange(len(asked)))
    query = asked[second]

    def mixed(values: Array) -> Array:
        weighted = share.reshape(-1, *[1] * (values.ndim - 1)) * values
        sums = weighted[first]
        sums[query] += weighted[second]
        return np.asarray(sums)

    poses = found.poses[first]
    if len(second):
        ratio = share[second] / total[query]
        poses[query] = se3.interpolate(poses[query], found.poses[second], ratio)
    twists = None
    if found.twists is not None:
        twists = Twists(mixed(found.twists.means), mixed(found.twists.covariances))
    return poses, mixed(found.covariances), twists


def _of_shared_stamps(std: Array, twists: Array) -> Array:
    """What stamps that are off together by ``std`` (q,) leave uncertain along twists (q, 6)."""
    along = std[:, None] * twists
    return np.asarray(along[:, :, None] * along[:, None])


def _usual(intervals: Stamps, index: Stamps) -> Array:
    """The median of the intervals before each ``index`` (n,), some of the newest; inf with none."""
    first = np.maximum(index - _GAP_INTERVALS, 0)
    places = first[:, None] + np.arange(_GAP_INTERVALS)
    earlier = np.where(
        places < index[:, None], intervals[np.minimum(places, index[:, None])], np.inf
    )
    earlier.sort(axis=1)
    count = index - first
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    rows = np.arange(len(index))
    return np.asarray(0.5 * (earlier[rows, low] + earlier[rows, high]))
