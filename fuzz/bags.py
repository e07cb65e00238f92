# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 1 and ROS 2 with damage to poses, messages, and the bytes of the container."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from fuzz import oracle
from fuzz.text import SECOND, Track, corrupted, damaged, good_run

_LOGGED = 1_778_000_000 * SECOND
_KINDS = {
    "geometry_msgs/msg/PoseStamped": (),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (),
    "nav_msgs/msg/Odometry": ("base",),
    "geometry_msgs/msg/TransformStamped": ("base",),
}


def message(
    store: Any, kind: str, stamp: int, numbers: list[float], covariance: float, ros1: bool
) -> Any:
    """Return a message of one of the four types; ``numbers`` x y z qx qy qz qw."""

    def make(name: str, *values: object) -> Any:
        return store.types[f"geometry_msgs/msg/{name}"](*values)

    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp, SECOND))
    header = store.types["std_msgs/msg/Header"](*([0] if ros1 else []), time, "map")
    turned = make("Quaternion", *numbers[3:])
    values: list[Any] = [header, *_KINDS[kind]]
    if kind.endswith("TransformStamped"):
        values.append(make("Transform", make("Vector3", *numbers[:3]), turned))
        return store.types[kind](*values)
    pose = make("Pose", make("Point", *numbers[:3]), turned)
    if kind.endswith("/PoseStamped"):
        return store.types[kind](*values, pose)
    values.append(make("PoseWithCovariance", pose, (covariance * np.eye(6)).reshape(-1)))
    if kind.endswith("Odometry"):
        zero = make("Vector3", 0.0, 0.0, 0.0)
        values.append(make("TwistWithCovariance", make("Twist", zero, zero), np.zeros(36)))
    return store.types[kind](*values)


def _messages(
    rng: np.random.Generator, store: Any, kind: str, track: Track, ros1: bool
) -> list[bytes]:
    """Return the serialised messages; the bytes of some are wrong."""
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    numbers = np.concatenate([track.positions, track.quaternions], axis=1).tolist()
    covariance = float(rng.choice([1e-4, 1e-4, 0.0, -1.0, np.nan, 1e300]))
    # What the message's 32 bits of seconds hold.
    stamps = track.held(0.0, 2e18).tolist()
    made = [
        bytes(serialize(message(store, kind, stamp, row, covariance, ros1), kind))
        for stamp, row in zip(stamps, numbers, strict=True)
    ]
    for _ in range(rng.choice([0, 0, 0, 1, 3])):
        i = int(rng.integers(len(made))) if made else 0
        made[i : i + 1] = [corrupted(rng, each) for each in made[i : i + 1]]
    return made


def write(rng: np.random.Generator, path: Path, form: str, tracks: list[Track]) -> None:
    """Write a bag of two topics, ``/ground_truth`` and ``/estimate``."""
    ros1 = form == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    writer: Any
    if ros1:
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        for topic, track in zip(("/ground_truth", "/estimate"), tracks, strict=True):
            kind = str(rng.choice(list(_KINDS)))
            connection = writer.add_connection(topic, kind, typestore=store)
            for i, raw in enumerate(_messages(rng, store, kind, track, ros1)):
                writer.write(connection, _LOGGED + i * 1_000_000, raw)


def case(rng: np.random.Generator, folder: Path) -> str:
    """Write a bag, damage it, evaluate it, check; return what became of it."""
    form = str(rng.choice(["bag", "mcap", "sqlite3"]))
    tracks = list(good_run(int(rng.integers(4))))
    if rng.random() < 0.3:
        which = rng.integers(2)
        tracks[which] = damaged(rng, tracks[which])
    path = folder / ("run.bag" if form == "bag" else "run")
    write(rng, path, form, tracks)
    described = path / "metadata.yaml"
    files = [path] if path.is_file() else [f for f in sorted(path.iterdir()) if f != described]
    chance = rng.random()
    if chance < 0.35:
        files[0].write_bytes(corrupted(rng, files[0].read_bytes()))
    elif chance < 0.45 and described.exists():
        described.write_bytes(corrupted(rng, described.read_bytes()))
    elif chance < 0.5 and described.exists():
        shutil.move(files[0], folder / "elsewhere")
    options = []
    if rng.random() < 0.3:
        options = [f"{name}.use_covariance=true" for name in ("estimate", "ground_truth")]
    topics = ["--ground-truth", "/ground_truth", "--estimate", "/estimate"]
    chosen = topics if rng.random() < 0.9 else topics[:2]
    sets = [word for option in options for word in ("--set", option)]
    return oracle.evaluate_and_check(["bag", str(path), *chosen, *sets], folder)
