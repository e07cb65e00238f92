# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is kept of one estimate's run, and the folder that it goes to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.alignment.gauge import GAUGES
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.error_model.positions import PositionErrorModel
from trajeval_ros.error_model.running import Due, Fitted
from trajeval_ros.files.output import OutputError, OutputFolder
from trajeval_ros.online.parameters import Value
from trajeval_ros.online.positions import rows_of
from trajeval_ros.online.results import Evaluations, Results
from trajeval_ros.report import Report
from trajeval_ros.report.track import Track
from trajeval_ros.runs.beside import Outcome, Work
from trajeval_ros.runs.error_models import LiveErrorModels, put_into
from trajeval_ros.runs.latest_path import LatestPath, on_positions
from trajeval_ros.runs.position_models import LivePositionModels, PositionsDue
from trajeval_ros.wall import shield

# Rows are written so many at a time: a batch costs hardly more than a pose.
_TOGETHER = 256
_COLUMNS = tuple(field.name for field in fields(Evaluations))


class Record:
    """The report of one estimate, its likely causes, its folder.

    A folder that cannot be written does not end the evaluation: ``error`` says what is wrong until
    a later attempt succeeds.
    """

    def __init__(
        self,
        parameters: Mapping[str, Value],
        sources: Mapping[str, str],
        directory: str,
        window: int,
    ) -> None:
        """Start empty; without a ``directory`` nothing is written.

        ``parameters`` are those of a run with this estimate alone; ``window`` in ns.
        """
        self.report = Report(parameters, sources)
        self.error: str | None = None
        self.models = LiveErrorModels(window)
        self.on_positions = self._no_position_models()
        self._is_on_positions = False
        self.undecodable = 0
        self.causes: tuple[Cause, ...] = ()
        self.latest_path: LatestPath | None = None
        self._examined = 0
        self._directory = directory
        self._folder: OutputFolder | None = None
        self._rows: list[Evaluations] = []  # that wait for others to be written with
        self._unwritten = 0  # poses evaluated while there was no folder for them
        if directory:
            self._try_open()

    def _no_position_models(self) -> LivePositionModels:
        wanted = self.report.parameters["gauge"]
        gauge = next(gauge for name, gauge in GAUGES.items() if name == wanted)
        return LivePositionModels(self.models.duration, gauge)

    def _try_open(self) -> OutputFolder | None:
        try:
            self._folder = OutputFolder(self._directory)
            self._folder.lack(self._unwritten, self.error or "")
            self.error = None
        except OutputError as error:
            self.error = str(error)
        return self._folder

    @property
    def path(self) -> Path | None:
        """The folder; None where there is none."""
        return None if self._folder is None else self._folder.path

    def add(self, results: Results, offset: int) -> None:
        """Take in what a call of the engine brought about.

        ``offset`` (ns): of the estimate's clock from the ground truth's.
        """
        evaluations = results.evaluations
        if len(evaluations):
            self.report.add(results)
            say = self.report.say
            self._is_on_positions = results.position_only
            models = self.on_positions if results.position_only else self.models
            shield("the error model", lambda: models.add(evaluations, offset), None, say)
            if self.latest_path is not None:
                self.latest_path.add(evaluations)
        if not len(evaluations):
            return
        if self._directory and self._folder is None:
            self._try_open()
        if self._folder is None:
            self._unwritten += len(evaluations)
            return
        self._rows.append(rows_of(results))
        if sum(map(len, self._rows)) >= _TOGETHER:
            self._put_rows()

    def _put_rows(self) -> None:
        """Put what waits into the folder."""
        rows, self._rows = self._rows, []
        if self._folder is None or not rows:
            return
        try:
            self._folder.add(_joined(rows))
        except OutputError as error:
            self.error = str(error)

    def fit_due(self, *, of_window: bool = True, last: bool = False) -> Work | None:
        """The fit of a block of the run, or of the window, if one has changed.

        Not ``of_window``: of a block alone. ``last``: nothing more comes before the figures are
        written.
        """
        say = self.report.say
        if self._is_on_positions:
            of_positions = self.on_positions
            find_one = partial(of_positions.due, of_window=of_window, last=last)
            found = shield("the error model", find_one, None, say)
            if found is None:
                return None
            return Work(found.fit, partial(self._take_on_positions, of_positions, found))
        find = self.models.due if of_window else self.models.block_due
        due: Due | None = shield("the error model", find, None, say)
        return None if due is None else Work(due.fit, partial(self._take, self.models, due))

    def _take(self, models: LiveErrorModels, due: Due, fitted: Callable[[], Fitted]) -> None:
        say = self.report.say
        shield("the error model", lambda: models.take(due, fitted()), None, say)
        found = self.error_models
        self.report.model = found.get("run", found.get("window"))

    def _take_on_positions(
        self,
        models: LivePositionModels,
        due: PositionsDue,
        fitted: Callable[[], PositionErrorModel | None],
    ) -> None:
        # What it says of causes is said with the figures: the report's model has orientations.
        say = self.report.say
        shield("the error model", lambda: models.take(due, fitted()), None, say)

    def change(self, window: int) -> None:
        """Go on with another window, ns."""
        self.models.change(window)
        self.on_positions.duration = window

    @property
    def error_models(self) -> dict[str, dict[str, Any]]:
        """The error models of the ``run`` and of the ``window``, as far as they are fitted."""
        lack: dict[str, dict[str, Any]] = {}
        models = self.on_positions if self._is_on_positions else self.models
        return shield("the error model", lambda: models.figures, lack, self.report.say)

    def path_due(self) -> Work | None:
        """The score of the latest whole trajectory, if it is new, or there is more to score by."""
        due = None if self.latest_path is None else self.latest_path.due()
        if due is None:
            return None

        def take(outcome: Outcome) -> None:
            shield("the latest path", lambda: due.take(outcome), None, self.report.say)

        return Work(due.do, take)

    def of_latest_path(self, position_only: bool) -> dict[str, Any] | None:
        """The figures of the latest whole trajectory, as far as it has been scored."""
        figures = None if self.latest_path is None else self.latest_path.figures
        return on_positions(figures) if position_only else figures

    def look_for_causes(self, evaluated: int, *, again: bool = False) -> None:
        """Look at the run so far, if more has been ``evaluated`` since, or ``again``."""
        search = self.search_due(evaluated, again=again)
        if search is not None:
            search.at_once()

    def search_due(self, evaluated: int, *, again: bool = False) -> Work | None:
        """The search for likely causes, if more has been ``evaluated`` since, or ``again``."""
        if evaluated == self._examined and not again:
            return None
        self._examined = evaluated
        return Work(self.report.search(), partial(self._found, self.report.track))

    def _found(self, track: Track, causes: Callable[[], tuple[Cause, ...]]) -> None:
        # Of a run that has ended, nothing.
        if track is self.report.track:
            say, otherwise = self.report.say, self.report.of_rows
            self.causes = shield("the search for likely causes", causes, otherwise, say)

    def completed(self, summary: Mapping[str, object]) -> dict[str, object]:
        """Return an engine's summary as ``summary.json`` has it."""
        whole = {**summary, "likely_causes": [cause._asdict() for cause in self.causes]}
        put_into(whole, self.error_models)
        path = self.path_due()
        if path is not None:
            path.at_once()
        latest_path = self.of_latest_path(bool(summary.get("position_only")))
        if latest_path is not None:
            whole["latest_path"] = latest_path
        return whole

    def save(self, summary: Mapping[str, object], *, last: bool) -> None:
        """Write the folder; after the ``last`` time nothing more is evaluated.

        Raises
        ------
        OutputError
            If some of it cannot be written; the rest is.
        """
        folder = self._folder or self._try_open()
        if folder is None:
            assert self.error is not None
            raise OutputError(self.error)
        self._put_rows()
        try:
            path = None if self.latest_path is None else self.latest_path.path
            folder.write(summary, self.report.render, last=last, latest_path=path)
        except OutputError as error:
            self.error = str(error)
            raise
        self.error = None

    def clear(self) -> None:
        """Start over; files that are written stay until the next time they are."""
        self._rows = []
        self._unwritten = self.undecodable = self._examined = 0
        self.causes = ()
        self.models = LiveErrorModels(self.models.duration)
        self.on_positions, self._is_on_positions = self._no_position_models(), False
        self.report.clear()
        if self.latest_path is not None:
            self.latest_path.clear()
        if self._folder is not None:
            try:
                self._folder.clear()
            except OutputError as error:
                self.error = str(error)

    def move(self, directory: str) -> None:
        """Go on in another folder, with the rows so far; raises OutputError if it cannot be."""
        self._put_rows()
        if self._folder is not None and directory:
            self._folder = self._folder.move(directory)
        elif directory:
            self._folder = OutputFolder(directory)
        else:
            self.close()
        self._directory = directory
        self.error = None

    def close(self) -> None:
        """Close the folder, without writing it."""
        if self._folder is not None:
            self._folder.close()
            self._folder = None


def _joined(parts: list[Evaluations]) -> Evaluations:
    """One after the other."""
    columns = ([getattr(part, name) for part in parts] for name in _COLUMNS)
    return Evaluations(*map(np.concatenate, columns))
