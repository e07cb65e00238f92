# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run: the engine, what it has found so far, and the folder that this goes to. No ROS."""

from __future__ import annotations

import itertools
import json
import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.comparison.ratio import Method
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.files.fixes import FixCounts
from trajeval_ros.files.output import (
    FILES,
    LATEST_PATH,
    OutputError,
    OutputFolder,
    write_report,
    write_summary,
)
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.parameters import (
    ParameterError,
    Value,
    is_name,
    names_in,
    of_estimate,
    table,
)
from trajeval_ros.online.results import Health, Results, TopicHealth
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.report import render_several
from trajeval_ros.runs.beside import Outcome, Work, outcome_of
from trajeval_ros.runs.fixes import notices_of_fixes, put_fixes_into
from trajeval_ros.runs.latest_path import LatestPath
from trajeval_ros.runs.origin import origin
from trajeval_ros.runs.position_only import causes_on_positions, comparisons_on_positions
from trajeval_ros.runs.record import Record
from trajeval_ros.runs.several import (
    NewestPoses,
    causes_of_all,
    newest_compared,
    sentences_of_all,
    together,
)
from trajeval_ros.wall import shield

T = TypeVar("T")

_SUMMARY = "summary.json"
_OF_ONE = (*FILES, LATEST_PATH)

UNDECODABLE = "undecodable"
"""Why a message is rejected that the engine never sees."""


class Session:
    """The engine with a record of each estimate; starts over as often as it must.

    The name of an estimate may be left out where there is one. With several, each has a folder of
    its name in ``output.directory``, and the summary of all lies beside them.

    A folder that cannot be written does not end the evaluation: ``error`` says what is wrong until
    a later attempt succeeds.
    """

    def __init__(
        self, values: Mapping[str, Value], sources: Mapping[str, str], *, beside: bool = False
    ) -> None:
        """Start with the parameters' ``values``.

        ``sources`` name the topics in the report: ``ground truth``, and the names of the estimates.
        ``beside``: the owner sees to `lesson_due`, and what needs its answer waits for it.
        """
        self.names = names_in(values)
        self._known = table(self.names)
        self.engine = Engine(values, self.names, beside=beside)
        self._directory = str(values["output.directory"])
        self._topics = {name: {"topic": topic} for name, topic in sources.items()}
        self._records = {
            name: Record(
                of_estimate(values, name),
                {"ground truth": sources["ground truth"], "estimate": sources[name]},
                self._place(self._directory, name),
                self.engine.settings.evaluation.window,
            )
            for name in self.names
        }
        # For the comparison, of which there is none with one estimate.
        self._newest = [
            NewestPoses(name, self.engine.settings.estimates[name].time_offset)
            for name in self.names
            if self.is_several
        ]
        self._next_fit = 0  # whose error model comes first, by its number
        self._error: str | None = None  # of the summary of all
        # Whether what is in the folder is of the run that goes on, and may be written anew.
        self._is_ours = False
        self._undecodable = 0  # of the ground truth
        self._without_orientation: set[int] = set()  # topics, 0 being the ground truth
        self._fix_counts: dict[int, FixCounts] = {}  # by topic

    @property
    def is_several(self) -> bool:
        """Whether there is more than one estimate."""
        return len(self.names) > 1

    def _place(self, directory: str, name: str) -> str:
        """The folder of an estimate's own; empty where nothing is to be written."""
        return str(Path(directory) / name) if directory and self.is_several else directory

    def _record(self, name: str | None) -> Record:
        return self._records[self.engine.only(name)]

    @property
    def error(self) -> str | None:
        """What is wrong with the output folder."""
        errors = [record.error for record in self._records.values()]
        return next((error for error in (*errors, self._error) if error is not None), None)

    def feed(self, ground_truth: PoseSamples | None, *estimates: PoseSamples | None) -> None:
        """Hand over what has arrived, of the estimates in the order of their names."""
        if ground_truth is not None and len(ground_truth):
            self.engine.add_ground_truth(ground_truth)
            for record in self._records.values():
                record.report.add_received(ground_truth=ground_truth.stamps)
        for (name, record), samples in zip(self._records.items(), estimates, strict=True):
            if samples is not None and len(samples):
                self.engine.add_estimate(samples, name)
                record.report.add_received(estimate=samples.stamps)

    def note_undecodable(self, topic: int, number: int) -> None:
        """Messages came that cannot be read: on topic 0, the ground truth, or an estimate's."""
        if topic == 0:
            self._undecodable += number
        else:
            self._records[self.names[topic - 1]].undecodable += number

    def note_without_orientation(self, topic: int) -> None:
        """What comes on a topic, 0 or an estimate's, are positions alone: `is_position_only`."""
        self._without_orientation.add(topic)
        self._note_orientations()

    def note_fixes(self, topic: int, fixes: FixCounts) -> None:
        """Of what modes the fixes of this run are, of a topic that has such."""
        self._fix_counts[topic] = fixes

    def fixes_of(self, topic: int) -> FixCounts | None:
        """Of what modes the fixes on a topic are, 0 or an estimate's; None where it has none."""
        return self._fix_counts.get(topic)

    def _fixes(self, name: str | None) -> dict[str, FixCounts | None]:
        topic = 1 + self.names.index(self.engine.only(name))
        return {"ground truth": self._fix_counts.get(0), "estimate": self._fix_counts.get(topic)}

    def note_orientation(self, topic: int) -> None:
        """From the next run on, what comes on a topic has an orientation again."""
        self._without_orientation.discard(topic)

    def _note_orientations(self) -> None:
        for topic in self._without_orientation:
            self.engine.note_without_orientation(self.names[topic - 1] if topic else None)
        for name, record in self._records.items():
            record.report.lacks_orientation = self.engine.lacks_orientation(name)

    def is_position_only(self, name: str | None = None) -> bool:
        """Whether the ground truth or the estimate has no orientation."""
        return self.engine.is_position_only(name)

    def take_path(self, topic: int, path: PoseSamples) -> None:
        """Take the latest whole trajectory of an estimate; before its poses are fed."""
        if topic == 0:
            return
        record = self._records[self.names[topic - 1]]
        if record.latest_path is None:
            settings = self.engine.settings
            own = settings.estimates[self.names[topic - 1]]
            record.latest_path = LatestPath(settings.evaluation, own)
        record.latest_path.take(path)

    def paths_due(self) -> Work | None:
        """The scores of the latest whole trajectories, where there are new ones."""
        found = (record.path_due() for record in self._records.values())
        return Work.together([path for path in found if path is not None])

    def score_latest_paths(self) -> bool:
        """Score those that are due at once, 0.1 s at the most; whether there were any."""
        work = self.paths_due()
        if work is not None:
            work.at_once()
        return work is not None

    def latest_path_of(self, name: str | None = None) -> dict[str, Any] | None:
        """The figures of an estimate's latest whole trajectory, if it publishes such."""
        return self._record(name).of_latest_path(self.is_position_only(name))

    def newest_stamps(self) -> list[int]:
        """The newest stamps let in (ns), one a topic, on the ground truth's clock."""
        return self.engine.newest_stamps()

    def health(self, name: str | None = None) -> Health:
        """The engine's health, with the messages in it that could not be read."""
        health = self.engine.health(name)
        return health._replace(
            ground_truth=_with_undecodable(health.ground_truth, self._undecodable),
            estimate=_with_undecodable(health.estimate, self._record(name).undecodable),
        )

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What is likely wrong with the data of the only estimate; `causes_of` is for several."""
        return self.causes_of()

    def causes_of(self, name: str | None = None) -> tuple[Cause, ...]:
        """What is likely wrong with the data, as far as `look_for_causes` has seen."""
        return self._record(name).causes

    @property
    def defects(self) -> tuple[str, ...]:
        """What of causes, report and pictures has failed, a line each."""
        found = (line for record in self._records.values() for line in record.report.defects)
        return tuple(dict.fromkeys(found))

    def say(self, defect: str) -> None:
        """Remember what of what is said of all estimates has failed, in one line."""
        self._records[self.names[0]].report.say(defect)

    def look_for_causes(self, *, again: bool = False) -> None:
        """Look at each run so far, if it has gone on since: 40 ms at the most, however long.

        ``again``: also where it has not.
        """
        self._tell_of_positions()
        for name, record in self._records.items():
            record.look_for_causes(self.engine.health(name).estimate.used, again=again)

    def search_due(self) -> Work | None:
        """The search for likely causes in each run that has gone on since."""
        self._tell_of_positions()
        searches = (
            record.search_due(self.engine.health(name).estimate.used)
            for name, record in self._records.items()
        )
        return Work.together([search for search in searches if search is not None])

    def _tell_of_positions(self) -> None:
        """Tell the reports what positions alone say of lever arm and clock."""
        for name, record in self._records.items():
            if self.is_position_only(name):
                figures, model = self.engine.figures(name), record.error_models.get("run")
                record.report.of_rows = causes_on_positions(self.engine, name, figures, model)

    def fit_due(self, *, of_window: bool = True, last: bool = False) -> Work | None:
        """The fit of a block of a run, or of a window, if one has changed.

        Not ``of_window``: of a block alone. ``last``: before the figures are written.
        """
        for name in self.names[self._next_fit :] + self.names[: self._next_fit]:
            work = self._records[name].fit_due(of_window=of_window, last=last)
            if work is not None:
                # The others come first the next time.
                self._next_fit = (self.names.index(name) + 1) % len(self.names)
                return work
        return None

    def fit_error_model(self, *, last: bool = False) -> bool:
        """Make a fit that is due at once; whether there was one. ``last`` as of `fit_due`."""
        work = self.fit_due(last=last)
        if work is not None:
            work.at_once()
        return work is not None

    def lesson_due(self) -> Work | None:
        """The lesson of the ground truth's process that is due, where it is learned beside."""
        lesson, engine = self.engine.lesson, self.engine
        if lesson is None:
            return None
        return Work(lesson.learned, lambda learned: engine.teach(lesson, learned()))

    @property
    def error_models(self) -> dict[str, dict[str, Any]]:
        """The error models of the only estimate; `error_models_of` is for several."""
        return self.error_models_of()

    def error_models_of(self, name: str | None = None) -> dict[str, dict[str, Any]]:
        """The error models of the ``run`` and of the ``window``, as far as they are fitted."""
        return self._record(name).error_models

    def comparisons(self, method: Method | None = None) -> tuple[Comparison, ...]:
        """Compare each pair of estimates, on the newest poses that are kept of each.

        ``method``: where the intervals come from; the best that is installed where None.
        """
        return self._said_of_all("the comparison", self._comparing(method))

    def causes_of_all(self) -> tuple[Cause, ...]:
        """What is likely wrong by what several estimates have in common, if anything is."""
        return self._said_of_all("the search for likely causes", self._finding())

    def comparison(
        self,
        method: Method,
        take: Callable[[tuple[Comparison, ...], tuple[Cause, ...]], None],
        *,
        pairs: bool,
    ) -> Work:
        """`comparisons`, if ``pairs``, and `causes_of_all`, which ``take`` is given."""
        of_pairs = self._comparing(method) if pairs else tuple
        of_all = self._finding()

        def taken(outcomes: Outcome) -> None:
            compared, found = outcomes()
            take(
                self._said_of_all("the comparison", compared),
                self._said_of_all("the search for likely causes", found),
            )

        return Work(lambda: (outcome_of(of_pairs), outcome_of(of_all)), taken)

    def _said_of_all(self, what: str, find: Callable[[], tuple[T, ...]]) -> tuple[T, ...]:
        return shield(what, find, (), self.say)

    def _comparing(self, method: Method | None) -> Callable[[], tuple[Comparison, ...]]:
        """What compares each pair, as they are by now: it touches nothing of the run."""
        newest = [each.copy() for each in self._newest]
        settings = self.engine.settings.evaluation
        known = {name: {"position_only": self.is_position_only(name)} for name in self.names}
        return lambda: comparisons_on_positions(newest_compared(newest, settings, method), known)

    def _finding(self) -> Callable[[], tuple[Cause, ...]]:
        """What finds the causes of all, as they are by now: it touches nothing of the run."""
        turning = [
            one.evaluated()
            for name, one in zip(self.names, self._newest, strict=False)
            if not self.is_position_only(name)
        ]
        return lambda: causes_of_all(turning)

    def figures(self, name: str | None = None) -> dict[str, object]:
        """The engine's figures, with the messages in them that could not be read."""
        return self._accounted(self.engine.figures(name), name)

    def summary(self, name: str | None = None) -> dict[str, object]:
        """The engine's summary, with the messages in it that could not be read."""
        return self._accounted(self.engine.summary(name), name)

    def _accounted(self, figures: dict[str, Any], name: str | None) -> dict[str, object]:
        unread = {"ground_truth": self._undecodable, "estimate": self._record(name).undecodable}
        for topic, count in unread.items():
            if count:
                account = figures[topic]
                account["received"] += count
                account["rejected"] = {**account["rejected"], UNDECODABLE: count}
        put_fixes_into(figures, self._fixes(name))
        return figures

    def advance(self, now: int | None) -> Results:
        """Evaluate what can be of the only estimate; ``now`` (ns) on the stamps' clock."""
        name = self.engine.only(None)
        return self.advance_all(now)[name]

    def advance_all(self, now: int | None, most: int | None = None) -> dict[str, Results]:
        """Evaluate what can be of every estimate; ``now`` (ns) on the stamps' clock.

        ``most`` as of `Engine.advance_all`.
        """
        return self._recorded(self.engine.advance_all(now, most))

    def finish(self) -> Results:
        """No more data will come: decide all that is pending of the only estimate."""
        name = self.engine.only(None)
        return self.finish_all()[name]

    def finish_all(self) -> dict[str, Results]:
        """No more data will come: decide all that is pending."""
        return self._recorded(self.engine.finish_all())

    def _recorded(self, found: dict[str, Results]) -> dict[str, Results]:
        for name, results in found.items():
            offset = self.engine.settings.estimates[name].time_offset
            self._records[name].add(results, offset)
        for name, newest in zip(found, self._newest, strict=False):
            add = partial(newest.add, found[name].evaluations)
            shield("keeping poses to compare", add, None, self._records[name].report.say)
        return found

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
        folder = Path(self._directory).expanduser().absolute()
        if not self._is_ours and any((folder / name).exists() for name in self._summaries()):
            if self.is_empty and last:
                return None
            self._keep_earlier(folder)
        self._is_ours = True
        while self.fit_error_model(last=True):
            pass
        self.look_for_causes(again=True)
        summaries = {name: self._completed(name) for name in self.names}
        failures: list[OutputError] = []
        for name, record in self._records.items():
            of_fixes = notices_of_fixes(self._fixes(name), record.report.parameters)
            record.report.notices = (*self.engine.notices(name), *of_fixes)
            record.report.way = self.engine.way()
            fit = self.engine.health(name).fit
            record.report.anew = () if fit is None else fit.anew
            try:
                record.save(summaries[name], last=last)
            except OutputError as error:
                if not self.is_several:
                    raise
                failures.append(error.below(name))
        if self.is_several:
            self._error = None
            try:
                comparisons, causes = self.comparisons(), self.causes_of_all()
                write_summary(folder, together(summaries, comparisons, causes))
                reports = {name: record.report for name, record in self._records.items()}
                said = sentences_of_all(comparisons, causes, summaries, self.say)
                write_report(folder, render_several(reports, summaries, said))
            except OutputError as error:
                self._error = str(error)
                failures.append(error)
        if failures:
            lines = {file: line for each in failures for file, line in each.failures.items()}
            text = "; ".join(map(str, failures))
            raise OutputError(text, lines, all(each.full for each in failures))
        return folder

    def _completed(self, name: str) -> dict[str, object]:
        """An estimate's summary as it is written."""
        record = self._records[name]
        topics = self._topics["ground truth"], self._topics[name]
        summary = {**origin(record.report.parameters, *topics), **self.summary(name)}
        return record.completed(summary)

    def _files(self) -> list[str]:
        """What is in the output folder."""
        if not self.is_several:
            return list(_OF_ONE)
        of_each = (f"{name}/{file}" for name in self.names for file in _OF_ONE)
        return [*of_each, _SUMMARY, "report.html"]

    def _summaries(self) -> list[str]:
        """Those of the files that tell of results."""
        return [file for file in self._files() if Path(file).name == _SUMMARY]

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
            if all(record.path is None for record in self._records.values()):
                raise
            saved, failures = Path(self._directory).expanduser().absolute(), error.failures
        if saved is None:
            return None
        copy = _free(saved)
        try:
            _keep_files(saved, copy, [name for name in self._files() if name not in failures])
        except OSError as error:
            failures[copy.name] = f"cannot write {copy}: {error.strerror or error}"
        if failures:
            self._error = "; ".join(failures.values())
            raise OutputError(self._error, failures)
        return copy

    @property
    def is_empty(self) -> bool:
        """Whether nothing has been evaluated since the start, or the last one."""
        return not any(self.engine.health(name).estimate.used for name in self.names)

    def _keep_earlier(self, folder: Path) -> None:
        """Keep what another run has written: an earlier one, or one of an earlier process."""
        copy = _free(folder)
        if any(_same_file(folder / _SUMMARY, kept / _SUMMARY) for kept in folder.glob("run_*")):
            return
        earlier = dict.fromkeys((*_OF_ONE, *_files_of_several(folder), *self._files()))
        try:
            _keep_files(folder, copy, earlier)
            # What no file of this run takes the place of.
            for name in set(earlier) - set(self._files()):
                (folder / name).unlink(missing_ok=True)
        except OSError as error:
            text = f"cannot write {copy}: {error.strerror or error}"
            raise OutputError(text) from error

    def reset(self) -> None:
        """Start over; files that are written stay until the next time they are."""
        self._is_ours = False
        self.engine.reset()
        self._undecodable = 0
        self._fix_counts.clear()
        for record in self._records.values():
            record.clear()
        self._note_orientations()
        for newest in self._newest:
            newest.clear()

    def change(self, changes: Mapping[str, object]) -> None:
        """Put changed parameters into effect, all of them or none.

        Raises
        ------
        ParameterError
            If they cannot be, an output folder that cannot be written included.
        """
        checked = {name: self._known[name].validate(value) for name, value in changes.items()}
        for name in checked:
            if not self._known[name].dynamic:
                raise ParameterError(f"{name} is read-only while the node runs")
        # The last that can fail.
        if "output.directory" in checked:
            self._move(str(checked["output.directory"]))
        for name, value in checked.items():
            self.engine.set(name, value)
            for record in self._records.values():
                record.report.parameters[name] = value
        for record in self._records.values():
            record.change(self.engine.settings.evaluation.window)

    def _move(self, directory: str) -> None:
        places = {name: self._place(directory, name) for name in self.names}
        try:
            if self.is_several and directory:
                # All or none: they can be written if this can.
                for place in places.values():
                    OutputFolder(place).close()
            for name, record in self._records.items():
                record.move(places[name])
        except OutputError as error:
            raise ParameterError(str(error)) from error
        self._directory = directory
        self._is_ours = False
        self._error = None

    def close(self) -> None:
        """Close the folder, without writing it."""
        for record in self._records.values():
            record.close()


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
            (copy / name).parent.mkdir(exist_ok=True)
            _keep(folder / name, copy / name)


def _same_file(one: Path, other: Path) -> bool:
    """Whether both are one file, or have the same in them: it has been kept already."""
    try:
        return one.samefile(other) or one.read_bytes() == other.read_bytes()
    except OSError:
        return False


def _files_of_several(folder: Path) -> list[str]:
    """The files that a summary of several estimates tells of."""
    try:
        names = list(json.loads((folder / _SUMMARY).read_text(encoding="utf-8"))["estimates"])
    except (OSError, ValueError, LookupError, TypeError):
        return []
    known = (name for name in names if isinstance(name, str) and is_name(name))
    return [f"{name}/{file}" for name in known for file in _OF_ONE]


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
