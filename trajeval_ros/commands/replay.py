# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""``replay``: publish recorded trajectories as live topics."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from trajeval_ros.commands import completion, console, inputs

TYPES = ("PoseStamped", "PoseWithCovarianceStamped", "Odometry", "TransformStamped")

DESCRIPTION = """\
Publish ground truth and estimate as live topics, in the order of their stamps, with /clock:
ground_truth and estimate, PoseStamped (PoseWithCovarianceStamped where there are covariances) or
of the type given, reliable, depth 1000. Waits for a subscriber of each before it begins, and for
their acknowledgement before it ends. Remap as any node: --ros-args -r estimate:=/odom"""


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="replay",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    console.add_version(parser)
    inputs.add_formats(parser, _add_options, several=True)
    return parser


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rate",
        type=console.number(0.01, 1000.0),
        default=1.0,
        metavar="R",
        help="times the recorded speed (default: 1)",
    )
    parser.add_argument(
        "--loop",
        action="store_true",
        help="start again at the end, with the same stamps, until Ctrl-C",
    )
    parser.add_argument(
        "--wait",
        type=console.number(0.0, 86400.0),
        default=30.0,
        metavar="S",
        help="how long to wait for subscribers; 0: begin at once (default: 30)",
    )
    parser.add_argument(
        "--no-clock", action="store_true", help="do not publish the data's time on /clock"
    )
    parser.add_argument(
        "--time-offset",
        type=console.number(-9e9, 9e9),
        default=0.0,
        metavar="S",
        help="the estimate's, to publish what belongs together at one time; stamps stay as they"
        " are (default: 0)",
    )
    parser.add_argument(
        "--type",
        choices=TYPES,
        help="of the messages; covariances are left out where it has none, and zero where the data"
        " have none (default: by the data)",
    )
    parser.add_argument(
        "--frame-id", default="world", metavar="NAME", help="of the ground truth (default: world)"
    )
    parser.add_argument(
        "--estimate-frame-id",
        default="odom",
        metavar="NAME",
        help="of the estimate (default: odom)",
    )


def split_ros_arguments(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return our arguments and ROS's, which stand between ``--ros-args`` and ``--``."""
    ours: list[str] = []
    ros: list[str] = []
    target = ours
    for argument in argv:
        if argument == "--ros-args":
            target = ros
        if argument == "--" and target is ros:
            target = ours
        else:
            target.append(argument)
    return ours, ros


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    ours, ros = split_ros_arguments(sys.argv[1:] if argv is None else argv)
    parser = make_parser()
    completion.complete(parser, inputs.with_format)
    arguments = parser.parse_args(inputs.with_format(ours))
    return console.run(lambda: replay(arguments, ros), "replay")


def replay(arguments: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Read the data, and publish it."""
    data = inputs.read(inputs.recognised(arguments))
    for estimate in data.estimates:
        inputs.check_overlap(data.ground_truth, estimate, arguments.time_offset)
    data = inputs.cut(arguments, data, [arguments.time_offset] * len(data.estimates))
    for remark in data.remarks:
        print(remark, flush=True)
    try:
        from trajeval_ros.commands.player import Player
    except ImportError as error:
        raise console.CommandError(
            f"replay needs ROS 2 ({error}); source it, or: python3 -m pip install"
            " 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces"
        ) from error
    with Player(
        data,
        type_name=arguments.type,
        frames=(arguments.frame_id, arguments.estimate_frame_id),
        time_offset=arguments.time_offset,
        clock=not arguments.no_clock,
        ros_arguments=ros_arguments,
    ) as player:
        try:
            player.wait_for_subscribers(arguments.wait)
            player.play(arguments.rate, loop=arguments.loop)
            acknowledged = player.wait_for_acknowledgement(10.0)
            player.say_all_is_sent(1.0)
        except KeyboardInterrupt:
            print(f"{player.account()}, interrupted")
            return console.DONE
        print(f"{player.account()}{', all acknowledged' if acknowledged else ''}", flush=True)
        if not acknowledged:
            raise console.CommandError("a subscriber has not acknowledged every message")
    return console.DONE


if __name__ == "__main__":
    sys.exit(main())
