# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Listens to the node: its figures and its health, as the live view wants them."""

from __future__ import annotations

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile

from trajeval_ros.commands.live import TRENDS, Health, State
from trajeval_ros.commands.participant import Participant

_METRICS = "/evaluator/metrics"
_PREFIX = "evaluator: "
_DEPARTED = ("its publisher is gone", "no publisher")


class Monitor(Participant):
    """A node that keeps ``state`` up to date.

    From ``/evaluator/metrics``, ``/evaluator/comparison`` and ``/diagnostics``.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        super().__init__("demo")
        qos = QoSProfile(depth=1000)
        self._node.create_subscription(DiagnosticArray, _METRICS, self._metrics, qos)
        self._node.create_subscription(
            DiagnosticArray, "/evaluator/comparison", self._comparison, qos
        )
        # Last: a node learns of a participant's readers in the order in which they were made.
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnostics, qos)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    @property
    def is_connected(self) -> bool:
        """Whether the node has been heard: its health, so that it knows of the other readers."""
        return bool(self._state.health)

    def listen(self, seconds: float) -> None:
        """Take in what comes within this time."""
        try:
            self._executor.spin_once(timeout_sec=seconds)
        except ExternalShutdownException:
            return

    def _metrics(self, message: DiagnosticArray) -> None:
        state, stamp = self._state, message.header.stamp
        state.take_metrics(stamp.sec + stamp.nanosec * 1e-9, values_of(message))
        for status_name, key in TRENDS:
            state.remember(f"{status_name}/{key}", state.figure(status_name, key))

    def _comparison(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._state.sentences[status.name] = status.message

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(_PREFIX):
                health = _without_departure(health_of(status))
                self._state.take_health(status.name.removeprefix(_PREFIX), health)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        super().close()


def _without_departure(health: Health) -> Health:
    """Health without the player's departure, which whoever started it knows better."""
    findings = health.message.split("; ")
    others = [finding for finding in findings if not finding.endswith(_DEPARTED)]
    if len(others) == len(findings):
        return health
    if others:
        return replace(health, message="; ".join(others))
    return replace(health, level=0, message="all has been sent")


def values_of(message: DiagnosticArray) -> dict[str, dict[str, str]]:
    """The values of each status."""
    return {
        status.name: {value.key: value.value for value in status.values}
        for status in message.status
    }


def health_of(status: DiagnosticStatus) -> Health:
    """One entry of ``/diagnostics``."""
    # DiagnosticStatus.level is a byte, which Python has as bytes.
    level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
    return Health(level, status.message, {value.key: value.value for value in status.values})
