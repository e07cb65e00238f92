# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses from serialised messages, many at a time.

rclpy takes 18 µs to deserialise a PoseStamped and 39 µs an Odometry. A batch of messages as they
come from the middleware has, message by message, the same layout, so that NumPy reads it in one go.

A message is CDR (OMG, "Common Data Representation", version 1): four bytes say its byte order,
then every value follows, aligned to its own size counted from behind those four bytes; a string is
its length with the closing zero (uint32), then its bytes. All four types begin with a
std_msgs/Header, Odometry and TransformStamped go on with ``child_frame_id``, and then come the
position and the quaternion, seven doubles, and the covariance, 36, where there is one.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message

from trajeval_ros.online.samples import PoseSamples

_ENCAPSULATION = 4
_REPRESENTATION = 2
_FRAME = _ENCAPSULATION + 8
_POSE_VALUES = 7
_COVARIANCE_VALUES = 36
_BIG_ENDIAN, _LITTLE_ENDIAN = b"\x00\x00", b"\x00\x01"
_UINT32_BIG, _UINT32_LITTLE = struct.Struct(">I"), struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class PoseType:
    """A message type that carries a pose."""

    name: str
    ros_name: str
    message: Any
    has_child_frame: bool
    has_covariance: bool
    further_values: int = 0
    """Doubles behind those of interest: an Odometry's twist with its covariance."""


POSE_TYPES: dict[str, PoseType] = {
    pose_type.name: pose_type
    for pose_type in (
        PoseType("PoseStamped", "geometry_msgs/msg/PoseStamped", PoseStamped, False, False),
        PoseType(
            "PoseWithCovarianceStamped",
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            PoseWithCovarianceStamped,
            False,
            True,
        ),
        PoseType("Odometry", "nav_msgs/msg/Odometry", Odometry, True, True, further_values=42),
        PoseType(
            "TransformStamped", "geometry_msgs/msg/TransformStamped", TransformStamped, True, False
        ),
    )
}


@dataclass(frozen=True, slots=True)
class Decoded:
    """Poses in the order of their messages, and their frames.

    ``frames`` are the messages' ``frame_id``, each where it changes: at least one if there is a
    pose; ``child_frame`` is the newest one's. ``undecodable`` messages, bytes that are not the
    type's serialisation, are left out.
    """

    samples: PoseSamples
    frames: tuple[str, ...]
    child_frame: str
    undecodable: int
    latest_path: PoseSamples | None = None
    """The whole trajectory that the messages bring with them."""
    has_orientation: bool = True
    """Whether the quaternions are the messages'; else they are 0 0 0 1."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where a message has its values; messages of equal layouts are read together."""

    size: int
    big_endian: bool
    names_end: int
    pose: int
    frame: bytes
    child_frame: bytes


def decode(pose_type: PoseType, messages: Sequence[bytes]) -> Decoded:
    """Read serialised ``messages``.

    What is not plain CDR goes through rclpy's deserialisation.
    """
    groups = list(_groups(pose_type, messages))
    parts = [_read(pose_type, layout, data) for layout, data in groups]
    if len(parts) == 1:
        ((stamps, values),) = parts
    else:
        stamps = np.concatenate([np.empty(0, dtype=np.int64), *(part[0] for part in parts)])
        nothing = np.empty((0, _width(pose_type)))
        values = np.concatenate([nothing, *(part[1] for part in parts)])
    return Decoded(
        _samples(stamps, values),
        tuple(_text(frame) for frame, _ in groupby(layout.frame for layout, _ in groups)),
        _text(groups[-1][0].child_frame) if groups else "",
        len(messages) - len(stamps),
    )


def deserialized(message: bytes, message_type: Any) -> Any:
    """Return the message, or None where the bytes are not one of this type."""
    try:
        return deserialize_message(message, message_type)
    # The middleware's own exception type is no public name; it says no more than "bad bytes".
    except Exception:  # noqa: BLE001
        return None


def _groups(pose_type: PoseType, messages: Sequence[bytes]) -> Iterator[tuple[_Layout, bytes]]:
    """The messages that can be read; those of equal layouts that follow each other joined."""
    first = _layout(pose_type, messages[0]) if messages else None
    if first is not None and len(set(map(len, messages))) == 1:
        data = b"".join(messages)
        if _are_alike(first, data):
            yield first, data
            return
    pairs = [(layout, m) for each in messages for layout, m in _understood(pose_type, each)]
    for layout, group in groupby(pairs, key=itemgetter(0)):
        yield layout, b"".join(message for _, message in group)


def _are_alike(layout: _Layout, data: bytes) -> bool:
    """Whether all have what the ``layout`` of the first, as long as all, was read from.

    As they mostly do; and a look at all of them at once costs a tenth of reading each one's layout.
    """
    rows = np.frombuffer(data, dtype=np.uint8).reshape(-1, layout.size)
    begin, names = rows[:, :_REPRESENTATION], rows[:, _FRAME : layout.names_end]
    return bool((begin == begin[0]).all() and (names == names[0]).all())


def _understood(pose_type: PoseType, message: bytes) -> list[tuple[_Layout, bytes]]:
    """The message with its layout, or nothing."""
    layout = _layout(pose_type, message)
    if layout is None:
        try:
            message = serialize_message(deserialize_message(message, pose_type.message))
        # As in `deserialized`.
        except Exception:  # noqa: BLE001
            return []
        layout = _layout(pose_type, message)
    return [] if layout is None else [(layout, message)]


def _layout(pose_type: PoseType, message: bytes) -> _Layout | None:
    """The layout of a message in plain CDR, or None."""
    encapsulation = message[:_REPRESENTATION]
    if encapsulation not in (_LITTLE_ENDIAN, _BIG_ENDIAN):
        return None
    big_endian = encapsulation == _BIG_ENDIAN
    length = _UINT32_BIG if big_endian else _UINT32_LITTLE
    child_frame = b""
    try:
        frame, end = _string(length, message, _FRAME)
        if pose_type.has_child_frame:
            child_frame, end = _string(length, message, end)
    except struct.error:
        return None
    pose = _aligned(end, 8)
    if len(message) < pose + 8 * (_width(pose_type) + pose_type.further_values):
        return None
    return _Layout(len(message), big_endian, end, pose, frame, child_frame)


def _string(length: struct.Struct, message: bytes, offset: int) -> tuple[bytes, int]:
    """The string at ``offset``, which is aligned first, and the offset behind it."""
    begin = _aligned(offset, 4) + 4
    end = begin + length.unpack_from(message, begin - 4)[0]
    return message[begin : end - 1], end


def _aligned(offset: int, size: int) -> int:
    return offset + (_ENCAPSULATION - offset) % size


def _width(pose_type: PoseType) -> int:
    """Number of doubles of interest."""
    return _POSE_VALUES + (_COVARIANCE_VALUES if pose_type.has_covariance else 0)


def _read(
    pose_type: PoseType, layout: _Layout, data: bytes
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Stamps (n,) in ns and doubles (n, 7 or 43) of joined messages of one layout."""
    rows = np.frombuffer(data, dtype=_fields(layout, _width(pose_type)))
    stamps = rows["sec"].astype(np.int64) * 1_000_000_000 + rows["nanosec"]
    return stamps, rows["values"].astype(np.float64)


@lru_cache(maxsize=16)
def _fields(layout: _Layout, width: int) -> np.dtype[np.void]:
    order = ">" if layout.big_endian else "<"
    return np.dtype(
        {
            "names": ["sec", "nanosec", "values"],
            "formats": [f"{order}i4", f"{order}u4", (f"{order}f8", (width,))],
            "offsets": [_ENCAPSULATION, _ENCAPSULATION + 4, layout.pose],
            "itemsize": layout.size,
        }
    )


def _samples(stamps: npt.NDArray[np.int64], values: npt.NDArray[np.float64]) -> PoseSamples:
    covariances = None
    if values.shape[1] > _POSE_VALUES:
        covariances = values[:, _POSE_VALUES:].reshape(-1, 6, 6)
    return PoseSamples(stamps, values[:, :3], values[:, 3:_POSE_VALUES], covariances)


def _text(name: bytes) -> str:
    return name.decode("utf-8", errors="replace")
