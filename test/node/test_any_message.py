# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses in a field of any message type, over DDS; and what is said where there are none."""

from __future__ import annotations

import importlib.util
import json

import data
import pytest
from geometry_msgs.msg import PointStamped, PoseArray, PoseStamped
from harness import Graph, values_of
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage

from trajeval_ros.node.any_message import FieldError, import_type, pose_path, stamp_path
from trajeval_ros.online.axes import turned
from trajeval_ros.online.parameters import ParameterError, complete

pytestmark = pytest.mark.ros
FIXED = {"gp__hyperparameters": "fixed"}
TRUTH, ESTIMATE = data.run(6.0)


def test_ground_truth_and_estimate_in_fields(graph: Graph) -> None:
    """A frame in which the element is missing costs itself only."""
    graph.start_evaluator(
        ground_truth__type="nav_msgs/msg/Odometry",
        ground_truth__field="pose.pose",
        estimate__type="geometry_msgs/msg/PoseArray",
        estimate__field="poses[1]",
        **FIXED,
    )
    truth, estimate = (
        graph.publisher("ground_truth", Odometry),
        graph.publisher("estimate", PoseArray),
    )
    graph.until_heard(truth, estimate)
    arrays = []
    for made in data.messages(PoseStamped, ESTIMATE):
        arrays.append(PoseArray(header=made.header, poses=[PoseStamped().pose, made.pose]))
    arrays[7].poses = arrays[7].poses[:1]
    data.publish_in_order((truth, estimate), (data.messages(Odometry, TRUTH), arrays))
    values = graph.until_accounted("estimate", len(ESTIMATE))
    assert int(values["rejected"]) == 1

    def evaluated() -> bool:
        return int(values_of(graph.health()["estimate"])["evaluated"]) > 50

    graph.until(evaluated, "evaluated poses")


@pytest.mark.parametrize(
    ("kind", "field", "words"),
    [
        ("absent_msgs/msg/Thing", "pose", "the package absent_msgs is not installed"),
        ("geometry_msgs/msg/PoseArray", "pose", "has no field pose; there are header, poses"),
    ],
)
def test_what_cannot_be_used_is_an_error(graph: Graph, kind: str, field: str, words: str) -> None:
    graph.start_evaluator(estimate__type=kind, estimate__field=field, **FIXED)
    graph.until_health("estimate", words, level=2)


@pytest.mark.parametrize(
    ("kind", "field", "words"),
    [
        (PointStamped, "point", "position only"),
        (Odometry, "pose", "is no pose: it has pose, covariance"),
        (Odometry, "pose[0].pose", "is no list"),
        (PoseArray, "poses", "is a list"),
        (PoseArray, "poses[name=drone]", "there are position, orientation"),
        (PoseArray, "poses[", "is no field"),
        (PoseStamped, "header.frame_id.x", "has no field x"),
    ],
)
def test_a_field_that_is_no_pose_says_why(kind: type, field: str, words: str) -> None:
    with pytest.raises(FieldError) as error:
        pose_path(kind, kind.__name__, field)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_px4s_odometry(graph: Graph) -> None:
    """Arrays of floats, w x y z, microseconds; north, east, down and forward, right, down."""
    px4 = pytest.importorskip("px4_msgs.msg", reason="px4_msgs is not installed")
    graph.start_evaluator(
        estimate__type="px4_msgs/msg/VehicleOdometry",
        estimate__field=json.dumps("."),
        estimate__stamp_field="timestamp_sample",
        estimate__axes="ned_frd",
        **FIXED,
    )
    truth = graph.publisher("ground_truth", Odometry)
    estimate = graph.publisher("estimate", px4.VehicleOdometry)
    graph.until_heard(truth, estimate)
    for each in data.messages(Odometry, TRUTH):
        truth.publish(each)
    # Its own inverse.
    for made in data.messages(PoseStamped, turned(ESTIMATE, "ned_frd")):
        stamp, at, to = made.header.stamp, made.pose.position, made.pose.orientation
        sent = px4.VehicleOdometry(timestamp_sample=stamp.sec * 10**6 + stamp.nanosec // 1000)
        sent.position, sent.q = [at.x, at.y, at.z], [to.w, to.x, to.y, to.z]
        estimate.publish(sent)
    values = graph.until_accounted("estimate", len(ESTIMATE))
    assert int(values["rejected"]) == 0
    graph.until(
        lambda: int(values_of(graph.health()["estimate"])["evaluated"]) > 50, "evaluated poses"
    )
    assert "likely_cause" not in str(values_of(graph.health()["consistency"]))


def test_px4s_odometry_where_it_is_not_installed(graph: Graph) -> None:
    if importlib.util.find_spec("px4_msgs"):
        pytest.skip("px4_msgs is installed")
    graph.start_evaluator(estimate__type="px4_msgs/msg/VehicleOdometry", **FIXED)
    graph.until_health("estimate", "the package px4_msgs is not installed", level=2)


def test_a_field_without_a_type_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"estimate\.field needs estimate\.type"):
        complete({"estimate.field": "poses[0]"})
    with pytest.raises(ParameterError, match="or package/msg/Type, got 'geometry_msgs/Pose'"):
        complete({"estimate.type": "geometry_msgs/Pose"})


def test_a_stamp_is_a_time() -> None:
    assert stamp_path(PathMessage, "Path", "poses[-1].header.stamp")
    with pytest.raises(FieldError, match="no ROS time"):
        stamp_path(PathMessage, "Path", "header.frame_id")


def test_an_unknown_type_of_a_known_package() -> None:
    with pytest.raises(FieldError, match="geometry_msgs has no message Nothing"):
        import_type("geometry_msgs/msg/Nothing")
