# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``--align-origin``: the first pose on the ground truth's, and nothing else aligned."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands import evaluate
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.runs.corrections import moved


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A ground truth at 100 Hz; an estimate at some of its stamps that drifts in its own world."""
    place = tmp_path_factory.mktemp("origin")
    t = np.arange(0, 20, 0.01)
    truth = se3.exp(
        np.stack([2 * np.sin(t), 2 * np.cos(t), 0.3 * t, 0 * t, 0.1 * np.sin(t), 0.2 * t], axis=1)
    )
    index = np.arange(100, 1900, 10)
    rng = np.random.default_rng(2)
    drift = np.cumsum(rng.normal(size=(len(index), 6)) * [0.01, 0.01, 0.01, 0, 0, 0.002], axis=0)
    world = se3.exp(np.array([10.0, -20.0, 3.0, 0.5, -0.4, 1.0]))
    estimate = world @ truth[index] @ se3.exp(drift)
    files = []
    for name, stamps, poses in (("gt", t, truth), ("est", t[index], estimate)):
        rows = np.column_stack((stamps, *se3.to_position_quaternion(poses)))
        np.savetxt(place / f"{name}.txt", rows, fmt="%.17g")
        files.append(str(place / f"{name}.txt"))
    return files


def summary_of(*arguments: str, output: Path) -> Any:
    assert evaluate.main([*arguments, "--output", str(output)]) == 0
    return json.loads((output / "summary.json").read_text())


def test_it_is_evo_s(run: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    metrics = pytest.importorskip("evo.core.metrics")
    from evo.core import sync
    from evo.tools import file_interface

    found = summary_of("tum", *run, "--align-origin", output=tmp_path)
    assert "laid on the ground truth at its first pose" in capsys.readouterr().out
    assert found["gauge"] == "none"
    truth, estimate = sync.associate_trajectories(
        *(file_interface.read_tum_trajectory_file(file) for file in run)
    )
    estimate.align_origin(truth)
    for relation, key in (
        (metrics.PoseRelation.translation_part, "ate_translation_rmse"),
        (metrics.PoseRelation.rotation_angle_rad, "ate_rotation_rmse"),
    ):
        ape = metrics.APE(relation)
        ape.process_data((truth, estimate))
        # The ground truth is smoothed here, by a tenth of a millimetre.
        expected = ape.get_statistic(metrics.StatisticsType.rmse)
        assert found["conventional"][key] == pytest.approx(expected, rel=2e-3)


def test_the_first_pose_lies_on_the_ground_truth(run: list[str], tmp_path: Path) -> None:
    found = summary_of("tum", run[0], run[1], run[0], "--align-origin", output=tmp_path)
    assert len(found["estimates"]) == 2
    rows = np.genfromtxt(tmp_path / "est" / "poses.csv", delimiter=",", names=True)
    for axis in ("tx", "ty", "tz"):
        assert rows[f"est_{axis}"][0] == pytest.approx(rows[f"gt_{axis}"][0], abs=1e-9)
        assert abs(rows[f"est_{axis}"] - rows[f"gt_{axis}"])[-50:].max() > 1e-3


def test_it_aligns_by_itself(run: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main(["tum", *run, "--align-origin", "--set", "gauge=sim3"]) == 2
    assert "--align-origin aligns by itself: it excludes gauge=sim3" in capsys.readouterr().err


def test_what_is_no_pose_stays_none() -> None:
    quaternions = np.array([[0, 0, 0, 0], [0, 0, 0, 2.0], [np.nan, 0, 0, 1], [0.5, 0.5, 0.5, 0.5]])
    covariances = np.tile(np.diag([1.0, 2, 3, 4, 5, 6]), (4, 1, 1))
    estimate = Trajectory(
        stamps=np.arange(4),
        positions=np.arange(12.0).reshape(4, 3),
        quaternions=quaternions,
        rows=np.arange(4),
        source="x",
        covariances=covariances,
    )
    pose = se3.exp(np.array([1.0, 2.0, 3.0, 0.4, 0.5, 0.6]))
    found = moved(estimate, pose)
    norms = np.linalg.norm(found.quaternions, axis=1)
    np.testing.assert_allclose(norms, [0, 2, np.nan, 1], atol=1e-12)
    before = se3.from_position_quaternion(estimate.positions[3], quaternions[3])
    after = se3.from_position_quaternion(found.positions[3], found.quaternions[3])
    np.testing.assert_allclose(after, pose @ before, atol=1e-12)
    # The same uncertainty, seen from the body.
    assert found.covariances is not None
    np.testing.assert_allclose(
        se3.covariance_from_fixed_axes(found.covariances[3], after),
        se3.covariance_from_fixed_axes(covariances[3], before),
        atol=1e-12,
    )
