# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain of one's own."""

import pytest

from trajeval_ros.commands import domain as domains
from trajeval_ros.commands.console import CommandError


def refused() -> None:
    with pytest.raises(CommandError, match="no ROS domain is free"), domains.own_domain():
        pass


def test_a_domain_is_kept_from_others_until_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    with domains.own_domain() as number:
        monkeypatch.setattr(domains, "_DOMAINS", [number])
        refused()
    with domains.own_domain() as again:
        assert again == number


@pytest.mark.ros
def test_a_domain_with_a_node_in_it_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    rclpy = pytest.importorskip("rclpy", reason="needs ROS 2")
    context = rclpy.context.Context()
    with domains.own_domain() as number:
        monkeypatch.setattr(domains, "_DOMAINS", [number])
        rclpy.init(context=context, domain_id=number)
        node = rclpy.create_node("somebody", context=context)
    try:
        refused()
    finally:
        node.destroy_node()
        context.try_shutdown()
    with domains.own_domain() as again:
        assert again == number
