# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One call from trajectories to figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, overload

import numpy as np

from trajeval_ros.comparison.common import Evaluated
from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.files.provenance import described
from trajeval_ros.files.span import Instant, cut_all, span_of
from trajeval_ros.library.result import Poses, Result, Results
from trajeval_ros.library.settings import parameters_of
from trajeval_ros.library.trajectory import Trajectory
from trajeval_ros.online import whole_run
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed_evenly
from trajeval_ros.online.parameters import ONE, of_estimate
from trajeval_ros.online.results import Results as EngineResults
from trajeval_ros.report import Report
from trajeval_ros.runs.error_models import error_models, put_into
from trajeval_ros.runs.offline import causes_of_rows, count_left_out, why_none
from trajeval_ros.runs.origin import origin
from trajeval_ros.runs.position_only import (
    comparisons_on_positions,
    is_position_only,
    notices_on_positions,
    without_orientation,
)
from trajeval_ros.runs.several import compared
from trajeval_ros.wall import shield

# Points of the report's running figures.
_PIECES = 120


@overload
def evaluate(
    ground_truth: Trajectory,
    estimate: Trajectory,
    *,
    start: float | None = None,
    end: float | None = None,
    **settings: object,
) -> Result: ...
@overload
def evaluate(
    ground_truth: Trajectory,
    estimate: Mapping[str, Trajectory],
    *,
    start: float | None = None,
    end: float | None = None,
    **settings: object,
) -> Results: ...
def evaluate(
    ground_truth: Trajectory,
    estimate: Trajectory | Mapping[str, Trajectory],
    *,
    start: float | None = None,
    end: float | None = None,
    **settings: object,
) -> Result | Results:
    """Evaluate one estimate, or several by name, against a ground truth.

    The figures are those of the node and of the command ``evaluate`` on the same data. ``settings``
    are the parameters (``docs/parameters.md``) with underscores for dots: ``gauge="sim3"``,
    ``relative_delta=5.0, relative_unit="m"``, ``estimate_time_offset=0.01``; of several estimates,
    what is an estimate's own begins with its name: ``vins_time_offset=0.01``.

    ``start`` and ``end`` leave out what comes before and after: seconds since the ground truth's
    first pose; or stamps, s or ns, from 1e8 on. What is left out is counted as ``cut``.

    Returns a :class:`Result`; of several, :class:`Results`: a dict of them with ``.comparison``.
    Names are of small letters, digits and underscores.

    Raises :class:`ValueError` for a setting that is unknown or out of range, for a name that cannot
    be one, for a span that is none, and where of an estimate not a single pose can be evaluated (it
    says why).

    >>> import numpy as np
    >>> import trajeval_ros as te
    >>> time = np.arange(0.0, 20.0, 0.05)
    >>> poses = np.tile(np.eye(4), (len(time), 1, 1))
    >>> poses[:, :3, 3] = np.stack([np.cos(time), np.sin(2 * time), np.sin(time)], axis=1)
    >>> estimate = poses.copy()
    >>> estimate[:, :3, 3] += 0.01 * np.random.default_rng(1).normal(size=(len(time), 3))
    >>> result = te.evaluate(te.Trajectory(time, poses), te.Trajectory(time, estimate))
    >>> print(f"{result.summary['conventional']['ate_translation_rmse']:.3f} m")
    0.017 m
    """
    if isinstance(estimate, Trajectory):
        one = {ONE[0]: estimate}
        return _evaluate(ground_truth, one, settings, start, end)[0][ONE[0]]
    if not estimate:
        raise ValueError("no estimate is given")
    results, comparison = _evaluate(ground_truth, dict(estimate), settings, start, end)
    return Results(results, comparison)


def _evaluate(
    truth: Trajectory,
    estimates: Mapping[str, Trajectory],
    settings: Mapping[str, object],
    start: float | None,
    end: float | None,
) -> tuple[dict[str, Result], list[Comparison]]:
    names = tuple(estimates)
    parameters = parameters_of(settings, names)
    joint = parameters["likelihood.covariance"] == "joint"
    engine = Engine(parameters, names, whole=not joint)
    truth, estimates = _cut(truth, estimates, engine, start, end)
    records = {
        name: Report(
            of_estimate(parameters, name),
            {"ground truth": truth.data.source, "estimate": one.data.source},
        )
        for name, one in estimates.items()
    }
    kept: dict[str, list[EngineResults]] = {name: [] for name in names}
    samples = {name: one.samples for name, one in estimates.items()}
    for found in feed_evenly(engine, truth.samples, samples, _PIECES):
        for name, results in found.items():
            records[name].add(results)
            kept[name].append(results)
    found_of = {
        name: _result(engine, name, truth, one, kept[name], records[name], joint)
        for name, one in estimates.items()
    }
    evaluated = [
        _compared(name, one.poses, engine.settings.estimates[name].time_offset)
        for name, one in found_of.items()
    ]
    summaries = {name: one.summary for name, one in found_of.items()}
    comparisons = compared(evaluated, engine.settings.evaluation)
    return found_of, list(comparisons_on_positions(comparisons, summaries))


def _cut(
    truth: Trajectory,
    estimates: Mapping[str, Trajectory],
    engine: Engine,
    start: float | None,
    end: float | None,
) -> tuple[Trajectory, Mapping[str, Trajectory]]:
    instants = [None if given is None else Instant.of(given) for given in (start, end)]
    span = span_of(instants[0], instants[1], truth.data)
    if span is None:
        return truth, estimates
    offsets = {name: one.time_offset for name, one in engine.settings.estimates.items()}
    data = {name: one.data for name, one in estimates.items()}
    left, cut = cut_all(span, truth.data, data, offsets)
    return truth.with_data(left), {n: one.with_data(cut[n]) for n, one in estimates.items()}


def _compared(name: str, poses: Poses, offset: int) -> Evaluated:
    """The poses outside the gaps of the ground truth: within, the errors would be its own."""
    known = poses.sampled
    stamps = poses.stamps[known] + offset
    return Evaluated(name, stamps, poses.ground_truth[known], poses.estimate[known])


def _result(
    engine: Engine,
    name: str,
    truth: Trajectory,
    estimate: Trajectory,
    kept: list[EngineResults],
    record: Report,
    joint: bool,
) -> Result:
    sources = described(truth.data.source), described(estimate.data.source)
    summary: dict[str, Any] = {**origin(record.parameters, *sources), **engine.summary(name)}
    poses = Poses.of([results.evaluations for results in kept], summary["conventional"])
    count_left_out(summary["estimate"], estimate.data)
    count_left_out(summary["ground_truth"], truth.data)
    why = why_none(estimate.name, len(estimate), summary)
    if why is not None:
        raise ValueError(why)
    record.notices, record.way = engine.notices(name), engine.way()
    record.add_received(ground_truth=truth.stamps, estimate=estimate.stamps)
    offset = engine.settings.estimates[name].time_offset
    record.of_rows = causes_of_rows(truth.data, estimate.data, offset)
    cross = tuple(blocks for results in kept for blocks in results.cross)
    run = whole_run.Poses(
        poses.stamps, poses.ground_truth, poses.covariance, poses.estimate, poses.sampled, cross
    )
    summary = whole_run.whole_run(summary, run, engine.settings.evaluation)
    position_only = is_position_only(truth.data, estimate.data)
    if position_only:
        summary = without_orientation(summary)
        poses = dataclasses.replace(poses, ate_rotation=np.full(len(poses), np.nan))
        record.notices = notices_on_positions(record.notices)
    if not position_only:
        lack: dict[str, dict[str, Any]] = {}
        parts = [results.evaluations for results in kept]
        models = shield(
            "the error model",
            lambda: error_models(engine, name, parts, whole=not joint),
            lack,
            record.say,
        )
        put_into(summary, models)
        record.model = models.get("run")
    causes = record.causes()
    summary["likely_causes"] = [dataclasses.asdict(cause) for cause in causes]
    return Result(name, summary, poses, causes, record)
