# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One call from trajectories to figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, overload

from trajeval_ros.blas import one_thread
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.files.provenance import described
from trajeval_ros.files.span import Instant, cut_all, span_of
from trajeval_ros.library.result import Poses, Result, Results
from trajeval_ros.library.settings import parameters_of
from trajeval_ros.library.trajectory import Trajectory
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed_evenly
from trajeval_ros.online.parameters import ONE, of_estimate
from trajeval_ros.report import Report
from trajeval_ros.runs.kept import WholeRun
from trajeval_ros.runs.offline import completed, is_kept_whole, why_none
from trajeval_ros.runs.position_only import note_orientations
from trajeval_ros.runs.several import looked_at_together

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

    Returns a :class:`Result`; of several, :class:`Results`: a dict of them with ``.comparison``,
    and ``.causes`` of what they have in common.
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
        return _evaluate(ground_truth, one, settings, start, end)[ONE[0]]
    if not estimate:
        raise ValueError("no estimate is given")
    return _evaluate(ground_truth, dict(estimate), settings, start, end)


@one_thread()
def _evaluate(
    truth: Trajectory,
    estimates: Mapping[str, Trajectory],
    settings: Mapping[str, object],
    start: float | None,
    end: float | None,
) -> Results:
    names = tuple(estimates)
    parameters = parameters_of(settings, names)
    whole = is_kept_whole(parameters, len(truth), map(len, estimates.values()))
    engine = Engine(parameters, names, whole=whole)
    truth, estimates = _cut(truth, estimates, engine, start, end)
    records = {
        name: Report(
            of_estimate(parameters, name),
            {"ground truth": truth.data.source, "estimate": one.data.source},
        )
        for name, one in estimates.items()
    }
    note_orientations(engine, truth.data, {name: one.data for name, one in estimates.items()})
    kept = {name: WholeRun(len(one), with_all=True) for name, one in estimates.items()}
    samples = {name: one.samples for name, one in estimates.items()}
    for found in feed_evenly(engine, truth.samples, samples, _PIECES):
        for name, results in found.items():
            records[name].add(results)
            kept[name].add(results)
    source = described(truth.data.source)
    found_of = {
        name: _result(engine, name, truth, one, kept[name], records[name], source, whole)
        for name, one in estimates.items()
    }
    evaluated = {
        name: kept[name].known(name, engine.settings.estimates[name].time_offset) for name in names
    }
    summaries = {name: one.summary for name, one in found_of.items()}
    defects: list[str] = []
    comparisons, causes = looked_at_together(
        evaluated, summaries, engine.settings.evaluation, defects.append
    )
    return Results(found_of, comparisons, causes, defects)


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


def _result(
    engine: Engine,
    name: str,
    truth: Trajectory,
    estimate: Trajectory,
    kept: WholeRun,
    record: Report,
    source: dict[str, Any],
    whole: bool,
) -> Result:
    inputs = source, described(estimate.data.source)
    summary = completed(engine, name, truth.data, estimate.data, record, inputs, kept, whole=whole)
    why = why_none(estimate.name, len(estimate), summary)
    if why is not None:
        raise ValueError(why)
    poses = Poses.of(kept.evaluations, summary["conventional"])
    causes = tuple(Cause(**each) for each in summary["likely_causes"])
    return Result(name, summary, poses, causes, record)
