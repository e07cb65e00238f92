# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every path in the dashboards leads to something that the node really publishes."""

import importlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from trajeval_ros import se3
from trajeval_ros.commands.domain import own_domain
from trajeval_ros.commands.simulation import simulate
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.runs.statuses import flatten

ROOT = Path(__file__).resolve().parents[2]
FOXGLOVE = json.loads((ROOT / "dashboards" / "foxglove.json").read_text(encoding="utf-8"))
PLOTJUGGLER = ElementTree.parse(ROOT / "dashboards" / "plotjuggler.xml").getroot()

METRICS = "/evaluator/metrics"


@pytest.fixture(scope="module")
def metrics() -> Mapping[str, Mapping[str, str]]:
    """The statuses and keys that the node publishes for a run."""
    run = simulate(20.0)
    engine = Engine({})
    samples = [
        PoseSamples(poses.stamps, *se3.to_position_quaternion(poses.poses))
        for poses in (run.ground_truth, run.estimate)
    ]
    for _ in feed(engine, *samples):
        pass
    return flatten(engine.summary())


def published(*arguments: str) -> dict[str, str]:
    """Topics and types of the real node, as the ROS graph has them."""
    rclpy = pytest.importorskip("rclpy", reason="needs ROS 2")
    from rclpy.signals import SignalHandlerOptions

    environment = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
    }
    with own_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        for name, value in environment.items():
            patch.setenv(name, value)
        node = subprocess.Popen([sys.executable, "-m", "trajeval_ros.node.main", *arguments])
        context = rclpy.context.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        watcher = rclpy.create_node("watcher", context=context)
        deadline = time.monotonic() + 120.0
        found: dict[str, str] = {}
        while time.monotonic() < deadline and not {METRICS, "/diagnostics"} <= set(found):
            time.sleep(0.2)
            try:
                names = watcher.get_publisher_names_and_types_by_node("evaluator", "/")
            except rclpy.node.NodeNameNonExistentError:
                continue
            found = {name: types[0] for name, types in names}
        watcher.destroy_node()
        rclpy.utilities.try_shutdown(context=context)
        node.send_signal(signal.SIGINT)
        assert node.wait(120.0) == 0
    return found


@pytest.fixture(scope="module")
def topics() -> dict[str, str]:
    return published()


def message(type_name: str) -> Any:
    """Return the class of ``package/msg/Name`` or, as fields have it, ``package/Name``."""
    package, *_, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def has_field(type_name: str, path: str) -> bool:
    """Whether a message type has a field such as ``pose.covariance[7]``."""
    for part in path.split("."):
        name, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", part).groups()  # type: ignore[union-attr]
        fields = message(type_name).get_fields_and_field_types()
        if name not in fields:
            return False
        kind = fields[name]
        array = re.fullmatch(r"([\w/]+)\[(\d*)\]", kind)
        if (index is not None) != (array is not None):
            return False
        if array is not None and array[2] and int(index) >= int(array[2]):
            return False
        type_name = array[1] if array is not None else kind
    return type_name in ("double", "float", "int32", "uint32")


def foxglove_paths() -> list[str]:
    return [
        path["value"]
        for panel in FOXGLOVE["configById"].values()
        for path in panel.get("paths", [])
    ]


def curves() -> list[str]:
    return [curve.attrib["name"] for curve in PLOTJUGGLER.iter("curve")]


def leaves(layout: Any) -> list[str]:
    if isinstance(layout, str):
        return [layout]
    return [*leaves(layout["first"]), *leaves(layout["second"])]


def test_every_foxglove_panel_is_placed_once() -> None:
    assert sorted(leaves(FOXGLOVE["layout"])) == sorted(FOXGLOVE["configById"])


@pytest.mark.parametrize("path", [p for p in foxglove_paths() if p.startswith(METRICS)])
def test_foxglove_metrics_exist(path: str, metrics: Mapping[str, Mapping[str, str]]) -> None:
    match = re.fullmatch(
        r'/evaluator/metrics\.status\[:\]\{name=="(\w+)"\}\.values\[:\]\{key=="(\w+)"\}\.value',
        path,
    )
    assert match is not None
    assert match[2] in metrics[match[1]]


@pytest.mark.ros
def test_foxglove_topics_and_fields_exist(topics: dict[str, str]) -> None:
    shown = FOXGLOVE["configById"]["3D!trajectory"]["topics"]
    assert set(shown) <= set(topics)
    assert FOXGLOVE["configById"]["DiagnosticSummary!health"]["topicToRender"] in topics
    for path in foxglove_paths():
        topic, _, field = path.partition(".")
        assert topic in topics, path
        if topic != METRICS:
            assert has_field(topics[topic], field), path


def test_plots_are_on_header_stamps() -> None:
    paths = [p for panel in FOXGLOVE["configById"].values() for p in panel.get("paths", [])]
    assert {path["timestampMethod"] for path in paths} == {"headerStamp"}
    assert PLOTJUGGLER.find("Plugins/plugin/use_header_stamp").attrib["value"] == "true"  # type: ignore[union-attr]


@pytest.mark.parametrize("curve", [c for c in curves() if c.startswith(METRICS)])
def test_plotjuggler_metrics_exist(curve: str, metrics: Mapping[str, Mapping[str, str]]) -> None:
    status, key = curve.removeprefix(f"{METRICS}/").split("/")
    assert key in metrics[status]


@pytest.mark.ros
def test_plotjuggler_topics_and_fields_exist(topics: dict[str, str]) -> None:
    selected = PLOTJUGGLER.find("Plugins/plugin/selected_topics")
    assert selected is not None
    listed = selected.attrib["value"].split(";")
    assert set(listed) <= set(topics)
    for curve in curves():
        topic = next(name for name in listed if curve.startswith(f"{name}/"))
        if topic != METRICS:
            assert has_field(topics[topic], curve.removeprefix(f"{topic}/").replace("/", ".")), (
                curve
            )


@pytest.mark.ros
def test_those_of_named_estimates_lead_somewhere(
    tmp_path: Path, metrics: Mapping[str, Mapping[str, str]]
) -> None:
    names = ["vins", "orb"]
    script = ROOT / "dashboards" / "for_estimates.py"
    subprocess.run([sys.executable, script, *names], cwd=tmp_path, check=True)
    foxglove = json.loads((tmp_path / "foxglove_vins_orb.json").read_text(encoding="utf-8"))
    plotjuggler = ElementTree.parse(tmp_path / "plotjuggler_vins_orb.xml").getroot()
    topics = published("--ros-args", "-p", "estimates:=[vins, orb]")

    shown = set(foxglove["configById"]["3D!trajectory"]["topics"])
    assert shown <= set(topics)
    assert {"/evaluator/vins/path", "/evaluator/orb/path", "/evaluator/ground_truth/path"} <= shown
    paths = [
        p["value"] for panel in foxglove["configById"].values() for p in panel.get("paths", ())
    ]
    assert len(paths) == 2 * len(foxglove_paths())
    for path in paths:
        topic, _, field = path.partition(".")
        assert topic in topics, path
        asked = re.findall(r'=="([^"]+)"', path)
        if asked:
            name, _, status = asked[0].partition(": ")
            assert name in names
            assert asked[1] in metrics[status]
        else:
            assert has_field(topics[topic], field), path
    selected = plotjuggler.find("Plugins/plugin/selected_topics")
    assert selected is not None
    assert set(selected.attrib["value"].split(";")) <= set(topics)
    drawn = [curve.attrib["name"] for curve in plotjuggler.iter("curve")]
    assert len(drawn) == 2 * len(curves())
    for curve in drawn:
        if curve.startswith(METRICS):
            status, key = curve.removeprefix(f"{METRICS}/").split("/")
            assert key in metrics[status.partition(": ")[2]]
        else:
            assert "/".join(curve.split("/")[:5]) in topics


def test_what_is_not_there_is_noticed() -> None:
    pytest.importorskip("geometry_msgs", reason="needs ROS 2")
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    assert has_field(kind, "pose.covariance[35]")
    assert has_field(kind, "pose.pose.position.x")
    for wrong in ("pose.covariance[36]", "pose.covariance", "pose.position.x", "pose.pose"):
        assert not has_field(kind, wrong)
