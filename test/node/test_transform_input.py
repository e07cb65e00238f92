# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An estimate that is a transform, over DDS; and what is said where it cannot be one."""

from __future__ import annotations

import importlib.util
import json
from operator import itemgetter
from pathlib import Path

import data
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TransformStamped
from harness import Graph, values_of
from twins.runs import assert_same_summary

from trajeval_ros import se3
from trajeval_ros.online.samples import PoseSamples

pytestmark = pytest.mark.ros

HAS_TF = importlib.util.find_spec("tf2_msgs") is not None
needs_tf = pytest.mark.skipif(not HAS_TF, reason="tf2_msgs is not installed")
FIXED = {"gp__hyperparameters": "fixed"}
TRUTH, ESTIMATE = data.run(6.0)
POSES = se3.from_position_quaternion(ESTIMATE.positions, ESTIMATE.quaternions)


def transforms(poses, stamps, parent, child):
    """TFMessages of one transform each."""
    from tf2_msgs.msg import TFMessage

    samples = PoseSamples(np.asarray(stamps), *se3.to_position_quaternion(poses))
    made = data.messages(TransformStamped, samples, parent)
    for each in made:
        each.child_frame_id = child
    return [TFMessage(transforms=[each]) for each in made]


@needs_tf
def test_a_transform_composed_along_the_tree(graph: Graph, tmp_path: Path) -> None:
    """The same figures as of the poses themselves, bit for bit but round-off."""
    from tf2_msgs.msg import TFMessage

    both = {"estimates": ["poses", "tree"], "tree__topic": "/tf:map.lidar"}
    graph.start_evaluator(**FIXED, **both, output__directory=str(tmp_path / "out"))
    truth, poses = graph.publisher("ground_truth"), graph.publisher("poses")
    slow, fast = graph.publisher("/tf", TFMessage), graph.publisher("/tf", TFMessage)
    static = graph.publisher("/tf_static", TFMessage, latched=True)
    graph.until_heard(truth, poses, slow, fast, static)
    lidar = se3.exp(np.array([0.3, 0.1, 0.2, 0.1, 0.4, 0.2]))
    static.publish(transforms(lidar[None], [0], "base", "lidar")[0])
    # A world that drifts at a constant twist: interpolation is exact.
    twist = np.array([0.1, 0.0, 0.02, 0.0, 0.01, 0.1])
    corrections = se3.exp(((ESTIMATE.stamps - ESTIMATE.stamps[0]) / 1e9)[:, None] * twist)
    odometry = se3.compose(se3.compose(se3.inverse(corrections), POSES), se3.inverse(lidar))
    rare = slice(0, None, 10)
    last = (len(ESTIMATE) - 1) // 10 * 10 + 1
    streams = {
        truth: (TRUTH.stamps, data.messages(PoseStamped, TRUTH)),
        poses: (ESTIMATE.stamps, data.messages(PoseStamped, ESTIMATE[:last])),
        slow: (
            ESTIMATE.stamps[rare],
            transforms(corrections[rare], ESTIMATE.stamps[rare], "map", "odom"),
        ),
        fast: (ESTIMATE.stamps, transforms(odometry, ESTIMATE.stamps, "odom", "base")),
    }
    in_order = sorted(
        (
            (stamp, message, publisher)
            for publisher, (stamps, made) in streams.items()
            for stamp, message in zip(stamps.tolist(), made, strict=False)
        ),
        key=itemgetter(0),
    )
    for _, message, publisher in in_order:
        publisher.publish(message)
        graph.spin(0.0)

    def all_composed() -> bool:
        status = graph.health().get("tree")
        return status is not None and int(values_of(status).get("received", 0)) >= last

    graph.until(all_composed, "all composed poses")
    assert "mixed" not in graph.health()["tree"].message
    graph.until_accounted("ground_truth", len(TRUTH))
    assert graph.call("/evaluator/save").success
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = summary["estimates"]
    assert_same_summary(found["tree"]["estimate"], found["poses"]["estimate"])
    assert found["tree"]["relative"]["log_likelihood"] == pytest.approx(
        found["poses"]["relative"]["log_likelihood"], rel=1e-9
    )


@needs_tf
def test_frames_that_are_not_there_are_named(graph: Graph) -> None:
    from tf2_msgs.msg import TFMessage

    graph.start_evaluator(estimate__topic="/tf:map.base", **FIXED)
    publisher = graph.publisher("/tf", TFMessage)
    graph.until_heard(publisher)
    for each in transforms(POSES[:5], ESTIMATE.stamps[:5], "odom", "base"):
        publisher.publish(each)
    graph.until_health("estimate", "/tf: there is no frame 'map'; there are base, odom", level=2)


@pytest.mark.skipif(HAS_TF, reason="tf2_msgs is installed")
def test_without_tf2_msgs_it_is_said(graph: Graph) -> None:
    graph.start_evaluator(estimate__topic="/tf:map.base", **FIXED)
    graph.until_health("estimate", "tf2_msgs is not installed: apt install", level=2)


def test_another_topic_by_parameter(graph: Graph) -> None:
    graph.start_evaluator(estimate__topic="/robot/pose", **FIXED)
    publisher = graph.publisher("/robot/pose")
    graph.until_heard(publisher)
    for each in data.messages(PoseStamped, ESTIMATE[:5]):
        publisher.publish(each)
    assert graph.until_accounted("estimate", 5)["topic"] == "/robot/pose"


@pytest.mark.parametrize("topic", ["/tf:map", "/tf:.base", "/a b", "/tf:map.", "1st"])
def test_what_is_no_topic_is_refused(graph: Graph, topic: str) -> None:
    process = graph.start_evaluator(estimate__topic=json.dumps(topic))
    assert process.wait() != 0
    assert "is neither a topic nor a transform" in process.output
    assert "Traceback" not in process.output
