# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Periodic work on the steady clock.

Not ROS timers: those that follow the ROS clock stop where it does, and a steady one makes rclpy's
executor wait on everything at once, so that each message of ``/clock``, of which a bag may publish
a thousand a second, wakes it up and costs 0.2 ms.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence


class Schedule:
    """Functions, each with its period (s).

    One may return how long after its beginning it is due again, where that is not its period.
    """

    def __init__(self, tasks: Sequence[tuple[float, Callable[[], float | None]]]) -> None:
        """All are due at once."""
        self._tasks = tasks
        self._due = [time.monotonic()] * len(tasks)

    def run(self) -> float:
        """Call what is due; return the time until something is."""
        for k, (period, function) in enumerate(self._tasks):
            begin = time.monotonic()
            if begin >= self._due[k]:
                # A period that was missed altogether is not made up for.
                self._due[k] = max(self._due[k] + period, begin)
                wait = function()
                if wait is not None:
                    self._due[k] = begin + wait
        return max(0.0, min(self._due) - time.monotonic())
