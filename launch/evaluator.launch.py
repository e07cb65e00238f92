# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node.

ros2 launch trajeval_ros evaluator.launch.py estimate:=/odom ground_truth:=/vicon/robot
ros2 launch trajeval_ros evaluator.launch.py estimates:=vins=/vins/odometry,orb=/orb/pose
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

SHARE = get_package_share_directory("trajeval_ros")

ARGUMENTS = (
    ("estimate", "estimate", "Topic of the estimate"),
    ("estimates", "", "Several instead of one: name=topic,name=topic"),
    ("ground_truth", "ground_truth", "Topic of the ground truth"),
    ("params_file", "", "Parameters of the node; when empty those of the package"),
    ("output_directory", "", "Where the results are written at the end; nowhere when empty"),
    ("namespace", "", "Namespace of the node"),
    ("use_sim_time", "", "Take the time from /clock; when empty as the parameters say"),
    ("rviz", "false", "Start RViz too"),
)


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; the arguments have their values by now."""
    value = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    # What is not given here, the parameter file says.
    clock = {"use_sim_time": value["use_sim_time"].lower() == "true"}
    overrides = dict(clock) if value["use_sim_time"] else {}
    topics = dict(pair.split("=", 1) for pair in value["estimates"].split(",") if pair)
    if topics:
        overrides["estimates"] = list(topics)
    else:
        topics = {"estimate": value["estimate"]}
    # The package's file is of one estimate, and says no more than the defaults.
    default = [] if value["estimates"] else [os.path.join(SHARE, "config", "evaluator.yaml")]
    files = [value["params_file"]] if value["params_file"] else default
    if value["output_directory"]:
        overrides["output.directory"] = value["output_directory"]
    evaluator = Node(
        package="trajeval_ros",
        executable="evaluator",
        namespace=value["namespace"],
        output="screen",
        emulate_tty=True,
        parameters=[*files, overrides],
        remappings=[*topics.items(), ("ground_truth", value["ground_truth"])],
        # The report may take seconds to write: do not kill the node over it.
        sigterm_timeout="30",
        sigkill_timeout="30",
    )
    if value["rviz"].lower() != "true":
        return [evaluator]
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=value["namespace"],
        arguments=["-d", os.path.join(SHARE, "config", "evaluator.rviz")],
        parameters=[clock],
    )
    return [evaluator, rviz]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, default, description in ARGUMENTS
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
