# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whole trajectories that are published again and again: their bytes, and what is new in them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins.path_bags import Store, samples, write

from trajeval_ros.files.paths import GrowingPath, PathMessage, decode_path, path_of
from trajeval_ros.online.samples import PoseSamples

SECOND = 1_000_000_000
KINDS = ["bag", "mcap", "sqlite3"]


def numbers(count: int, seed: int = 0) -> npt.NDArray[np.float64]:
    values = np.random.default_rng(seed).normal(size=(count, 7))
    values[:, 3:] /= np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return values


def path(stamps: Sequence[int], seed: int = 0, stamp: int = 9) -> PathMessage:
    return PathMessage(stamp, "map", samples(stamps, numbers(len(stamps), seed)))


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
    growing.take(path([0, 5 * SECOND, 10 * SECOND], stamp=10 * SECOND))
    assert growing.take(path([0, 9 * SECOND + 1], stamp=10 * SECOND)).stamps.tolist() == []
    growing.take(path([n * SECOND for n in range(11)], stamp=11 * SECOND))
    assert growing.take(path([SECOND], stamp=SECOND)).stamps.tolist() == [SECOND]


@pytest.mark.parametrize("now", [120 * SECOND, 0, 60 * SECOND], ids=["on", "not set", "its end"])
def test_a_trajectory_that_is_cut_is_not_fed_again(now: int) -> None:
    """An estimator takes back its last forty seconds, and goes on."""
    growing, stamps = GrowingPath(), [n * SECOND for n in range(1, 101)]
    growing.take(path(stamps, stamp=100 * SECOND if now else 0))
    assert len(growing.take(path(stamps[:60], stamp=now))) == 0
    assert growing.latest is not None
    assert len(growing.latest) == 60
    assert growing.take(path([*stamps[:60], 121 * SECOND], stamp=now)).stamps.tolist() == [
        121 * SECOND
    ]


@pytest.mark.parametrize("header", [SECOND, 0])
def test_a_bag_that_loops_begins_anew(header: int) -> None:
    growing, stamps = GrowingPath(), [n * SECOND for n in range(1, 101)]
    growing.take(path(stamps, stamp=100 * header))
    assert len(growing.take(path(stamps[:1], stamp=header))) == 1
    assert len(growing.take(path(stamps[:3], stamp=3 * header))) == 2


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
