# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bag, played with its clock, and the node, which writes its results when the bag ends.

ros2 launch trajeval_ros replay.launch.py bag:=DIR estimate:=/odom ground_truth:=/vicon/robot
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    IncludeLaunchDescription,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription

SHARE = get_package_share_directory("trajeval_ros")

ARGUMENTS = (
    ("bag", None, "The bag to play"),
    ("rate", "1.0", "Times the recorded speed"),
    ("estimate", "estimate", "Topic of the estimate"),
    ("estimates", "", "Several instead of one: name=topic,name=topic"),
    ("ground_truth", "ground_truth", "Topic of the ground truth"),
    ("params_file", "", "Parameters of the node; when empty those of the package"),
    ("output_directory", "", "Where the results are written at the end; nowhere when empty"),
    ("namespace", "", "Namespace of the node"),
    ("rviz", "false", "Start RViz too"),
)
PASSED_ON = (
    "estimate",
    "estimates",
    "ground_truth",
    "params_file",
    "output_directory",
    "namespace",
    "rviz",
)


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    evaluator = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(os.path.join(SHARE, "launch", "evaluator.launch.py")),
        launch_arguments={
            "use_sim_time": "true",
            **{name: LaunchConfiguration(name) for name in PASSED_ON},
        }.items(),
    )
    # Bare --clock ticks at 40 Hz only. --disable-keyboard-controls: there is no terminal here.
    bag = ExecuteProcess(
        cmd=[
            "ros2",
            "bag",
            "play",
            LaunchConfiguration("bag"),
            "--rate",
            LaunchConfiguration("rate"),
            "--clock-topics-all",
            "--disable-keyboard-controls",
        ],
        output="screen",
    )
    # Time for the node to find the topics, and at the end to take what is on its way.
    start = TimerAction(period=3.0, actions=[bag])
    end = RegisterEventHandler(
        OnProcessExit(
            target_action=bag,
            on_exit=[
                TimerAction(period=2.0, actions=[EmitEvent(event=Shutdown(reason="bag ended"))])
            ],
        )
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, default, description in ARGUMENTS
    ]
    return LaunchDescription([*arguments, evaluator, start, end])
