# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Paths and markers for RViz, Foxglove and the like; rarely, and only where somebody looks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.node.outputs import time_message
from trajeval_ros.online.results import Results
from trajeval_ros.runs.trail import DEVIATIONS, SMALLEST, Poses, Trail, ellipsoids

Array = npt.NDArray[np.float64]

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_LINE_WIDTH = 0.01
_UNCERTAINTY = ColorRGBA(r=0.2, g=0.6, b=1.0, a=0.4)
# One for each estimate, over and over.
_ERRORS = (
    ColorRGBA(r=1.0, g=0.3, b=0.2, a=0.9),
    ColorRGBA(r=0.2, g=0.8, b=0.3, a=0.9),
    ColorRGBA(r=0.9, g=0.7, b=0.1, a=0.9),
    ColorRGBA(r=0.7, g=0.4, b=0.9, a=0.9),
)


class _Lazy:
    """A publisher that is served when there is something new, or somebody new."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._state = (0, 0)

    def serve(self, version: int, make: Callable[[], object]) -> None:
        """Publish what ``make`` returns, if it is of another version or has another audience."""
        state = (version, self._publisher.get_subscription_count())
        if state[1] and state != self._state:
            self._publisher.publish(make())
        self._state = state

    @property
    def is_wanted(self) -> bool:
        """Whether somebody listens."""
        return bool(self._publisher.get_subscription_count())

    def clear(self, empty: object) -> None:
        """Publish ``empty`` in place of what was there, also for those who come later."""
        self._publisher.publish(empty)
        self._state = (0, 0)


class _Shown:
    """An estimate's path, in the ground truth's frame."""

    def __init__(self, publisher: Publisher) -> None:
        self.trail = Trail()
        self.path = _Lazy(publisher)
        self._alignment: Similarity | None = None

    def add(self, results: Results) -> None:
        self.trail.add(results.evaluations)
        self._alignment = results.alignment

    def clear(self) -> None:
        self.trail.clear()
        self._alignment = None

    def aligned(self, poses: Poses) -> Array:
        """The estimate in the ground truth's frame."""
        if self._alignment is None:
            return poses.estimate
        return self._alignment.apply(poses.estimate)


class Visualization:
    """``~/ground_truth/path``, a path for each estimate, and ``~/markers``.

    The ground truth is drawn at the stamps of the estimate that has come farthest.
    """

    def __init__(self, node: Node, names: Sequence[str]) -> None:
        """Advertise the topics; ``names``: of the estimates, as their paths' topics have them."""

        def path(name: str) -> Publisher:
            return node.create_publisher(Path, f"~/{name}/path", _LATCHED)

        self._frame = ""
        self._truth = _Lazy(path("ground_truth"))
        self._estimates = {name: _Shown(path(name)) for name in names}
        self._markers = _Lazy(node.create_publisher(MarkerArray, "~/markers", _LATCHED))

    def add(self, name: str, results: Results, frame: str) -> None:
        """Take in what a batch brought of an estimate; ``frame`` is the ground truth's."""
        if len(results.evaluations):
            self._estimates[name].add(results)
            self._frame = frame

    @property
    def is_wanted(self) -> bool:
        """Whether somebody looks."""
        paths = (one.path for one in self._estimates.values())
        return any(each.is_wanted for each in (self._truth, self._markers, *paths))

    def clear(self) -> None:
        """Start over, and take paths and markers off the screen."""
        if self._begun:
            for path in (self._truth, *(one.path for one in self._estimates.values())):
                path.clear(Path(header=self._header(0)))
        self._markers.clear(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
        for one in self._estimates.values():
            one.clear()

    @property
    def _begun(self) -> list[_Shown]:
        """Those with poses, the one that has come farthest first."""
        found = [one for one in self._estimates.values() if one.trail.count]
        return sorted(found, key=lambda one: -int(one.trail.recent.stamps[-1]))

    def publish_paths(self) -> None:
        """Publish all paths in the ground truth's frame."""
        for number, one in enumerate(self._begun):
            poses = one.trail.run
            if not number:
                self._truth.serve(
                    sum(each.trail.count for each in self._begun),
                    partial(self._path, poses, poses.ground_truth),
                )
            one.path.serve(one.trail.count, partial(self._aligned_path, one, poses))

    def _aligned_path(self, one: _Shown, poses: Poses) -> Path:
        return self._path(poses, one.aligned(poses))

    def publish_markers(self) -> None:
        """Publish ellipsoids of the ground truth's uncertainty and lines to the estimates."""
        if self._begun:
            self._markers.serve(sum(one.trail.count for one in self._begun), self._marker_array)

    def _path(self, poses: Poses, shown: Array) -> Path:
        path = Path(header=self._header(int(poses.stamps[-1])))
        positions, quaternions = se3.to_position_quaternion(shown)
        rows = zip(poses.stamps.tolist(), positions.tolist(), quaternions.tolist(), strict=True)
        for stamp, position, quaternion in rows:
            message = PoseStamped(header=self._header(stamp))
            at, turned = message.pose.position, message.pose.orientation
            at.x, at.y, at.z = position
            turned.x, turned.y, turned.z, turned.w = quaternion
            path.poses.append(message)
        return path

    def _marker_array(self) -> MarkerArray:
        farthest = self._begun[0]
        markers = [
            self._error_lines(one, f"{name}: error" if len(self._estimates) > 1 else "error", color)
            for (name, one), color in zip(self._estimates.items(), cycle(_ERRORS), strict=False)
            if one.trail.count
        ]
        return MarkerArray(markers=[*markers, *self._ellipsoids(farthest.trail.recent)])

    def _error_lines(self, one: _Shown, namespace: str, color: ColorRGBA) -> Marker:
        poses = one.trail.recent
        marker = self._marker(poses, namespace, 0, Marker.LINE_LIST, color)
        marker.scale.x = _LINE_WIDTH
        ends = (poses.ground_truth[:, :3, 3], one.aligned(poses)[:, :3, 3])
        points = np.stack(ends, axis=1).reshape(-1, 3).tolist()
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in points]
        return marker

    def _ellipsoids(self, poses: Poses) -> list[Marker]:
        positions, quaternions, deviations = ellipsoids(poses.ground_truth, poses.covariance)
        markers = []
        rows = zip(positions.tolist(), quaternions.tolist(), deviations.tolist(), strict=True)
        for number, (position, quaternion, axes) in enumerate(rows):
            marker = self._marker(poses, "uncertainty", number, Marker.SPHERE, _UNCERTAINTY)
            at, turned = marker.pose.position, marker.pose.orientation
            at.x, at.y, at.z = position
            turned.x, turned.y, turned.z, turned.w = quaternion
            # Foxglove and RViz take the diameter.
            marker.scale.x, marker.scale.y, marker.scale.z = (
                max(2.0 * DEVIATIONS * axis, SMALLEST) for axis in axes
            )
            markers.append(marker)
        return markers

    def _marker(
        self, poses: Poses, namespace: str, number: int, kind: int, color: ColorRGBA
    ) -> Marker:
        marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=color)
        marker.header = self._header(int(poses.stamps[-1]))
        marker.pose.orientation.w = 1.0
        return marker

    def _header(self, stamp: int) -> Header:
        return Header(stamp=time_message(stamp), frame_id=self._frame)
