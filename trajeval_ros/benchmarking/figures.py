# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures that systems are compared by, and what of them runs and sequences give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros.benchmarking.work import FAILED, OK, Row

Runs = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Figure:
    """A figure of the tables: its column, title, unit, and the factor to that unit.

    ``worst``: what a run that failed is worth. ``ratios``: whether it is an error, of which twice
    as much means the same on every sequence; a share or a log-likelihood is none.
    """

    column: str
    title: str
    unit: str
    factor: float
    larger_is_better: bool = False
    worst: float = np.inf
    ratios: bool = True


_DEGREES = 180.0 / np.pi
_MODEL = "error_model.{}.{}.value"
FIGURES = (
    Figure("conventional.ate_translation_rmse", "ATE", "m", 1.0),
    Figure("conventional.ate_rotation_rmse", "ATE rotation", "deg", _DEGREES),
    Figure("conventional.re_translation_rmse", "RE", "m", 1.0),
    Figure("conventional.re_rotation_rmse", "RE rotation", "deg", _DEGREES),
    Figure("drift.kitti.translation", "KITTI drift", "%", 100.0),
    Figure("drift.kitti.rotation", "KITTI drift rotation", "deg/100 m", 100.0 * _DEGREES),
    Figure(_MODEL.format("translation", "jitter_std"), "Jitter", "mm", 1e3),
    Figure(_MODEL.format("rotation", "jitter_std"), "Jitter rotation", "deg", _DEGREES),
    Figure(_MODEL.format("translation", "long_run_drift"), "Drift", "mm/√s", 1e3),
    Figure(_MODEL.format("rotation", "long_run_drift"), "Drift rotation", "deg/√s", _DEGREES),
    Figure(_MODEL.format("translation", "wander_std"), "Wander", "mm", 1e3),
    Figure(_MODEL.format("rotation", "wander_std"), "Wander rotation", "deg", _DEGREES),
    Figure("error_model.nats_per_pose", "Error model", "nats/pose", 1.0, True, -np.inf, False),
    Figure("coverage.time", "Coverage", "%", 100.0, True, 0.0, False),
)


def values(rows: Sequence[Row], figure: Figure) -> Runs:
    """The figure of each run (n,); a run that failed is worse than any, see ``Figure.worst``.

    Runs that are evaluated and have no such figure are left out, and so are those whose worker
    died: of the system they say nothing.
    """
    evaluated = [row for row in rows if row["status"] == OK]
    found = [value for row in evaluated if isinstance(value := row.get(figure.column), float)]
    # One that nobody has (no orientations, say) is no figure, however many runs failed.
    if evaluated and not found:
        return np.full(0, np.nan)
    failures = sum(row["status"] == FAILED for row in rows)
    return np.array([*found, *[figure.worst] * failures])


def costs(runs: Runs, figure: Figure) -> Runs:
    """The runs as lower is better, and as differences mean the same: errors' logarithms."""
    if figure.ratios:
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(runs))
    return -runs if figure.larger_is_better else runs


def quartiles(runs: Runs) -> Runs:
    """First quartile, median and third (3,), without arithmetic on infinite values."""
    shares = [0.25, 0.5, 0.75]
    if np.isfinite(runs).all():
        return np.asarray(np.quantile(runs, shares))
    return np.asarray(np.quantile(runs, shares, method="inverted_cdf"))


def over_sequences(of_each: Runs, figure: Figure) -> Runs:
    """The mean (...,) over sequences (n, ...): geometric for errors.

    So no sequence counts more because its errors are larger. One that failed makes it a failure.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.exp(np.log(of_each).mean(axis=0)) if figure.ratios else np.mean(of_each, axis=0)
    return np.where(np.isinf(of_each).any(axis=0), figure.worst, mean)
