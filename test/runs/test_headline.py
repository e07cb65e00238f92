# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a person asks first has the answer that was put in."""

import functools
from typing import Any

import numpy as np
import pytest

import trajeval_ros as te
from trajeval_ros import se3
from trajeval_ros.commands.simulation import simulate
from trajeval_ros.online.parameters import complete
from trajeval_ros.report.answers import first_lines

_SECOND = 1_000_000_000


def evaluated(change: Any = None, **settings: Any) -> te.Result:
    """A simulated estimate, without its own drift, changed before it is evaluated."""
    run = simulate(60.0, seed=3)
    rng = np.random.default_rng(0)
    stamps, truth = run.ground_truth.stamps, run.ground_truth.poses
    every = slice(3, None, 10)
    poses = truth[every] @ se3.exp(
        rng.normal(0.0, [5e-3] * 3 + [2e-3] * 3, (len(stamps[every]), 6))
    )
    mine = stamps[every]
    if change is not None:
        mine, poses = change(mine, poses)
    return te.evaluate(
        te.Trajectory(stamps, truth),
        te.Trajectory(mine, poses),
        **settings,
    )


@functools.cache
def clean() -> te.Result:
    """As it is."""
    return evaluated()


def test_the_worst_is_where_it_was_put() -> None:
    def bump(stamps: Any, poses: Any) -> Any:
        poses = poses.copy()
        poses[200, :3, 3] += 0.4
        return stamps, poses

    result = evaluated(bump)
    worst = result.summary["headline"]["worst"]
    begin = int(result.poses.stamps[0])
    assert worst["stamp"] == int(result.poses.stamps[200])
    assert 0.0 <= worst["seconds_from_start"] - (worst["stamp"] - begin) * 1e-9 < 0.1
    assert worst["translation"] == pytest.approx(0.4 * np.sqrt(3.0), rel=0.05)
    assert 0.0 < worst["ground_truth_std"] < 0.05
    lines = first_lines(result.summary, complete({}))
    assert any(line.startswith(f"Worst         {worst['translation']:.3g} m at ") for line in lines)


def test_an_interval_holds_the_noise_that_was_put_in() -> None:
    result = clean()
    found = result.summary["headline"]["intervals"]
    for key, noise in (
        ("ate_translation_rmse", 5e-3 * np.sqrt(3.0)),
        ("ate_rotation_rmse", 2e-3 * np.sqrt(3.0)),
        ("re_translation_rmse", 5e-3 * np.sqrt(6.0)),
        ("re_rotation_rmse", 2e-3 * np.sqrt(6.0)),
    ):
        low, high = found[key]["interval"]
        assert low < result.summary["conventional"][key] < high
        # The ground truth's own error is in it, too.
        assert 0.9 * low < noise < 1.05 * high, key
    assert result.summary["headline"]["ground_truth"]["share_in_gaps"] == 0.0
    assert result.summary["headline"]["without"] is None


def test_what_is_not_its_fault_is_taken_out() -> None:
    mounting = se3.exp(np.array([0.1, 0.0, 0.05, 0.0, 0.1, 0.0]))

    def spoil(stamps: Any, poses: Any) -> Any:
        return stamps - 30_000_000, poses @ mounting

    without = evaluated(spoil).summary["headline"]["without"]
    right = clean().summary["conventional"]
    assert {"clock", "lever arm", "mounting"} <= set(without["of"])
    for key in ("ate_translation_rmse", "ate_rotation_rmse", "re_translation_rmse"):
        assert without[key] == pytest.approx(right[key], rel=0.1), key
