# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two trajectories through the engine, as fast as it goes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.commands.console import CommandError, Progress
from trajeval_ros.commands.inputs import Inputs, first_bad_rows
from trajeval_ros.files.output import OutputFolder
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.metrics.absolute import absolute
from trajeval_ros.metrics.gauge import GAUGES
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.merge import feed
from trajeval_ros.online.results import Evaluations
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.report import Report

Array = npt.NDArray[np.float64]
Figures = dict[str, Any]

# Seconds of data between two calls of the engine's advance.
_CHUNK = 1.0


def score(
    data: Inputs,
    parameters: Mapping[str, Any],
    report: Report,
    folder: OutputFolder | None,
) -> Figures:
    """Feed the engine in the order of time; return the summary.

    Raises
    ------
    CommandError
        If not a single estimate could be evaluated; says why.
    """
    engine = Engine(parameters)
    whole_run = WholeRun()
    truth, estimate = data.ground_truth, data.estimate
    with Progress("evaluating", len(estimate), "poses") as progress:
        done = 0
        for results in feed(engine, samples(truth), samples(estimate), _CHUNK):
            report.add(results)
            whole_run.add(results.evaluations)
            if folder is not None:
                folder.add(results.evaluations)
            done += len(results.evaluations.stamps)
            progress.update(done)
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
    summary["absolute"]["log_likelihood_nonlinear"] = whole_run.log_likelihood(parameters)
    return summary


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
        counts["rejected"]["non_finite"] = counts["rejected"].get("non_finite", 0) + count


class WholeRun:
    """Every evaluated pose of a run, for the one figure that needs them all at once."""

    def __init__(self) -> None:
        self._ground_truth: list[Array] = []
        self._covariance: list[Array] = []
        self._estimate: list[Array] = []

    def add(self, evaluations: Evaluations) -> None:
        """Keep the poses."""
        self._ground_truth.append(evaluations.ground_truth)
        self._covariance.append(evaluations.covariance)
        self._estimate.append(evaluations.estimate)

    def log_likelihood(self, parameters: Mapping[str, Any]) -> float | None:
        """Return the nonlinear absolute log-likelihood, linearised at the best alignment of all.

        None where the gauge is not observed, and under the joint covariance, of which only the
        blocks on the diagonal are kept.
        """
        if parameters["likelihood.covariance"] != "independent":
            return None
        found = absolute(
            np.concatenate(self._ground_truth),
            np.concatenate(self._covariance),
            np.concatenate(self._estimate),
            GAUGES[parameters["gauge"]],
        )
        return None if found.likelihood is None else float(found.likelihood.log_likelihood)


def where_to_look(data: Inputs, summary: Mapping[str, Any]) -> list[str]:
    """Return a line for each reason of rejection that has a first row in a file."""
    lines = []
    for key, trajectory in (("estimate", data.estimate), ("ground_truth", data.ground_truth)):
        rejected = summary[key]["rejected"]
        for reason, where in first_bad_rows(trajectory).items():
            if rejected.get(reason):
                title = key.replace("_", " ")
                lines.append(f"{title}: {rejected[reason]:,} {reason}, the first in {where}")
    return lines
