# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated run is what it says it is."""

from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands.simulate import main
from trajeval_ros.commands.simulation import SECOND, motion, simulate
from trajeval_ros.files.tum import read_tum


def test_motion_is_rigid_smooth_and_aggressive() -> None:
    step = 1e-3
    seconds = np.arange(0.0, 60.0, step)
    poses = motion(seconds)
    rotation = poses[:, :3, :3]
    identity = rotation @ rotation.swapaxes(-1, -2)
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), identity.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-12)
    velocity = se3.log(se3.compose(se3.inverse(poses[:-1]), poses[1:])) / step
    speed = np.linalg.norm(velocity[:, :3], axis=1)
    assert 3.5 < speed.max() < 6.0
    # at rest at first
    assert speed[: round(0.5 / step)].max() < 0.05
    jerk = np.diff(velocity, axis=0) / step
    assert np.abs(np.diff(jerk, axis=0)).max() < 5.0


def test_ground_truth_has_two_dropouts_and_jitter() -> None:
    stamps = simulate(80.0, seed=5).ground_truth.stamps
    steps = np.diff(stamps) / SECOND
    assert np.all(steps > 0)
    long = steps[steps > 0.1]
    np.testing.assert_allclose(np.sort(long), [2.5, 4.0], atol=0.05)
    usual = steps[steps < 0.1]
    assert usual.mean() == pytest.approx(0.01, rel=1e-3)
    assert 5e-4 < usual.std() < 3e-3


def test_noise_of_the_ground_truth_is_as_asked() -> None:
    run = simulate(60.0, seed=2, ground_truth_std=(0.002, 0.004), start=0)
    truth = motion(run.ground_truth.stamps / SECOND)
    error = se3.log(se3.compose(se3.inverse(truth), run.ground_truth.poses))
    count = len(error) * 3
    for part, std in ((error[:, :3], 0.002), (error[:, 3:], 0.004)):
        assert part.std() == pytest.approx(std, abs=5 * std / np.sqrt(2 * count))


def test_estimate_drifts_and_has_its_own_world_and_clock_phase() -> None:
    run = simulate(60.0, seed=2, start=0)
    estimate = run.estimate
    np.testing.assert_allclose(np.diff(estimate.stamps) / SECOND, 0.05, atol=2e-9)
    assert not np.isin(estimate.stamps, run.ground_truth.stamps).any()
    # world estimate = W Exp(drift) truth Exp(noise)
    world = se3.compose(estimate.poses, se3.inverse(motion(estimate.stamps / SECOND)))
    assert np.linalg.norm(se3.log(world[:1])[0]) > 1.0
    walk = se3.log(se3.compose(se3.inverse(world[:1]), world))
    assert np.linalg.norm(walk[-200:, :3], axis=1).mean() > 0.03


def test_the_seed_decides() -> None:
    one, again, other = (simulate(seed=seed).estimate.poses for seed in (4, 4, 5))
    np.testing.assert_allclose(again, one, rtol=0, atol=1e-12)
    assert np.abs(other - one).max() > 1e-3


def test_command_writes_two_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "run"), "--duration", "12", "--seed", "7"]) == 0
    truth, estimate = (Path(line) for line in capsys.readouterr().out.splitlines())
    expected = simulate(12.0, 7)
    for path, poses in ((truth, expected.ground_truth), (estimate, expected.estimate)):
        trajectory = read_tum(path)
        np.testing.assert_array_equal(trajectory.stamps, poses.stamps)
        np.testing.assert_allclose(trajectory.positions, poses.poses[:, :3, 3], rtol=0, atol=1e-12)


@pytest.mark.parametrize("arguments", [["--duration", "3"], ["--seed", "-1"], ["--seed", "x"]])
def test_wrong_usage(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main([str(tmp_path), *arguments])
    assert caught.value.code == 2
    assert arguments[0] in capsys.readouterr().err
