# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags for tests, by rosbags."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from trajeval_ros.files.trajectory import Trajectory


def write_bag(path: Path, trajectories: Mapping[str, Trajectory]) -> None:
    """Write a bag of ROS 2 with a topic of PoseStamped for each trajectory."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = store.types
    kind = "geometry_msgs/msg/PoseStamped"
    with Writer(path, version=9) as writer:
        for topic, trajectory in trajectories.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            rows = zip(
                *(trajectory.stamps.tolist(), trajectory.positions, trajectory.quaternions),
                strict=True,
            )
            for stamp, p, q in rows:
                time = kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
                header = kinds["std_msgs/msg/Header"](stamp=time, frame_id="map")
                pose = kinds["geometry_msgs/msg/Pose"](
                    kinds["geometry_msgs/msg/Point"](*p), kinds["geometry_msgs/msg/Quaternion"](*q)
                )
                message = kinds[kind](header=header, pose=pose)
                writer.write(connection, stamp, store.serialize_cdr(message, kind))
