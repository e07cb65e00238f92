# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One call from trajectories to figures."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from typing import Any, overload

import numpy as np

from trajeval_ros.comparison.common import Evaluated
from trajeval_ros.comparison.compare import Comparison, compare
from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.named import named
from trajeval_ros.library.result import Poses, Result, Results
from trajeval_ros.library.settings import parameters_of
from trajeval_ros.library.trajectory import Trajectory
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import arrival_times
from trajeval_ros.online.parameters import ONE, Value
from trajeval_ros.online.results import Results as EngineResults
from trajeval_ros.online.summary import whole_run
from trajeval_ros.report import Report
from trajeval_ros.wall import shield

_SECOND = 1_000_000_000
# Points of the report's running figures.
_CHUNKS = 120


@overload
def evaluate(ground_truth: Trajectory, estimate: Trajectory, **settings: object) -> Result: ...
@overload
def evaluate(
    ground_truth: Trajectory, estimate: Mapping[str, Trajectory], **settings: object
) -> Results: ...
def evaluate(
    ground_truth: Trajectory, estimate: Trajectory | Mapping[str, Trajectory], **settings: object
) -> Result | Results:
    """Evaluate one estimate, or several by name, against a ground truth.

    The figures are those of the node and of the command ``evaluate`` on the same data. ``settings``
    are the parameters (``docs/parameters.md``) with underscores for dots: ``gauge="sim3"``,
    ``relative_delta=5.0, relative_unit="m"``, ``estimate_time_offset=0.01``; of several estimates,
    what is an estimate's own begins with its name: ``vins_time_offset=0.01``.

    Returns a :class:`Result`; of several, :class:`Results`: a dict of them with ``.comparison``.
    Names are of small letters, digits and underscores.

    Raises :class:`ValueError` for a setting that is unknown or out of range, for a name that cannot
    be one, and where of an estimate not a single pose can be evaluated (it says why).

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
        return _evaluate(ground_truth, {ONE[0]: estimate}, settings)[0][ONE[0]]
    if not estimate:
        raise ValueError("no estimate is given")
    results, comparison = _evaluate(ground_truth, dict(estimate), settings)
    return Results(results, comparison)


def _evaluate(
    truth: Trajectory, estimates: Mapping[str, Trajectory], settings: Mapping[str, object]
) -> tuple[dict[str, Result], list[Comparison]]:
    names = tuple(estimates)
    parameters = parameters_of(settings, names)
    joint = parameters["likelihood.covariance"] == "joint"
    engine = Engine(parameters, names, whole=not joint)
    records = {
        name: Report(
            _of_one(parameters, name),
            {"ground truth": truth.data.source, "estimate": one.data.source},
        )
        for name, one in estimates.items()
    }
    kept: dict[str, list[EngineResults]] = {name: [] for name in names}
    for found in _feed(engine, truth, estimates):
        for name, results in found.items():
            records[name].add(results)
            kept[name].append(results)
    found_of = {
        name: _result(engine, name, truth, one, kept[name], records[name], joint)
        for name, one in estimates.items()
    }
    chosen = engine.settings.evaluation
    evaluated = [
        _compared(name, one.poses, engine.settings.estimates[name].time_offset)
        for name, one in found_of.items()
    ]
    return found_of, [
        compare(a, b, chosen.gauge.name, chosen.relative_delta, chosen.relative_unit)
        for a, b in itertools.combinations(evaluated, 2)
    ]


def _compared(name: str, poses: Poses, offset: int) -> Evaluated:
    """The poses outside the gaps of the ground truth: within, the errors would be its own."""
    known = poses.sampled
    stamps = poses.stamps[known] + offset
    return Evaluated(name, stamps, poses.ground_truth[known], poses.estimate[known])


def _of_one(parameters: Mapping[str, Value], name: str) -> dict[str, Value]:
    """The parameters as a run of this estimate alone has them."""
    own = {f"{name}.{rest}": f"{ONE[0]}.{rest}" for rest in _OWN}
    own[f"{name}.extrinsic"] = "extrinsic"
    return {own.get(key, key): value for key, value in parameters.items()}


_OWN = ("type", "reliability", "use_covariance", "time_offset")


def _feed(
    engine: Engine, truth: Trajectory, estimates: Mapping[str, Trajectory]
) -> Iterator[dict[str, EngineResults]]:
    """Feed all in the order of their stamps, a piece of the run at a time."""
    samples = [truth.samples, *(one.samples for one in estimates.values())]
    offsets = [0, *(engine.settings.estimates[name].time_offset for name in estimates)]
    times = [
        arrival_times(topic.stamps + offset) for topic, offset in zip(samples, offsets, strict=True)
    ]
    every = np.sort(np.concatenate(times))
    # By number and not by time: a wrong stamp does not make a million empty pieces.
    ends = every[np.linspace(0, len(every) - 1, _CHUNKS).astype(int)] if len(every) else every
    taken = [0] * len(samples)
    for now in np.unique(ends).tolist():
        until = [int(np.searchsorted(t, now, side="right")) for t in times]
        batches = [topic[a:b] for topic, a, b in zip(samples, taken, until, strict=True)]
        engine.add_ground_truth(batches[0])
        for name, batch in zip(estimates, batches[1:], strict=True):
            engine.add_estimate(batch, name)
        taken = until
        yield engine.advance_all(now)
    yield engine.finish_all()


def _result(
    engine: Engine,
    name: str,
    truth: Trajectory,
    estimate: Trajectory,
    kept: list[EngineResults],
    record: Report,
    joint: bool,
) -> Result:
    poses = Poses.of([results.evaluations for results in kept])
    summary: dict[str, Any] = engine.summary(name)
    for account, trajectory in (
        (summary["estimate"], estimate),
        (summary["ground_truth"], truth),
    ):
        _count_unstamped(account, trajectory)
    if not len(poses):
        rejected = summary["estimate"]["rejected"].items()
        reasons = ", ".join(f"{count:,} {reason}" for reason, count in rejected if count)
        raise ValueError(
            f"{estimate.name}: none of its {len(estimate):,} poses could be evaluated"
            + (f" ({reasons})" if reasons else "")
        )
    record.notices = engine.notices(name)
    record.add_received(ground_truth=truth.stamps, estimate=estimate.stamps)
    cross = tuple(blocks for results in kept for blocks in results.cross)
    gauge = engine.settings.evaluation.gauge
    summary = whole_run(summary, poses.ground_truth, poses.covariance, poses.estimate, gauge, cross)
    if not joint:
        model = shield("the error model", lambda: _model(engine, name, poses), None, record.say)
        if model is not None:
            summary["error_model"] = model
    causes = record.causes()
    summary["likely_causes"] = [dataclasses.asdict(cause) for cause in causes]
    return Result(name, summary, poses, causes, record)


def _model(engine: Engine, name: str, poses: Poses) -> dict[str, Any] | None:
    stamps = poses.stamps + engine.settings.estimates[name].time_offset
    found = fit(stamps, poses.estimate, lambda asked: engine.truth(asked, name))
    return None if found is None else named(found)


def _count_unstamped(account: dict[str, Any], trajectory: Trajectory) -> None:
    """Account for the rows of a file whose stamp is not a number."""
    count = len(trajectory.data.non_finite_stamp_rows)
    if count:
        account["received"] += count
        account["rejected"]["non_finite"] = account["rejected"].get("non_finite", 0) + count
