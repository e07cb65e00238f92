# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate bag`` on real bags."""

import json
import re
import subprocess
from pathlib import Path

import pytest
from test_evaluate import evaluate

ROOT = Path(__file__).resolve().parents[2]
BAGS = ROOT.parent / "shared" / "data" / "rosbags"


def evaluate_bag(*arguments: object) -> subprocess.CompletedProcess[str]:
    return evaluate("bag", *arguments)


def bag(name: str) -> Path:
    pytest.importorskip("rosbags", reason="needs the extra bags")
    path = BAGS / name
    if not path.exists():
        pytest.skip(f"the real data is not here: {path}")
    return path


def test_without_topics_the_candidates_are_listed() -> None:
    result = evaluate_bag(bag("nav2_turtlebot.mcap"))
    assert result.returncode == 0
    assert result.stderr == ""
    assert "Name two of them behind the bag" in result.stdout
    assert re.search(r"/odom +Odometry +2,639 +27\.3 Hz", result.stdout)
    assert re.search(r"/amcl_pose +PoseWithCovarianceStamped +135", result.stdout)


def test_the_list_of_topics_fits_a_terminal_of_80_columns() -> None:
    for name in ("nav2_turtlebot.mcap", "ROS_example.bag", "tf_example.bag"):
        assert max(map(len, evaluate_bag(bag(name)).stdout.splitlines())) <= 80


def test_a_fit_does_not_take_the_motion_for_an_error(tmp_path: Path) -> None:
    """Corrections of a localisation a few times a second are no metres a second of drift."""
    result = evaluate_bag(
        bag("nav2_turtlebot.mcap"), "/tf:map.base_link", "/odom", "--output", tmp_path
    )
    assert result.returncode == 0, result.stderr
    model = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["error_model"]
    assert model["scale"]["value"] == pytest.approx(1.0, abs=0.05)
    assert model["translation"]["long_run_drift"]["value"] < 0.05
    # No step of the odometry differs from the ground truth's by more than a few centimetres.
    assert max(jump["translation"] for jump in model["jumps"]) < 0.1


def test_two_topics_are_scored_by_header_stamps(tmp_path: Path) -> None:
    result = evaluate_bag(
        bag("nav2_turtlebot.mcap"),
        *("--ground-truth", "/odom", "--estimate", "/amcl_pose", "--output", tmp_path),
    )
    assert result.returncode == 0, result.stderr
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["estimate"]["received"] == 135
    assert summary["estimate"]["evaluated"] > 100
    stamp = (tmp_path / "poses.csv").read_text(encoding="utf-8").splitlines()[1].split(",")[0]
    # simulated time begins near 0; the log was written in 2026
    assert int(stamp) < 1e15


def test_a_topic_that_is_not_there_is_named_with_those_that_are() -> None:
    result = evaluate_bag(
        bag("ROS_example.bag"), "--ground-truth", "groundtruth", "--estimate", "orb"
    )
    assert result.returncode == 1
    assert len(result.stderr.strip().splitlines()[-1:]) == 1
    assert "no topic 'orb'" in result.stderr
    assert "ORB-SLAM" in result.stderr


def test_a_file_that_is_no_bag(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="needs the extra bags")
    path = tmp_path / "notes.bag"
    path.write_text("not a bag\n", encoding="utf-8")
    result = evaluate_bag(path, "--ground-truth", "a", "--estimate", "b")
    assert result.returncode == 1
    assert "notes.bag" in result.stderr
    assert "Traceback" not in result.stderr
