# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The two input topics: found on the graph, subscribed to, and emptied in batches.

The messages are not delivered by callbacks. A callback a message costs an executor 100 µs and more;
taking a serialised message from the middleware costs 4 µs. So the subscriptions belong to a
callback group that is never executed, the middleware's queue is the queue, and the node
empties it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, islice
from typing import Any

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import NavSatFix

from trajeval_ros.files.fixes import FixCounts
from trajeval_ros.files.paths import PATH_TYPE, GrowingPath, decode_paths
from trajeval_ros.files.points import FIX_TYPE, POINT_TYPE, PYPROJ_IS_MISSING, Points
from trajeval_ros.node.decode import POSE_TYPES, Decoded, decode, deserialized
from trajeval_ros.node.discovery import Endpoint, Offer, Plan, plan
from trajeval_ros.node.groups import Gated
from trajeval_ros.online.samples import PoseSamples

Array = npt.NDArray[np.float64]

# Five seconds of 10 kHz: as long as writing the report may take, or a busy machine keeps the node
# waiting. What is not used of it takes no memory.
QUEUE_DEPTH = 50_000
# A batch; what is beyond it waits for the next one, so that a flood does not starve the services.
BATCH = 2_000

# Each is a whole trajectory: one that is lost is made up for by the next.
_PATH_DEPTH = 20
_PATH = "Path"

# The norm of a quaternion that is none.
_NO_ROTATION = 1e-6
_POINTS: dict[str, Any] = {"PointStamped": PointStamped, "NavSatFix": NavSatFix}

KNOWN = {pose_type.ros_name: name for name, pose_type in POSE_TYPES.items()} | {
    PATH_TYPE: _PATH,
    POINT_TYPE: "PointStamped",
    FIX_TYPE: "NavSatFix",
}
_RELIABILITY = {
    "reliable": ReliabilityPolicy.RELIABLE,
    "best_effort": ReliabilityPolicy.BEST_EFFORT,
}
_DURABILITY = {
    "volatile": DurabilityPolicy.VOLATILE,
    "transient_local": DurabilityPolicy.TRANSIENT_LOCAL,
}


@dataclass(frozen=True, slots=True)
class InputState:
    """An input as the diagnostics show it."""

    topic: str
    publishers: tuple[Endpoint, ...]
    plan: Plan
    lost: int
    frame_changes: int
    is_shared: bool = False
    """Whether several publishers on the topic are as it should be."""


class Input:
    """One input topic.

    The messages are numbered by their publisher, so that a loss is known to the message, as long as
    there is one publisher (rclpy does not say which one a message is from).
    """

    _known: Mapping[str, str] = KNOWN
    _is_shared = False

    def __init__(self, node: Node, name: str, type_name: str, reliability: str) -> None:
        """Make the input ``name`` (a topic name, open to remapping)."""
        self._node = node
        self._name = name
        self._type_name = type_name
        self._reliability = reliability
        self._topic = node.resolve_topic_name(name)
        self._publishers: tuple[Endpoint, ...] = ()
        self._plan = Plan(None, ())
        self._subscription: Subscription | None = None
        self._held: Decoded | None = None
        self._group = Gated()  # never opened
        self._identities: list[tuple[int, ...]] = []
        self._sequence: int | None = None
        self._lost = 0
        self._frame_changes = 0
        self._frame: str | None = None
        self._path = GrowingPath()
        self._points = Points()
        self._has_turned = False  # whether a pose has come that has an orientation
        self.heard = False
        """Whether anything has come yet."""
        self.is_behind = False
        """Whether the queue may hold more than was taken last."""
        self.child_frame = ""
        self.discover()

    @property
    def state(self) -> InputState:
        """What the diagnostics need."""
        problem = self._problem
        return InputState(
            self._topic,
            self._publishers,
            self._plan
            if problem is None
            else replace(self._plan, problems=(*self._plan.problems, problem)),
            self._lost,
            self._frame_changes,
            self._is_shared,
        )

    @property
    def is_subscribed(self) -> bool:
        """Whether a publisher has been found that can be heard."""
        return self._subscription is not None

    @property
    def has_changed(self) -> bool:
        """Whether there are more or fewer publishers."""
        return bool(self._node.count_publishers(self._topic) != len(self._publishers))

    @property
    def frame(self) -> str:
        """``frame_id`` of the newest message."""
        return self._frame or ""

    @property
    def fixes(self) -> FixCounts | None:
        """Of what modes the fixes of this run are; None where there are none."""
        return self._points.fixes

    def discover(self) -> None:
        """Look at the publishers, and subscribe in the way that suits them."""
        found = self._node.get_publishers_info_by_topic(self._name)
        self._publishers = tuple(_endpoint(info) for info in found)
        identities = [tuple(info.endpoint_gid) for info in found]
        if identities != self._identities:
            # Another publisher counts its messages anew.
            self._identities, self._sequence = identities, None
        before = self._plan.offer
        after = plan(
            self._topic, self._publishers, self._type_name, self._reliability, self._known, before
        )
        if after.offer != before and self._subscription is not None:
            # What the old subscription still holds would go with it.
            self._held = self.take()
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
        self._plan = after
        if after.offer is not None and self._subscription is None:
            self._subscribe(after.offer)

    def reset(self) -> None:
        """A new run has begun."""
        self._frame_changes = 0
        self._points.fixes = None

    def _subscribe(self, offer: Offer) -> None:
        self._sequence = None
        self._subscription = self._node.create_subscription(
            self._message(offer.type_name),
            self._name,
            _never,
            QoSProfile(
                depth=_PATH_DEPTH if offer.type_name == _PATH else QUEUE_DEPTH,
                reliability=_RELIABILITY[offer.reliability],
                durability=_DURABILITY[offer.durability],
            ),
            callback_group=self._group,
            raw=True,
        )
        self._node.get_logger().info(
            f"listening to {self._topic}: {offer.type_name}, "
            f"{offer.reliability.replace('_', ' ')}, {offer.durability.replace('_', ' ')}"
        )

    def take(self) -> Decoded | None:
        """Return what has come since the last call, or None."""
        if self._held is not None:
            held, self._held = self._held, None
            return held
        offer = self._plan.offer
        if self._subscription is None or offer is None:
            return None
        messages = self._drain(self._subscription, self._message(offer.type_name))
        if not messages:
            return None
        self.heard = True
        decoded = self._without_none(self._decode(offer.type_name, messages))
        if len(decoded.samples):
            self._note_frames(decoded)
        return decoded

    def _without_none(self, decoded: Decoded) -> Decoded:
        """Poses whose orientations are all zero or not a number, as positions alone.

        Until the first that has one: from then on such a pose is a wrong one.
        """
        quaternions = decoded.samples.quaternions
        if self._has_turned or not decoded.has_orientation or not len(quaternions):
            return decoded
        with np.errstate(over="ignore"):
            self._has_turned = bool((np.linalg.norm(quaternions, axis=1) > _NO_ROTATION).any())
        if self._has_turned:
            return decoded
        unturned = np.tile([0.0, 0.0, 0.0, 1.0], (len(quaternions), 1))
        samples = replace(decoded.samples, quaternions=unturned)
        return replace(decoded, samples=samples, has_orientation=False)

    @property
    def _problem(self) -> str | None:
        """Why what is heard is of no use."""
        if self._points.is_without_pyproj:
            return f"{self._topic}: {PYPROJ_IS_MISSING}"
        if not self._path.lacks_stamps:
            return None
        return (
            f"{self._topic}: the poses of the paths have no stamps: the last of each is taken, at"
            " the path's, and corrections of earlier ones are not scored"
        )

    def _message(self, type_name: str) -> Any:
        """The class of a type's messages, by the type's short name."""
        if type_name in _POINTS:
            return _POINTS[type_name]
        return Path if type_name == _PATH else POSE_TYPES[type_name].message

    def _decode(self, type_name: str, messages: Sequence[bytes]) -> Decoded:
        if type_name == _PATH:
            return self._decode_paths(messages)
        if type_name in _POINTS:
            return self._decode_points(type_name, messages)
        return decode(POSE_TYPES[type_name], messages)

    def _decode_points(self, type_name: str, messages: Sequence[bytes]) -> Decoded:
        read = (deserialized(raw, _POINTS[type_name]) for raw in messages)
        points = [self._points.read(message) for message in read if message is not None]
        known = [point for point in points if point is not None]
        covariances = [point.covariance for point in known]
        samples = PoseSamples(
            np.array([point.stamp for point in known], dtype=np.int64),
            np.array([point.position for point in known]).reshape(-1, 3),
            np.tile([0.0, 0.0, 0.0, 1.0], (len(known), 1)),
            _stacked(covariances),
        )
        frames = tuple(frame for frame, _ in groupby(point.frame for point in known))
        return Decoded(samples, frames, "", len(messages) - len(known), has_orientation=False)

    def _decode_paths(self, messages: Sequence[bytes]) -> Decoded:
        samples, frames, undecodable = decode_paths(
            messages, self._path, lambda raw: deserialized(raw, Path)
        )
        named = tuple(frame for frame, _ in groupby(frames))
        latest = None if self._path.lacks_stamps else self._path.latest
        return Decoded(samples, named, "", undecodable, latest)

    def _drain(self, subscription: Subscription, message: Any) -> list[bytes]:
        with subscription.handle:
            take = partial(subscription.handle.take_message, message, True)
            taken = list(islice(iter(take, None), BATCH))
        self.is_behind = len(taken) == BATCH
        self._count_lost([about["publication_sequence_number"] for _, about in taken])
        return [raw for raw, _ in taken]

    def _count_lost(self, sequences: Sequence[int | None]) -> None:
        if len(self._publishers) != 1:
            self._sequence = None
            return
        before = self._sequence
        for sequence in sequences:
            # It starts over where the publisher does.
            if sequence is not None and before is not None and sequence > before:
                self._lost += sequence - before - 1
            before = sequence
        self._sequence = before

    def _note_frames(self, decoded: Decoded) -> None:
        frames = decoded.frames
        self._frame_changes += len(frames) - 1
        self._frame_changes += self._frame is not None and frames[0] != self._frame
        self._frame = frames[-1]
        self.child_frame = decoded.child_frame


def _stacked(covariances: Sequence[Array | None]) -> Array | None:
    """Covariances (n, 6, 6); None where none is known. One that is not known is of nothing."""
    if all(each is None for each in covariances):
        return None
    return np.stack([np.zeros((6, 6)) if each is None else each for each in covariances])


def _never(message: bytes) -> None:
    raise AssertionError("the executor must not deliver the messages of an input")


def _endpoint(info: Any) -> Endpoint:
    qos = info.qos_profile
    best_effort = qos.reliability == ReliabilityPolicy.BEST_EFFORT
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return Endpoint(
        f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        info.topic_type,
        "best_effort" if best_effort else "reliable",
        "transient_local" if latched else "volatile",
    )
