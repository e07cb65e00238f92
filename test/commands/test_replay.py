# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``replay`` over real DDS, into a subscriber in another process."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros.commands.replay import split_ros_arguments
from trajeval_ros.commands.simulate import write_files
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.files.tum import read_tum

ROOT = Path(__file__).resolve().parents[2]
LISTENER = Path(__file__).with_name("listener.py")
PATIENCE = 120
"""How long a listener may wait for what it expects, s. Reached only when a test fails."""

ros = pytest.mark.ros

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_files(tmp_path_factory.mktemp("run"), 12.0, 3)


@pytest.fixture
def start(domain: int) -> Iterator[Start]:
    """Return a function that starts Python in the test's own domain; nothing outlives the test."""
    pytest.importorskip("rclpy", reason="needs ROS 2")
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    with ExitStack() as stack:

        def start(*arguments: object) -> subprocess.Popen[str]:
            process = subprocess.Popen(
                [sys.executable, *map(str, arguments)],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env=environment,
            )
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        yield start


@pytest.fixture
def replay(start: Start) -> Start:
    """Return a function that starts the command."""
    return partial(start, "-m", "trajeval_ros.commands.replay")


@ros
def test_every_message_arrives_once_and_exactly(
    run: tuple[Path, Path], start: Start, replay: Start
) -> None:
    expected = {"ground_truth": read_tum(run[0]), "estimate": read_tum(run[1])}
    total = sum(map(len, expected.values()))
    listener = start(LISTENER, "/mocap", "/odom", total, PATIENCE)
    player = replay(
        *("tum", *run, "--rate", 6, "--frame-id", "map"),
        *("--ros-args", "-r", "ground_truth:=/mocap", "-r", "estimate:=/odom"),
    )
    output, errors = player.communicate(timeout=2 * PATIENCE)
    heard: dict[str, Any] = json.loads(listener.communicate(timeout=2 * PATIENCE)[0])
    assert player.returncode == 0, errors
    counts = f"ground_truth {len(expected['ground_truth'])}, estimate {len(expected['estimate'])}"
    assert output.startswith(f"published {counts} in ")
    assert output.strip().endswith("all acknowledged")
    for name, frame in (("ground_truth", "map"), ("estimate", "odom")):
        trajectory = expected[name]
        assert [message[0] for message in heard[name]] == trajectory.stamps.tolist()
        assert {message[1] for message in heard[name]} == {frame}
        assert [message[2] for message in heard[name]] == trajectory.positions.tolist()
        assert [message[3] for message in heard[name]] == trajectory.quaternions.tolist()
    clock, came = np.array(heard["clock"]).T
    assert np.all(np.diff(clock) >= 0)
    stamps = np.concatenate([expected["ground_truth"].stamps, expected["estimate"].stamps])
    assert stamps.min() <= clock[0]
    assert clock[-1] == stamps.max()
    # No hole in the clock, not even in a dropout of 2.5 s, but where the machine stood still.
    assert np.diff(expected["ground_truth"].stamps).max() > 2.5e9
    assert np.all(np.diff(clock) < 1.5e9 + 6 * np.diff(came))


@ros
@pytest.mark.parametrize("name", ["PoseWithCovarianceStamped", "Odometry", "TransformStamped"])
def test_the_type_of_the_messages(
    name: str, run: tuple[Path, Path], start: Start, replay: Start
) -> None:
    expected = {"ground_truth": read_tum(run[0]), "estimate": read_tum(run[1])}
    total = sum(map(len, expected.values()))
    listener = start(LISTENER, "/ground_truth", "/estimate", total, PATIENCE, name)
    player = replay("tum", *run, "--rate", 12, "--type", name)
    _, errors = player.communicate(timeout=2 * PATIENCE)
    assert player.returncode == 0, errors
    heard: dict[str, Any] = json.loads(listener.communicate(timeout=2 * PATIENCE)[0])
    for topic, trajectory in expected.items():
        assert [message[0] for message in heard[topic]] == trajectory.stamps.tolist()
        assert [message[2] for message in heard[topic]] == trajectory.positions.tolist()
        assert [message[3] for message in heard[topic]] == trajectory.quaternions.tolist()


@ros
@pytest.mark.parametrize("covariances", [None, np.arange(36.0).reshape(1, 6, 6)])
def test_the_type_that_the_data_ask_for(covariances: Any) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    from trajeval_ros.commands import player

    trajectory = Trajectory(
        *(np.zeros(1, np.int64), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]])),
        *(np.ones(1, np.int64), "made up", covariances),
    )
    kind = player._kind(None, trajectory)
    assert kind.__name__ == ("PoseStamped" if covariances is None else "PoseWithCovarianceStamped")
    odometry = player._Template(player._kind("Odometry", trajectory), "map")
    given = None if covariances is None else covariances[0]
    odometry.fill(player._time(5), [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], given)
    message = odometry.message
    assert message.pose.covariance.tolist() == ([0.0] * 36 if given is None else [*range(36)])
    assert (message.header.frame_id, message.header.stamp.nanosec) == ("map", 5)
    assert message.child_frame_id == "base_link"
    transform = player._Template(player._kind("TransformStamped", trajectory), "map").message
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")


@ros
def test_a_stamp_that_does_not_fit_is_named_by_its_row(
    run: tuple[Path, Path], replay: Start, tmp_path: Path
) -> None:
    bad = tmp_path / "estimate.txt"
    bad.write_text("# stamp tx ty tz qx qy qz qw\n1750000001 0 0 0 0 0 0 1\n-2 0 0 0 0 0 0 1\n")
    player = replay("tum", run[0], bad, "--wait", 0)
    output, errors = player.communicate(timeout=2 * PATIENCE)
    assert player.returncode == 1
    assert output == f"{bad}: rows are not in the order of time (1 steps back): sorted\n"
    assert errors.strip() == f"replay: error: {bad}, row 3: the stamp does not fit a ROS message"


@ros
def test_nobody_listens(run: tuple[Path, Path], replay: Start) -> None:
    player = replay("tum", *run, "--wait", 0.5)
    output, errors = player.communicate(timeout=2 * PATIENCE)
    assert player.returncode == 1
    assert output == ""
    assert errors.strip() == (
        "replay: error: nobody subscribes to /ground_truth and /estimate (waited 0.5 s)"
    )


@ros
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_well(
    signal_number: int, run: tuple[Path, Path], start: Start, replay: Start
) -> None:
    once = sum(len(read_tum(path)) for path in run)
    listener = start(LISTENER, "/ground_truth", "/estimate", 2 * once, PATIENCE)
    player = replay("tum", *run, "--loop", "--rate", 50)
    listener.communicate(timeout=2 * PATIENCE)
    player.send_signal(signal_number)
    output, errors = player.communicate(timeout=2 * PATIENCE)
    assert player.returncode == 0, errors
    assert "Traceback" not in errors
    published = int(output.split("estimate ")[1].split()[0])
    assert published > len(read_tum(run[1]))
    assert output.strip().endswith("interrupted")


@pytest.mark.parametrize(
    ("option", "value"), [("--rate", "0"), ("--rate", "fast"), ("--wait", "-1")]
)
def test_wrong_usage(option: str, value: str, run: tuple[Path, Path]) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "trajeval_ros.commands.replay", "tum", *run, option, value],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert result.returncode == 2
    assert option in result.stderr


@ros
@pytest.mark.parametrize(
    "arguments", [("-r", "nonsense"), ("-r", "__node:=a/b"), ("--params-file", "/no/such.yaml")]
)
def test_wrong_ros_arguments(
    arguments: tuple[str, str], run: tuple[Path, Path], replay: Start
) -> None:
    player = replay("tum", *run, "--ros-args", *arguments)
    _, errors = player.communicate(timeout=2 * PATIENCE)
    assert player.returncode == 2
    ours = [line for line in errors.splitlines() if line.startswith("replay: error: ")]
    assert len(ours) == 1
    assert "Traceback" not in errors


def test_ros_arguments_are_ros() -> None:
    argv = ["tum", "a", "--ros-args", "-r", "x:=y", "--", "b", "--rate", "2"]
    assert split_ros_arguments(argv) == (
        ["tum", "a", "b", "--rate", "2"],
        ["--ros-args", "-r", "x:=y"],
    )
