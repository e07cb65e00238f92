# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run: the engine, what it has found so far, and the folder that this goes to. No ROS."""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.files.output import FILES, OutputError, OutputFolder
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.parameters import PARAMETERS, ParameterError, Value
from trajeval_ros.online.results import Evaluations, Health, Results, TopicHealth
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.report import Report
from trajeval_ros.runs.error_models import LiveErrorModels, put_into
from trajeval_ros.runs.origin import origin
from trajeval_ros.wall import shield

UNDECODABLE = "undecodable"
"""Why a message is rejected that the engine never sees."""


class Session:
    """The engine with its records; starts over as often as it must.

    A folder that cannot be written does not end the evaluation: ``error`` says what is wrong until
    a later attempt succeeds.
    """

    def __init__(self, values: Mapping[str, Value], sources: Mapping[str, str]) -> None:
        """Start with the parameters' ``values``; ``sources`` name the topics in the report."""
        self.engine = Engine(values)
        self.error: str | None = None
        self._report = Report(values, sources)
        self._topics = tuple({"topic": sources[name]} for name in ("ground truth", "estimate"))
        self._directory = str(values["output.directory"])
        self._folder: OutputFolder | None = None
        self._unwritten = 0  # poses evaluated while there was no folder for them
        # Whether what is in the folder is of the run that goes on, and may be written anew.
        self._is_ours = False
        self._causes: tuple[Cause, ...] = ()
        self._examined = 0
        self._models = LiveErrorModels(self.engine.settings.evaluation.window)
        # Of ground truth and estimate.
        self._undecodable = [0, 0]
        if self._directory:
            self._try_open()

    def _try_open(self) -> OutputFolder | None:
        try:
            self._folder = OutputFolder(self._directory)
            self._folder.lack(self._unwritten, self.error or "")
            self.error = None
        except OutputError as error:
            self.error = str(error)
        return self._folder

    def feed(self, ground_truth: PoseSamples | None, estimate: PoseSamples | None) -> None:
        """Hand over what has arrived."""
        if ground_truth is not None and len(ground_truth):
            self.engine.add_ground_truth(ground_truth)
            self._report.add_received(ground_truth=ground_truth.stamps)
        if estimate is not None and len(estimate):
            self.engine.add_estimate(estimate)
            self._report.add_received(estimate=estimate.stamps)

    def note_undecodable(self, topic: int, number: int) -> None:
        """Messages that cannot be read came on topic 0 (ground truth) or 1 (estimate)."""
        self._undecodable[topic] += number

    def newest_stamps(self) -> list[int]:
        """The newest stamps let in (ns), one a topic, on the ground truth's clock."""
        health = self.engine.health()
        (settings,) = self.engine.settings.estimates.values()
        truth, estimate = health.ground_truth.latest_stamp, health.estimate.latest_stamp
        shifted = None if estimate is None else estimate + settings.time_offset
        return [stamp for stamp in (truth, shifted) if stamp is not None]

    def health(self) -> Health:
        """The engine's health, with the messages in it that could not be read."""
        health = self.engine.health()
        truth, estimate = self._undecodable
        return replace(
            health,
            ground_truth=_with_undecodable(health.ground_truth, truth),
            estimate=_with_undecodable(health.estimate, estimate),
        )

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What is likely wrong with the data, as far as `look_for_causes` has seen."""
        return self._causes

    @property
    def defects(self) -> tuple[str, ...]:
        """What of causes, report and pictures has failed, a line each."""
        return self._report.defects

    def look_for_causes(self) -> None:
        """Look at the run so far, if it has gone on since: 40 ms at the most, however long."""
        evaluated = self.engine.health().estimate.used
        if evaluated != self._examined:
            self._causes, self._examined = self._report.causes(), evaluated

    def fit_error_model(self) -> bool:
        """Fit a block of the run or the window, if one has changed; it takes a part of a second."""
        defects = self._report.say
        fitted = shield("the error model", self._models.fit_one, False, defects)
        models = self.error_models
        self._report.model = models.get("run", models.get("window"))
        return fitted

    @property
    def error_models(self) -> dict[str, dict[str, Any]]:
        """The error models of the ``run`` and of the ``window``, as far as they are fitted."""
        lack: dict[str, dict[str, Any]] = {}
        return shield("the error model", lambda: self._models.figures, lack, self._report.say)

    def figures(self) -> dict[str, object]:
        """The engine's figures, with the messages in them that could not be read."""
        return self._accounted(self.engine.figures())

    def summary(self) -> dict[str, object]:
        """The engine's summary, with the messages in it that could not be read."""
        return self._accounted(self.engine.summary())

    def _accounted(self, figures: dict[str, Any]) -> dict[str, object]:
        for topic, count in zip(("ground_truth", "estimate"), self._undecodable, strict=True):
            if count:
                account = figures[topic]
                account["received"] += count
                account["rejected"] = {**account["rejected"], UNDECODABLE: count}
        return figures

    def advance(self, now: int | None) -> Results:
        """Evaluate what can be; ``now`` (ns) on the stamps' clock."""
        return self._record(self.engine.advance(now))

    def finish(self) -> Results:
        """Decide all that is pending: no more data will come."""
        return self._record(self.engine.finish())

    def _record(self, results: Results) -> Results:
        if len(results.evaluations):
            self._report.add(results)
            self._add_to_models(results.evaluations)
        folder = self._folder
        if self._directory and folder is None and len(results.evaluations):
            folder = self._try_open()
        if folder is None:
            self._unwritten += len(results.evaluations)
            return results
        try:
            folder.add(results.evaluations)
        except OutputError as error:
            self.error = str(error)
        return results

    def _add_to_models(self, evaluations: Evaluations) -> None:
        (settings,) = self.engine.settings.estimates.values()
        shield(
            "the error model",
            lambda: self._models.add(evaluations, settings.time_offset),
            None,
            self._report.say,
        )

    def save(self, *, last: bool = False) -> Path | None:
        """Write the output folder and return it; None where there is nothing to write.

        That is without a folder, and at the end of a run in which nothing has been evaluated, where
        there are results. Those of another run are kept first: nothing is overwritten by less.
        After the ``last`` time nothing more is evaluated.

        Raises
        ------
        OutputError
            If some of it cannot be written; the rest is.
        """
        if not self._directory:
            return None
        folder = self._folder or self._try_open()
        if folder is None:
            assert self.error is not None
            raise OutputError(self.error)
        if not self._is_ours and (folder.path / FILES[0]).exists():
            if self.is_empty and last:
                return None
            self._keep_earlier(folder.path)
        self._is_ours = True
        while self.fit_error_model():
            pass
        self._examined = 0
        self.look_for_causes()
        causes = [asdict(cause) for cause in self._causes]
        self._report.notices = self.engine.notices()
        self._report.way = self.engine.way()
        summary = {
            **origin(self.engine.parameters, *self._topics),
            **self.summary(),
            "likely_causes": causes,
        }
        put_into(summary, self.error_models)
        try:
            folder.write(summary, self._report.render, last=last)
        except OutputError as error:
            self.error = str(error)
            raise
        self.error = None
        return folder.path

    def archive(self) -> Path | None:
        """Write the output folder and keep a copy, which the next run does not overwrite.

        Returns the copy, ``run_1``, ``run_2``, ... in the folder; None for a run in which nothing
        has been evaluated, which has nothing to keep. Raises OutputError if it, or a part of it,
        cannot be written.
        """
        if self.is_empty:
            return None
        failures: dict[str, str] = {}
        try:
            saved = self.save()
        except OutputError as error:
            if self._folder is None:
                raise
            saved, failures = self._folder.path, error.failures
        if saved is None:
            return None
        copy = _free(saved)
        try:
            _keep_files(saved, copy, [name for name in FILES if name not in failures])
        except OSError as error:
            failures[copy.name] = f"cannot write {copy}: {error.strerror or error}"
        if failures:
            self.error = "; ".join(failures.values())
            raise OutputError(self.error, failures)
        return copy

    @property
    def is_empty(self) -> bool:
        """Whether nothing has been evaluated since the start, or the last one."""
        return not self.engine.health().estimate.used

    def _keep_earlier(self, folder: Path) -> None:
        """Keep what another run has written: an earlier one, or one of an earlier process."""
        copy = _free(folder)
        if any(_same_file(folder / FILES[0], kept / FILES[0]) for kept in folder.glob("run_*")):
            return
        try:
            _keep_files(folder, copy, FILES)
        except OSError as error:
            text = f"cannot write {copy}: {error.strerror or error}"
            raise OutputError(text) from error

    def reset(self) -> None:
        """Start over; files that are written stay until the next time they are."""
        self._is_ours = False
        self.engine.reset()
        self._unwritten = 0
        self._undecodable = [0, 0]
        self._causes, self._examined = (), 0
        self._models = LiveErrorModels(self.engine.settings.evaluation.window)
        self._report.clear()
        if self._folder is not None:
            try:
                self._folder.clear()
            except OutputError as error:
                self.error = str(error)

    def change(self, changes: Mapping[str, object]) -> None:
        """Put changed parameters into effect, all of them or none.

        Raises
        ------
        ParameterError
            If they cannot be, an output folder that cannot be written included.
        """
        checked = {name: PARAMETERS[name].validate(value) for name, value in changes.items()}
        for name in checked:
            if not PARAMETERS[name].dynamic:
                raise ParameterError(f"{name} is read-only while the node runs")
        # The last that can fail.
        if "output.directory" in checked:
            self._move(str(checked["output.directory"]))
        for name, value in checked.items():
            self.engine.set(name, value)
            self._report.parameters[name] = value
        self._models.change(self.engine.settings.evaluation.window)

    def _move(self, directory: str) -> None:
        try:
            if self._folder is not None and directory:
                self._folder = self._folder.move(directory)
            elif directory:
                self._folder = OutputFolder(directory)
            else:
                self.close()
        except OutputError as error:
            raise ParameterError(str(error)) from error
        self._directory = directory
        self._is_ours = False
        self.error = None

    def close(self) -> None:
        """Close the folder, without writing it."""
        if self._folder is not None:
            self._folder.close()
            self._folder = None


def _free(folder: Path) -> Path:
    """The first of ``run_1``, ``run_2``, ... that is not there yet."""
    return next(
        path
        for path in (folder / f"run_{number}" for number in itertools.count(1))
        if not path.exists()
    )


def _keep_files(folder: Path, copy: Path, names: Iterable[str]) -> None:
    copy.mkdir()
    for name in names:
        if (folder / name).is_file():
            _keep(folder / name, copy / name)


def _same_file(one: Path, other: Path) -> bool:
    """Whether both are one file, or have the same in them: it has been kept already."""
    try:
        return one.samefile(other) or one.read_bytes() == other.read_bytes()
    except OSError:
        return False


def _keep(path: Path, kept: Path) -> None:
    """Keep a file that is only ever replaced: by a second name for it, which needs no room."""
    kept.unlink(missing_ok=True)
    try:
        os.link(path, kept)
    except OSError:
        shutil.copyfile(path, kept)


def _with_undecodable(health: TopicHealth, count: int) -> TopicHealth:
    if not count:
        return health
    rejected = {**health.rejected, UNDECODABLE: count}
    return replace(health, received=health.received + count, rejected=rejected)
