# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The latest whole trajectory of an estimator that publishes one, against the ground truth.

The figures of a run are of each pose as it came. An estimator that corrects its past, as by loop
closures, publishes the whole trajectory anew; here it is scored as a whole, by the ground truth's
answers to the poses when they came, beside the same poses as they came.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.conventional.running import RunningConventional
from trajeval_ros.online.axes import turned
from trajeval_ros.online.results import Evaluations
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.settings import EstimateSettings, EvaluationSettings
from trajeval_ros.online.summary import ate_alignment
from trajeval_ros.runs.beside import Outcome, Work

Array = npt.NDArray[np.float64]
Figures = dict[str, Any]

MOST_POSES = 10_000
"""More poses than these are not scored: then it is every 2nd, 4th, ... of the run."""

_FIGURES = (
    "ate_translation_rmse",
    "ate_rotation_rmse",
    "re_translation_rmse",
    "re_rotation_rmse",
)


class LatestPath:
    """The evaluated poses of a run, evenly thinned, and the whole trajectory that came last."""

    def __init__(self, settings: EvaluationSettings, estimate: EstimateSettings) -> None:
        """Start without poses."""
        self._settings = settings
        self._from_body, self._axes = estimate.from_body, estimate.axes
        self._offset = estimate.time_offset
        self.path: PoseSamples | None = None
        """The latest trajectory, as published."""
        self.figures: Figures | None = None
        """Those of the last `score`."""
        self._stamps = np.empty(0, dtype=np.int64)
        self._poses = np.empty((0, 2, 4, 4))
        self._every = 1
        self._seen = 0
        self._is_new = False
        self._run = 0

    def add(self, evaluations: Evaluations) -> None:
        """Keep evaluated poses, but for those in the ground truth's gaps, as ATE does."""
        known = np.flatnonzero(evaluations.sampled)
        chosen = known[-self._seen % self._every :: self._every]
        self._seen += len(known)
        if not len(chosen):
            return
        both = np.stack([evaluations.ground_truth[chosen], evaluations.estimate[chosen]], axis=1)
        self._stamps = np.concatenate([self._stamps, evaluations.stamps[chosen]])
        self._poses = np.concatenate([self._poses, both])
        while len(self._stamps) > MOST_POSES:
            self._stamps, self._poses = self._stamps[::2].copy(), self._poses[::2].copy()
            self._every *= 2
        self._is_new = True

    def take(self, path: PoseSamples) -> None:
        """Take the latest trajectory, stamps increasing."""
        self.path, self._is_new = path, True

    def clear(self) -> None:
        """A new run has begun; the trajectory goes on."""
        self._stamps, self._poses = self._stamps[:0], self._poses[:0]
        self._every, self._seen, self.figures = 1, 0, None
        self._run += 1

    def due(self) -> Work | None:
        """The score of what has come; None where nothing has since the last time."""
        if not self._is_new or self.path is None:
            return None
        self._is_new = False
        run = self._run

        def take(figures: Outcome) -> None:
            # Of a run that has ended, nothing.
            if run == self._run:
                self.figures = figures()

        return Work(partial(self._scored, self.path, self._stamps, self._poses), take)

    def score(self) -> bool:
        """Score what has come at once; False where nothing has since the last time."""
        work = self.due()
        if work is not None:
            work.at_once()
        return work is not None

    def _scored(self, path: PoseSamples, evaluated: npt.NDArray[np.int64], poses: Array) -> Figures:
        """The figures of a path, by poses evaluated at so many stamps. Touches nothing else."""
        path = turned(path, self._axes)
        usable = _usable(path)
        stamps = path.stamps[usable]
        places = np.searchsorted(stamps, evaluated)
        found = places < len(stamps)
        found[found] = stamps[places[found]] == evaluated[found]
        index = np.flatnonzero(usable)[places[found]]
        corrected = se3.compose(
            se3.from_position_quaternion(path.positions[index], path.quaternions[index]),
            self._from_body,
        )
        truth, online = poses[found, 0], poses[found, 1]
        shared = evaluated[found] + self._offset
        after, before = (self._conventional(shared, truth, each) for each in (corrected, online))
        return {
            "poses": len(path),
            "scored": len(shared),
            **after,
            "online": before,
        }

    def _conventional(
        self, stamps: npt.NDArray[np.int64], truth: Array, estimate: Array
    ) -> Figures:
        settings = self._settings
        running = RunningConventional(
            settings.gauge.name, settings.relative_delta, settings.relative_unit
        )
        running.update(stamps, truth, estimate)
        found = running.figures()
        return {
            **{name: getattr(found, name) for name in _FIGURES},
            "alignment": ate_alignment(found.alignment),
        }


def scored(
    path: PoseSamples,
    evaluated: Iterable[Evaluations],
    settings: EvaluationSettings,
    estimate: EstimateSettings,
) -> Figures | None:
    """Return the figures of a run's latest trajectory, as `LatestPath` has them live."""
    latest = LatestPath(settings, estimate)
    latest.take(path)
    for evaluations in evaluated:
        latest.add(evaluations)
    latest.score()
    return latest.figures


def on_positions(figures: Figures | None) -> Figures | None:
    """The figures without what contains an orientation."""
    if figures is None:
        return None
    gone = dict.fromkeys(_FIGURES[1:])
    return {**figures, **gone, "online": {**figures["online"], **gone}}


def _usable(path: PoseSamples) -> npt.NDArray[np.bool_]:
    """Poses that are finite and turned by a unit quaternion."""
    with np.errstate(over="ignore", invalid="ignore"):
        norms = np.linalg.norm(path.quaternions, axis=1)
        return np.asarray(np.isfinite(path.positions).all(axis=1) & (np.abs(norms - 1.0) < 1e-2))
