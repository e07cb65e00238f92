# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the node's process ends: exit codes, the last line, the signals that ask for it."""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from trajeval_ros.online.parameters import PARAMETERS

DONE = 0
NOT_WRITTEN = 1
WRONG_USAGE = 2


class Stop:
    """Whether the process is to end. A second signal does not disturb what the first began."""

    def __init__(self) -> None:
        """Answer SIGINT and SIGTERM from now on."""
        self.requested = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._request)

    def over(self) -> None:
        """All is done: Python takes our handlers away before it is gone itself."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested = True


def right_command(arguments: Sequence[str]) -> str:
    """Return what the command line with these ``arguments`` may have been meant to be.

    Remappings and parameters are written as ``ros2 launch`` and ROS 1 take them.
    """
    words = []
    for argument in arguments:
        name, assigns, value = argument.partition(":=")
        if not assigns or not name or not value:
            return "ROS arguments follow --ros-args"
        name = name.lstrip("_") if name.lstrip("_") in PARAMETERS else name
        words.append(f"{'-p' if name in PARAMETERS else '-r'} {shlex.quote(name + ':=' + value)}")
    return f"ROS arguments follow --ros-args: evaluator --ros-args {' '.join(words)}"


def fail(message: str, code: int) -> int:
    """Say in one line what is wrong, and return the exit code."""
    sys.stderr.write(f"evaluator: error: {message}\n")
    return code
