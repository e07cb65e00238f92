# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is published for each evaluated estimate.

rclpy does not check types: an int or a NumPy scalar in a field of float64 goes out as another
number. So a field is given a Python float, where a message is not made of bytes (`encode`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from trajeval_ros import se3
from trajeval_ros.node import encode
from trajeval_ros.online.results import Evaluations, Results
from trajeval_ros.runs.statuses import NUMBERS

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_SECOND = 1_000_000_000
# A reader that is slower than this loses the oldest messages; the node does not wait for it. Of
# figures the newest counts. What there is of each pose comes in bursts: of all poses that waited
# for their ground truth, at once.
_QUALITY = QoSProfile(depth=100)
_OF_EACH_POSE = QoSProfile(depth=10_000)
# Shared memory holds 512 messages for a process that listens, and what does not find room there is
# sent again, but only 3 s later (Fast DDS): a burst is given time (s) to be taken.
_BURST = 50
_BREATH = 1e-3
# Name of the body frame in the error vectors where no message gives one.
_BODY = "body"


def time_message(stamp: int) -> Time:
    """Return a stamp in ns as a message."""
    return Time(sec=stamp // _SECOND, nanosec=stamp % _SECOND)


class Outputs:
    """The publishers of an estimate's figures, its errors and the ground truth's answer."""

    def __init__(self, node: Node, below: str = "") -> None:
        """Advertise the topics below the node's own name, or ``below`` it, such as ``vins/``."""

        def publisher(kind: type, topic: str, quality: QoSProfile = _OF_EACH_POSE) -> Publisher:
            return node.create_publisher(kind, topic, quality)

        self._relative = publisher(Float64, f"~/{below}relative/log_likelihood")
        self._absolute = publisher(Float64, f"~/{below}absolute/log_likelihood", _QUALITY)
        self._numbers = {
            where: publisher(Float64, f"~/{below}{topic}", _QUALITY)
            for topic, where in NUMBERS.items()
        }
        self._pose = publisher(PoseWithCovarianceStamped, f"~/{below}ground_truth/pose")
        self._errors = {
            (which, part): publisher(Vector3Stamped, f"~/{below}{which}/{part}_error")
            for which in ("relative", "absolute")
            for part in ("translation", "rotation")
        }

    def publish(self, results: Results, frame: str, body_frame: str) -> None:
        """Publish what a batch of evaluated estimates brought; nobody's topics cost nothing."""
        evaluations = results.evaluations
        if not len(evaluations):
            return
        if self._relative.get_subscription_count():
            values = evaluations.relative_log_likelihood
            _publish(self._relative, encode.numbers(values[~np.isnan(values)]))
        absolute = results.absolute_log_likelihood
        if absolute is not None and self._absolute.get_subscription_count():
            self._absolute.publish(Float64(data=float(absolute)))
        body_frame = body_frame or _BODY
        self._publish_errors("relative", evaluations.stamps, evaluations.relative_error, body_frame)
        self._publish_errors("absolute", evaluations.stamps, evaluations.absolute_error, body_frame)
        self._publish_poses(evaluations, frame)

    def _publish_errors(self, which: str, stamps: Stamps, errors: Array, frame: str) -> None:
        """Publish the (n, 6) errors' two halves; a pose without an error has none."""
        for part, values in (("translation", errors[:, :3]), ("rotation", errors[:, 3:])):
            publisher = self._errors[which, part]
            if publisher.get_subscription_count():
                known = ~np.isnan(values[:, 0])
                _publish(publisher, encode.stamped(stamps[known], frame, values[known]))

    def _publish_poses(self, evaluations: Evaluations, frame: str) -> None:
        if not self._pose.get_subscription_count():
            return
        poses = evaluations.ground_truth
        covariances = se3.covariance_to_fixed_axes(evaluations.covariance, poses)
        values = [*se3.to_position_quaternion(poses), covariances.reshape(-1, 36)]
        messages = encode.stamped(evaluations.stamps, frame, np.concatenate(values, axis=1))
        _publish(self._pose, messages)

    @property
    def is_heard(self) -> bool:
        """Whether somebody listens to what there is of each pose."""
        of_each = (self._relative, self._absolute, self._pose, *self._errors.values())
        return any(publisher.get_subscription_count() for publisher in of_each)

    @property
    def numbers_wanted(self) -> bool:
        """Whether somebody listens to a figure of ``~/metrics`` as a number."""
        return any(publisher.get_subscription_count() for publisher in self._numbers.values())

    def publish_numbers(self, statuses: Mapping[str, Mapping[str, str]]) -> None:
        """Publish what is known of the figures of ``~/metrics`` as numbers."""
        for (status, key), publisher in self._numbers.items():
            if key in statuses[status]:
                publisher.publish(Float64(data=float(statuses[status][key])))

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """Those whose subscribers are waited for at the end."""
        errors = self._errors.values()
        return *self._numbers.values(), *errors, self._relative, self._absolute, self._pose


@dataclass(frozen=True, slots=True)
class Row:
    """A status of figures: its values, and a sentence where there is one."""

    values: Mapping[str, str]
    message: str = ""
    level: bytes = DiagnosticStatus.OK


class Table:
    """A topic of statuses that hold figures: ``~/metrics``, ``~/comparison``."""

    def __init__(self, node: Node, topic: str) -> None:
        """Advertise it."""
        self.publisher = node.create_publisher(DiagnosticArray, topic, _QUALITY)

    @property
    def wanted(self) -> bool:
        """Whether somebody listens."""
        return bool(self.publisher.get_subscription_count())

    def publish(self, stamp: int, rows: Mapping[str, Row]) -> None:
        """Publish the figures, under the stamp (ns) of the newest evaluated estimate."""
        message = DiagnosticArray()
        message.header.stamp = time_message(stamp)
        message.status = [
            DiagnosticStatus(
                level=row.level,
                name=name,
                message=row.message,
                values=[KeyValue(key=key, value=value) for key, value in row.values.items()],
            )
            for name, row in rows.items()
        ]
        self.publisher.publish(message)


def flush(publishers: Iterable[Publisher], seconds: float) -> None:
    """Give the subscribers this long to have everything, before the publishers go."""
    deadline = time.monotonic() + seconds
    for publisher in publishers:
        remaining = max(0.0, deadline - time.monotonic())
        publisher.wait_for_all_acked(Duration(seconds=remaining))


def _publish(publisher: Publisher, messages: Sequence[bytes]) -> None:
    for begin in range(0, len(messages), _BURST):
        if begin:
            time.sleep(_BREATH)
        for message in messages[begin : begin + _BURST]:
            publisher.publish(message)
