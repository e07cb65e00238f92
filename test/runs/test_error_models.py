# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What of a run the error model is of."""

import numpy as np
import pytest
from twins.real_pairs import DATA
from twins.runs import SECOND, START, motion, poses_of, simulated

import trajeval_ros as te
from trajeval_ros import se3
from trajeval_ros.diagnosis.fitted import beyond_doubt


def test_a_gap_of_the_ground_truth_is_no_jump_of_the_estimate() -> None:
    seconds = np.arange(0.0, 30.0, 0.02)
    rng = np.random.default_rng(4)
    poses = motion(seconds)
    poses[:, :3, 3] += 5e-4 * rng.normal(size=(len(seconds), 3))
    sampled = (seconds < 12.0) | (seconds > 18.0)
    stamps = START + np.rint(seconds * SECOND).astype(np.int64)
    estimate = motion(seconds[5::4])
    estimate[:, :3, 3] += 4e-3 * rng.normal(size=(len(estimate), 3))
    result = te.evaluate(
        te.Trajectory(stamps[sampled], poses[sampled]),
        te.Trajectory(stamps[5::4], estimate),
        ground_truth_max_gap=10.0,
    )
    model = result.summary["error_model"]
    assert result.summary["estimate"]["evaluated"] > model["poses"] == result.poses.sampled.sum()
    assert model["jumps"] == []
    jitter = model["translation"]["jitter_std"]
    assert abs(jitter["value"] - 4e-3) < 4.0 * jitter["std"]


def test_of_a_rare_ground_truth_the_samples_count() -> None:
    run = simulated(5, 60.0, rates=(1.0, 20.0))
    result = te.evaluate(
        te.Trajectory(run.ground_truth.stamps, poses_of(run.ground_truth)),
        te.Trajectory(run.estimate.stamps, poses_of(run.estimate)),
    )
    assert len(result.poses.stamps) > 1000
    samples = len(run.ground_truth.stamps)
    assert samples - 4 <= result.summary["error_model"]["poses"] <= samples


def test_poses_too_far_apart_to_ask_between() -> None:
    """Keyframes at 5 Hz that drift: the window is fitted from what is near each."""
    run = simulated(3, 40.0, rates=(50.0, 5.0))
    given = poses_of(run.estimate)
    twist = np.array([0.6, -0.3, 0.2, 0.0, 0.0, 0.1])
    drifted = se3.exp(np.linspace(0.0, 1.0, len(given))[:, None] * twist) @ given
    result = te.evaluate(
        te.Trajectory(run.ground_truth.stamps, poses_of(run.ground_truth)),
        te.Trajectory(run.estimate.stamps, drifted),
    )
    assert result.summary["error_model"]["poses"] == len(given)
    window = result.summary["window"]["error_model"]
    assert window["poses"] > 100
    assert np.isfinite(window["log_likelihood"])


def test_a_body_turned_about_its_only_axis_has_no_kilometre_of_jitter() -> None:
    """Where a fit begins too far off to find anything, none is told; the cause is named."""
    seconds = np.arange(0.0, 40.0, 0.02)

    def planar(times: np.ndarray) -> np.ndarray:
        poses = motion(times)
        poses[:, 2, 3] = 0.0
        yaw = np.zeros((len(times), 3))
        yaw[:, 2] = 0.5 * times + np.sin(0.8 * times)
        poses[:, :3, :3] = se3.exp_so3(yaw)
        return poses

    rng = np.random.default_rng(1)
    turned = np.eye(4)
    turned[:3, :3] = se3.exp_so3(np.array([0.0, 0.0, np.radians(120.0)]))
    error = rng.normal(size=(400, 6)) * np.repeat([0.02, 0.005], 3)
    times = seconds[2 : 2 + 4 * 400 : 4]
    result = te.evaluate(
        te.Trajectory(seconds, planar(seconds)),
        te.Trajectory(times, planar(times) @ se3.exp(error) @ turned),
    )
    assert [cause.code for cause in result.causes] == ["body_frame"]
    model = result.summary.get("error_model")
    assert model is None or model["translation"]["jitter_std"]["value"] < 0.1


def test_of_a_copy_of_the_ground_truth_nothing_is_blamed() -> None:
    """Its markers are a decimetre off its origin: position jitters with the orientation.

    A lever arm to the markers made the jitter less, and a drift made up for what it moved: it was
    91 mm, beyond doubt, and left 17 mm where 0.3 mm had been.
    """
    path = DATA / "tum_fr2_desk" / "groundtruth.txt"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    copy = te.read_tum(path)
    result = te.evaluate(copy, copy)
    model = result.summary["error_model"]
    assert model["fit"] == "whole"
    assert (result.causes, beyond_doubt(model)) == ((), ())
    size = model["translation"]["jitter_std"], model["translation"]["wander_std"]
    assert all(each["value"] < 5e-4 for each in size)
