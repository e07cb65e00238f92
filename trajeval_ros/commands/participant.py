# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What every command that joins the ROS graph does first and last."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown


class Participant:
    """Has a node in a context of its own until it is closed. The signals stay Python's."""

    def __init__(self, name: str, ros_arguments: Sequence[str] = (), **options: Any) -> None:
        """Join the graph as ``name``; ``options`` are those of ``rclpy.create_node``."""
        self._context = Context()
        try:
            rclpy.init(
                args=list(ros_arguments),
                context=self._context,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            self._node = rclpy.create_node(name, context=self._context, **options)
        except BaseException:
            try_shutdown(context=self._context)
            raise

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        try_shutdown(context=self._context)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
