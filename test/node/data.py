# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A short run to evaluate, and its messages."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry

from trajeval_ros import se3
from trajeval_ros.online.samples import PoseSamples

Array = npt.NDArray[np.float64]

START = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def motion(t: Array) -> Array:
    """A smooth motion, (n, 4, 4)."""
    position = np.stack([3 * np.sin(0.7 * t), 2 * np.cos(0.5 * t), 0.5 * np.sin(1.3 * t)], axis=-1)
    turn = np.stack([0.3 * np.sin(0.9 * t), 0.2 * np.cos(1.1 * t), 0.1 * t], axis=-1)
    poses = np.tile(np.eye(4), (len(t), 1, 1))
    poses[:, :3, :3] = se3.exp_so3(turn)
    poses[:, :3, 3] = position
    return poses


def samples(t: Array, poses: Array, start: int = START) -> PoseSamples:
    """Poses at the seconds ``t`` after ``start``."""
    stamps = start + np.round(t * SECOND).astype(np.int64)
    return PoseSamples(stamps, *se3.to_position_quaternion(poses))


def run(
    duration: float = 10.0,
    ground_truth_rate: float = 100.0,
    estimate_rate: float = 20.0,
    start: int = START,
) -> tuple[PoseSamples, PoseSamples]:
    """Return ground truth and estimate, both noisy, the estimate in a world of its own."""
    random = np.random.default_rng(7)
    t = np.arange(0.0, duration, 1.0 / ground_truth_rate)
    truth = motion(t) @ se3.exp(random.normal(0.0, 0.0005, (len(t), 6)))
    u = np.arange(0.1, duration - 0.5, 1.0 / estimate_rate)
    world = se3.exp(np.array([1.0, 2.0, 0.5, 0.1, 0.2, 0.3]))
    estimate = world @ motion(u) @ se3.exp(random.normal(0.0, 0.01, (len(u), 6)))
    return samples(t, truth, start), samples(u, estimate, start)


def stamp_message(stamp: int) -> Time:
    return Time(sec=stamp // SECOND, nanosec=stamp % SECOND)


def message(
    kind: type, stamp: int, position: Sequence[float], quaternion: Sequence[float], frame: str
) -> Any:
    """A message of any of the four types."""
    made = kind()
    made.header.stamp = stamp_message(stamp)
    made.header.frame_id = frame
    at, turned = _parts(made)
    at.x, at.y, at.z = (float(value) for value in position)
    turned.x, turned.y, turned.z, turned.w = (float(value) for value in quaternion)
    return made


def _parts(made: Any) -> tuple[Any, Any]:
    if isinstance(made, PoseStamped):
        return made.pose.position, made.pose.orientation
    if isinstance(made, TransformStamped):
        return made.transform.translation, made.transform.rotation
    assert isinstance(made, PoseWithCovarianceStamped | Odometry)
    return made.pose.pose.position, made.pose.pose.orientation


def messages(kind: type, chosen: PoseSamples, frame: str = "map") -> list[Any]:
    """Messages of all samples."""
    rows = zip(
        chosen.stamps.tolist(), chosen.positions.tolist(), chosen.quaternions.tolist(), strict=True
    )
    return [message(kind, *row, frame) for row in rows]


def merged(
    streams: Sequence[Sequence[Any]], delays: Sequence[float] = (0.0, 0.0)
) -> list[tuple[float, int, int]]:
    """Several streams in the order in which their messages come: when (s), stream, message."""
    return sorted(
        (m.header.stamp.sec + m.header.stamp.nanosec / SECOND + delays[i], i, k)
        for i, stream in enumerate(streams)
        for k, m in enumerate(stream)
    )


def publish_in_order(
    publishers: Sequence[Any],
    streams: Sequence[Sequence[Any]],
    rate: float = 4000.0,
    delays: Sequence[float] = (0.0, 0.0),
) -> None:
    """Publish several streams merged by stamp, at most ``rate`` messages a second.

    ``delays`` (s) tell how much later than its stamp each stream comes.
    """
    begin = time.monotonic()
    for count, (_, i, k) in enumerate(merged(streams, delays)):
        publishers[i].publish(streams[i][k])
        if count % 20 == 19:
            time.sleep(max(0.0, begin + count / rate - time.monotonic()))
