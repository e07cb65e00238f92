# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What ``evaluate`` does once all is read: score, write, print."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from trajeval_ros import se3
from trajeval_ros.commands import console, figures
from trajeval_ros.commands.console import CommandError, Progress
from trajeval_ros.commands.inputs import Inputs
from trajeval_ros.commands.overlap import by_stamps, small_share
from trajeval_ros.files.output import (
    FILES,
    LATEST_PATH,
    OutputError,
    OutputFolder,
    write_report,
    write_summary,
)
from trajeval_ros.files.provenance import described, named
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.parameters import Value, of_estimate
from trajeval_ros.online.settings import Settings, settings_of
from trajeval_ros.report import Report, answers, render_several
from trajeval_ros.runs import offline
from trajeval_ros.runs.offline import Scored, Scoring
from trajeval_ros.wall import shield

# Loaded where they are asked for: to score one estimate takes none of it.
if TYPE_CHECKING:
    from trajeval_ros.commands.baseline import Baseline, Judgement
    from trajeval_ros.commands.exports import Exports
    from trajeval_ros.comparison.compare import Comparison
    from trajeval_ros.runs.corrections import Corrected


class Outcome(NamedTuple):
    """What came of it: the ``summary`` as it is written, of one estimate or of several.

    ``found`` of each by its name; ``failures``: a line for each that could not be evaluated or
    written; ``judgements`` against the baseline of those that have one.
    """

    summary: Mapping[str, Any]
    found: Mapping[str, Scored]
    failures: tuple[str, ...]
    judgements: Mapping[str, Judgement]


def score(
    data: Inputs,
    parameters: Mapping[str, Value],
    output: str,
    apply: Sequence[str] = (),
    baselines: Mapping[str, Baseline] = MappingProxyType({}),
    *,
    align_origin: bool = False,
    given: Sequence[str] = (),
    exports: Exports | None = None,
    is_told: bool = True,
) -> Outcome:
    """Score every estimate, write what is to be written to ``output``, and print.

    ``given``: the command line, for the summary to say how it can be made again. ``exports``: what
    is to be written for other tools. ``is_told``: whether anybody is told what the files hold.

    ``apply``: what the error model finds is set, and all is scored again. ``align_origin``: the
    first pose of each is laid on the ground truth's, and nothing else is aligned. With several
    estimates, each has a folder of its name in ``output``, and beside them lie the summary and
    the report of all.
    """
    before: Mapping[str, Scored] = {}
    corrections: Mapping[str, Corrected] = {}
    if apply:
        before = _found(data, parameters, _records(data, parameters))
        corrections = _corrections(data, parameters, before, apply)
        right = tuple(each.estimate for each in corrections.values())
        data = data._replace(estimates=right)
        for each in corrections.values():
            parameters = {**parameters, **each.changed}
    if align_origin:
        parameters = {**parameters, "gauge": "none"}
        first = _found(data, parameters, _records(data, parameters))
        data = _aligned_at_the_origin(data, parameters, first)
    settings = settings_of(parameters, data.names)
    with contextlib.ExitStack() as stack:
        runs = {
            name: _Run(name, data, parameters, _place(data, output, name), stack, spread=is_told)
            for name in data.names
        }
        recorded = {} if exports is None else exports.recorded(data.names)
        scorings = {
            name: run.scoring._replace(observe=recorded[name].observe) if recorded else run.scoring
            for name, run in runs.items()
        }
        # To be told of, a file is read once more.
        describe = described if is_told else named
        found = {
            name: _with_arguments(one, given)
            for name, one in _found(data, parameters, scorings, describe).items()
        }
        failures = _write(runs, found)
    reports = {name: run.scoring.report for name, run in runs.items()}
    everything = _together(found, settings, output, reports)
    failures += everything.failures
    if exports is not None:
        from trajeval_ros.commands.exports import Finished

        exports.write(Finished(data, parameters, scorings, found, everything.comparisons, recorded))
        failures += exports.failures
    if data.remarks:
        console.say(f"info: {remark}" for remark in data.remarks)
    for number, (name, run) in enumerate(runs.items()):
        if number or data.remarks:
            print()
        run.say(found[name], before.get(name), corrections.get(name))
        failures += dict.fromkeys(run.failures.values())
    everything.say(found, output)
    for line in () if exports is None else exports.written:
        print(f"\n{line}")
    judgements = _judged(found, baselines, settings) if baselines else {}
    return Outcome(everything.summary, found, tuple(dict.fromkeys(failures)), judgements)


def _judged(
    found: Mapping[str, Scored], baselines: Mapping[str, Baseline], settings: Settings
) -> dict[str, Judgement]:
    """How each that has a baseline compares with it."""
    from trajeval_ros.commands.baseline import judge

    return {
        name: judge(name, earlier, found[name], settings)
        for name, earlier in baselines.items()
        if len(found[name].stamps)
    }


def _write(runs: Mapping[str, _Run], found: Mapping[str, Scored]) -> list[str]:
    """Write each one's folder; return why one of several has no poses to be evaluated."""
    failures = []
    for name, run in runs.items():
        try:
            run.require_poses(found[name])
        except CommandError as error:
            # One of several costs itself alone.
            if len(runs) == 1:
                raise
            failures.append(str(error))
        run.write(found[name])
    return failures


class _Together(NamedTuple):
    """The summary of all, of one that is its own; what is said of several; what has failed."""

    summary: Mapping[str, Any]
    comparisons: tuple[Comparison, ...] = ()
    sentences: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()

    def say(self, found: Mapping[str, Scored], output: str) -> None:
        """Print what there is to say of several."""
        if self.comparisons:
            from trajeval_ros.runs.several import against_the_best

            print("\nCompared, each with each\n")
            summaries = {name: one.summary for name, one in found.items()}
            print("\n".join(figures.side_by_side(summaries)) + "\n")
            console.say(against_the_best(summaries, self.comparisons, self.sentences))
        if len(found) > 1 and output:
            folder = Path(output).expanduser().absolute()
            print(f"\nWritten: summary.json, report.html of all in {folder}")


def _together(
    found: Mapping[str, Scored], settings: Settings, output: str, reports: Mapping[str, Report]
) -> _Together:
    """Compare several, and write the summary and the report of all."""
    summaries = {name: one.summary for name, one in found.items()}
    if len(found) == 1:
        (summary,) = summaries.values()
        return _Together(summary)
    from trajeval_ros.runs.several import looked_at_together, sentences_of_all, together

    failures: list[str] = []
    evaluated = {name: one.evaluated for name, one in found.items()}
    comparisons, causes = looked_at_together(
        evaluated, summaries, settings.evaluation, failures.append
    )
    summary = together(summaries, comparisons, causes)
    said = sentences_of_all(comparisons, causes, summaries, failures.append)
    if output:
        try:
            write_summary(Path(output).expanduser(), summary)
            write_report(Path(output).expanduser(), render_several(reports, summaries, said))
        except OutputError as error:
            failures += error.lines
    return _Together(summary, comparisons, said, tuple(failures))


def _with_arguments(scored: Scored, given: Sequence[str]) -> Scored:
    """What was scored, with the command line among what its summary is of."""
    inputs = {**scored.summary["inputs"], "arguments": list(given)}
    return scored._replace(summary={**scored.summary, "inputs": inputs})


def _require_poses(scored: Scored, estimate: Trajectory) -> None:
    """Refuse an estimate of which not a single pose could be evaluated; say why."""
    why = offline.why_none(estimate.source, len(estimate), scored.summary)
    if why is not None:
        raise CommandError(why)


def _records(data: Inputs, parameters: Mapping[str, Value]) -> dict[str, Scoring]:
    """Every estimate with a record that nobody reads."""
    return {
        name: Scoring(estimate, Report(of_estimate(parameters, name), {}))
        for name, estimate in zip(data.names, data.estimates, strict=True)
    }


def _found(
    data: Inputs,
    parameters: Mapping[str, Value],
    scorings: Mapping[str, Scoring],
    describe: Callable[[str], dict[str, Any]] = named,
) -> dict[str, Scored]:
    with Progress("evaluating", sum(map(len, data.estimates)), "poses") as progress:
        return offline.score(parameters, data.ground_truth, scorings, progress.update, describe)


def _corrections(
    data: Inputs, parameters: Mapping[str, Value], found: Mapping[str, Scored], what: Sequence[str]
) -> dict[str, Corrected]:
    """The estimates with what the error models have found put right."""
    from trajeval_ros.runs.corrections import corrected

    corrections = {}
    settings = settings_of(parameters, data.names).estimates
    for name, estimate in zip(data.names, data.estimates, strict=True):
        model = found[name].summary.get("error_model")
        if model is None:
            _require_poses(found[name], estimate)
            which = f" to {name}" if len(data.names) > 1 else ""
            raise CommandError(f"--apply: no error model could be fitted{which}")
        missing = [one for one in what if one not in model]
        if missing:
            # Of positions alone there is no scale.
            raise CommandError(f"--apply: the error model has no {' and no '.join(missing)}")
        corrections[name] = corrected(estimate, name, settings[name], parameters, model, what)
    return corrections


def _aligned_at_the_origin(
    data: Inputs, parameters: Mapping[str, Value], found: Mapping[str, Scored]
) -> Inputs:
    """Each estimate so moved that its first evaluated pose is the ground truth's."""
    from trajeval_ros.runs.corrections import moved

    estimates = []
    for name, estimate in zip(data.names, data.estimates, strict=True):
        poses = found[name].evaluated
        if len(poses) == 0:
            _require_poses(found[name], estimate)
            raise CommandError(f"--align-origin: every pose of {name} lies in a gap")
        if found[name].summary.get("position_only"):
            raise CommandError("--align-origin: positions alone do not say how to turn an estimate")
        origin = poses.ground_truth[0] @ se3.inverse(poses.estimate[0])
        estimates.append(moved(estimate, origin))
    remark = "each estimate is laid on the ground truth at its first pose, and not aligned besides"
    return data._replace(estimates=tuple(estimates), remarks=(*data.remarks, remark))


def _place(data: Inputs, output: str, name: str) -> str:
    """The folder of an estimate's own, as it was named; empty where nothing is to be written."""
    return str(Path(output) / name) if output and len(data.names) > 1 else output


class _Run:
    """An estimate with its records."""

    def __init__(
        self,
        name: str,
        data: Inputs,
        parameters: Mapping[str, Value],
        output: str,
        stack: contextlib.ExitStack,
        *,
        spread: bool,
    ) -> None:
        estimate = data.estimates[data.names.index(name)]
        self._truth = data.ground_truth
        self._sources = {"ground truth": data.ground_truth.source, "estimate": estimate.source}
        self._parameters = of_estimate(parameters, name)
        self._title = f"{name}: " if len(data.names) > 1 else ""
        self._output = output
        self._stack = stack
        self._folder: OutputFolder | None = None
        self._full = ""
        self.failures: dict[str, str] = {}
        try:
            self._folder = stack.enter_context(OutputFolder(output)) if output else None
        except OutputError as error:
            if not error.full:
                raise CommandError(str(error)) from error
            self._full = str(error)
        report = Report(self._parameters, self._sources)
        self.scoring = Scoring(estimate, report, self._folder, spread=spread)

    def require_poses(self, scored: Scored) -> None:
        """Refuse it where not a single pose could be evaluated; say why, by the stamps too."""
        estimate, counts = self.scoring.estimate, scored.summary["estimate"]["rejected"]
        why = offline.why_none(estimate.source, len(estimate), scored.summary)
        if why is None:
            return
        reason = max(counts, key=lambda each: int(counts[each]), default=None)
        offset = float(self._parameters["estimate.time_offset"])  # type: ignore[arg-type]
        said = shield(
            "the likely reason",
            lambda: by_stamps(reason, self._truth, estimate, offset),
            "",
            self.scoring.report.say,
        )
        raise CommandError(f"{why}{said}")

    def write(self, scored: Scored) -> None:
        """Write the output folder, if there is to be one."""
        try:
            if self._output and self._folder is None:
                # There may be room by now: not for the rows, which are gone.
                self._folder = self._stack.enter_context(OutputFolder(self._output))
                self._folder.lack(scored.summary["estimate"]["evaluated"], self._full)
            if self._folder is not None:
                self._folder.write(
                    scored.summary,
                    self.scoring.report.render,
                    last=True,
                    latest_path=self.scoring.estimate.latest_path,
                )
        except OutputError as error:
            self.failures = error.failures or dict.fromkeys(FILES, str(error))

    def say(self, scored: Scored, before: Scored | None, correction: Corrected | None) -> None:
        """Print the figures and what there is to say of them.

        ``before`` the ``correction``, if there was one.
        """
        report = self.scoring.report
        title = f"{self._title}{self._sources['estimate']} against {self._sources['ground truth']}"
        console.say([title, ""])
        none: str | None = None
        share = shield(
            "the reason of a small share",
            lambda: small_share(
                scored.summary["estimate"],
                self._truth,
                self.scoring.estimate,
                float(self._parameters["estimate.time_offset"]),  # type: ignore[arg-type]
            ),
            none,
            report.say,
        )
        if share is not None:
            print(f"warning: {share}\n")
        lines = answers.first_lines(scored.summary, self._parameters)
        if before is not None and correction is not None:
            names = correction.applied, correction.doubted
            lines.append(answers.applied_line(before.summary, scored.summary, *names))
        print("\n".join([*console.wrapped(lines, 14), ""] if lines else []))
        lines = figures.summary_lines(scored.summary, self._parameters)
        console.say(lines, indent=14)
        remarks = [
            f"likely cause: {cause['text']}. To try: {cause['advice']}."
            for cause in scored.summary["likely_causes"]
        ]
        remarks += [f"{notice.level}: {notice.text}" for notice in report.notices]
        remarks += scored.places
        remarks += [f"error: {line}" for line in report.defects]
        if remarks:
            print("\n" + "\n".join(console.wrapped(remarks, 4)))
        there = FILES if self.scoring.estimate.latest_path is None else (*FILES, LATEST_PATH)
        written = [name for name in there if name not in self.failures]
        if self._folder is not None and written:
            print(f"\nWritten: {', '.join(written)} in {self._folder.path}")
