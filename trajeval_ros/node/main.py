# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluator``: the node as a process."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from trajeval_ros import __version__, memory
from trajeval_ros.node.ending import DONE, WRONG_USAGE, Stop, fail

USAGE = """\
usage: evaluator [--help] [--version] [--ros-args -r estimate:=TOPIC -r ground_truth:=TOPIC
                  -p NAME:=VALUE --params-file FILE ...]

Scores an estimated trajectory against ground truth while both arrive.
Ends on Ctrl-C; writes its results where the parameter output.directory says."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    arguments = list(sys.argv if argv is None else argv)
    if "--help" in arguments[1:] or "-h" in arguments[1:]:
        sys.stdout.write(USAGE + "\n")
        return DONE
    if "--version" in arguments[1:]:
        sys.stdout.write(f"evaluator {__version__}\n")
        return DONE
    memory.begin()
    # Before the libraries load, which takes a second: a signal in that second counts too.
    stop = Stop()
    try:
        from trajeval_ros.node.process import run
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("trajeval_ros"):
            raise
        return fail(
            f"ROS 2 is missing ({error}); source ROS 2, or: python3 -m pip install"
            " 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces",
            WRONG_USAGE,
        )
    code = run(arguments, stop)
    stop.over()
    return code


if __name__ == "__main__":
    sys.exit(main())
