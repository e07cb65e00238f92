# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The process: how it starts, refuses, changes, saves and ends."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import stat
from dataclasses import replace
from pathlib import Path

import data
import listener as listener_process
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from harness import Graph, Process, accounted, values_of
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as Path_
from std_msgs.msg import Float64

from trajeval_ros.online.parameters import PARAMETERS

pytestmark = pytest.mark.ros

FIXED = {"gp__hyperparameters": "fixed"}


def play(graph: Graph, duration: float = 6.0) -> tuple[int, int]:
    """Publish a short run; return the numbers of messages."""
    truth, estimate = data.run(duration)
    publishers = [graph.publisher(topic) for topic in ("ground_truth", "estimate")]
    graph.until_heard(*publishers)
    data.publish_in_order(
        publishers, [data.messages(PoseStamped, each) for each in (truth, estimate)]
    )
    return len(truth), len(estimate)


def play_and_wait(graph: Graph) -> tuple[int, int]:
    """Publish a short run, and wait until each of its messages is accounted for."""
    counts = play(graph)
    for topic, count in zip(("ground_truth", "estimate"), counts, strict=True):
        graph.until_accounted(topic, count)
    return counts


def ready(graph: Graph) -> None:
    graph.until(graph.health, "diagnostics")


def summary_in(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "gauge:=so3"], "gauge must be one of se3, none"),
        (["-p", "ground_truth.lags:=0.3"], "unknown parameter ground_truth.lags"),
        (["-p", "max_wait:=-1.0"], "max_wait must be at least 0.0, got -1.0"),
        (["-p", "estimate.use_covariance:=maybe"], "estimate.use_covariance must be a bool"),
        (["-p", "extrinsic:=[1.0, 2.0]"], "extrinsic must be seven finite numbers"),
        (["-p", "use_sim_time:=2"], "use_sim_time must be a bool, got 2"),
        (["--params-file", "/does/not/exist.yaml"], "/does/not/exist.yaml"),
    ],
)
def test_wrong_parameters_are_refused_by_name(
    graph: Graph, arguments: list[str], words: str
) -> None:
    node = graph.start_evaluator(*arguments)
    assert node.wait() == 2, node.output
    assert "Traceback" not in node.output
    ours = [line for line in node.output.splitlines() if line.startswith("evaluator: error: ")]
    assert len(ours) == 1
    assert words in ours[0]


def test_an_unknown_argument_is_refused(graph: Graph) -> None:
    node = graph.start("-m", "trajeval_ros.node.main", "bag")
    assert node.wait() == 2
    assert node.output.startswith("evaluator: error: unknown argument bag")


def test_what_is_missing_is_said_until_it_comes_and_the_end_has_the_figures(graph: Graph) -> None:
    other = graph.publisher("odom", Odometry)
    node = graph.start_evaluator(**FIXED)
    graph.until(lambda: "waiting for /estimate and /ground_truth" in node.output, "a word at once")
    graph.until(lambda: "there is /odom (Odometry): remap with -r" in node.output, "another topic")
    numbers = {
        topic: graph.listen(Float64, f"/evaluator/{topic}")
        for topic in ("ate/translation", "re/rotation", "accuracy/translation", "coverage/time")
    }
    play_and_wait(graph)
    said = node.output.count("waiting for")
    assert node.end() == 0
    assert node.output.count("waiting for") == said
    assert re.search(r"estimates: \d+ received, \d+ evaluated", node.output)
    assert "coverage: 100 % of" in node.output
    assert re.search(r"ATE, RMSE: [\d.e-]+ m, [\d.e-]+ deg", node.output)
    for topic, heard in numbers.items():
        graph.until(lambda heard=heard: heard, topic)
    assert numbers["coverage/time"][-1].data == 1.0
    assert 0.0 < numbers["ate/translation"][-1].data < 1.0
    graph.node.destroy_publisher(other)


def test_help(graph: Graph) -> None:
    node = graph.start("-m", "trajeval_ros.node.main", "--help")
    assert node.wait() == 0
    assert node.output.startswith("usage: evaluator")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_delivered_twice_ends_it_well(
    graph: Graph, tmp_path: Path, number: signal.Signals
) -> None:
    out = tmp_path / "out"
    node = graph.start_evaluator(output__directory=str(out), **FIXED)
    counts = play_and_wait(graph)
    node.send(number)
    node.send(number)
    # The second one while it is writing.
    graph.until(lambda: (out / "poses.csv").exists() or node.child.poll() is not None, "writing")
    if node.child.poll() is None:
        node.send(number)
    assert node.wait() == 0, node.output
    assert "Traceback" not in node.output
    summary = summary_in(out)
    assert summary["ground_truth"]["received"] == counts[0]
    assert summary["estimate"]["received"] == counts[1]
    assert accounted(summary["estimate"], "evaluated")
    assert {path.name for path in out.iterdir()} == {"summary.json", "poses.csv", "report.html"}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_nothing_that_was_evaluated_is_overwritten_by_less(
    graph: Graph, tmp_path: Path, number: signal.Signals
) -> None:
    out = tmp_path / "out"
    node = graph.start_evaluator(output__directory=str(out), **FIXED)
    counts = play_and_wait(graph)
    assert graph.call("/evaluator/save").success
    saved = summary_in(out)["estimate"]["evaluated"]
    assert saved > 0
    answer = graph.call("/evaluator/reset")
    assert answer.success
    assert answer.message == f"started over; the run so far is in {out / 'run_1'}"
    assert node.end(number) == 0, node.output
    for folder in (out, out / "run_1"):
        summary = summary_in(folder)
        assert summary["estimate"]["received"] == counts[1]
        assert summary["estimate"]["evaluated"] >= saved
        rows = (folder / "poses.csv").read_text(encoding="utf-8").count("\n") - 1
        assert rows == summary["estimate"]["evaluated"]
        assert (folder / "report.html").stat().st_size > 0


def test_a_signal_while_it_starts_ends_it_well(graph: Graph) -> None:
    node = graph.start_evaluator()
    # Before it is there it has Python's own answer; once it answers, ours.
    graph.until(lambda: caught(node), "its own signal handler")
    node.send(signal.SIGTERM)
    assert node.wait() == 0, node.output
    assert node.output.count("Traceback") == 0


def caught(node: Process) -> bool:
    """Whether the process catches SIGTERM."""
    text = Path(f"/proc/{node.child.pid}/status").read_text(encoding="utf-8")
    mask = next(line for line in text.splitlines() if line.startswith("SigCgt:")).split()[1]
    return bool(int(mask, 16) >> (signal.SIGTERM - 1) & 1)


def test_save_reset_and_parameters_at_run_time(graph: Graph, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    node = graph.start_evaluator(**FIXED)
    counts = play_and_wait(graph)

    refused = graph.call("/evaluator/save")
    assert not refused.success
    assert refused.message == "output.directory is not set"
    assert graph.set_parameter("output.directory", str(first)).successful
    saved = graph.call("/evaluator/save")
    assert saved.success, saved.message
    assert saved.message == f"written to {first}"
    summary = summary_in(first)
    assert summary["estimate"]["received"] == counts[1]
    assert summary["window"]["poses"] == summary["estimate"]["evaluated"]
    assert summary["likely_causes"] == []

    # A shorter window shows at once when the next pose comes; an integer is taken as a number.
    assert graph.set_parameter("window.duration", 2).successful
    for name, value, words in (
        ("window.duration", 0.5, "window.duration"),
        ("window.duration", "long", "Wrong parameter type"),
        ("gauge", "none", "gauge"),
        ("output.directory", "/proc/nowhere", "cannot write the output folder: /proc/nowhere"),
    ):
        result = graph.set_parameter(name, value)
        assert not result.successful, name
        assert words in result.reason

    # All or none: what stands before the wrong one has no effect either.
    third = tmp_path / "third"
    for wrong in ({"window.duration": 0.5}, {"use_sim_time": "yes"}, {"gauge": "none"}):
        assert not graph.set_parameters({"output.directory": str(third), **wrong}).successful
    assert not third.exists()
    assert not graph.set_parameters(
        {"window.duration": 20.0, "output.directory": "/proc/nowhere"}
    ).successful

    path = graph.listen(Path_, "/evaluator/estimate/path", latched=True)
    graph.until(lambda: path and path[-1].poses, "a path")
    assert graph.call("/evaluator/reset").success
    graph.until(lambda: not path[-1].poses, "an empty path")
    graph.until(lambda: values_of(graph.health()["estimate"])["received"] == "0", "a new count")
    assert graph.set_parameter("output.directory", str(second)).successful
    assert graph.call("/evaluator/save").success
    assert summary_in(second)["estimate"]["received"] == 0
    counts = play_and_wait(graph)
    assert node.end() == 0
    summary = summary_in(second)
    assert summary["estimate"]["received"] == counts[1]
    assert summary["window"]["duration"] <= 2.0
    assert summary["window"]["poses"] < summary["estimate"]["evaluated"]


def test_an_estimate_that_never_turns_is_survived_and_said(graph: Graph, tmp_path: Path) -> None:
    out = tmp_path / "out"
    node = graph.start_evaluator(output__directory=str(out), **FIXED)
    truth, estimate = data.run(10.0)
    upright = replace(estimate, quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (len(estimate), 1)))
    publishers = [graph.publisher(topic) for topic in ("ground_truth", "estimate")]
    graph.until_heard(*publishers)
    data.publish_in_order(
        publishers, [data.messages(PoseStamped, each) for each in (truth, upright)]
    )
    graph.until_accounted("estimate", len(upright))
    graph.until_health("consistency", "the estimate's orientation never changes")
    assert graph.call("/evaluator/save").success
    assert node.end() == 0
    assert "Traceback" not in node.output
    assert sorted(os.listdir(out)) == ["poses.csv", "report.html", "summary.json"]
    summary = summary_in(out)
    assert accounted(summary["estimate"], "evaluated")
    assert [cause["code"] for cause in summary["likely_causes"]] == ["constant_orientation"]


def test_a_folder_that_cannot_be_written_is_said_and_survived(graph: Graph, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    node = graph.start_evaluator(output__directory=str(tmp_path / "file" / "out"), **FIXED)
    graph.until_health("performance", "cannot write the output folder", level=2)
    counts = play(graph)
    graph.until_accounted("estimate", counts[1])
    refused = graph.call("/evaluator/save")
    assert not refused.success
    assert "cannot write the output folder" in refused.message
    # It becomes writable: all is written but the rows from before, and that is said.
    (tmp_path / "file").unlink()
    saved = graph.call("/evaluator/save")
    assert "poses.csv lacks" in saved.message
    assert not saved.success
    graph.until_health("performance", "poses.csv lacks", level=2)
    assert summary_in(tmp_path / "file" / "out")["estimate"]["received"] == counts[1]
    assert node.end() == 1


@pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="the limit stands for a full disk")
def test_a_full_disk_at_the_end_costs_what_does_not_fit(graph: Graph, tmp_path: Path) -> None:
    out = tmp_path / "out"
    node = graph.start_evaluator(output__directory=str(out), **FIXED)
    counts = play_and_wait(graph)
    resource.prlimit(node.child.pid, resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))
    assert node.end() == 1
    assert sorted(os.listdir(out)) == ["poses.csv", "summary.json"]
    summary = summary_in(out)
    assert summary["estimate"]["received"] == counts[1]
    assert f"estimates: {counts[1]} received, {summary['estimate']['evaluated']}" in node.output
    assert "ATE, RMSE: " in node.output
    assert "report.html: File too large" in node.output
    assert "Traceback" not in node.output


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_makes_the_exit_code_one(graph: Graph, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    out.chmod(stat.S_IRUSR | stat.S_IXUSR)
    node = graph.start_evaluator(output__directory=str(out))
    ready(graph)
    assert node.end() == 1


def test_a_folder_that_never_was_writable_makes_the_exit_code_one(
    graph: Graph, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("in the way")
    node = graph.start_evaluator(output__directory=str(tmp_path / "file" / "out"))
    ready(graph)
    assert node.end() == 1
    assert "Traceback" not in node.output


def test_the_default_file_and_a_dump_reproduce_the_parameters(graph: Graph, tmp_path: Path) -> None:
    import yaml
    from rcl_interfaces.srv import GetParameters, ListParameters
    from rclpy.parameter import parameter_value_to_python

    default = Path(__file__).parent.parent.parent / "config" / "evaluator.yaml"
    changed = default.read_text(encoding="utf-8").replace(
        "window.duration: 30.0", "window.duration: 7"
    )
    changed += "    qos_overrides./estimate.subscription.depth: 5\n"
    (tmp_path / "mine.yaml").write_text(changed, encoding="utf-8")

    def ask(kind: type, service: str, request: object) -> object:
        client = graph.node.create_client(kind, service)
        graph.until(client.service_is_ready, service)
        return graph.answer(client, request, service)

    def dump(node: str) -> dict:
        names = ask(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        wanted = list(names.result.names)
        request = GetParameters.Request(names=wanted)
        values = ask(GetParameters, f"{node}/get_parameters", request).values
        return dict(zip(wanted, map(parameter_value_to_python, values), strict=True))

    graph.start_evaluator("--params-file", str(tmp_path / "mine.yaml"))
    first = dump("/evaluator")
    assert first["window.duration"] == 7.0
    assert set(PARAMETERS) <= set(first)
    plain = {k: list(v) if hasattr(v, "typecode") else v for k, v in first.items()}
    dumped = {"/robot/evaluator": {"ros__parameters": plain}}
    (tmp_path / "dump.yaml").write_text(yaml.safe_dump(dumped), encoding="utf-8")
    graph.start_evaluator("-r", "__ns:=/robot", "--params-file", str(tmp_path / "dump.yaml"))
    assert dump("/robot/evaluator") == first


def test_two_in_two_namespaces(graph: Graph, tmp_path: Path) -> None:
    nodes = [
        graph.start_evaluator(
            "-r", f"__ns:=/{name}", output__directory=str(tmp_path / name), **FIXED
        )
        for name in ("one", "two")
    ]
    sizes = {}
    for name, duration in (("one", 4.0), ("two", 5.0)):
        truth, estimate = data.run(duration)
        publishers = [graph.publisher(f"/{name}/{t}") for t in ("ground_truth", "estimate")]
        graph.until_heard(*publishers)
        streams = [data.messages(PoseStamped, each) for each in (truth, estimate)]
        data.publish_in_order(publishers, streams)
        sizes[name] = (len(truth), len(estimate))
    for name, (truth_size, estimate_size) in sizes.items():
        graph.until(
            lambda name=name, size=truth_size: received(graph, name, "ground truth") == size, name
        )
        graph.until(
            lambda name=name, size=estimate_size: received(graph, name, "estimate") == size, name
        )
    assert [node.end() for node in nodes] == [0, 0]
    for name, (_, estimate_size) in sizes.items():
        assert summary_in(tmp_path / name)["estimate"]["received"] == estimate_size


def received(graph: Graph, namespace: str, topic: str) -> int:
    status = graph.health(f"{namespace}/evaluator").get(topic)
    return -1 if status is None else int(values_of(status).get("received", -1))


def test_a_subscriber_that_stands_still_slows_nothing(graph: Graph, tmp_path: Path) -> None:
    """A reliable subscriber to everything that has stopped taking its messages."""
    graph.start_evaluator(output__directory=str(tmp_path / "out"), **FIXED)
    listener = graph.start(str(Path(listener_process.__file__)))
    graph.rehearse(
        lambda: all(f"heard {topic}\n" in listener.output for topic in listener_process.TOPICS),
        "every topic at the listener",
    )
    listener.send(signal.SIGSTOP)
    counts = play(graph, 20.0)
    # Were each message to wait for room, 100 ms with Fast DDS, all this would take minutes.
    graph.until_accounted("ground_truth", counts[0])
    graph.until_accounted("estimate", counts[1])
    assert graph.call("/evaluator/save").success


def test_paths_and_markers_are_bounded_and_cleared(graph: Graph) -> None:
    from nav_msgs.msg import Path as PathMessage
    from visualization_msgs.msg import Marker, MarkerArray

    graph.start_evaluator(**FIXED)
    play(graph, 30.0)
    # Subscribed only now: they are latched, and served to whoever comes.
    truth = graph.listen(PathMessage, "/evaluator/ground_truth/path", latched=True)
    estimate = graph.listen(PathMessage, "/evaluator/estimate/path", latched=True)
    markers = graph.listen(MarkerArray, "/evaluator/markers", latched=True)
    graph.until(lambda: truth and estimate and markers, "paths and markers")
    graph.until(lambda: len(truth[-1].poses) > 500, "the whole path")
    assert len(truth[-1].poses) <= 1000
    assert {truth[-1].header.frame_id, estimate[-1].header.frame_id} == {"map"}
    graph.until(lambda: len(estimate[-1].poses) == len(truth[-1].poses), "both of one length")
    for one, other in zip(truth[-1].poses, estimate[-1].poses, strict=True):
        # The estimate is in a world of its own; here it is aligned.
        assert abs(one.pose.position.x - other.pose.position.x) < 0.2
        assert one.header.stamp == other.header.stamp
    kinds = [marker.type for marker in markers[-1].markers]
    assert kinds == [Marker.LINE_LIST] + 50 * [Marker.SPHERE]
    assert all(marker.scale.x > 0.0 for marker in markers[-1].markers)
    assert graph.call("/evaluator/reset").success
    graph.until(lambda: markers[-1].markers[0].action == Marker.DELETEALL, "no more markers")
