# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error models of a run and of its window, as the summary has them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.gauge import GAUGES, Gauge
from trajeval_ros.error_model.at_samples import fit_independent
from trajeval_ros.error_model.model import ErrorModel
from trajeval_ros.error_model.named import named
from trajeval_ros.error_model.nuisances import Truth
from trajeval_ros.error_model.recorded import Recorded
from trajeval_ros.error_model.running import Due, Fitted, Poses, RunningErrorModel
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.results import Evaluations
from trajeval_ros.runs.kept import WholeRun

Figures = dict[str, Any]

# Poses wait for each other: so many are taken in for what one costs.
_TOGETHER = 256

WHOLE, BLOCKS = "whole", "blocks"
"""Of what the model of a run is: of all poses, with the ground truth asked anew; or of blocks."""


class LiveErrorModels:
    """Takes evaluations; says which fit is due, and takes what it says, one at a time."""

    def __init__(self, window: int) -> None:
        """Start empty. window: ns."""
        self._running = RunningErrorModel(window)
        self._waiting: list[Poses] = []
        self._figures: dict[str, Figures] = {}

    @property
    def duration(self) -> int:
        """Length of the window, ns."""
        return self._running.duration

    def change(self, window: int) -> None:
        """Go on with another window, ns."""
        self._take_in()
        self._running.duration = window

    def add(self, evaluations: Evaluations, offset: int) -> None:
        """Take poses, whose stamps on the ground truth's clock are ``offset`` (ns) later."""
        if evaluations.sampled.any():
            self._waiting.append(poses_of(evaluations, offset))
            if sum(map(len, self._waiting)) >= _TOGETHER:
                self._take_in()

    def _take_in(self) -> None:
        if self._waiting:
            waiting, self._waiting = self._waiting, []
            self._running.add(Poses.joined(waiting))

    def due(self) -> Due | None:
        """A block of the run that waits for a fit, or else the window, if it has changed."""
        return self.block_due() or self.window_due()

    def block_due(self) -> Due | None:
        """A block of the run that waits for a fit."""
        self._take_in()
        return self._running.block_due()

    def window_due(self) -> Due | None:
        """The window, if it has changed since."""
        self._take_in()
        return self._running.window_due()

    def take(self, due: Due, fitted: Fitted) -> None:
        """Take what the fit that was ``due`` says."""
        self._running.take(due, fitted)
        self._figures = _figures(self._running)

    @property
    def figures(self) -> dict[str, Figures]:
        """Of the ``run`` and of the ``window``, as far as they have been fitted."""
        return self._figures


def error_models(engine: Engine, name: str, kept: WholeRun, *, whole: bool) -> dict[str, Figures]:
    """Of the ``run`` and of its ``window``, where there are enough poses.

    ``kept``: all poses of the run. ``whole``: the engine has all of the ground truth still.
    """
    offset = engine.settings.estimates[name].time_offset
    running = RunningErrorModel(engine.settings.evaluation.window)
    some = False
    for part in kept.parts:
        if part.sampled.any():
            some = True
            running.add(poses_of(part, offset))
            while not whole and _fit(running, running.block_due()):
                pass
    if not some:
        return {}
    _fit(running, running.window_due())
    found = _figures(running)
    if not whole:
        return found

    def truth(asked: npt.NDArray[np.int64]) -> Truth:
        return engine.truth(asked, name)

    poses = poses_of(kept.evaluations, offset)
    stamps = poses.truth.stamps
    run = fit_independent(stamps, poses.estimate, poses.nearest, truth, poses.truth.at(stamps))
    if run is not None:
        found["run"] = _named(run, WHOLE)
    return found


def gauge_of_model(gauge: Gauge) -> Gauge:
    """That of an error model: whatever figures are aligned by, an offset is no kind of error."""
    return gauge if gauge.has_scale else GAUGES["se3"]


def put_into(summary: Figures, models: dict[str, Figures]) -> None:
    """Add the models to a summary, where they belong."""
    if "run" in models:
        summary["error_model"] = models["run"]
    if "window" in models:
        summary["window"]["error_model"] = models["window"]


def poses_of(evaluations: Evaluations, offset: int) -> Poses:
    """Those outside the ground truth's gaps, within which its errors go on from pose to pose."""
    known: slice | npt.NDArray[np.bool_] = evaluations.sampled
    if evaluations.sampled.all():
        known = slice(None)  # nothing is copied
    return Poses(
        Recorded(
            evaluations.stamps[known] + offset,
            evaluations.ground_truth[known],
            evaluations.covariance[known],
            evaluations.twist[known],
        ),
        evaluations.estimate[known],
        evaluations.nearest[known],
    )


def _fit(running: RunningErrorModel, due: Due | None) -> bool:
    """Make a fit that is ``due``, if any; of the run once all blocks are there."""
    if due is not None:
        running.take(due, due.fit(with_run=False))
    return due is not None


def _figures(running: RunningErrorModel) -> dict[str, Figures]:
    """Of the ``run`` and of the ``window``, as far as they have been fitted."""
    found: dict[str, Figures] = {}
    if running.run is not None:
        found["run"] = _named(running.run, BLOCKS)
        found["run"]["blocks"] = running.blocks
        found["run"]["blocks_lost"] = running.lost
    if running.window is not None:
        found["window"] = _named(running.window)
    return found


def _named(model: ErrorModel, of: str | None = None) -> Figures:
    return named(model) if of is None else {**named(model), "fit": of}
