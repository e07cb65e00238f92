# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An input that is a transform: ``/tf:map.base_link``, composed from ``/tf`` and ``/tf_static``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from trajeval_ros import se3
from trajeval_ros.node.decode import Decoded, deserialized
from trajeval_ros.node.inputs import QUEUE_DEPTH, Input
from trajeval_ros.node.transform_tree import Transform, TransformTree
from trajeval_ros.online.samples import PoseSamples

_ROS_NAME, _NAME = "tf2_msgs/msg/TFMessage", "TFMessage"
_ABSENT = "the package tf2_msgs is not installed: apt install ros-jazzy-tf2-msgs"


class TransformInput(Input):
    """The poses of one frame in another.

    A message is many transforms and none of them need be a pose, so what is received is the poses
    that are composed. ``topic_static`` is listened to as well.
    """

    _is_shared = True

    def __init__(self, node: Node, name: str, reliability: str) -> None:
        """Make the input ``TOPIC:PARENT.CHILD``, see `online.parameters`."""
        topic, _, frames = name.partition(":")
        parent, _, child = frames.partition(".")
        self._tree = TransformTree(parent, child)
        self._turns_in_vain = 0
        self._tf_message = _tf_message()
        self._known = {} if self._tf_message is None else {_ROS_NAME: _NAME}
        self._static: Subscription | None = None
        super().__init__(node, topic, "auto", reliability)
        if self._tf_message is not None:
            self._static = node.create_subscription(
                self._tf_message,
                f"{topic}_static",
                _never,
                QoSProfile(depth=QUEUE_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL),
                callback_group=self._group,
                raw=True,
            )

    def discover(self) -> None:
        """As every input; and see for how long no pose could be made."""
        super().discover()
        self._turns_in_vain = self._turns_in_vain + 1 if self._tree.problem else 0

    @property
    def _problem(self) -> str | None:
        if self._tf_message is None:
            return f"{self._topic}: {_ABSENT}"
        # At first the static ones may not have arrived yet.
        late = self._turns_in_vain > 2
        return f"{self._topic}: {self._tree.problem}" if late and self._tree.problem else None

    def take(self) -> Decoded | None:
        """Return the poses that could be composed since the last call, or None."""
        unread = 0
        if self._static is not None:
            # rclpy has no way to tell of a loss here, nor would it matter: the last one counts.
            sequence, self._sequence = self._sequence, None
            unread = self._add(self._drain(self._static, self._tf_message), static=True)
            self._sequence = sequence
        decoded = super().take()
        if decoded is None or not unread:
            return decoded
        return Decoded(
            decoded.samples, decoded.frames, decoded.child_frame, decoded.undecodable + unread
        )

    def _message(self, type_name: str) -> Any:
        return self._tf_message

    def _decode(self, type_name: str, messages: Sequence[bytes]) -> Decoded:
        undecodable = self._add(messages, static=False)
        stamps, poses = self._tree.take()
        positions, quaternions = se3.to_position_quaternion(poses)
        frames = (self._tree.parent,) if len(stamps) else ()
        samples = PoseSamples(stamps, positions, quaternions, None)
        return Decoded(samples, frames, self._tree.child, undecodable)

    def _add(self, messages: Sequence[bytes], static: bool) -> int:
        """Let the tree grow; return how many messages or transforms could not be used."""
        undecodable = 0
        unusable = self._tree.unusable
        for raw in messages:
            message = deserialized(raw, self._tf_message)
            if message is None:
                undecodable += 1
                continue
            self._tree.add(_transforms(message), static)
        return undecodable + self._tree.unusable - unusable


def _tf_message() -> Any:
    """The message's class, or None where its package is not installed."""
    try:
        return import_module("tf2_msgs.msg").TFMessage
    except ImportError:
        return None


def _transforms(message: Any) -> Iterator[Transform]:
    for each in message.transforms:
        stamp = each.header.stamp
        at, turned = each.transform.translation, each.transform.rotation
        yield Transform(
            stamp.sec * 1_000_000_000 + stamp.nanosec,
            each.header.frame_id,
            each.child_frame_id,
            (at.x, at.y, at.z),
            (turned.x, turned.y, turned.z, turned.w),
        )


def _never(message: bytes) -> None:
    raise AssertionError("the executor must not deliver the messages of an input")
