# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A clock that is off by seconds while the two have time in common."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from twins.runs import SECOND, Run, simulated

import trajeval_ros as te
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.report import Report
from trajeval_ros.runs.far_offset import far_offset


def trajectory(samples: PoseSamples, shift: float = 0.0) -> Trajectory:
    return Trajectory(
        samples.stamps + round(shift * SECOND),
        samples.positions.copy(),
        samples.quaternions.copy(),
        np.arange(len(samples)),
        "there",
    )


@pytest.fixture(scope="module")
def run() -> Run:
    return simulated(3, 60.0, rates=(50.0, 20.0))


@pytest.mark.parametrize(("late", "name"), [(5.0, ""), (-9.0, ""), (18.0, "GPS time is 18 s")])
def test_seconds_are_named_by_what_they_undo(run: Run, late: float, name: str) -> None:
    truth, estimate = trajectory(run.ground_truth), trajectory(run.estimate, late)
    (cause,) = far_offset(truth, estimate, 0.0, 1.5)
    assert cause.code == "time_base"
    assert float(cause.advice.rpartition("=")[2]) == pytest.approx(-late, abs=0.1)
    assert name in cause.text
    # Once it is set it is none.
    assert far_offset(truth, estimate, -late, 1.5) == ()


def test_rows_that_are_no_poses_do_not_matter(run: Run) -> None:
    truth, estimate = trajectory(run.ground_truth), trajectory(run.estimate, 5.0)
    expected = far_offset(truth, estimate, 0.0, 1.5)
    spoilt = []
    for each in (truth, estimate):
        positions = each.positions.copy()
        positions[[10, 20]] = [[1e308, -1e308, 1e308], [np.nan, np.inf, 0.0]]
        spoilt.append(replace(each, positions=positions))
    found = far_offset(spoilt[0], spoilt[1], 0.0, 1.5)
    assert [cause.code for cause in found] == [cause.code for cause in expected] == ["time_base"]


def test_what_is_only_bad_has_no_offset(run: Run) -> None:
    """Another motion; and an error that is small against the motion is not looked into."""
    truth = trajectory(run.ground_truth)
    other = trajectory(simulated(3, 60.0, rates=(50.0, 20.0)).estimate)
    backwards = Trajectory(
        other.stamps.copy(),
        other.positions[::-1].copy(),
        other.quaternions[::-1].copy(),
        np.arange(len(other)),
        "there",
    )
    assert far_offset(truth, backwards, 0.0, 1.5) == ()
    assert far_offset(truth, trajectory(run.estimate, 5.0), 0.0, 0.05) == ()
    assert far_offset(truth, trajectory(run.estimate, 5.0), 0.0, None) == ()


def test_nothing_is_fitted_to_poses_that_do_not_belong_together(run: Run) -> None:
    def of(samples: PoseSamples, shift: float = 0.0) -> te.Trajectory:
        poses = np.concatenate([samples.positions, samples.quaternions], axis=1)
        return te.Trajectory(samples.stamps + round(shift * SECOND), poses)

    result: Any = te.evaluate(of(run.ground_truth), of(run.estimate, 5.0))
    assert [cause.code for cause in result.causes] == ["time_base"]
    report = Report({}, {})
    report.of_rows = result.causes
    assert report.causes() == result.causes
