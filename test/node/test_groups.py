# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What stands behind a gate is executed while that is open, and then only."""

from __future__ import annotations

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from trajeval_ros.node.groups import Gated

pytestmark = pytest.mark.ros


def test_a_closed_gate_is_passed_by_nothing_and_an_open_one_by_what_has_waited(domain: int) -> None:
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node("gated", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    gate, passed = Gated(), list[str]()
    waiting = node.create_guard_condition(lambda: passed.append("gated"), gate)
    other = node.create_guard_condition(lambda: passed.append("other"))
    try:
        waiting.trigger()
        other.trigger()
        for _ in range(5):
            executor.spin_once(timeout_sec=0.05)
        assert passed == ["other"]
        gate.is_open = True
        for _ in range(5):
            executor.spin_once(timeout_sec=0.05)
        assert passed == ["other", "gated"]
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
