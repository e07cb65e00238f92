# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth as a continuous-time stochastic trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.ground_truth import learning
from trajeval_ros.ground_truth.hyperparameters import Hyperparameters
from trajeval_ros.ground_truth.kernels import SUMS
from trajeval_ros.ground_truth.segment import Process, Samples, Segment
from trajeval_ros.ground_truth.segmentation import Segmentation, SegmentShape

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# Learning takes place once this much of the ground truth shows motion, or at the latest after so
# much of it.
_LEARN_MOVING = 6_000_000_000
_LEARN_LATEST = 30_000_000_000
# A segment moves when the spread of its coordinates exceeds the instrument's accuracy by this
# factor.
_MOVING = 5.0
_LEARN_SAMPLES = 128
# A gap is an interval between two samples longer than this (ns) and than three times the median of
# those before it.
_GAP = 100_000_000
_GAP_INTERVALS = 64


@dataclass(frozen=True, slots=True)
class Model:
    """The process's fixed choices.

    ``hyperparameters`` None: they are learned; ``translation_std`` (m) and ``rotation_std`` (rad)
    are then the floors of the noise.
    """

    kernel: str
    hyperparameters: Hyperparameters | None
    translation_std: float
    rotation_std: float
    shape: SegmentShape


@dataclass(frozen=True, slots=True)
class Posterior:
    """Stochastic poses ``T Exp(ξ)``, ``ξ ~ N(0, Σ)``.

    ``poses`` (q, 4, 4) T_world_body; ``covariances`` (q, 6, 6), body frame.

    ``sampled`` (q,): the samples around lie as close together as usual, so that there is no gap.
    """

    poses: Array
    covariances: Array
    sampled: Mask


class GroundTruth:
    """Overlapping Gaussian-process segments (``docs/method.md``, Ground truth)."""

    def __init__(self, model: Model) -> None:
        """Start without samples."""
        self._model = model
        self._kernels = SUMS[model.kernel]
        self._segmentation = Segmentation(model.shape)
        self._hyperparameters = model.hyperparameters
        self._lessons: list[Segment] = []
        self._stamps = np.empty(0, dtype=np.int64)

    @property
    def hyperparameters(self) -> Hyperparameters | None:
        """The hyperparameters, None until they are known."""
        return self._hyperparameters

    @property
    def segments(self) -> int:
        """Number of segments opened so far."""
        return self._segmentation.opened

    @property
    def stamps(self) -> Stamps:
        """Stamps of the retained samples, increasing; (n,)."""
        return self._stamps

    def append(self, samples: Samples) -> None:
        """Add samples, each later than all before."""
        self._stamps = np.concatenate([self._stamps, samples.stamps])
        closed = self._segmentation.append(samples)
        if self._hyperparameters is None:
            self._lessons += closed
            self._learn_if_due()

    def conclude(self) -> None:
        """No more samples will come: learn from what there is, if that has not been done."""
        if self._hyperparameters is None:
            self._lessons += [
                b.segment for b in self._segmentation if b.segment not in self._lessons
            ]
            self._learn()

    def _learn_if_due(self) -> None:
        """Learn when the closed segments suffice; a function of the samples alone."""
        moving = [s for s in self._lessons if self._moves(s)]
        if _span(moving) >= _LEARN_MOVING or _span(self._lessons) >= _LEARN_LATEST:
            self._learn()

    def _moves(self, segment: Segment) -> bool:
        spread = np.std(segment.coordinates, axis=0)
        return bool(
            spread[:3].max() > _MOVING * self._model.translation_std
            or spread[3:].max() > _MOVING * self._model.rotation_std
        )

    def _learn(self) -> None:
        lessons = [s for s in self._lessons if self._moves(s)] or self._lessons
        groups = []
        for columns, floor in (
            (slice(0, 3), self._model.translation_std),
            (slice(3, 6), self._model.rotation_std),
        ):
            records = [
                learning.Record(
                    s.times[:_LEARN_SAMPLES],
                    s.coordinates[:_LEARN_SAMPLES, columns],
                    np.zeros(min(len(s), _LEARN_SAMPLES)),
                )
                for s in lessons
            ]
            groups.append(learning.learn(self._kernels, records, floor))
        translation, rotation = groups
        if translation is not None and rotation is not None:
            self._hyperparameters = Hyperparameters(translation, rotation)
            self._lessons = []

    def posterior(self, stamps: Stamps, until: Stamps) -> Posterior:
        """Return the poses at ``stamps`` (q,), given the samples stamped up to ``until`` (q,).

        ``stamps`` lie between the first and the last retained sample; ``until >= stamps``, and a
        sample lies between the two. Raises :class:`ValueError` while the hyperparameters are not
        known.
        """
        if self._hyperparameters is None:
            raise ValueError("the hyperparameters are not known yet")
        floors = (self._model.translation_std, self._model.rotation_std)
        process = Process(self._kernels, self._hyperparameters, floors)
        poses, covariances = np.empty((len(stamps), 4, 4)), np.zeros((len(stamps), 6, 6))
        weights = np.zeros(len(stamps))
        for blended in self._segmentation:
            share = blended.weight(stamps)
            asked = share > 0.0
            if not asked.any():
                continue
            pose, covariance = blended.segment.posterior(process, stamps[asked], until[asked])
            weights[asked] += share[asked]
            ratio = share[asked] / weights[asked]
            before = np.where((ratio < 1.0)[:, None, None], poses[asked], pose)
            poses[asked] = se3.interpolate(before, pose, ratio)
            covariances[asked] += share[asked, None, None] * covariance
        return Posterior(poses, covariances, self._sampled(stamps))

    def _sampled(self, stamps: Stamps) -> Mask:
        """Which of ``stamps`` (q,) do not lie in a gap, by the samples up to the next one."""
        last = len(self._stamps) - 1
        after = np.clip(np.searchsorted(self._stamps, stamps), 1, last) if last else None
        if after is None:
            return np.ones(len(stamps), dtype=np.bool_)
        intervals = np.diff(self._stamps)
        sampled = intervals[after - 1] <= _GAP
        for i in np.unique(after[~sampled]):  # few: one an interval, and most are short
            earlier = intervals[max(i - 1 - _GAP_INTERVALS, 0) : i - 1]
            usual = np.median(earlier) if len(earlier) else np.inf
            sampled[after == i] = intervals[i - 1] <= 3.0 * usual
        return np.asarray(sampled)

    def forget(self, before: int) -> None:
        """Drop what no query at ``before`` (ns) or later needs."""
        if self._hyperparameters is None:
            return
        self._segmentation.forget(before)
        keep = int(np.searchsorted(self._stamps, before, side="right")) - 2 - _GAP_INTERVALS
        keep = max(keep, 0)
        self._stamps = self._stamps[keep:]


def _span(segments: list[Segment]) -> int:
    return sum(int(s.samples.stamps[-1] - s.samples.stamps[0]) for s in segments)
