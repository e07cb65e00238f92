# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate --mcap`` beside the node: the same topics, and played to it the same figures."""

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from test_demo import assert_live_is_as_from_files
from test_evaluate import evaluate, summary_of
from test_mcap import read, stamp_of, statuses

pytest.importorskip("rosbags", reason="rosbags is not installed")
pytest.importorskip("rclpy", reason="needs ROS 2")

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from node.harness import Graph
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[2]
METRICS = "/evaluator/metrics"
# What a burst has no room for comes 3 s later, at ten times the speed.
MAX_WAIT = "max_wait=60"


@pytest.fixture
def graph(domain: int, tmp_path: Path) -> Iterator[Graph]:
    made = Graph(domain, tmp_path)
    yield made
    made.close()


@pytest.fixture(scope="module")
def one(paths: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run's results and its bag."""
    folder = tmp_path_factory.mktemp("one")
    result = evaluate(
        "tum", *paths, "--output", folder, "--mcap", folder / "run.mcap", "--set", MAX_WAIT
    )
    assert result.returncode == 0, result.stderr
    return folder


def durabilities(path: Path) -> dict[str, bool]:
    """Whether each topic of a bag is for those who come later, too."""
    reader_of = pytest.importorskip("mcap.reader", reason="mcap is not installed")
    with path.open("rb") as file:
        summary = reader_of.make_reader(file).get_summary()
    return {
        channel.topic: "transient_local" in channel.metadata["offered_qos_profiles"]
        for channel in summary.channels.values()
    }


def test_topics_types_and_durability_are_the_nodes(graph: Graph, one: Path) -> None:
    types, _ = read(one / "run.mcap")
    latched = durabilities(one / "run.mcap")
    ours = {topic for topic in types if topic.startswith("/evaluator/")}
    graph.start_evaluator()

    def published() -> dict[str, Any]:
        names = [name for name, _ in graph.node.get_topic_names_and_types()]
        found = {name: graph.node.get_publishers_info_by_topic(name) for name in names}
        return {
            name: infos[0]
            for name, infos in found.items()
            if infos and name.startswith("/evaluator/")
        }

    graph.until(lambda: ours <= set(published()), "the node's topics")
    found = published()
    assert set(found) == ours
    for topic, info in found.items():
        assert info.topic_type == types[topic], topic
        assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE, topic
        durable = info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert durable == latched[topic], topic


def test_played_to_a_node_it_gives_the_same(graph: Graph, one: Path, tmp_path: Path) -> None:
    output = tmp_path / "live"
    name, value = MAX_WAIT.split("=")
    evaluator = graph.start_evaluator(
        use_sim_time=True, output__directory=str(output), **{name: float(value)}
    )
    heard = {
        "/evaluator/ground_truth/pose": PoseWithCovarianceStamped,
        "/evaluator/relative/translation_error": Vector3Stamped,
        "/evaluator/relative/rotation_error": Vector3Stamped,
    }
    live = {topic: graph.listen(kind, topic) for topic, kind in heard.items()}
    metrics = graph.listen(DiagnosticArray, METRICS)
    graph.until_known()
    bag = one / "run.mcap"
    topics = ("--ground-truth", "/ground_truth", "--estimate", "/estimate")
    player = graph.start(
        "-m", "trajeval_ros.commands.replay", "bag", str(bag), *topics, "--rate", "10"
    )
    graph.until(lambda: player.child.poll() is not None, "the end of the bag")
    assert player.child.returncode == 0, player.output
    count = len(read(bag)[1]["/estimate"])
    graph.until_accounted("estimate", count)
    assert evaluator.end() == 0, evaluator.output
    before = summary_of(one)
    assert_live_is_as_from_files(summary_of(output), before)
    _, messages = read(bag)
    for topic in heard:
        recorded = dict(messages[topic])
        graph.until(partial(live.get, topic), topic)
        for message in live[topic]:
            other = recorded[stamp_of(message)]
            assert numbers(message) == pytest.approx(numbers(other), rel=1e-9, abs=1e-12)
    last = messages[METRICS][-1][1]
    graph.until(lambda: metrics and stamp_of(metrics[-1]) == stamp_of(last), "the last metrics")
    ours, theirs = statuses(metrics[-1]), statuses(last)
    assert ours.keys() == theirs.keys()
    for status in ("relative", "conventional", "coverage"):
        for key, value in ours[status].items():
            if re.fullmatch(r"-?[\d.]+(e[-+]?\d+)?", value):
                assert float(value) == pytest.approx(float(theirs[status][key]), rel=1e-9), key
            else:
                assert value == theirs[status][key]


def numbers(message: Any) -> list[float]:
    """What a message of poses or vectors holds."""
    if hasattr(message, "vector"):
        return [message.vector.x, message.vector.y, message.vector.z]
    at, turned = message.pose.pose.position, message.pose.pose.orientation
    pose = [at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w]
    return [*pose, *map(float, message.pose.covariance)]


def test_the_dashboards_fit_it_at_once(one: Path) -> None:
    types, messages = read(one / "run.mcap")
    table = statuses(messages[METRICS][-1][1])
    foxglove = json.loads((ROOT / "dashboards" / "foxglove.json").read_text(encoding="utf-8"))
    panels = foxglove["configById"]
    shown = set(panels["3D!trajectory"]["topics"])
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    for path in paths:
        shown.add(path.partition(".")[0])
        asked = re.findall(r'=="([^"]+)"', path)
        if asked:
            assert asked[1] in table[asked[0]], path
    plotjuggler = ElementTree.parse(ROOT / "dashboards" / "plotjuggler.xml").getroot()
    selected = plotjuggler.find("Plugins/plugin/selected_topics")
    assert selected is not None
    shown |= set(selected.attrib["value"].split(";"))
    for curve in plotjuggler.iter("curve"):
        name = curve.attrib["name"]
        if name.startswith(f"{METRICS}/"):
            status, key = name.removeprefix(f"{METRICS}/").split("/")
            assert key in table[status]
    # Health is of a running process.
    assert shown - {"/diagnostics"} <= set(types)
    assert all(messages[topic] for topic in shown - {"/diagnostics"})
