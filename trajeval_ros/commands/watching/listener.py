# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hears a node for the page: subscribes, and nothing else.

Messages are taken from the middleware's queues by turns, not delivered by an executor, which would
cost ten times as much for each. What comes with every pose is asked for reliably: what a burst has
no room for is sent again. The node waits for nobody: of what it keeps for us the newest counts.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from nav_msgs.msg import Path
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile

from trajeval_ros.commands.monitor import health_of, values_of
from trajeval_ros.commands.participant import Participant
from trajeval_ros.commands.sent import SENT
from trajeval_ros.commands.watching.history import Gathered
from trajeval_ros.commands.watching.state import ALONE, ERRORS, GROUND_TRUTH, Watched

_SECOND = 1_000_000_000
_DISCOVERY_PERIOD = 0.5
# The health comes once a second, whatever the data do.
_SILENCE = 4.0
# What is not complete by then will not be: the middleware sends again within 3 s. A column that has
# not been heard for so long since the run's first one is not there.
_PATIENCE = 4.0
# Of a topic in one turn; what is beyond it waits for the next one.
_MOST = 5000

ENDING = "run"
"""The status in which a node says that it has ended."""

_FEW = QoSProfile(depth=100)
_MANY = QoSProfile(depth=10_000)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class _Topic:
    """A subscription that is emptied by hand."""

    def __init__(self, node: Any, kind: Any, topic: str, quality: QoSProfile) -> None:
        self._kind = kind
        self._node = node
        self._subscription = node.create_subscription(kind, topic, _never, quality)

    def take(self) -> Iterator[Any]:
        """What has come."""
        with self._subscription.handle:
            for _ in range(_MOST):
                taken = self._subscription.handle.take_message(self._kind, False)
                if taken is None:
                    return
                yield taken[0]

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)


def _never(message: object) -> None:
    raise AssertionError("there is no executor")


class _Estimate:
    """The topics of one estimate that come with every pose, and its path.

    ``name``: of one of several; empty of one alone.
    """

    def __init__(self, node: Any, prefix: str, name: str) -> None:
        below = f"{prefix}{name}/" if name else prefix
        self.errors = [
            _Topic(node, Vector3Stamped, f"{below}absolute/{part}_error", _MANY)
            for part in ("translation", "rotation")
        ]
        self.pose = _Topic(node, PoseWithCovarianceStamped, f"{below}ground_truth/pose", _MANY)
        self.path = _Topic(node, Path, f"{prefix}{name or ALONE}/path", _LATCHED)
        self.start_over()

    def start_over(self) -> None:
        self.gathered = Gathered(len(ERRORS))
        self.heard = time.monotonic()
        self.began: float | None = None

    def close(self) -> None:
        for topic in (*self.errors, self.pose, self.path):
            topic.close()


class Listener(Participant):
    """Keeps ``watched`` up to date with the node called ``name``."""

    def __init__(self, name: str, watched: Watched) -> None:
        """Join the ROS graph."""
        self._name = name
        self._prefix = f"{name}/"
        self._health_prefix = f"{name.removeprefix('/')}: "
        self._watched = watched
        super().__init__(
            f"watch_{os.getpid()}",
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._metrics = _Topic(self._node, DiagnosticArray, f"{self._prefix}metrics", _FEW)
        self._compared = _Topic(self._node, DiagnosticArray, f"{self._prefix}comparison", _FEW)
        self._truth = _Topic(self._node, Path, f"{self._prefix}{GROUND_TRUTH}/path", _LATCHED)
        # Before the node is there: of one that evaluates at once nothing is missed.
        self._estimates = {"": _Estimate(self._node, self._prefix, "")}
        # Last: a node learns of a participant's readers in the order in which they were made. One
        # whose health is heard knows of all of them.
        self._diagnostics = _Topic(self._node, DiagnosticArray, "/diagnostics", _FEW)
        self._publishers: frozenset[tuple[int, ...]] = frozenset()
        self._run = watched.run
        self._heard = 0.0
        self._is_gone = False  # the node that was there
        self._ending = ""  # what it said of its end
        self._is_new = False  # what is heard, and not seen on the graph yet
        self._next_discovery = 0.0

    def listen(self) -> None:
        """Take in what has come."""
        now = time.monotonic()
        if now >= self._next_discovery:
            self._next_discovery = now + _DISCOVERY_PERIOD
            self._discover(now)
        if self._watched.run != self._run:
            self._run = self._watched.run
            for estimate in self._estimates.values():
                estimate.start_over()
        for message in self._diagnostics.take():
            self._take_health(message, now)
        paths = [(GROUND_TRUTH, message) for message in self._truth.take()]
        for name, estimate in self._estimates.items():
            paths += [(name or ALONE, message) for message in estimate.path.take()]
        for name, estimate in self._estimates.items():
            self._take_errors(name or ALONE, estimate, now)
        for message in self._metrics.take():
            self._heard = now
            if self._is_gone:
                # Another one is heard before it is seen.
                self._watched.start_over()
                self._ending = ""
                self._is_gone, self._is_new = False, True
            self._watched.take_metrics(_stamp(message), values_of(message))
        for message in self._compared.take():
            said = {status.name: status.message for status in message.status}
            self._watched.take_comparison(said)
        # Last: an empty one says that a run is over, and what came before is of that run.
        for name, message in paths:
            self._take_path(name, message)

    # ------------------------------------------------------------------------------- the graph

    def _discover(self, now: float) -> None:
        """Who publishes, and what; say how it stands with the node."""
        found = self._node.get_publishers_info_by_topic(f"{self._prefix}metrics")
        publishers = frozenset(tuple(info.endpoint_gid) for info in found)
        if publishers:
            if self._publishers and not publishers & self._publishers and not self._is_new:
                # Another process under the same name.
                self._watched.start_over()
            self._is_gone = self._is_new = False
            if publishers != self._publishers:
                # From now on it is to be heard.
                self._heard = now
                self._ending = ""
            self._publishers = publishers
            self._follow()
        elif self._publishers and not self._is_new:
            self._is_gone = True
        self._watched.connect(*self._standing(len(publishers), now))

    def _standing(self, publishers: int, now: float) -> tuple[str, str]:
        if not publishers and not self._publishers:
            return "waiting", f"waiting for {self._name}{self._instead()}"
        if not publishers and self._ending:
            return "ended", f"{self._name} has {self._ending}"
        if not publishers:
            return "gone", f"the publisher is gone: {self._name} has ended or died"
        if now - self._heard > _SILENCE:
            return "silent", f"{self._name} has been silent for {now - self._heard:.0f} s"
        if not self._watched.has_begun:
            return "waiting", f"{self._name} is there; nothing is evaluated yet"
        if publishers > 1:
            return "live", f"{publishers} nodes are called {self._name}: their figures are mixed"
        return "live", "live"

    def _instead(self) -> str:
        """Other nodes that could be meant."""
        topics = self._node.get_topic_names_and_types()
        found = sorted(
            name.removesuffix("/metrics")
            for name, kinds in topics
            if name.endswith("/metrics") and "diagnostic_msgs/msg/DiagnosticArray" in kinds
            if self._node.count_publishers(name)
        )
        return f"; there is {', '.join(found)}: --node {found[0]}" if found else ""

    def _follow(self) -> None:
        """Subscribe to what there is of each estimate."""
        kind = "geometry_msgs/msg/Vector3Stamped"
        ending = "absolute/translation_error"
        names = []
        for topic, kinds in self._node.get_topic_names_and_types():
            if topic.startswith(self._prefix) and topic.endswith(ending) and kind in kinds:
                name = topic.removeprefix(self._prefix).removesuffix(ending).rstrip("/")
                if self._node.count_publishers(topic):
                    names.append(name)
        if not names or set(names) == set(self._estimates):
            return
        for name in set(self._estimates) - set(names):
            self._estimates.pop(name).close()
        for name in names:
            if name not in self._estimates:
                self._estimates[name] = _Estimate(self._node, self._prefix, name)
        self._watched.name_estimates([name or ALONE for name in names], several=names != [""])

    # ---------------------------------------------------------------------------- the messages

    def _take_health(self, message: Any, now: float) -> None:
        for status in message.status:
            if status.name == SENT:
                values = health_of(status).values
                self._watched.take_sent({topic: int(count) for topic, count in values.items()})
            elif status.name == f"{self._health_prefix}{ENDING}":
                self._ending = status.message
            elif status.name.startswith(self._health_prefix):
                self._heard = now
                name = status.name.removeprefix(self._health_prefix)
                self._watched.take_health(name, health_of(status))

    def _take_errors(self, name: str, estimate: _Estimate, now: float) -> None:
        gathered = estimate.gathered
        for column, topic in enumerate(estimate.errors):
            for message in topic.take():
                estimate.heard = now
                vector = message.vector
                gathered.put(_stamp(message), column, math.hypot(vector.x, vector.y, vector.z))
        poses = list(estimate.pose.take())
        if poses:
            estimate.heard = now
            covariances = np.array([pose.pose.covariance for pose in poses]).reshape(-1, 6, 6)
            # Of what is not finite there are no eigenvalues, nor of all that came with it.
            finite = np.isfinite(covariances).all(axis=(1, 2))
            poses = [pose for pose, is_finite in zip(poses, finite, strict=True) if is_finite]
            covariances = covariances[finite]
            bands = [
                2.0 * np.sqrt(np.maximum(np.linalg.eigvalsh(covariances[:, part, part])[:, -1], 0))
                for part in (slice(3), slice(3, 6))
            ]
            for pose, *widths in zip(poses, *bands, strict=True):
                for column, width in enumerate(widths, len(estimate.errors)):
                    gathered.put(_stamp(pose), column, float(width))
        if estimate.began is None and gathered.has_begun:
            estimate.began = now
        rows = gathered.ready(
            all_of_them=now - estimate.heard > _PATIENCE,
            of_all_columns=estimate.began is None or now - estimate.began <= _PATIENCE,
        )
        self._watched.take_errors(name, rows)

    def _take_path(self, name: str, message: Any) -> None:
        if not message.poses:
            if name == GROUND_TRUTH:
                self._watched.start_over()
            return
        points = [
            (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z)
            for pose in message.poses
        ]
        self._watched.take_path(name, np.array(points), [_stamp(pose) for pose in message.poses])


def _stamp(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * _SECOND + int(stamp.nanosec)
