# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""nav_msgs/Path as an estimate: each message is the whole trajectory as it is believed by then.

What is new in a message are the poses as they come, online; the latest message is the trajectory
after all corrections, such as those of loop closures.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajeval_ros.online.samples import PoseSamples

PATH_TYPE = "nav_msgs/msg/Path"

_SECOND = 1_000_000_000
# A trajectory that ends this far (ns) before the last one did may have begun anew: a looping bag.
_BACK = 1_000_000_000
_NOTHING = PoseSamples(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 4)))


@dataclass(frozen=True, slots=True)
class PathMessage:
    """A message's own ``stamp`` (ns) and ``frame``, and its poses with the stamps of theirs."""

    stamp: int
    frame: str
    samples: PoseSamples


class GrowingPath:
    """Tells what is new in each of the messages of a topic, and keeps the latest."""

    def __init__(self) -> None:
        """Start without a message."""
        self._newest: int | None = None
        self._before: PathMessage | None = None
        self.latest: PoseSamples | None = None
        """The poses of the latest message that has any, by stamp."""
        self.lacks_stamps = False
        """Whether the poses of the latest message have none: such a one has nothing later."""

    def take(self, message: PathMessage) -> PoseSamples:
        """Return the poses that are stamped after all that came before, by stamp.

        Of poses with one stamp the last counts. Where none has a stamp the last pose is taken at
        the stamp of the message: it is the one that is meant by it.
        """
        poses = message.samples
        if not len(poses):
            return _NOTHING
        self.lacks_stamps = not poses.stamps.any()
        if self.lacks_stamps:
            stamps = np.array([message.stamp], dtype=np.int64)
            return PoseSamples(stamps, poses.positions[-1:], poses.quaternions[-1:])
        # The last of each stamp: that of the reversed order that comes first.
        stamps, from_end = np.unique(poses.stamps[::-1], return_index=True)
        order = len(poses) - 1 - from_end
        self.latest = PoseSamples(stamps, poses.positions[order], poses.quaternions[order])
        ends_early = self._newest is not None and stamps[-1] < self._newest - _BACK
        if ends_early and self._is_anew(message):
            self._newest = None
        self._before = message
        known = -1 if self._newest is None else self._newest
        new = self.latest[int(np.searchsorted(stamps, known, side="right")) :]
        self._newest = max(known, int(stamps[-1]))
        return new

    def _is_anew(self, message: PathMessage) -> bool:
        """Whether a trajectory that ends earlier than the one before has begun anew.

        One that is cut, as by an estimator that takes back its last seconds, goes on with the time
        of its messages, or has most of its poses still.
        """
        before = self._before
        if before is None or 2 * len(message.samples) >= len(before.samples):
            return False
        if message.stamp and before.stamp:
            return message.stamp < before.stamp - _BACK
        return True


def decode_paths(
    messages: Sequence[bytes], growing: GrowingPath, otherwise: Callable[[bytes], Any]
) -> tuple[PoseSamples, list[str], int]:
    """Return what is new in serialised messages, their frames, and how many are not readable.

    ``otherwise`` deserialises what is not read here; it returns None for what is no message.
    """
    new, frames, undecodable = [_NOTHING], [], 0
    for raw in messages:
        read = decode_path(raw)
        if read is None:
            message = otherwise(raw)
            if message is None:
                undecodable += 1
                continue
            read = path_of(message)
        new.append(growing.take(read))
        frames.append(read.frame)
    stamps, positions, quaternions = (
        np.concatenate([getattr(each, part) for each in new])
        for part in ("stamps", "positions", "quaternions")
    )
    return PoseSamples(stamps, positions, quaternions), frames, undecodable


def path_of(message: Any) -> PathMessage:
    """Read a deserialised message, pose by pose; of rclpy or of rosbags."""
    poses = [(each.pose.position, each.pose.orientation) for each in message.poses]
    rows = [(at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w) for at, turned in poses]
    stamps = [_nanoseconds(each.header.stamp) for each in message.poses]
    values = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return PathMessage(
        _nanoseconds(message.header.stamp),
        str(message.header.frame_id),
        PoseSamples(np.array(stamps, dtype=np.int64), values[:, :3], values[:, 3:]),
    )


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * _SECOND + int(stamp.nanosec)


def decode_path(raw: bytes) -> PathMessage | None:
    """Read CDR whose poses' frames are all of one length, many poses at a time; else None.

    The layout of CDR is in `trajeval_ros.node.decode`. From the second pose on they are equally far
    apart: each ends with doubles, aligned to eight bytes.
    """
    if raw[:2] not in (b"\x00\x00", b"\x00\x01"):
        return None
    order = ">" if raw[:2] == b"\x00\x00" else "<"
    try:
        sec, nanosec, length = struct.unpack_from(f"{order}iII", raw, 4)
        frame, end = raw[16 : 16 + max(length - 1, 0)], 16 + length
        begin = _aligned(end, 4)
        (count,) = struct.unpack_from(f"{order}I", raw, begin)
        begin += 4
        (length,) = struct.unpack_from(f"{order}I", raw, begin + 8) if count else (0,)
        read = [_poses(raw, order, begin, length, min(count, 1))]
        begin = _aligned(begin + 12 + length, 8) + 56
        read.append(_poses(raw, order, begin, length, max(count - 1, 0)))
    except (struct.error, ValueError):
        return None
    if any((each["length"] != length).any() for each in read):
        return None
    rows = [(each["sec"].astype(np.int64), each["nanosec"], each["values"]) for each in read]
    stamps = np.concatenate([seconds * _SECOND + rest for seconds, rest, _ in rows])
    values = np.concatenate([numbers.astype(np.float64) for _, _, numbers in rows])
    return PathMessage(
        sec * _SECOND + nanosec,
        frame.decode("utf-8", errors="replace"),
        PoseSamples(stamps, values[:, :3], values[:, 3:]),
    )


def _poses(raw: bytes, order: str, begin: int, length: int, count: int) -> Any:
    """``count`` PoseStamped from ``begin`` on, with frames of so many bytes; ValueError if short.

    The next begins where one ends.
    """
    values = _aligned(begin + 12 + length, 8) - begin
    layout = np.dtype(
        {
            "names": ["sec", "nanosec", "length", "values"],
            "formats": [f"{order}i4", f"{order}u4", f"{order}u4", (f"{order}f8", (7,))],
            "offsets": [0, 4, 8, values],
            "itemsize": values + 56,
        }
    )
    return np.frombuffer(raw, dtype=layout, count=count, offset=begin if count else 0)


def _aligned(offset: int, size: int) -> int:
    return offset + (4 - offset) % size
