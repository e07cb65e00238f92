# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishers of every kind, late, vanishing, changing; and what cannot be heard is named."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import data
import pytest
from geometry_msgs.msg import PoseArray, PoseStamped, TransformStamped
from harness import Graph, save_samples, values_of
from nav_msgs.msg import Odometry

from trajeval_ros.node.decode import POSE_TYPES

pytestmark = pytest.mark.ros

FIXED = {"gp__hyperparameters": "fixed"}
TRUTH, ESTIMATE = data.run(4.0)


@pytest.mark.parametrize(
    ("name", "reliable"),
    [
        ("PoseStamped", False),
        ("PoseWithCovarianceStamped", True),
        ("Odometry", False),
        ("TransformStamped", True),
    ],
)
def test_every_type_is_found_and_heard(graph: Graph, name: str, reliable: bool) -> None:
    kind = POSE_TYPES[name].message
    graph.start_evaluator(**FIXED)
    publishers = [graph.publisher(t, kind, reliable=reliable) for t in ("ground_truth", "estimate")]
    graph.until_heard(*publishers)
    streams = [data.messages(kind, each) for each in (TRUTH, ESTIMATE)]
    # Slow enough for best effort on a busy machine.
    data.publish_in_order(publishers, streams, rate=1000.0)
    values = graph.until_accounted("estimate", len(ESTIMATE))
    assert values["type"] == name
    assert values["reliability"] == ("reliable" if reliable else "best_effort")
    graph.until_accounted("ground_truth", len(TRUTH))
    graph.until(
        lambda: int(values_of(graph.health()["estimate"])["evaluated"]) > 0, "an evaluated pose"
    )


def test_latched_messages_from_before_the_node_are_heard(graph: Graph) -> None:
    publisher = graph.publisher("estimate", latched=True)
    for message in data.messages(PoseStamped, ESTIMATE[:5]):
        publisher.publish(message)
    graph.start_evaluator()
    values = graph.until_accounted("estimate", 5)
    assert values["durability"] == "transient_local"


def test_a_publisher_that_vanishes_comes_back_as_another_type(graph: Graph) -> None:
    graph.start_evaluator(**FIXED)
    graph.until_health("estimate", "no publisher", level=1)
    first = graph.publisher("estimate")
    graph.until_heard(first)
    for message in data.messages(PoseStamped, ESTIMATE[:7]):
        first.publish(message)
    graph.until_accounted("estimate", 7)
    graph.node.destroy_publisher(first)
    graph.until_health("estimate", "its publisher is gone", level=1)
    second = graph.publisher("estimate", Odometry, reliable=False)
    graph.until_heard(second)
    for message in data.messages(Odometry, ESTIMATE[7:12]):
        second.publish(message)
    values = graph.until_accounted("estimate", 12)
    assert (values["type"], values["reliability"]) == ("Odometry", "best_effort")


def test_a_publisher_killed_and_restarted(graph: Graph, tmp_path: Path) -> None:
    half = len(TRUTH) // 2
    save_samples(tmp_path / "nothing.npz", ESTIMATE[:0])
    save_samples(tmp_path / "first.npz", TRUTH[:half])
    save_samples(tmp_path / "second.npz", TRUTH[half:])
    script = str(Path(data.__file__).parent / "player.py")
    graph.start_evaluator(**FIXED)
    # So slow that it is killed in the middle.
    player = graph.start(script, str(tmp_path / "first.npz"), str(tmp_path / "nothing.npz"), "50")
    graph.until_accounted("ground_truth", 20)
    player.end(signal.SIGKILL)
    second = graph.start(
        script, str(tmp_path / "second.npz"), str(tmp_path / "nothing.npz"), "2000"
    )
    assert second.wait() == 0, second.output
    last = int(TRUTH.stamps[-1]) / 1e9
    graph.until(
        lambda: float(values_of(graph.health()["ground truth"]).get("latest_stamp", 0)) == last,
        "the last message",
    )
    values = values_of(graph.health()["ground truth"])
    assert int(values["received"]) == int(values["used"]) + int(values["rejected"])
    assert int(values["rejected"]) == 0


def test_what_cannot_be_heard_is_an_error_with_its_remedy(graph: Graph) -> None:
    graph.start_evaluator(
        ground_truth__reliability="reliable", estimate__type="PoseStamped", **FIXED
    )
    truth = graph.publisher("ground_truth", TransformStamped, reliable=False)
    estimate = graph.publisher("estimate", Odometry)
    graph.until_health("ground truth", "set the reliability parameter to auto", level=2)
    graph.until_health("estimate", "/estimate: /test publishes Odometry, but PoseStamped", level=2)
    for publisher in (truth, estimate):
        graph.node.destroy_publisher(publisher)
    graph.until_health("ground truth", "no publisher", level=1)
    array = graph.publisher("estimate", PoseArray)
    graph.until_health("estimate", "geometry_msgs/msg/PoseArray, which cannot be read", level=2)
    graph.node.destroy_publisher(array)


def test_two_publishers_on_one_topic_are_named(graph: Graph) -> None:
    graph.start_evaluator(**FIXED)
    pair = [graph.publisher("estimate") for _ in range(2)]
    graph.until_heard(*pair)
    graph.until_health("estimate", "2 publishers", level=1)
    for k, message in enumerate(data.messages(PoseStamped, ESTIMATE[:10])):
        pair[k % 2].publish(message)
    graph.until_accounted("estimate", 10)


def test_remapped_topics(graph: Graph) -> None:
    graph.start_evaluator("-r", "estimate:=/slam/odom", "-r", "ground_truth:=/vicon/robot")
    publishers = [graph.publisher("/vicon/robot"), graph.publisher("/slam/odom", Odometry)]
    graph.until_heard(*publishers)
    graph.until_health("estimate", "/slam/odom: a publisher, but no message yet", level=1)


def test_losses_are_counted_to_the_message(graph: Graph) -> None:
    """A best-effort flood from a publisher with a short memory, while the node is stopped."""
    node = graph.start_evaluator(**FIXED)
    truth, _ = data.run(300.0, ground_truth_rate=100.0)
    publisher = graph.publisher("ground_truth", reliable=False)
    graph.until_heard(publisher)
    messages = data.messages(PoseStamped, truth)
    publisher.publish(messages[0])
    graph.until_accounted("ground_truth", 1)
    node.send(signal.SIGSTOP)
    for message in messages[1:-1]:
        publisher.publish(message)
    node.send(signal.SIGCONT)
    graph.until_heard(publisher)
    sent, last = len(messages) - 1, 0.0

    def all_accounted() -> bool:
        """What is lost shows with the next message, which may be lost, too: now and then one."""
        nonlocal sent, last
        values = values_of(graph.health()["ground truth"])
        received = int(values["received"])
        if received > 1 and received + int(values["lost"]) == sent:
            return True
        if time.monotonic() - last > 3.0:  # health comes once a second
            publisher.publish(messages[-1])
            sent, last = sent + 1, time.monotonic()
        return False

    graph.until(all_accounted, "received and lost make up what was sent")
