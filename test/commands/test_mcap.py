# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate --mcap``: the bag holds what ``summary.json`` and ``poses.csv`` do."""

import csv
import os
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_evaluate import evaluate, summary_of
from twins.path_bags import Store, samples, write
from twins.runs import assert_same_summary, simulated

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.runs.statuses import NUMBERS, error_model_entries, flatten

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

NAMES = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
FLOAT, VECTOR = "std_msgs/msg/Float64", "geometry_msgs/msg/Vector3Stamped"
POSE = "geometry_msgs/msg/PoseStamped"
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TABLE, PATH = "diagnostic_msgs/msg/DiagnosticArray", "nav_msgs/msg/Path"
# Of an estimate, below the node's name or its own.
OF_EACH = {
    "relative/log_likelihood": FLOAT,
    "absolute/log_likelihood": FLOAT,
    **dict.fromkeys(NUMBERS, FLOAT),
    "relative/translation_error": VECTOR,
    "relative/rotation_error": VECTOR,
    "absolute/translation_error": VECTOR,
    "absolute/rotation_error": VECTOR,
    "ground_truth/pose": WITH_COVARIANCE,
}
OF_ALL = {
    "/ground_truth": POSE,
    "/evaluator/ground_truth/path": PATH,
    "/evaluator/markers": "visualization_msgs/msg/MarkerArray",
    "/evaluator/metrics": TABLE,
}
OF_ONE = {
    **OF_ALL,
    **{f"/evaluator/{name}": kind for name, kind in OF_EACH.items()},
    "/estimate": POSE,
    "/evaluator/estimate/path": PATH,
}


def stamp_of(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def read(path: Path) -> tuple[dict[str, str], dict[str, list[tuple[int, Any]]]]:
    """Types and messages with their times of a bag, by topic."""
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([path], default_typestore=store) as reader:
        types = {one.topic: one.msgtype for one in reader.connections}
        for connection, when, raw in reader.messages():
            found[connection.topic].append((when, reader.deserialize(raw, connection.msgtype)))
    return types, found


def statuses(message: Any) -> dict[str, dict[str, str]]:
    return {one.name: {each.key: each.value for each in one.values} for one in message.status}


def numbers_of(tables: dict[str, dict[str, str]]) -> dict[str, dict[str, float | str]]:
    """The same, with what is a number read: figures are computed for a message and for a file."""
    return {name: {key: read_value(v) for key, v in each.items()} for name, each in tables.items()}


def read_value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def expected_statuses(summary: dict[str, Any]) -> dict[str, dict[str, str]]:
    window = dict(summary["window"])
    models = {"run": summary["error_model"], "window": window.pop("error_model")}
    found = flatten({**summary, "window": window})
    return {**found, "error_model": error_model_entries(models)}


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "poses.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def one(paths: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run's results, and its bag in a folder that was not there."""
    folder = tmp_path_factory.mktemp("one")
    bag = folder / "bags" / "run.mcap"
    result = evaluate("tum", *paths, "--output", folder, "--mcap", bag)
    assert result.returncode == 0, result.stderr
    assert f"Written: {bag}" in result.stdout
    assert os.listdir(bag.parent) == ["run.mcap"]
    return folder


def test_the_topics_are_the_nodes(one: Path) -> None:
    types, messages = read(one / "bags" / "run.mcap")
    assert types == OF_ONE
    assert all(messages[topic] for topic in types)


def test_every_message_is_logged_at_its_stamp(one: Path) -> None:
    _, messages = read(one / "bags" / "run.mcap")
    for topic, found in messages.items():
        times = [when for when, _ in found]
        assert times == sorted(times), topic
        for when, message in found:
            if hasattr(message, "header"):
                assert when == stamp_of(message), topic


def test_poses_and_errors_are_those_of_the_table(one: Path) -> None:
    rows = rows_of(one)
    _, messages = read(one / "bags" / "run.mcap")
    answers = [message for _, message in messages["/evaluator/ground_truth/pose"]]
    assert [stamp_of(message) for message in answers] == [int(row["stamp_ns"]) for row in rows]
    for message, row in zip(answers, rows, strict=True):
        at, turned = message.pose.pose.position, message.pose.pose.orientation
        ours = (at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w)
        theirs = [float(row[f"gt_{name}"]) for name in NAMES]
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)
    for part, first in (("translation", 0), ("rotation", 3)):
        errors = messages[f"/evaluator/relative/{part}_error"]
        told = [row for row in rows if row["e_0"]]
        assert [when for when, _ in errors] == [int(row["stamp_ns"]) for row in told]
        ours = [(each.vector.x, each.vector.y, each.vector.z) for _, each in errors]
        theirs = [[float(row[f"e_{first + axis}"]) for axis in range(3)] for row in told]
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)
    running = [message.data for _, message in messages["/evaluator/relative/log_likelihood"]]
    shares = [float(row["log_likelihood"]) for row in rows]
    np.testing.assert_allclose(running, np.cumsum(shares), rtol=1e-9, atol=1e-9)


def test_the_last_figures_are_those_of_the_summary(one: Path) -> None:
    summary = summary_of(one)
    _, messages = read(one / "bags" / "run.mcap")
    expected = expected_statuses(summary)
    last_ones = statuses(messages["/evaluator/metrics"][-1][1])
    assert_same_summary(numbers_of(last_ones), numbers_of(expected))
    assert len(messages["/evaluator/metrics"]) > 5
    for topic, (status, key) in NUMBERS.items():
        last = messages[f"/evaluator/{topic}"][-1][1].data
        assert last == pytest.approx(float(expected[status][key]), rel=1e-9)
    for which in ("relative", "absolute"):
        last = messages[f"/evaluator/{which}/log_likelihood"][-1][1].data
        assert last == pytest.approx(summary[which]["log_likelihood"], rel=1e-9)


def test_the_estimates_path_is_aligned_as_the_likelihood_has_it(one: Path) -> None:
    alignment = summary_of(one)["absolute"]["alignment"]
    pose = np.array(alignment["pose"])
    world = Similarity(se3.from_position_quaternion(pose[:3], pose[3:]), alignment["scale"])
    rows = {int(row["stamp_ns"]): row for row in rows_of(one)}
    _, messages = read(one / "bags" / "run.mcap")
    path = messages["/evaluator/estimate/path"][-1][1]
    assert len(path.poses) > 100
    numbers = np.array(
        [[float(rows[stamp_of(p)][f"est_{name}"]) for name in NAMES] for p in path.poses]
    )
    expected = world.apply(se3.from_position_quaternion(numbers[:, :3], numbers[:, 3:]))
    shown = [(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in path.poses]
    np.testing.assert_allclose(shown, expected[:, :3, 3], atol=1e-9)


def test_a_second_library_reads_the_same(one: Path) -> None:
    reader_of = pytest.importorskip("mcap.reader", reason="mcap is not installed")
    path = one / "bags" / "run.mcap"
    types, messages = read(path)
    store = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with path.open("rb") as file:
        reader = reader_of.make_reader(file)
        assert reader.get_header().profile == "ros2"
        for schema, channel, message in reader.iter_messages():
            assert schema.name == types[channel.topic]
            read_back = store.deserialize_cdr(message.data, schema.name)
            found[channel.topic].append((message.log_time, read_back))
        latched = {
            channel.topic
            for channel in reader.get_summary().channels.values()
            if "transient_local" in channel.metadata["offered_qos_profiles"]
        }
    assert {name: len(each) for name, each in found.items()} == {
        name: len(each) for name, each in messages.items()
    }
    metrics = found["/evaluator/metrics"][-1][1]
    assert_same_summary(
        numbers_of(statuses(metrics)), numbers_of(expected_statuses(summary_of(one)))
    )
    assert latched == {
        "/evaluator/ground_truth/path",
        "/evaluator/estimate/path",
        "/evaluator/markers",
    }


def test_evaluated_again_the_figures_are_the_same(one: Path, tmp_path: Path) -> None:
    result = evaluate(
        "bag",
        one / "bags" / "run.mcap",
        "--ground-truth",
        "/ground_truth",
        "--estimate",
        "/estimate",
        "--output",
        tmp_path,
    )
    assert result.returncode == 0, result.stderr
    again, before = summary_of(tmp_path), summary_of(one)
    for summary in (again, before):
        del summary["inputs"]
    assert_same_summary(again, before)
    for ours, theirs in zip(rows_of(tmp_path), rows_of(one), strict=True):
        assert ours.keys() == theirs.keys()
        for name, value in theirs.items():
            if value.strip():
                assert float(ours[name]) == pytest.approx(float(value), rel=1e-9, abs=1e-9)
            else:
                assert not ours[name].strip()


def test_several_have_namespaces(paths: tuple[Path, Path], tmp_path: Path) -> None:
    truth, estimate = paths
    sparse = tmp_path / "sparse.txt"
    lines = estimate.read_text(encoding="utf-8").splitlines()
    sparse.write_text("\n".join(lines[::2]) + "\n", encoding="utf-8")
    bag = tmp_path / "run.mcap"
    result = evaluate("tum", truth, estimate, sparse, "--output", tmp_path, "--mcap", bag)
    assert result.returncode == 0, result.stderr
    types, messages = read(bag)
    names = ("estimate", "sparse")
    assert types == {
        **OF_ALL,
        "/evaluator/comparison": TABLE,
        **{f"/{name}": POSE for name in names},
        **{f"/evaluator/{name}/path": PATH for name in names},
        **{f"/evaluator/{name}/{topic}": k for name in names for topic, k in OF_EACH.items()},
    }
    summary = summary_of(tmp_path)
    tables = [statuses(message) for _, message in messages["/evaluator/metrics"]]
    for name in names:
        last = [table for table in tables if f"{name}: relative" in table][-1]
        expected = expected_statuses(summary["estimates"][name])
        named = {f"{name}: {status}": values for status, values in expected.items()}
        assert_same_summary(numbers_of(last), numbers_of(named))
    ((_, compared),) = messages["/evaluator/comparison"]
    (pair,) = compared.status
    assert pair.name == "estimate vs sparse"
    assert pair.message in result.stdout
    namespaces = {marker.ns for marker in messages["/evaluator/markers"][-1][1].markers}
    assert namespaces == {"estimate: error", "sparse: error", "uncertainty"}


def test_a_path_has_its_latest_figures(tmp_path: Path) -> None:
    """Online and after the last closure, as in the summary; a folder that is made is said."""
    made, store = simulated(3, 15.0), Store()
    poses = np.concatenate([made.estimate.positions, made.estimate.quaternions], axis=1)
    messages = []
    for count in (60, 100, len(poses)):
        corrected = poses[:count].copy()
        corrected[:, :3] += 0.3 * (len(poses) - count) / len(poses)
        whole = samples(made.estimate.stamps[:count].tolist(), corrected)
        stamp = int(whole.stamps[-1])
        messages.append(store.path(stamp, "map", ["map"] * count, whole)[1])
    bag, truth = write(tmp_path, "mcap", store.store, messages), tmp_path / "truth.txt"
    rows = zip(
        made.ground_truth.stamps / 1e9,
        np.concatenate([made.ground_truth.positions, made.ground_truth.quaternions], axis=1),
        strict=True,
    )
    text = (f"{t:.9f} {' '.join(map(repr, map(float, row)))}\n" for t, row in rows)
    truth.write_text("".join(text))
    target = tmp_path / "new" / "run.mcap"
    output = ("--output", tmp_path / "out", "--mcap", target)
    result = evaluate(f"tum:{truth}", f"bag:{bag}:/path", *output)
    assert result.returncode == 0, result.stderr
    assert f"Written: {target} (its folder is new)" in result.stdout
    summary = summary_of(tmp_path / "out")
    _, found = read(target)
    latest = statuses(found["/evaluator/metrics"][-1][1])["latest_path"]
    expected = summary["latest_path"]
    for key in ("ate_translation_rmse", "ate_rotation_rmse"):
        assert float(latest[key]) == pytest.approx(expected[key], rel=1e-9)
        assert float(latest[f"online_{key}"]) == pytest.approx(expected["online"][key], rel=1e-9)
    assert expected["ate_translation_rmse"] < expected["online"]["ate_translation_rmse"]


def test_a_bag_that_cannot_be_written_leaves_nothing(
    paths: tuple[Path, Path], tmp_path: Path
) -> None:
    taken = tmp_path / "run.mcap"
    taken.mkdir()
    result = evaluate("tum", *paths, "--mcap", taken)
    assert result.returncode == 1
    assert result.stderr.startswith(f"evaluate: error: cannot write {taken}: ")
    assert len(result.stderr.splitlines()) == 1
    assert "ATE" in result.stdout
    assert os.listdir(tmp_path) == ["run.mcap"]
    assert os.listdir(taken) == []


def test_without_the_library_one_line(
    paths: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    from trajeval_ros.commands import evaluate as command

    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    bag = tmp_path / "run.mcap"
    assert command.main(["tum", *map(str, paths), "--mcap", str(bag)]) == 1
    said = capsys.readouterr()
    assert said.err.splitlines() == [
        "evaluate: error: --mcap: writing bags needs the library rosbags: pip install rosbags"
    ]
    assert said.out == ""
    assert not bag.exists()
