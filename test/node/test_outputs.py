# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is published of every pose reaches a reader that keeps up, however many come at once."""

from __future__ import annotations

import data
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3Stamped
from harness import Graph, values_of

pytestmark = pytest.mark.ros


def test_a_burst_of_evaluations_is_not_cut(graph: Graph) -> None:
    """Three thousand poses wait for a ground truth that comes all at once."""
    truth, estimate = data.run(16.0, estimate_rate=200.0)
    heard = {
        topic: graph.listen(kind, f"/evaluator/{topic}")
        for topic, kind in (
            ("relative/translation_error", Vector3Stamped),
            ("absolute/translation_error", Vector3Stamped),
            ("absolute/rotation_error", Vector3Stamped),
            ("ground_truth/pose", PoseWithCovarianceStamped),
        )
    }
    graph.start_evaluator(max_wait=60.0)
    publishers = [graph.publisher(topic) for topic in ("ground_truth", "estimate")]
    graph.until_heard(*publishers)
    streams = [data.messages(PoseStamped, each) for each in (truth, estimate)]
    data.publish_in_order(publishers, [[], streams[1]])
    graph.until_accounted("estimate", len(estimate))
    assert not any(heard.values())
    data.publish_in_order(publishers, [streams[0], []])

    def evaluated() -> int:
        return int(values_of(graph.health()["estimate"])["evaluated"])

    graph.until(lambda: evaluated() > 0.95 * len(estimate), "evaluations")
    count = evaluated()
    assert count > 2500
    for topic, messages in heard.items():
        fewest = count - (topic.startswith("relative"))
        graph.until(lambda m=messages, n=fewest: len(m) >= n, f"{fewest} of {topic}")


def test_a_reader_that_asks_for_more_than_is_offered_is_spoken_of(graph: Graph) -> None:
    """Events of publishers are waited for more rarely than services, but they are."""
    evaluator = graph.start_evaluator()
    graph.listen(DiagnosticArray, "/evaluator/metrics", latched=True)
    graph.until(lambda: "incompatible QoS" in evaluator.output, "a warning")
