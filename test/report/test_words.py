# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the report's sentences say of a run."""

from dataclasses import replace

import numpy as np
import pytest
from twins.runs import SECOND, START, motion, samples

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.parameters import complete
from trajeval_ros.report import Report, answers
from trajeval_ros.report.run import Run
from trajeval_ros.report.series import make_series
from trajeval_ros.report.words import verdict


def evaluated(noise: float) -> Run:
    """A run of 40 s whose samples have so much noise, m."""
    seconds = np.arange(0.0, 40.0, 0.05)
    stamps = START + np.rint(seconds * SECOND).astype(np.int64)
    poses = motion(seconds)
    poses[:, :3, 3] += np.random.default_rng(1).normal(size=(len(poses), 3)) * noise
    engine, report = Engine({}), Report(complete({}), {})
    for results in feed(
        engine, samples(stamps, poses), samples(stamps[5::4], motion(seconds[5::4]))
    ):
        report.add(results)
    report.add_received(ground_truth=stamps, estimate=stamps[5::4])
    return report.run(engine.summary())


@pytest.fixture(scope="module")
def run() -> Run:
    return evaluated(0.0)


def test_the_worst_moment_is_judged_against_what_is_known(run: Run) -> None:
    series = make_series(run)
    error, band = np.full(len(series.seconds), 0.01), np.full(len(series.seconds), 0.002)
    error[10], band[10] = 1.3, 1.76  # within its own gap the ground truth is a guess
    error[50] = 0.16
    said = verdict(run, replace(series, translation_error=error, translation_band=band))
    assert f"furthest off at {series.seconds[50]:.1f} s" in said
    assert "160 mm" in said
    assert "1.3 m" not in said


@pytest.mark.parametrize(("noise", "assumed"), [(0.0, True), (0.005, False)])
def test_an_assumed_accuracy_is_said_as_assumed(noise: float, assumed: bool) -> None:
    found = evaluated(noise)
    said = verdict(found, make_series(found))
    assert ("set ground_truth.translation_std" in said) == assumed


def test_what_is_applied_names_what_is_left():
    def left(*doubted):
        return answers.applied_line({}, {}, (), doubted)

    assert left("scale") == "Applied       nothing: scale, within doubt, left as it was"
    assert left("mounting", "scale").endswith("mounting, scale, within doubt, left as they were")
