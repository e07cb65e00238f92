# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A task on a worker: one ground truth, several runs, a row for each."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from trajeval_ros import __version__, memory
from trajeval_ros.benchmarking.errors import Errors, errors_of
from trajeval_ros.benchmarking.manifest import Source
from trajeval_ros.benchmarking.plan import Planned, Task
from trajeval_ros.files import sources
from trajeval_ros.files.provenance import named
from trajeval_ros.files.recognise import recognise
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError
from trajeval_ros.online.parameters import PARAMETERS, Value, complete, of_estimate
from trajeval_ros.report import Report
from trajeval_ros.runs.offline import Scored, Scoring, score, why_none

Cell = str | float | None
Row = dict[str, Cell]

OK, FAILED, LOST = "ok", "failed", "lost"
"""Evaluated; not to be evaluated, and why; its worker died, which may go better another time."""


@dataclass(frozen=True)
class Outcome:
    """What became of a run: its row, and its errors over time where it has any."""

    row: Row
    errors: Errors | None = None


@memory.kept()
def outcomes_of(task: Task) -> list[Outcome]:
    """Evaluate the runs of a task. What is wrong with one of them is its row's ``error``."""
    start = time.perf_counter()
    try:
        truth = read(task.ground_truth)
    except Exception as error:  # noqa: BLE001 (whatever it is, it is these rows' and no others')
        return [Outcome(failed(one, f"ground truth: {_said(error)}")) for one in task.runs]
    estimates: dict[Planned, Trajectory] = {}
    outcomes: dict[str, Outcome] = {}
    for one in task.runs:
        try:
            estimates[one] = read(one.run.source)
        except Exception as error:  # noqa: BLE001 (as above)
            outcomes[one.key] = Outcome(failed(one, _said(error)))
    reading = (time.perf_counter() - start) / len(task.runs)
    outcomes |= _scored(task, truth, estimates, reading)
    return [outcomes[one.key] for one in task.runs]


def _scored(
    task: Task, truth: Trajectory, estimates: Mapping[Planned, Trajectory], before: float
) -> dict[str, Outcome]:
    """The outcomes by key; where all together fail, each by itself."""
    if not estimates:
        return {}
    start = time.perf_counter()
    try:
        scored = scores_of(task.parameters, truth, list(estimates.values()))
    except Exception as error:  # noqa: BLE001 (a defect, or no memory; one run may be the reason)
        if len(estimates) == 1:
            return {one.key: Outcome(failed(one, _said(error))) for one in estimates}
        outcomes: dict[str, Outcome] = {}
        for one, estimate in estimates.items():
            outcomes |= _scored(task, truth, {one: estimate}, before)
        return outcomes
    share = before + (time.perf_counter() - start) / len(estimates)
    return {
        one.key: Outcome(
            _row(one, estimate, each, share),
            errors_of(one.key, truth.stamps, each.evaluated, _alignment(each.summary)),
        )
        for (one, estimate), each in zip(estimates.items(), scored, strict=True)
    }


def _alignment(summary: Mapping[str, Any]) -> object:
    conventional = summary["conventional"]
    aligned = conventional.get("ate_translation_rmse") is not None
    return conventional.get("alignment") if aligned else None


def scores_of(
    parameters: Mapping[str, Value], truth: Trajectory, estimates: Sequence[Trajectory]
) -> list[Scored]:
    """What became of each estimate, in order; ``parameters`` as of a run with one."""
    # The engine's names have rules of their own that a run's need not follow.
    names = [f"e{place}" for place in range(len(estimates))]
    values: dict[str, Any] = {}
    for name, value in parameters.items():
        if name.startswith("estimate."):
            rest = name.removeprefix("estimate.")
            values |= {f"{each}.{rest}": value for each in names}
        elif name not in ("estimates", "extrinsic"):
            values[name] = value
    whole = complete(values, names)
    scorings = {
        name: Scoring(estimate, Report(of_estimate(whole, name), {}), explain=False)
        for name, estimate in zip(names, estimates, strict=True)
    }
    # The rows have the plan's hashes, so that no file is read once more for its own.
    found = score(whole, truth, scorings, describe=named)
    return [found[name] for name in names]


def read(source: Source) -> Trajectory:
    """Read a trajectory; its format by its content where none is said."""
    kind = source.format or ("bag" if source.topic else recognise(source.path).format)
    name = source.path if source.topic is None else f"{source.path}:{source.topic}"
    return sources.read(kind, name, source.times)


def _origin(one: Planned, status: str, error: str | None) -> Row:
    return {
        "system": one.run.system,
        "sequence": one.run.sequence,
        "run": one.run.run,
        "status": status,
        "error": error,
        "key": one.key,
        "ground_truth_sha256": one.ground_truth,
        "estimate_sha256": one.estimate,
        "parameters_sha256": one.parameters,
        "version": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "wall_time": None,
        "defects": None,
    }


def failed(one: Planned, error: str, status: str = FAILED) -> Row:
    """The row of a run that has no figures."""
    return _origin(one, status, error)


def _row(one: Planned, estimate: Trajectory, scored: Scored, seconds: float) -> Row:
    summary = scored.summary
    why = why_none(estimate.source, len(estimate), summary)
    row = _origin(one, OK if why is None else FAILED, why and _one_line(why))
    row["wall_time"] = seconds
    row["defects"] = "; ".join(scored.defects) or None
    parameters = {f"parameters.{name}": summary["parameters"][name] for name in PARAMETERS}
    row |= {name: cell(value) for name, value in parameters.items()}
    figures = {k: v for k, v in summary.items() if k not in ("version", "inputs", "parameters")}
    return row | dict(_scalars(figures, ""))


def _scalars(part: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Cell]]:
    """Every scalar, by its dotted name. Lists (poses, covariances, jumps) are not."""
    for name, value in part.items():
        if isinstance(value, Mapping):
            yield from _scalars(value, f"{prefix}{name}.")
        elif isinstance(value, str | int | float):
            yield f"{prefix}{name}", cell(value)


def cell(value: Any) -> Cell:
    """Text or a number; all numbers are floats, so that a row read again is the row written."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return float(value) if np.isfinite(value) else None
    return value if isinstance(value, str) else json.dumps(value)


def _said(error: Exception) -> str:
    text = str(error) or type(error).__name__
    return _one_line(
        text
        if isinstance(error, ValueError | TrajectoryFileError)
        else f"{type(error).__name__}: {text}"
    )


def _one_line(text: str) -> str:
    return " ".join(text.split())
