# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error models of a run of positions alone, and of its window, while it goes on."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.gauge import Gauge
from trajeval_ros.error_model.named import named_on_positions
from trajeval_ros.error_model.nuisances import Truth
from trajeval_ros.error_model.positions import PositionErrorModel, fit_positions
from trajeval_ros.error_model.running import Poses
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.results import Evaluations
from trajeval_ros.runs.error_models import WHOLE, gauge_of_model, poses_of

Figures = dict[str, Any]

THINNED = "thinned"
"""Of what the model of a run is: of all poses, or of some, with the ground truth as answered."""

# Poses that are fitted: of more it is every 2nd, 4th, ... And those that are kept of a window.
_MOST = 2000
_LONGEST = 20_000
# How far (s) the ground truth is followed from an answer along its velocity.
_NEAR = 0.2
# The run is fitted anew when it has grown by this.
_GROWN = 1.1


class _Run:
    """Poses, evenly: every one, every 2nd, every 4th, ... by their number in the run."""

    def __init__(self) -> None:
        self.seen = 0
        self._parts: list[Poses] = []
        self._count = 0
        self._every = 1

    def add(self, poses: Poses) -> None:
        chosen = poses[-self.seen % self._every :: self._every]
        self.seen += len(poses)
        self._count += len(chosen)
        self._parts.append(chosen)
        while self._count > _MOST:
            self._parts = [Poses.joined(self._parts)[::2]]
            self._count = len(self._parts[0])
            self._every *= 2

    def poses(self) -> Poses:
        self._parts = [Poses.joined(self._parts)]
        return self._parts[0]


class _Window:
    """The poses of the last seconds, and no more than so many."""

    def __init__(self) -> None:
        self._parts: deque[Poses] = deque()
        self._count = 0

    def add(self, poses: Poses, duration: int) -> None:
        self._parts.append(poses)
        self._count += len(poses)
        oldest = int(poses.truth.stamps[-1]) - duration
        while self._parts[0].truth.stamps[-1] < oldest or (
            self._count > _LONGEST and len(self._parts) > 1
        ):
            self._count -= len(self._parts.popleft())

    def poses(self, duration: int) -> Poses:
        found = Poses.joined(list(self._parts))
        oldest = found.truth.stamps[-1] - duration
        found = found[int(np.searchsorted(found.truth.stamps, oldest)) :]
        return found[:: -(-len(found) // _MOST)]


@dataclass(frozen=True, slots=True)
class PositionsDue:
    """A fit that is due: of the ``run`` or of the ``window``, with the gauge of the figures."""

    part: str
    poses: Poses
    gauge: Gauge

    def fit(self) -> PositionErrorModel | None:
        """Fit it."""
        truth = self.poses.truth

        def answered(stamps: npt.NDArray[np.int64]) -> Truth:
            return truth.at(stamps, near=_NEAR)

        gauge = gauge_of_model(self.gauge)
        return fit_positions(truth.stamps, self.poses.estimate, answered, gauge)


class LivePositionModels:
    """Takes evaluations on positions; says which fit is due, and takes what it says."""

    def __init__(self, window: int, gauge: Gauge) -> None:
        """Start empty. window: ns. gauge: of the figures."""
        self.duration = window
        self._gauge = gauge
        self._run, self._window = _Run(), _Window()
        self._fitted = 0  # poses of the run when it was fitted
        self._current = True
        self.figures: dict[str, Figures] = {}
        """Of the ``run`` and of the ``window``, as far as they have been fitted."""

    def add(self, evaluations: Evaluations, offset: int) -> None:
        """Take poses, whose stamps on the ground truth's clock are ``offset`` (ns) later."""
        if not evaluations.sampled.any():
            return
        poses = poses_of(evaluations, offset)
        self._run.add(poses)
        self._window.add(poses, self.duration)
        self._current = False

    def due(self, *, of_window: bool = True, last: bool = False) -> PositionsDue | None:
        """The run if it has grown, however little where it is the ``last`` time; or the window."""
        least = self._fitted + 1 if last else round(_GROWN * self._fitted) + 1
        if self._run.seen >= least:
            self._fitted = self._run.seen
            return PositionsDue("run", self._run.poses(), self._gauge)
        return self.window_due() if of_window else None

    def window_due(self) -> PositionsDue | None:
        """The window, if it has changed since."""
        if self._current:
            return None
        self._current = True
        return PositionsDue("window", self._window.poses(self.duration), self._gauge)

    def take(self, due: PositionsDue, model: PositionErrorModel | None) -> None:
        """Take what the fit that was ``due`` says."""
        found = {key: value for key, value in self.figures.items() if key != due.part}
        if model is not None:
            found[due.part] = named_on_positions(model)
            if due.part == "run":
                found[due.part]["fit"] = THINNED
        self.figures = found


def error_models_on_positions(
    engine: Engine, name: str, evaluations: Evaluations, *, whole: bool
) -> dict[str, Figures]:
    """Of a ``run``'s evaluations on positions, and of its ``window``, where they can be told.

    ``whole``: the engine has all of the ground truth still; its orientations are not looked at.
    """
    if not evaluations.sampled.any():
        return {}
    offset, settings = engine.settings.estimates[name].time_offset, engine.settings.evaluation
    live = LivePositionModels(settings.window, settings.gauge)
    live.add(evaluations, offset)
    window = live.window_due()
    if window is not None:
        live.take(window, window.fit())
    found, poses = dict(live.figures), poses_of(evaluations, offset)

    def truth(asked: npt.NDArray[np.int64]) -> Truth:
        return engine.truth(asked, name) if whole else poses.truth.at(asked, near=_NEAR)

    gauge = gauge_of_model(settings.gauge)
    model = fit_positions(poses.truth.stamps, poses.estimate, truth, gauge)
    if model is not None:
        found["run"] = {**named_on_positions(model), "fit": WHOLE}
    return found
