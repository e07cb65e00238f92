# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How an input subscribes, decided from the publishers alone."""

from __future__ import annotations

import pytest

from trajeval_ros.node.discovery import Endpoint, Offer, Plan, plan, waiting
from trajeval_ros.node.ending import right_command
from trajeval_ros.node.inputs import KNOWN

POSE, ODOMETRY = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"


def publisher(
    type_name: str = POSE, reliability: str = "reliable", durability: str = "volatile"
) -> Endpoint:
    return Endpoint("/slam", type_name, reliability, durability)  # type: ignore[arg-type]


def planned(
    *publishers: Endpoint,
    type_name: str = "auto",
    reliability: str = "auto",
    current: Offer | None = None,
) -> Plan:
    return plan("/estimate", publishers, type_name, reliability, KNOWN, current)


RELIABLE = Offer("PoseStamped", "reliable", "volatile")
BEST_EFFORT = Offer("PoseStamped", "best_effort", "volatile")


def test_auto_waits_for_a_publisher() -> None:
    assert planned() == Plan(None, ())


@pytest.mark.parametrize(("ros_name", "name"), KNOWN.items())
def test_auto_takes_the_type(ros_name: str, name: str) -> None:
    assert planned(publisher(ros_name)) == Plan(Offer(name, "reliable", "volatile"), ())


def test_a_set_type_is_subscribed_to_before_it_is_published() -> None:
    assert planned(type_name="PoseStamped") == Plan(RELIABLE, ())


def test_auto_follows_the_least_reliable_publisher() -> None:
    both = (publisher(), publisher(reliability="best_effort"))
    assert planned(*both, current=RELIABLE) == Plan(BEST_EFFORT, ())


def test_latched_only_if_all_are() -> None:
    latched = publisher(durability="transient_local")
    assert planned(latched).offer == Offer("PoseStamped", "reliable", "transient_local")
    assert planned(latched, publisher()).offer == RELIABLE


def test_the_subscription_stays_while_the_publisher_is_away() -> None:
    offer = Offer("Odometry", "best_effort", "transient_local")
    assert planned(current=offer) == Plan(offer, ())


def test_the_type_changes_with_the_publisher() -> None:
    assert planned(publisher(ODOMETRY), current=RELIABLE).offer == Offer(
        "Odometry", "reliable", "volatile"
    )


def test_a_second_type_does_not_take_over() -> None:
    found = planned(publisher(ODOMETRY), publisher(), current=RELIABLE)
    assert found.offer == RELIABLE
    assert found.problems == (
        "/estimate: /slam publishes Odometry, but PoseStamped is subscribed to (auto);"
        " set the type parameter, or remap one of the publishers",
    )


def test_a_type_that_cannot_be_read_is_named_with_the_remedy() -> None:
    found = planned(publisher("sensor_msgs/msg/Imu"))
    assert found.offer is None
    assert found.problems == (
        "/estimate: /slam publishes sensor_msgs/msg/Imu, which cannot be read; remap to a topic of"
        " type PoseStamped, PoseWithCovarianceStamped, Odometry, TransformStamped, Path,"
        " PointStamped, NavSatFix",
    )


def test_a_set_type_that_is_not_published_is_named() -> None:
    found = planned(publisher(), type_name="Odometry")
    assert found.offer == Offer("Odometry", "reliable", "volatile")
    (problem,) = found.problems
    assert "publishes PoseStamped, but Odometry is subscribed to (Odometry, set by" in problem


def test_a_reliable_subscription_to_best_effort_is_named_with_the_remedy() -> None:
    found = planned(publisher(reliability="best_effort"), reliability="reliable")
    assert found.offer == RELIABLE
    assert found.problems == (
        "/estimate: /slam publishes best effort, which a reliable subscription cannot hear;"
        " set the reliability parameter to auto or best_effort",
    )


def test_best_effort_hears_all() -> None:
    assert planned(publisher(), reliability="best_effort") == Plan(BEST_EFFORT, ())


def test_what_the_node_waits_for_is_said_with_what_there_is_instead() -> None:
    nobody: dict[str, list[Endpoint]] = {"/estimate": [], "/ground_truth": []}
    assert waiting({}, {}) is None
    assert waiting(nobody, None) == "waiting for /estimate and /ground_truth"
    assert "no other topic of a fitting type" in str(waiting(nobody, {}))
    said = waiting(nobody, {"/odom": "Odometry", "/vrpn/pose": "PoseStamped"})
    assert said is not None
    assert said.endswith(
        "of a fitting type there is /odom (Odometry), /vrpn/pose (PoseStamped):"
        " remap with -r NAME:=TOPIC"
    )
    silent = {"/estimate": [Endpoint("/vio", "x/msg/Y", "reliable", "volatile")]}
    said = waiting(silent, {"/odom": "Odometry"})
    assert said == "waiting for /estimate (/vio publishes it, no message yet)"
    many = {f"/topic_{n:02}": "Odometry" for n in range(20)}
    assert "and 12 more" in str(waiting(nobody, many))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["estimate:=/odom", "ground_truth:=/vrpn/pose"],
            "evaluator --ros-args -r estimate:=/odom -r ground_truth:=/vrpn/pose",
        ),
        (
            ["estimate:=/odom", "output.directory:=my results"],
            "evaluator --ros-args -r estimate:=/odom -p 'output.directory:=my results'",
        ),
        (["bag"], "ROS arguments follow --ros-args"),
        (["estimate:=/odom", "--fast"], "ROS arguments follow --ros-args"),
    ],
)
def test_a_command_line_without_ros_args_gets_the_right_one_back(
    arguments: list[str], said: str
) -> None:
    assert right_command(arguments).endswith(said)
