# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages are taken and figures go on while a fit or a lesson lasts, however long, over DDS."""

from __future__ import annotations

import json
import signal
from typing import Any

import data
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from harness import HERE, Graph, accounted, values_of
from rclpy.serialization import serialize_message

pytestmark = [pytest.mark.ros, pytest.mark.slow]

# So many may be on their way: what the publisher keeps. All of them are more than that.
MOST = 10_000
FIXED = ("-p", "gp.hyperparameters:=fixed")


def started(graph: Graph, what: str, *parameters: str) -> Any:
    folder = str(graph.folder)
    output = ("-p", f"output.directory:={graph.folder / 'out'}")
    return graph.start(str(HERE / "held_up.py"), what, folder, "--ros-args", *output, *parameters)


class Traffic:
    """Publishes a run as fast as the node takes it: never more on its way than `MOST`."""

    def __init__(self, graph: Graph, duration: float, rate: float) -> None:
        self._graph = graph
        self._topics = dict(
            zip(("ground_truth", "estimate"), data.run(duration, rate, 50.0), strict=True)
        )
        self._made = {
            topic: [serialize_message(m) for m in data.messages(PoseStamped, samples)]
            for topic, samples in self._topics.items()
        }
        self._publishers = {topic: graph.publisher(topic) for topic in self._topics}
        self.sent = dict.fromkeys(self._topics, 0)
        graph.until_heard(*self._publishers.values())

    def until(self, seconds: float) -> None:
        """Publish what is stamped up to then."""
        for topic, samples in self._topics.items():
            end = int(np.searchsorted(samples.stamps, data.START + seconds * data.SECOND))
            while self.sent[topic] < end:
                step = min(end, self.sent[topic] + 3 * MOST // 4)
                for message in self._made[topic][self.sent[topic] : step]:
                    self._publishers[topic].publish(message)
                self.sent[topic] = step
                self._graph.until_accounted(topic, step)


def lost(graph: Graph) -> int:
    """Messages that overflowed, as far as the diagnostics have counted them."""
    return max(
        int(values_of(status).get("lost", 0))
        for message in graph.received["/diagnostics"]
        for status in message.status
    )


def summary(graph: Graph) -> dict[str, Any]:
    found = json.loads((graph.folder / "out" / "summary.json").read_text())
    for topic, used in (("estimate", "evaluated"), ("ground_truth", "used")):
        assert accounted(found[topic], used)
    return found


def test_figures_go_on_while_a_fit_lasts(graph: Graph) -> None:
    errors = graph.listen(Vector3Stamped, "/evaluator/absolute/translation_error")
    node = started(graph, "fit", *FIXED)
    traffic = Traffic(graph, 16.0, 1000.0)
    traffic.until(4.0)
    graph.until((graph.folder / "begun").exists, "a fit")
    before = len(errors)
    traffic.until(15.0)
    graph.until(lambda: len(errors) >= before + 10 * 50, "figures while a fit lasts")
    assert not (graph.folder / "over").exists()
    (graph.folder / "over").touch()
    traffic.until(16.0)
    assert node.end(signal.SIGINT) == 0, node.output
    found = summary(graph)
    assert lost(graph) == 0
    assert found["ground_truth"]["received"] == traffic.sent["ground_truth"]
    assert found["estimate"]["received"] == traffic.sent["estimate"]
    assert found["estimate"]["pending"] == 0
    # The one that was due is in the summary, too.
    assert found["window"]["error_model"]["poses"] > 0


def test_messages_are_taken_while_a_lesson_lasts(graph: Graph) -> None:
    node = started(graph, "lesson")
    traffic = Traffic(graph, 36.0, 200.0)
    # A lesson after eight seconds of motion, and one after sixteen.
    traffic.until(12.0)
    traffic.until(21.0)
    graph.until((graph.folder / "begun").exists, "the second lesson")
    traffic.until(33.0)
    waiting = values_of(graph.health()["estimate"])
    assert int(waiting["evaluated"]) > 0
    assert int(waiting["pending"]) > 10 * 50
    (graph.folder / "over").touch()
    traffic.until(34.0)
    evaluated = 50 * 32
    graph.until(
        lambda: int(values_of(graph.health()["estimate"])["evaluated"]) > evaluated,
        "what has waited",
    )
    assert node.end(signal.SIGINT) == 0, node.output
    found = summary(graph)
    assert lost(graph) == 0
    assert found["ground_truth"]["received"] == traffic.sent["ground_truth"]
    assert found["estimate"]["received"] == traffic.sent["estimate"]
    assert set(found["estimate"]["rejected"]) <= {"outside_ground_truth", "no_ground_truth"}
