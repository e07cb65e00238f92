# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whole trajectories that are published again and again: their bytes, and what is new in them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.files.paths import GrowingPath, PathMessage, decode_path, path_of
from trajeval_ros.online.samples import PoseSamples

SECOND = 1_000_000_000
KINDS = ["bag", "mcap", "sqlite3"]


def numbers(count: int, seed: int = 0) -> npt.NDArray[np.float64]:
    values = np.random.default_rng(seed).normal(size=(count, 7))
    values[:, 3:] /= np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return values


def samples(stamps: Sequence[int], values: npt.NDArray[np.float64]) -> PoseSamples:
    return PoseSamples(np.array(stamps, dtype=np.int64), values[:, :3].copy(), values[:, 3:].copy())


def path(stamps: Sequence[int], seed: int = 0, stamp: int = 9) -> PathMessage:
    return PathMessage(stamp, "map", samples(stamps, numbers(len(stamps), seed)))


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


def same(one: PoseSamples, other: PoseSamples) -> bool:
    return all(
        np.array_equal(getattr(one, part), getattr(other, part))
        for part in ("stamps", "positions", "quaternions")
    )


@given(
    st.text(max_size=9).filter(lambda text: "\0" not in text),
    st.lists(st.sampled_from(["", "m", "map", "odom", "camera_link"]), max_size=6),
    st.booleans(),
)
def test_bytes_are_read_as_the_message_says(frame: str, frames: list[str], alike: bool) -> None:
    """The twin is the library's own reading, pose by pose."""
    frames = frames[:1] * len(frames) if alike else frames
    stamps = [7 * SECOND + i for i in range(len(frames))]
    made = samples(stamps, numbers(len(frames)))
    message, raw = Store().path(12 * SECOND + 5, frame, frames, made)
    twin = path_of(message)
    read = decode_path(raw)
    if read is None:
        assert len({len(each) for each in frames}) > 1
        return
    assert (read.stamp, read.frame) == (twin.stamp, twin.frame) == (12 * SECOND + 5, frame)
    assert same(read.samples, twin.samples)
    assert same(read.samples, made)


def test_bytes_that_end_early_are_no_message() -> None:
    _, raw = Store().path(1, "map", ["map"] * 4, samples([1, 2, 3, 4], numbers(4)))
    assert decode_path(raw) is not None
    # What is left out at the very end may be padding.
    assert all(decode_path(raw[:size]) is None for size in range(len(raw) - 8))


def test_only_what_is_new_is_new() -> None:
    growing = GrowingPath()
    assert len(growing.take(path([]))) == 0
    assert growing.latest is None
    assert growing.take(path([1, 2, 3], 1)).stamps.tolist() == [1, 2, 3]
    later = path([1, 2, 3, 4, 5], 2)
    assert growing.take(later).stamps.tolist() == [4, 5]
    assert growing.latest is not None
    assert same(growing.latest, later.samples)
    # A window, out of order, with a pose said twice.
    window = path([6, 4, 6, 5], 3)
    assert growing.take(window).stamps.tolist() == [6]
    assert growing.latest.stamps.tolist() == [4, 5, 6]
    assert np.array_equal(growing.latest.positions[2], window.samples.positions[2])


def test_a_trajectory_that_begins_anew() -> None:
    growing = GrowingPath()
    growing.take(path([0, 5 * SECOND, 10 * SECOND]))
    assert growing.take(path([0, 9 * SECOND + 1])).stamps.tolist() == []
    assert growing.take(path([0, 5 * SECOND])).stamps.tolist() == [0, 5 * SECOND]


def test_poses_without_stamps() -> None:
    """The last is taken, at the message's own stamp; there is nothing to be corrected later."""
    growing = GrowingPath()
    message = path([0, 0, 0], stamp=17)
    new = growing.take(message)
    assert new.stamps.tolist() == [17]
    assert np.array_equal(new.positions[0], message.samples.positions[-1])
    assert growing.lacks_stamps
    assert growing.latest is None


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_of_paths(tmp_path: Path, kind: str) -> None:
    from trajeval_ros.files.bag import list_candidates, read_bag

    store = Store(kind == "bag")
    messages = [path(list(range(SECOND, (n + 1) * SECOND, SECOND)), n, n) for n in (2, 3, 5)]
    raws = [
        store.path(one.stamp, one.frame, ["map"] * len(one.samples), one.samples)[1]
        for one in messages
    ]
    bag = write(tmp_path, kind, store.store, raws)
    (read,) = read_bag(bag, ["/path"])
    assert read.stamps.tolist() == [n * SECOND for n in range(1, 6)]
    assert read.rows.tolist() == [1, 1, 2, 3, 3]
    assert np.array_equal(read.positions[:2], messages[0].samples.positions)
    assert np.array_equal(read.positions[2], messages[1].samples.positions[2])
    assert read.latest_path is not None
    assert same(read.latest_path, messages[2].samples)
    (found,) = list_candidates(bag)
    assert (found.topic, found.count, found.rate) == ("/path", 5, 1.0)


def test_a_message_of_rclpy_is_read_by_its_fields() -> None:
    at = SimpleNamespace(x=1.0, y=2.0, z=3.0)
    turned = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=4), frame_id="map")
    pose = SimpleNamespace(header=header, pose=SimpleNamespace(position=at, orientation=turned))
    read = path_of(SimpleNamespace(header=header, poses=[pose]))
    assert read.samples.stamps.tolist() == [3 * SECOND + 4]
    assert read.samples.positions.tolist() == [[1.0, 2.0, 3.0]]
