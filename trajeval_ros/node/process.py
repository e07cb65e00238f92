# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The life of the node's process: ROS up, spin, results written, ROS down."""

from __future__ import annotations

import time
from collections.abc import Sequence

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args, try_shutdown

from trajeval_ros import memory
from trajeval_ros.node.ending import DONE, NOT_WRITTEN, WRONG_USAGE, Stop, fail, right_command
from trajeval_ros.node.evaluator import Evaluator
from trajeval_ros.node.groups import answer
from trajeval_ros.online.parameters import ParameterError
from trajeval_ros.rcl_errors import first_line

# How long a request may wait, and a publisher's event (s).
_ANSWER_PERIOD = 0.05
_EVENTS_PERIOD = 1.0


def run(arguments: Sequence[str], stop: Stop) -> int:
    """Run the node until ``stop`` is requested; return the exit code."""
    try:
        # Our own signal handlers: rclpy's would take ROS down before the results are published.
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: BLE001 (rclpy has several types for wrong arguments)
        return fail(first_line(error), WRONG_USAGE)
    try:
        return _run(remove_ros_args(list(arguments))[1:], stop)
    finally:
        try_shutdown()


def _run(others: Sequence[str], stop: Stop) -> int:
    if others:
        return fail(f"unknown argument {others[0]}; {right_command(others)}", WRONG_USAGE)
    try:
        node = Evaluator()
    except ParameterError as error:
        return fail(str(error), WRONG_USAGE)
    memory.loaded()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    next_answer = next_events = 0.0
    try:
        while not stop.requested:
            begin = time.monotonic()
            if begin >= next_answer:
                next_answer = begin if answer(node) else begin + _ANSWER_PERIOD
            node.events.is_open = begin >= next_events
            if node.events.is_open or node.follows_clock:
                # One callback a turn: an event, or the newest /clock.
                next_events = begin + _EVENTS_PERIOD if node.events.is_open else next_events
                executor.spin_once(timeout_sec=0.0)
            idle = node.work()
            time.sleep(max(0.0, min(idle, next_answer - time.monotonic())))
    except Exception:
        # A defect, and it is shown; what has been evaluated until then is written all the same.
        node.rescue()
        raise
    written = node.close()
    executor.shutdown()
    node.destroy_node()
    return DONE if written else NOT_WRITTEN
