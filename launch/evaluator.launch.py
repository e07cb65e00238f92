# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node.

ros2 launch trajeval_ros evaluator.launch.py estimate:=/odom ground_truth:=/vicon/robot
ros2 launch trajeval_ros evaluator.launch.py estimates:=vins=/vins/odometry,orb=/tf:map.base_link
"""

import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

SHARE = get_package_share_directory("trajeval_ros")

# As of the lines of ~/markers.
COLOURS = ("255; 76; 51", "51; 204; 76", "230; 179; 26", "179; 102; 230")

ARGUMENTS = (
    ("estimate", "estimate", "Topic of the estimate"),
    ("estimates", "", "Several instead of one: name=topic,name=topic; a transform as /tf:a.b"),
    ("ground_truth", "ground_truth", "Topic of the ground truth"),
    ("params_file", "", "Parameters of the node; when empty those of the package"),
    ("output_directory", "", "Where the results are written at the end; nowhere when empty"),
    ("namespace", "", "Namespace of the node"),
    ("use_sim_time", "", "Take the time from /clock; when empty as the parameters say"),
    ("rviz", "false", "Start RViz too"),
)


def topics_of(estimate: str, estimates: str) -> dict[str, str]:
    """Return the topic of each estimate by its name."""
    pairs = [pair.strip().partition("=") for pair in estimates.split(",") if pair.strip()]
    for name, _, topic in pairs:
        if not (name and topic):
            raise ValueError(f"estimates must be name=topic,name=topic, got {estimates!r}")
    return {name: topic for name, _, topic in pairs} or {"estimate": estimate}


def displays(text: str, names: list[str]) -> str:
    """Return RViz's configuration with a path for each of several estimates."""
    name = text.index("Name: Estimate, aligned")
    begin, end = text.rindex("    - Class: ", 0, name), text.index("    - Class: ", name)
    of_one = text[begin:end]
    of_each = [
        of_one.replace("Estimate, aligned", f"{name}, aligned")
        .replace("evaluator/estimate/path", f"evaluator/{name}/path")
        .replace("255; 76; 51", COLOURS[number % len(COLOURS)])
        for number, name in enumerate(names)
    ]
    return text[:begin] + "".join(of_each) + text[end:]


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; the arguments have their values by now."""
    value = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    # What is not given here, the parameter file says.
    clock = {"use_sim_time": value["use_sim_time"].lower() == "true"}
    overrides = dict(clock) if value["use_sim_time"] else {}
    topics = topics_of(value["estimate"], value["estimates"])
    if value["estimates"]:
        overrides["estimates"] = list(topics)
    topics = {**topics, "ground_truth": value["ground_truth"]}
    # A transform is no name that a topic could be remapped to.
    overrides |= {f"{name}.topic": topic for name, topic in topics.items() if ":" in topic}
    remappings = [(name, topic) for name, topic in topics.items() if ":" not in topic]
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
        remappings=remappings,
        # The report may take seconds to write: do not kill the node over it.
        sigterm_timeout="30",
        sigkill_timeout="30",
    )
    if value["rviz"].lower() != "true":
        return [evaluator]
    view = os.path.join(SHARE, "config", "evaluator.rviz")
    if value["estimates"]:
        text = displays(Path(view).read_text(encoding="utf-8"), overrides["estimates"])
        view = os.path.join(launch_config.log_dir, "evaluator.rviz")
        Path(view).write_text(text, encoding="utf-8")
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=value["namespace"],
        arguments=["-d", view],
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
