# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the executor is kept away from.

It makes its wait set anew at every turn, of all that may be executed, which takes some 10 µs for
each entity whether anything has come or not.
"""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node


class Gated(CallbackGroup):
    """The executor leaves alone what belongs to it, unless it is open."""

    def __init__(self) -> None:
        """Start closed."""
        super().__init__()
        self.is_open = False

    def can_execute(self, entity: Any) -> bool:
        """Whether it is open."""
        return self.is_open

    def beginning_execution(self, entity: Any) -> bool:
        """Whether it still is."""
        return self.is_open

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: one thread executes one callback at a time."""


def answer(node: Node) -> bool:
    """Answer a request of each service that has one; whether there was any.

    As the executor does, for a tenth of what a turn of it costs where there is none.
    """
    answered = False
    for service in node.services:
        kind: Any = service.srv_type
        with service.handle:
            request, header = service.handle.service_take_request(kind.Request)
        if header is not None:
            response = service.callback(request, kind.Response())
            service.send_response(response, header)
            answered = True
    return answered
