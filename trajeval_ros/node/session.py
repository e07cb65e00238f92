# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run: the engine, what it has found so far, and the folder that this goes to. No ROS."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

from trajeval_ros.files.output import OutputError, OutputFolder
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.parameters import ParameterError, Value
from trajeval_ros.online.results import Results
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.report import Report

_FILES = ("summary.json", "poses.csv", "report.html")


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
        self._directory = str(values["output.directory"])
        self._folder: OutputFolder | None = None
        self._finished_runs = 0
        if self._directory:
            self._try_open()

    def _try_open(self) -> OutputFolder | None:
        try:
            self._folder = OutputFolder(self._directory)
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

    def advance(self, now: int | None) -> Results:
        """Evaluate what can be; ``now`` (ns) on the stamps' clock."""
        return self._record(self.engine.advance(now))

    def finish(self) -> Results:
        """Decide all that is pending: no more data will come."""
        return self._record(self.engine.finish())

    def _record(self, results: Results) -> Results:
        if len(results.evaluations) or results.notices:
            self._report.add(results)
        if self._folder is not None:
            try:
                self._folder.add(results.evaluations)
            except OutputError as error:
                self.error = str(error)
        return results

    def save(self) -> Path | None:
        """Write the output folder and return it; None where there is none to write.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        if not self._directory:
            return None
        folder = self._folder or self._try_open()
        if folder is None:
            assert self.error is not None
            raise OutputError(self.error)
        try:
            folder.write(self.engine.summary(), self._report.render)
        except OutputError as error:
            self.error = str(error)
            raise
        self.error = None
        return folder.path

    def archive(self) -> Path | None:
        """Write the output folder and keep a copy, which the next run does not overwrite.

        Returns the copy, ``run_1``, ``run_2``, ... in the folder. Raises OutputError.
        """
        saved = self.save()
        if saved is None:
            return None
        self._finished_runs += 1
        copy = saved / f"run_{self._finished_runs}"
        try:
            copy.mkdir(exist_ok=True)
            for name in _FILES:
                if (saved / name).exists():
                    shutil.copyfile(saved / name, copy / name)
        except OSError as error:
            self.error = f"cannot write {copy}: {error.strerror or error}"
            raise OutputError(self.error) from error
        return copy

    def reset(self) -> None:
        """Start over; files that are written stay until the next time they are."""
        self.engine.reset()
        self._report.clear()
        if self._folder is not None:
            try:
                self._folder.clear()
            except OutputError as error:
                self.error = str(error)

    def change(self, name: str, value: Value) -> None:
        """Put a changed parameter into effect.

        Raises
        ------
        ParameterError
            If it cannot be, an output folder that cannot be written included.
        """
        if name == "output.directory":
            self._move(str(value))
        self.engine.set(name, value)

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
        self.error = None

    def close(self) -> None:
        """Close the folder, without writing it."""
        if self._folder is not None:
            self._folder.close()
            self._folder = None
