# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is published for each evaluated estimate.

rclpy does not check types: an int or a NumPy scalar in a field of float64 goes out as another
number. So every field is given a Python float.
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
from trajeval_ros.online.results import Evaluations, Results
from trajeval_ros.runs.statuses import NUMBERS

Array = npt.NDArray[np.float64]

_SECOND = 1_000_000_000
# A reader that is slower than this loses the oldest messages; the node does not wait for it. Of
# figures the newest counts. What there is of each pose comes in bursts: of all poses that waited
# for their ground truth, at once.
_QUALITY = QoSProfile(depth=100)
_OF_EACH_POSE = QoSProfile(depth=10_000)
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
        for value in _heard(self._relative, evaluations.relative_log_likelihood):
            if value == value:  # not NaN
                self._relative.publish(Float64(data=float(value)))
        if results.absolute_log_likelihood is not None:
            self._absolute.publish(Float64(data=float(results.absolute_log_likelihood)))
        stamps = [time_message(stamp) for stamp in evaluations.stamps.tolist()]
        body_frame = body_frame or _BODY
        self._publish_errors("relative", stamps, evaluations.relative_error, body_frame)
        self._publish_errors("absolute", stamps, evaluations.absolute_error, body_frame)
        self._publish_poses(stamps, evaluations, frame)

    def _publish_errors(
        self, which: str, stamps: Sequence[Time], errors: Array, frame: str
    ) -> None:
        """Publish the (n, 6) errors' two halves; a pose without an error has none."""
        for part, values in (("translation", errors[:, :3]), ("rotation", errors[:, 3:])):
            publisher = self._errors[which, part]
            for stamp, (x, y, z) in zip(stamps, _heard(publisher, values), strict=False):
                if x == x:  # not NaN
                    message = Vector3Stamped()
                    message.header.stamp, message.header.frame_id = stamp, frame
                    message.vector.x, message.vector.y, message.vector.z = x, y, z
                    publisher.publish(message)

    def _publish_poses(self, stamps: Sequence[Time], evaluations: Evaluations, frame: str) -> None:
        if not self._pose.get_subscription_count():
            return
        poses = evaluations.ground_truth
        positions, quaternions = se3.to_position_quaternion(poses)
        covariances = se3.covariance_to_fixed_axes(evaluations.covariance, poses)
        rows = zip(stamps, positions.tolist(), quaternions.tolist(), covariances, strict=True)
        for stamp, position, quaternion, covariance in rows:
            message = PoseWithCovarianceStamped()
            message.header.stamp, message.header.frame_id = stamp, frame
            at, turned = message.pose.pose.position, message.pose.pose.orientation
            at.x, at.y, at.z = position
            turned.x, turned.y, turned.z, turned.w = quaternion
            message.pose.covariance = covariance.ravel()
            self._pose.publish(message)

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


def _heard(publisher: Publisher, values: Array) -> list:
    """The values as Python floats, or nothing where nobody listens."""
    return values.tolist() if publisher.get_subscription_count() else []
