# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whole trajectories through the engine, as fast as it goes."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.comparison.common import Evaluated
from trajeval_ros.conventional.sub_trajectories import Box
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.lost import lost
from trajeval_ros.diagnosis.swapped import Given, swapped
from trajeval_ros.files.output import OutputError, OutputFolder
from trajeval_ros.files.provenance import described
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed_all
from trajeval_ros.online.parameters import Value
from trajeval_ros.online.positions import rows_of
from trajeval_ros.online.results import Health, Notice, Results, TopicHealth
from trajeval_ros.online.settings import PATIENCE
from trajeval_ros.online.summary_on_positions import drift_on_positions
from trajeval_ros.online.whole_run import drift, grown, whole_run
from trajeval_ros.report import Report
from trajeval_ros.runs.error_models import error_models, put_into
from trajeval_ros.runs.far_offset import far_offset
from trajeval_ros.runs.fixes import notices_of_fixes, put_fixes_into
from trajeval_ros.runs.headline import with_headline
from trajeval_ros.runs.kept import WholeRun
from trajeval_ros.runs.origin import origin
from trajeval_ros.runs.position_only import causes_on_positions, note_orientations
from trajeval_ros.wall import shield

Figures = dict[str, Any]
Observer = Callable[[Results, Callable[[], Mapping[str, Any]]], None]

_SECOND = 1_000_000_000

# So many nanoseconds of data at a time: a chunk costs some milliseconds, however much is in it. The
# report has a point of the running absolute error a chunk, so for it there are as many as this.
_CHUNK = 40_000_000_000
# Of smaller ones the ground truth is fed together: half of what the engine keeps of it.
_AHEAD = PATIENCE // 2
_POINTS = 60
# The error model asks the ground truth anew at every offset of the clocks that it tries, so the
# whole of it is kept, a kilobyte a sample; and a fit of all poses takes 12 kB of each. Of more than
# these the model is of blocks.
_MOST_SAMPLES = 500_000
_MOST_POSES = 30_000


class Scoring(NamedTuple):
    """An estimate to be scored: its poses, and the records that are kept of it.

    ``observe`` is called with what each batch brings, and what gives the run's summary by then.
    Without ``explain`` there are the single figures alone: no causes are looked for, no quantiles
    over sub-trajectories, and the report has its parameters and defects only. Without ``spread``
    those quantiles alone are left out, of which nothing is printed.
    """

    estimate: Trajectory
    report: Report
    folder: OutputFolder | None = None
    observe: Observer | None = None
    explain: bool = True
    spread: bool = True


class Scored(NamedTuple):
    """What became of an estimate.

    Its ``summary``; ``places`` where rejected poses stand; the poses that were ``evaluated``, on
    the ground truth's clock, but for those in its gaps: there the errors would be its own;
    ``stamps`` (M,) of all that were, ns, on the same clock; ``defects``: a line for what failed.
    """

    summary: Figures
    places: tuple[str, ...]
    evaluated: Evaluated
    stamps: npt.NDArray[np.int64]
    defects: tuple[str, ...] = ()


def score(
    parameters: Mapping[str, Value],
    truth: Trajectory,
    scorings: Mapping[str, Scoring],
    progress: Callable[[int], None] = lambda done: None,
    describe: Callable[[str], Figures] = described,
) -> dict[str, Scored]:
    """Feed an engine in the order of time; return what became of each estimate, by its name.

    ``parameters``: every one's value, for the names of ``scorings``; ``progress`` is told how many
    poses have been evaluated; ``describe``: what a summary has of a source, which is to read it all
    once more for its hash.
    """
    estimates = {name: scoring.estimate.samples for name, scoring in scorings.items()}
    whole = is_kept_whole(parameters, len(truth), map(len, estimates.values()))
    engine = Engine(parameters, tuple(scorings), whole=whole)
    note_orientations(engine, truth, {name: one.estimate for name, one in scorings.items()})
    kept = {name: WholeRun(len(one.estimate)) for name, one in scorings.items()}
    done = 0
    chunk = _chunk(scorings)
    ahead = min(_AHEAD, _CHUNK - chunk)
    for found in feed_all(engine, truth.samples, estimates, chunk, ahead):
        for name, results in found.items():
            scoring = scorings[name]
            if scoring.explain:
                scoring.report.add(results)
            kept[name].add(results)
            if scoring.folder is not None:
                # The folder says at the end what it has not got.
                with contextlib.suppress(OutputError):
                    scoring.folder.add(rows_of(results))
            if scoring.observe is not None:
                scoring.observe(results, partial(engine.summary, name))
            done += len(results.evaluations)
        progress(done)
    source = describe(truth.source)
    return {
        name: _scored(engine, name, truth, source, scoring, kept[name], whole, describe)
        for name, scoring in scorings.items()
    }


def _swapped(
    truth: Trajectory, estimate: Trajectory, known: tuple[Notice, ...]
) -> tuple[Notice, ...]:
    """Whether the two stand in each other's place, unless that has been asked."""
    if any(notice.code == "sparse_ground_truth" for notice in known) or not len(estimate):
        return ()
    if not (truth.has_orientation and estimate.has_orientation):
        # Positions alone begin where they begin: fixes at the first of them.
        return ()
    asked = swapped(
        *(Given(e.source, e.stamps, e.positions[0], e.quaternions[0]) for e in (truth, estimate))
    )
    return () if asked is None else (Notice("warning", "swapped", asked),)


def is_kept_whole(parameters: Mapping[str, Value], samples: int, poses: Iterable[int]) -> bool:
    """Whether all ground truth is kept, of so many samples, and error models are of whole runs.

    ``poses``: how many each estimate has.
    """
    few = samples <= _MOST_SAMPLES and max(poses, default=0) <= _MOST_POSES
    return few and parameters["likelihood.covariance"] != "joint"


def _chunk(scorings: Mapping[str, Scoring]) -> int:
    """How much is fed at a time, ns."""
    spans = [
        int(np.ptp(scoring.estimate.stamps))
        for scoring in scorings.values()
        if (scoring.folder or scoring.observe) is not None and len(scoring.estimate)
    ]
    return min(max(min(spans) // _POINTS, _SECOND), _CHUNK) if spans else _CHUNK


def _scored(
    engine: Engine,
    name: str,
    truth: Trajectory,
    source: Figures,
    scoring: Scoring,
    kept: WholeRun,
    whole: bool,
    describe: Callable[[str], Figures],
) -> Scored:
    report, estimate = scoring.report, scoring.estimate
    inputs = source, describe(estimate.source)
    summary = completed(
        *(engine, name, truth, estimate, report, inputs, kept),
        whole=whole,
        explain=scoring.explain,
        spread=scoring.explain and scoring.spread,
    )
    places: tuple[str, ...] = ()
    if scoring.explain:
        places = shield(
            "the list of rejected rows",
            lambda: _places(engine.health(name), truth, estimate),
            places,
            report.say,
        )
    offset = engine.settings.estimates[name].time_offset
    known = kept.known(name, offset)
    return Scored(summary, places, known, kept.stamps + offset, report.defects)


def completed(
    engine: Engine,
    name: str,
    truth: Trajectory,
    estimate: Trajectory,
    report: Report,
    inputs: tuple[Figures, Figures],
    kept: WholeRun,
    *,
    whole: bool,
    explain: bool = True,
    spread: bool = True,
) -> Figures:
    """Return the summary of a run that has been fed; tell the report what its page needs.

    ``inputs``: what the ground truth and the estimate are of; ``kept``: every evaluated pose;
    ``whole``: the engine has all of the ground truth still; without ``explain`` no likely causes
    are looked for; without ``spread`` how errors grow, which the page alone shows, is not, and
    ``drift.sub_trajectories`` are none.
    """
    offset = engine.settings.estimates[name].time_offset
    summary: Figures = {
        **origin(report.parameters, *inputs),
        **engine.summary(name),
    }
    count_left_out(summary["estimate"], estimate)
    count_left_out(summary["ground_truth"], truth)
    fixes = {"ground truth": truth.fixes, "estimate": estimate.fixes}
    put_fixes_into(summary, fixes)
    if explain:
        _look(engine, name, truth, estimate, report, summary)
    poses, evaluation = kept.poses, engine.settings.evaluation
    some, position_only = len(poses.stamps) > 0, engine.is_position_only(name)
    report.lacks_orientation = engine.lacks_orientation(name)
    if some and position_only:
        summary["drift"] = drift_on_positions(drift(poses, evaluation, spread=False))
        of_positions: dict[str, Figures] = {}
        if summary["absolute"].get("log_likelihood") is not None:
            # Where the motion shows the alignment.
            from trajeval_ros.runs.position_models import error_models_on_positions

            of_positions = shield(
                "the error model",
                lambda: error_models_on_positions(engine, name, kept.evaluations, whole=whole),
                of_positions,
                report.say,
            )
        put_into(summary, of_positions)
        report.of_rows += causes_on_positions(engine, name, summary, of_positions.get("run"))
    if some and not position_only:
        summary = whole_run(summary, poses, evaluation, spread=spread)
        none: dict[str, tuple[Box, ...]] = {}
        if spread:
            report.growth = shield(
                "the growth of errors",
                lambda: grown(poses, evaluation),
                none,
                report.say,
            )
        lack: dict[str, Figures] = {}
        models = shield(
            "the error model",
            lambda: error_models(engine, name, kept, whole=whole),
            lack,
            report.say,
        )
        put_into(summary, models)
        report.model = models.get("run")
    if some and estimate.latest_path is not None:
        from trajeval_ros.runs.latest_path import on_positions, scored

        own, settings, latest = (
            engine.settings.estimates[name],
            engine.settings.evaluation,
            estimate.latest_path,
        )
        found = shield(
            "the latest path",
            lambda: scored(latest, kept.parts, settings, own),
            None,
            report.say,
        )
        summary["latest_path"] = on_positions(found) if position_only else found
    if some:
        start = min(int(truth.stamps.min()), int(estimate.stamps.min()) + offset)
        summary = shield(
            "the headline",
            lambda: with_headline(
                *(summary, kept.evaluations, offset, start, evaluation, engine.conventional(name))
            ),
            summary,
            report.say,
        )
    if explain:
        summary["likely_causes"] = [cause._asdict() for cause in report.causes()]
    return summary


def _look(
    engine: Engine,
    name: str,
    truth: Trajectory,
    estimate: Trajectory,
    report: Report,
    summary: Figures,
) -> None:
    """Tell the report what the inputs are like, and what of a run's rows may be wrong."""
    offset = engine.settings.estimates[name].time_offset
    report.notices, report.way = engine.notices(name), engine.way()
    nothing: tuple[Notice, ...] = ()
    fixes = {"ground truth": truth.fixes, "estimate": estimate.fixes}
    report.notices += notices_of_fixes(fixes, report.parameters)
    report.notices += shield(
        "the question of the order",
        lambda: _swapped(truth, estimate, report.notices),
        nothing,
        report.say,
    )
    fit = engine.health(name).fit
    report.anew = () if fit is None else fit.anew
    report.add_received(ground_truth=truth.stamps, estimate=estimate.stamps)
    none: tuple[Cause, ...] = ()
    report.of_rows = causes_of_rows(truth, estimate, offset) + shield(
        "the search for the clocks' offset",
        lambda: far_offset(
            truth, estimate, 1e-9 * offset, summary["conventional"]["ate_translation_rmse"]
        ),
        none,
        report.say,
    )


def causes_of_rows(truth: Trajectory, estimate: Trajectory, offset: int) -> tuple[Cause, ...]:
    """What is wrong with rows; ``offset`` (ns) is added to the estimate's stamps."""
    none: tuple[Cause, ...] = ()
    order: slice | npt.NDArray[np.intp] = slice(None)
    if (truth.stamps[1:] < truth.stamps[:-1]).any():
        order = np.argsort(truth.stamps, kind="stable")
    poses = np.concatenate([estimate.positions, estimate.quaternions], axis=1)
    return shield(
        "the search for a lost tracker",
        lambda: lost(
            estimate.stamps + offset,
            poses,
            truth.stamps[order],
            truth.positions[order],
            lambda place: int(estimate.rows[place]),
        ),
        none,
        lambda line: None,
    )


def _places(health: Health, truth: Trajectory, estimate: Trajectory) -> tuple[str, ...]:
    places = _where_to_look("estimate", estimate, health.estimate)
    return (*places, *_where_to_look("ground truth", truth, health.ground_truth))


def why_none(source: str, poses: int, summary: Figures) -> str | None:
    """Why of an estimate's ``poses`` none could be evaluated, by its summary; None if some."""
    counts, truth = summary["estimate"], summary["ground_truth"]
    if counts["evaluated"]:
        return None
    if truth["received"] and not truth["used"]:
        # With no ground truth at all, that is the trouble.
        return (
            f"{source}: none of its {poses:,} poses could be evaluated, for of the ground truth's"
            f" {truth['received']:,} none could be used ({_reasons(truth)})"
        )
    return f"{source}: none of its {poses:,} poses could be evaluated" + (
        f" ({_reasons(counts)})" if _reasons(counts) else ""
    )


def _reasons(counts: Figures) -> str:
    return ", ".join(f"{n:,} {reason}" for reason, n in counts["rejected"].items() if n)


def count_left_out(counts: Figures, trajectory: Trajectory) -> None:
    """Account for the rows that the engine was not given, and for those cut, if any."""
    if trajectory.cut:
        counts["cut"] = trajectory.cut
    for reason, rows in _left_out(trajectory).items():
        if len(rows):
            counts["received"] += len(rows)
            counts["rejected"][reason] = counts["rejected"].get(reason, 0) + len(rows)


def _left_out(trajectory: Trajectory) -> dict[str, npt.NDArray[np.int64]]:
    """Rows by reason: their stamp is not a number, or that of a later row."""
    return {
        str(Reason.NON_FINITE): trajectory.non_finite_stamp_rows,
        str(Reason.SUPERSEDED): trajectory.superseded_rows,
    }


def _where_to_look(title: str, trajectory: Trajectory, health: TopicHealth) -> list[str]:
    """Return a line for each reason of rejection that has a first row in the file."""
    rejected = Counter(health.rejected)
    rows = {reason: int(trajectory.rows[place]) for reason, place in health.first_rejected.items()}
    for reason, missing in _left_out(trajectory).items():
        if len(missing):
            rejected[reason] += len(missing)
            rows[reason] = min(int(missing[0]), rows.get(reason, int(missing[0])))
    return [
        f"{title}: {rejected[reason]:,} {reason}, the first in {trajectory.where(row)}"
        for reason, row in rows.items()
    ]
