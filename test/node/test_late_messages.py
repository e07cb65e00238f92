# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that arrive in another order than that of their stamps, over DDS."""

from __future__ import annotations

import json
from pathlib import Path

import data
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from harness import Graph, accounted

pytestmark = pytest.mark.ros
TRUTH, ESTIMATE = data.run(6.0)


def test_late_poses_are_taken_in_their_place(graph: Graph, tmp_path: Path) -> None:
    """The same figures as of the poses in order; what has been decided is counted."""
    graph.start_evaluator(
        gp__hyperparameters="fixed",
        estimates=["sorted", "late"],
        output__directory=str(tmp_path / "out"),
    )
    publishers = [graph.publisher(topic) for topic in ("ground_truth", "sorted", "late")]
    graph.until_heard(*publishers)
    truth, in_order, late = publishers
    made = data.messages(PoseStamped, ESTIMATE)
    # By up to 0.4 s; the first two stay.
    delay = np.random.default_rng(1).uniform(0.0, 0.4, len(made))
    delay[:2] = 0.0
    arrival = ESTIMATE.stamps / data.SECOND - data.START / data.SECOND + delay
    order = np.argsort(arrival, kind="stable")
    assert (np.diff(order) < 0).sum() > 20
    for n, place in enumerate(order.tolist()):
        in_order.publish(made[n])
        late.publish(made[place])
    for name in ("sorted", "late"):
        graph.until_accounted(name, len(made))
    for each in data.messages(PoseStamped, TRUTH):
        truth.publish(each)
    graph.until_accounted("ground_truth", len(TRUTH))
    # The ground truth has passed it.
    late.publish(made[20])
    graph.until_accounted("late", len(made) + 1)
    assert graph.call("/evaluator/save").success
    found = json.loads((tmp_path / "out" / "summary.json").read_text())["estimates"]
    assert accounted(found["late"]["estimate"], "evaluated")
    assert found["late"]["estimate"]["rejected"] == {
        **found["sorted"]["estimate"]["rejected"],
        "out_of_order": 1,
    }
    assert found["late"]["estimate"]["evaluated"] == found["sorted"]["estimate"]["evaluated"]
    for part in ("relative", "conventional"):
        mine, others = (
            {k: v for k, v in found[name][part].items() if isinstance(v, float)}
            for name in ("late", "sorted")
        )
        assert mine == pytest.approx(others, rel=1e-9)


def test_late_ground_truth_is_taken_in_its_place(graph: Graph, tmp_path: Path) -> None:
    """Every third sample is overtaken by the two after it; what was decided first is counted."""
    graph.start_evaluator(gp__hyperparameters="fixed", output__directory=str(tmp_path / "out"))
    truth, estimate = publishers = [graph.publisher(t) for t in ("ground_truth", "estimate")]
    graph.until_heard(*publishers)
    made = data.messages(PoseStamped, TRUTH)
    order = np.arange(len(made))
    for n in range(30, len(made) - 10, 3):
        order[n : n + 3] = order[[n + 1, n + 2, n]]
    for each in data.messages(PoseStamped, ESTIMATE):
        estimate.publish(each)
    graph.until_accounted("estimate", len(ESTIMATE))
    for place in order.tolist():
        truth.publish(made[place])
    graph.until_accounted("ground_truth", len(made))
    assert graph.call("/evaluator/save").success
    found = json.loads((tmp_path / "out" / "summary.json").read_text())
    counts = found["ground_truth"]
    assert accounted(counts, "used")
    assert sum(counts["rejected"].values()) == counts["rejected"]["out_of_order"] <= 2
    assert found["estimate"]["evaluated"] > 0.8 * len(ESTIMATE)
