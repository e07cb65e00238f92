# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two trajectories through the engine, as fast as it goes."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import GAUGES
from trajeval_ros.alignment.umeyama import Gauge
from trajeval_ros.commands.console import CommandError, Progress
from trajeval_ros.commands.inputs import SECOND, Inputs
from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.named import named
from trajeval_ros.files.output import OutputError, OutputFolder
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.results import Evaluations, Results, TopicHealth
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.summary import whole_run
from trajeval_ros.report import Report
from trajeval_ros.wall import shield

Figures = dict[str, Any]

_NON_FINITE = str(Reason.NON_FINITE)

# So many nanoseconds of data at a time: a chunk costs some milliseconds, however much is in it. The
# report has a point of the running absolute error a chunk, so for it there are as many as this.
_CHUNK = 40_000_000_000
_POINTS = 120
# The error model asks the ground truth anew at every offset of the clocks that it tries, so the
# whole of it is kept, some kilobytes a sample. More samples than this are not.
_MOST_SAMPLES = 500_000


def score(
    data: Inputs,
    parameters: Mapping[str, Any],
    report: Report,
    folder: OutputFolder | None,
) -> tuple[Figures, list[str]]:
    """Feed the engine in the order of time; return the summary, and where rejected poses stand.

    Raises
    ------
    CommandError
        If not a single estimate could be evaluated; says why.
    """
    truth, estimate = data.ground_truth, data.estimate
    whole = len(truth) <= _MOST_SAMPLES and parameters["likelihood.covariance"] != "joint"
    engine = Engine(parameters, whole=whole)
    poses = WholeRun()
    chunk = _CHUNK
    if folder is not None:
        chunk = min(max(int(np.ptp(estimate.stamps)) // _POINTS, SECOND), _CHUNK)
    with Progress("evaluating", len(estimate), "poses") as progress:
        done = 0
        for results in feed(engine, samples(truth), samples(estimate), chunk):
            report.add(results)
            poses.add(results)
            if folder is not None:
                # The folder says at the end what it has not got.
                with contextlib.suppress(OutputError):
                    folder.add(results.evaluations)
            done += len(results.evaluations.stamps)
            progress.update(done)
    report.notices = engine.notices()
    report.add_received(ground_truth=truth.stamps, estimate=estimate.stamps)
    summary: Figures = engine.summary()
    _count_unstamped(summary["estimate"], estimate)
    _count_unstamped(summary["ground_truth"], truth)
    if not summary["estimate"]["evaluated"]:
        rejected = {**summary["estimate"]["rejected"]}
        reasons = ", ".join(f"{count:,} {reason}" for reason, count in rejected.items() if count)
        raise CommandError(
            f"{estimate.source}: none of its {len(estimate):,} poses could be evaluated"
            + (f" ({reasons})" if reasons else "")
        )
    summary = poses.complete(summary, parameters["gauge"])
    if whole:
        lack: dict[str, Figures] = {}
        found = shield(
            "the error model", lambda: _models(engine, poses, parameters), lack, report.say
        )
        for name, model in found.items():
            (summary if name == "run" else summary[name])["error_model"] = model
    summary["likely_causes"] = [asdict(cause) for cause in report.causes()]
    none: list[str] = []
    places = shield("the list of rejected rows", lambda: _places(engine, data), none, report.say)
    return summary, places


def corrected(
    data: Inputs, parameters: Mapping[str, Any], summary: Figures, names: Sequence[str]
) -> tuple[Inputs, dict[str, Any]]:
    """The inputs and parameters with what the error model of ``summary`` has found set.

    Raises
    ------
    CommandError
        If there is no error model.
    """
    model = summary.get("error_model")
    if model is None:
        raise CommandError("--apply: no error model could be fitted")
    values = dict(parameters)
    estimate = data.estimate
    if "clock_offset" in names:
        values["estimate.time_offset"] += model["clock_offset"]["value"]
    if "extrinsic" in names:
        known, found = (
            se3.from_position_quaternion(pose[:3], pose[3:])
            for pose in (values["extrinsic"], model["extrinsic"]["pose"])
        )
        position, quaternion = se3.to_position_quaternion(found @ known)
        values["extrinsic"] = [*position.tolist(), *quaternion.tolist()]
    if "scale" in names:
        scaled = estimate.positions * model["scale"]["value"]
        estimate = replace(estimate, positions=scaled)
    return replace(data, estimate=estimate), values


def _models(engine: Engine, poses: WholeRun, parameters: Mapping[str, Any]) -> dict[str, Figures]:
    """The error models of the ``run`` and of its ``window``, where there are enough poses."""
    offset = round(parameters["estimate.time_offset"] * SECOND)
    stamps, estimate = poses.trajectory
    stamps = stamps + offset
    last = stamps >= stamps[-1] - round(parameters["window.duration"] * SECOND)
    found = {"run": fit(stamps, estimate, engine.truth)}
    found["window"] = (
        found["run"] if last.all() else fit(stamps[last], estimate[last], engine.truth)
    )
    return {name: named(model) for name, model in found.items() if model is not None}


def _places(engine: Engine, data: Inputs) -> list[str]:
    health = engine.health()
    places = _where_to_look("estimate", data.estimate, health.estimate)
    return places + _where_to_look("ground truth", data.ground_truth, health.ground_truth)


def samples(trajectory: Trajectory) -> PoseSamples:
    """Return the poses as the engine takes them."""
    return PoseSamples(
        trajectory.stamps, trajectory.positions, trajectory.quaternions, trajectory.covariances
    )


def _count_unstamped(counts: Figures, trajectory: Trajectory) -> None:
    """Account for the rows whose stamp is not a number, which the engine cannot be given."""
    count = len(trajectory.non_finite_stamp_rows)
    if count:
        counts["received"] += count
        counts["rejected"][_NON_FINITE] = counts["rejected"].get(_NON_FINITE, 0) + count


class WholeRun:
    """Every evaluated pose of a run, for the one figure that needs them all at once."""

    def __init__(self) -> None:
        self._poses: list[Evaluations] = []
        self._cross: list[npt.NDArray[np.float64]] = []

    def add(self, results: Results) -> None:
        """Keep the poses."""
        self._poses.append(results.evaluations)
        self._cross.extend(results.cross)

    @property
    def trajectory(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """The estimate's stamps (N,), on its own clock, and its poses (N, 4, 4)."""
        return (
            np.concatenate([poses.stamps for poses in self._poses]),
            np.concatenate([poses.estimate for poses in self._poses]),
        )

    def complete(self, summary: Figures, gauge: Gauge) -> Figures:
        """Return the summary with the nonlinear absolute log-likelihood over all poses."""
        return whole_run(
            summary,
            np.concatenate([poses.ground_truth for poses in self._poses]),
            np.concatenate([poses.covariance for poses in self._poses]),
            np.concatenate([poses.estimate for poses in self._poses]),
            GAUGES[gauge],
            tuple(self._cross),
        )


def _where_to_look(title: str, trajectory: Trajectory, health: TopicHealth) -> list[str]:
    """Return a line for each reason of rejection that has a first row in the file."""
    rejected = Counter(health.rejected)
    rows = {reason: int(trajectory.rows[place]) for reason, place in health.first_rejected.items()}
    unstamped = trajectory.non_finite_stamp_rows
    if len(unstamped):
        rejected[_NON_FINITE] += len(unstamped)
        rows[_NON_FINITE] = min(int(unstamped[0]), rows.get(_NON_FINITE, int(unstamped[0])))
    return [
        f"{title}: {rejected[reason]:,} {reason}, the first in {trajectory.where(row)}"
        for reason, row in rows.items()
    ]
