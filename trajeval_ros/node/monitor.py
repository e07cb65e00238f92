# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Keeps the counts that the diagnostics need over a period, and publishes them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from trajeval_ros.node.diagnostics import (
    ClockState,
    Further,
    Load,
    Status,
    Traffic,
    both,
    check_clock,
    check_consistency,
    check_fixes,
    check_performance,
    check_process,
    check_synchronization,
    check_topic,
    joined,
)
from trajeval_ros.node.inputs import InputState
from trajeval_ros.online.parameters import ONE
from trajeval_ros.online.results import TopicHealth
from trajeval_ros.report.after_closure import after_closure
from trajeval_ros.runs.session import Session


class _Count:
    """What came on one topic."""

    def __init__(self) -> None:
        self.messages = 0
        self.last: float | None = None
        self.before = 0
        self.lost_before = 0
        self.frame_changes_before = 0
        self.rejected_before: Mapping[str, int] = {}


class Monitor:
    """The publisher of ``/diagnostics``. Its periods are on the steady clock."""

    def __init__(self, node: Node, session: Session) -> None:
        """Advertise ``/diagnostics``."""
        self._node = node
        self._session = session
        self._publisher = node.create_publisher(
            DiagnosticArray, "/diagnostics", QoSProfile(depth=10)
        )
        self._prefix = node.get_fully_qualified_name().removeprefix("/")
        self._topics = [_Count() for _ in ("ground truth", *session.names)]
        self._jumps = 0
        self._left_over = 0
        self._longest_batch = 0.0
        self._evaluated_before = 0
        self._published = time.monotonic()
        self._processor = time.process_time()
        self._clock: int | None = None
        self._clock_moved = time.monotonic()

    @property
    def publisher(self) -> Publisher:
        """That of ``/diagnostics``."""
        return self._publisher

    @property
    def messages(self) -> int:
        """Messages taken so far."""
        return sum(count.messages for count in self._topics)

    def note_messages(self, topic: int, number: int) -> None:
        """Messages have come on topic 0, the ground truth, or an estimate's, from 1 on."""
        count = self._topics[topic]
        count.messages += number
        count.last = time.monotonic()

    def note_batch(self, seconds: float) -> None:
        """A batch has taken this long."""
        self._longest_batch = max(self._longest_batch, seconds)

    def note_jump(self) -> None:
        """Time has jumped back."""
        self._jumps += 1

    def note_left_over(self, number: int) -> None:
        """Messages of the run before a jump came after it."""
        self._left_over += number

    def reset(self) -> None:
        """The engine's counts start over."""
        self._evaluated_before = 0
        for count in self._topics:
            count.rejected_before = {}
            count.frame_changes_before = 0

    def publish(
        self,
        states: Sequence[InputState],
        sim_time: bool,
        now: int | None,
        ending: Sequence[Status] = (),
    ) -> None:
        """Publish the node's health of the period since the last call.

        ``states``: of the ground truth and of each estimate; ``now`` on the ROS clock; ``ending``:
        what else there is to say, at the end.
        """
        steady, processor = time.monotonic(), time.process_time()
        period = max(steady - self._published, 1e-3)
        session = self._session
        found = {name: session.health(name) for name in session.names}
        first = found[session.names[0]]
        evaluated = sum(health.estimate.used for health in found.values())
        timing = session.engine.settings.timing
        tolerance = timing.max_gap + timing.lag + timing.max_wait
        settings = session.engine.settings
        of_truth = both(
            check_process(first),
            check_fixes("ground truth", session.fixes_of(0), settings.ground_truth.use_covariance),
        )
        statuses = [
            self._check_topic(
                0, "ground truth", states[0], first.ground_truth, "used", period, of_truth
            )
        ]
        for topic, (name, health) in enumerate(found.items(), 1):
            # Of one estimate it is that of `estimate`, whatever it is called.
            title = name if session.is_several else ONE[0]
            account = health.estimate
            statuses.append(
                self._check_topic(
                    topic,
                    title,
                    states[topic],
                    account,
                    "evaluated",
                    period,
                    both(
                        ((), {"latest_path": after_closure(session.latest_path_of(name))}),
                        check_fixes(
                            title, session.fixes_of(topic), settings.estimates[name].use_covariance
                        ),
                    ),
                )
            )
        offsets = session.engine.settings.estimates
        statuses += [
            joined(
                {
                    name: check_synchronization(health, offsets[name].time_offset, tolerance)
                    for name, health in found.items()
                }
            ),
            check_clock(self._clock_state(sim_time, now, steady), list(found.values())),
            joined(
                {
                    name: check_consistency(health, session.causes_of(name))
                    for name, health in found.items()
                }
            ),
            check_performance(
                Load(
                    processor=(processor - self._processor) / period,
                    longest_batch=self._longest_batch,
                    evaluated_rate=(evaluated - self._evaluated_before) / period,
                    output_error=session.error,
                )
            ),
        ]
        self._published, self._processor = steady, processor
        self._longest_batch, self._evaluated_before = 0.0, evaluated
        self._send([*statuses, *ending])

    def _check_topic(
        self,
        topic: int,
        title: str,
        state: InputState,
        health: TopicHealth,
        used: str,
        period: float,
        further: Further = ((), {}),
    ) -> Status:
        count = self._topics[topic]
        silence = None if count.last is None else time.monotonic() - count.last
        rejected = {
            reason: number - count.rejected_before.get(reason, 0)
            for reason, number in health.rejected.items()
            if number > count.rejected_before.get(reason, 0)
        }
        traffic = Traffic(
            (count.messages - count.before) / period,
            silence,
            rejected,
            state.lost - count.lost_before,
            state.frame_changes - count.frame_changes_before,
        )
        count.frame_changes_before = state.frame_changes
        count.before, count.lost_before = count.messages, state.lost
        count.rejected_before = dict(health.rejected)
        return check_topic(title, state, health, traffic, used, further)

    def _clock_state(self, sim_time: bool, now: int | None, steady: float) -> ClockState:
        if now != self._clock:
            self._clock, self._clock_moved = now, steady
        return ClockState(
            sim_time,
            now,
            self._node.count_publishers("/clock"),
            steady - self._clock_moved,
            self._jumps,
            self._left_over,
        )

    def _send(self, statuses: list[Status]) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=bytes([status.level]),
                name=f"{self._prefix}: {status.name}",
                message=status.message,
                hardware_id=self._prefix,
                values=[KeyValue(key=k, value=v) for k, v in status.values.items()],
            )
            for status in statuses
        ]
        self._publisher.publish(message)
