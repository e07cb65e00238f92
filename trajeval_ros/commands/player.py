# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishes trajectories in the order of time, paced by a steady clock."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Sequence
from types import FrameType
from typing import Any

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from trajeval_ros.commands.console import CommandError, Progress, UsageError
from trajeval_ros.commands.inputs import Inputs
from trajeval_ros.commands.participant import Participant
from trajeval_ros.commands.schedule import Schedule, merge
from trajeval_ros.commands.sent import SENT
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.rcl_errors import first_line

Array = npt.NDArray[np.float64]

SECOND = 1_000_000_000

# A burst is what falls due while we slept. Late, we catch up with at most this many messages in
# 5 ms, 4,000 a second: a node keeps up with that, and its queue of 1,000 never fills.
_BURST = 20
_PAUSE = 0.005
# The clock ticks at least this often, gaps in the data or not, and not more often than that.
_TICK = 0.01
_CLOCK_INTERVAL = 0.001


# The files do not name the body; REP 105 calls it so.
_BODY = "base_link"

_KINDS: dict[str, Any] = {
    kind.__name__: kind
    for kind in (PoseStamped, PoseWithCovarianceStamped, Odometry, TransformStamped)
}


class _Template:
    """A message of one topic that is filled and published again and again."""

    def __init__(self, kind: Any, frame: str) -> None:
        self.message = kind()
        self.message.header.frame_id = frame
        if kind in (Odometry, TransformStamped):
            self.message.child_frame_id = _BODY
        self._covariance: Any = None
        if kind is TransformStamped:
            transform = self.message.transform
            self._position, self._orientation = transform.translation, transform.rotation
            return
        pose = self.message.pose
        if kind is not PoseStamped:
            self._covariance, pose = pose, pose.pose
        self._position, self._orientation = pose.position, pose.orientation

    def fill(self, stamp: Time, values: Sequence[float], covariance: Array | None) -> None:
        """Take a stamp, ``x y z qx qy qz qw`` and, where the type has one, a covariance (6, 6)."""
        self.message.header.stamp = stamp
        position, turned = self._position, self._orientation
        position.x, position.y, position.z, turned.x, turned.y, turned.z, turned.w = values
        if self._covariance is not None and covariance is not None:
            self._covariance.covariance = covariance.ravel()


class Player(Participant):
    """A node that publishes ``ground_truth``, the estimates by their names, and ``/clock``.

    ``type_name`` is the messages' type; without one, poses that come with covariances are
    PoseWithCovarianceStamped, the others PoseStamped.
    ``time_offset`` in seconds is added to the estimates' stamps to find when it comes, not to the
    stamps that are published.
    """

    def __init__(
        self,
        data: Inputs,
        *,
        frames: tuple[str, str],
        type_name: str | None = None,
        time_offset: float,
        clock: bool,
        ros_arguments: Sequence[str] = (),
    ) -> None:
        self._topics = (data.ground_truth, *data.estimates)
        self._names = ("ground_truth", *data.names)
        for trajectory in self._topics:
            _check_stamps(trajectory)
        offset = np.int64(round(time_offset * SECOND))
        self._schedule = merge(
            data.ground_truth.stamps, *(each.stamps + offset for each in data.estimates)
        )
        self._rows = [
            np.concatenate([each.positions, each.quaternions], axis=1).tolist()
            for each in self._topics
        ]
        self._stamps = [each.stamps.tolist() for each in self._topics]
        try:
            super().__init__("replay", ros_arguments)
        except Exception as error:
            # rclpy has several types for wrong arguments.
            raise UsageError(first_line(error)) from error
        # As Ctrl-C does.
        signal.signal(signal.SIGTERM, _interrupt)
        qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        kinds = [_kind(type_name, each) for each in self._topics]
        self._publishers: list[Publisher] = [
            self._node.create_publisher(kind, name, qos)
            for kind, name in zip(kinds, self._names, strict=True)
        ]
        self._diagnostics = self._node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._clock = self._node.create_publisher(Clock, "/clock", 10) if clock else None
        self._templates = [
            _Template(kind, frames[min(topic, 1)]) for topic, kind in enumerate(kinds)
        ]
        self._published = [0] * len(kinds)
        self._started = time.monotonic()

    def wait_for_subscribers(self, seconds: float) -> None:
        """Wait until each topic has a subscriber.

        Raises
        ------
        CommandError
            If there is none after this many seconds; with 0 there is no wait and no error.
        """
        deadline = time.monotonic() + seconds
        while seconds > 0:
            lonely = [p for p in self._publishers if p.get_subscription_count() == 0]
            if not lonely:
                return
            if time.monotonic() > deadline:
                names = " and ".join(publisher.topic_name for publisher in lonely)
                raise CommandError(f"nobody subscribes to {names} (waited {seconds:g} s)")
            time.sleep(0.02)

    def play(self, rate: float, *, loop: bool = False) -> None:
        """Publish everything once, or again and again."""
        self._started = time.monotonic()
        with Progress("replaying", len(self._schedule), "messages") as progress:
            while True:
                self._play_once(self._schedule, rate, progress)
                if not loop:
                    return

    def _play_once(self, schedule: Schedule, rate: float, progress: Progress) -> None:
        times, topics = schedule.times.tolist(), schedule.topics.tolist()
        rows = schedule.rows.tolist()
        first, begin = times[0], time.monotonic()
        last_tick, sent, count = -1.0, 0, len(times)
        while sent < count:
            now = time.monotonic()
            data_now = first + int((now - begin) * rate * SECOND)
            burst = 0
            while sent < count and burst < _BURST and times[sent] <= data_now:
                if now - last_tick >= _CLOCK_INTERVAL:
                    self._tick(times[sent])
                    last_tick = now
                self._publish(topics[sent], rows[sent])
                sent += 1
                burst += 1
            progress.update(sent)
            if burst == _BURST:
                time.sleep(_PAUSE)
            elif sent < count:
                due = begin + (times[sent] - first) / SECOND / rate
                time.sleep(max(0.0, min(due - time.monotonic(), _TICK)))
                if time.monotonic() - last_tick >= _TICK:
                    # Never ahead of a message that is still to come.
                    now = time.monotonic()
                    self._tick(min(times[sent], first + int((now - begin) * rate * SECOND)))
                    last_tick = now
        self._tick(times[-1])

    def _tick(self, nanoseconds: int) -> None:
        if self._clock is not None:
            self._clock.publish(Clock(clock=_time(nanoseconds)))

    def _publish(self, topic: int, row: int) -> None:
        template, covariances = self._templates[topic], self._topics[topic].covariances
        template.fill(
            _time(self._stamps[topic][row]),
            self._rows[topic][row],
            None if covariances is None else covariances[row],
        )
        self._publishers[topic].publish(template.message)
        self._published[topic] += 1

    def wait_for_acknowledgement(self, seconds: float) -> bool:
        """Wait until every subscriber has every message; say whether that came about."""
        timeout = Duration(seconds=seconds)
        publishers = [*self._publishers, *([] if self._clock is None else [self._clock])]
        # Of all, even when the first one fails.
        acknowledged = [publisher.wait_for_all_acked(timeout) for publisher in publishers]
        return all(acknowledged)

    def say_all_is_sent(self, seconds: float) -> None:
        """Say on ``/diagnostics`` that everything has been published, and how much of it."""
        values = [
            KeyValue(key=publisher.topic_name, value=str(count))
            for publisher, count in zip(self._publishers, self._published, strict=True)
        ]
        status = DiagnosticStatus(
            level=DiagnosticStatus.OK, name=SENT, message="all has been sent", values=values
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        self._diagnostics.wait_for_all_acked(Duration(seconds=seconds))

    def account(self) -> str:
        """Return what has been published, as one line."""
        counts = zip(self._names, self._published, strict=True)
        elapsed = time.monotonic() - self._started
        return f"published {', '.join(f'{n} {count}' for n, count in counts)} in {elapsed:.1f} s"


def _interrupt(signum: int, frame: FrameType | None) -> Any:
    raise KeyboardInterrupt


def _kind(type_name: str | None, trajectory: Trajectory) -> Any:
    """The message type of a topic."""
    if type_name is not None:
        return _KINDS[type_name]
    return PoseStamped if trajectory.covariances is None else PoseWithCovarianceStamped


def _time(nanoseconds: int) -> Time:
    seconds, rest = divmod(nanoseconds, SECOND)
    return Time(sec=seconds, nanosec=rest)


def _check_stamps(trajectory: Trajectory) -> None:
    """Refuse stamps that a message cannot carry, and say which rows cannot be published."""
    outside = (trajectory.stamps < 0) | (trajectory.stamps >= 2**31 * SECOND)
    if outside.any():
        where = trajectory.where(trajectory.rows[np.argmax(outside)])
        raise CommandError(f"{where}: the stamp does not fit a ROS message")
    count = len(trajectory.non_finite_stamp_rows)
    if count:
        print(
            f"replay: {trajectory.source}: {count} rows have no finite stamp and are not published",
            file=sys.stderr,
        )
