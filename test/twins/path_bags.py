# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of nav_msgs/Path, by rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from trajeval_ros.online.samples import PoseSamples

SECOND = 1_000_000_000


def samples(stamps: Sequence[int], values: npt.NDArray[np.float64]) -> PoseSamples:
    return PoseSamples(np.array(stamps, dtype=np.int64), values[:, :3].copy(), values[:, 3:].copy())


class Store:
    """Messages by rosbags."""

    def __init__(self, ros1: bool = False) -> None:
        pytest.importorskip("rosbags", reason="rosbags is not installed")
        from rosbags.typesys import Stores, get_typestore

        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)

    def header(self, stamp: int, frame: str) -> Any:
        time = self.store.types["builtin_interfaces/msg/Time"](*divmod(stamp, SECOND))
        return self.store.types["std_msgs/msg/Header"](*([0] if self.ros1 else []), time, frame)

    def path(
        self, stamp: int, frame: str, frames: Sequence[str], poses: PoseSamples
    ) -> tuple[Any, bytes]:
        types = self.store.types
        made = [
            types["geometry_msgs/msg/PoseStamped"](
                self.header(when, own),
                types["geometry_msgs/msg/Pose"](
                    types["geometry_msgs/msg/Point"](*at),
                    types["geometry_msgs/msg/Quaternion"](*turned),
                ),
            )
            for when, own, at, turned in zip(
                poses.stamps.tolist(),
                frames,
                poses.positions.tolist(),
                poses.quaternions.tolist(),
                strict=True,
            )
        ]
        message = types["nav_msgs/msg/Path"](self.header(stamp, frame), made)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        return message, bytes(serialize(message, "nav_msgs/msg/Path"))


def write(folder: Path, kind: str, store: Any, raws: Sequence[bytes]) -> Path:
    """A bag of paths."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    bag = folder / ("run.bag" if kind == "bag" else "run")
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer: Any = Writer1(bag)
    if kind != "bag":
        writer = Writer2(bag, version=9, storage_plugin=plugin)
    with writer:
        connection = writer.add_connection("/path", "nav_msgs/msg/Path", typestore=store)
        for time, raw in enumerate(raws, 1):
            writer.write(connection, time, raw)
    return bag
