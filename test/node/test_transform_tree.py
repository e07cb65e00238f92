# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A transform composed while the tree arrives, held to what was put in and to a bag's reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.node.transform_tree import MEMORY, Transform, TransformTree

SECOND = 1_000_000_000
BAG = Path(__file__).parents[2] / ".." / "shared" / "data" / "rosbags" / "nav2_turtlebot.mcap"


def motion(seconds, seed):
    """A constant twist, of which interpolation is exact."""
    random = np.random.default_rng(seed)
    twist, start = random.normal(size=6) * 0.2, se3.exp(random.normal(size=6))
    return se3.compose(start, se3.exp(np.asarray(seconds)[:, None] * twist))


def transforms(seconds, poses, parent, child):
    positions, quaternions = se3.to_position_quaternion(poses)
    stamps = np.rint(np.asarray(seconds) * SECOND).astype(int).tolist()
    return [
        Transform(stamp, parent, child, tuple(p), tuple(q))
        for stamp, p, q in zip(stamps, positions.tolist(), quaternions.tolist(), strict=True)
    ]


SLOW, FAST = np.arange(1.0, 9.0, 0.5), np.arange(0.0, 10.0, 0.02)
TURN = se3.exp(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))


def stream():
    """Slow and fast edges by stamp."""
    both = transforms(SLOW, motion(SLOW, 1), "map", "odom")
    both += transforms(FAST, motion(FAST, 2), "/odom", "base")
    return sorted(both, key=lambda each: each.stamp)


def fed(tree, batches):
    stamps, poses = [], []
    for batch in batches:
        tree.add(batch, static=False)
        taken = tree.take()
        stamps.append(taken[0])
        poses.append(taken[1])
    return np.concatenate(stamps), np.concatenate(poses)


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_the_same_however_the_batches_are_cut(size):
    tree = TransformTree("/map", "imu")
    tree.add(transforms([5.0], TURN[None], "base", "imu"), static=True)
    all_of_it = stream()
    stamps, poses = fed(tree, [all_of_it[i : i + size] for i in range(0, len(all_of_it), size)])
    seconds = stamps / SECOND
    assert (seconds[0], seconds[-1], len(seconds)) == (1.0, 8.5, 376)
    expected = se3.compose(se3.compose(motion(seconds, 1), motion(seconds, 2)), TURN)
    np.testing.assert_allclose(poses, expected, atol=1e-12)


def test_what_is_not_known_on_both_sides_waits():
    tree = TransformTree("map", "base")
    tree.add(transforms([0.0, 1.0], motion([0.0, 1.0], 1), "map", "odom"), static=False)
    tree.add(transforms(FAST, motion(FAST, 2), "odom", "base"), static=False)
    assert tree.take()[0][-1] == SECOND
    tree.add(transforms([2.0], motion([2.0], 1), "map", "odom"), static=False)
    stamps, poses = tree.take()
    assert (stamps[0], stamps[-1]) == (1.02 * SECOND, 2 * SECOND)
    expected = se3.compose(motion(stamps / SECOND, 1), motion(stamps / SECOND, 2))
    np.testing.assert_allclose(poses, expected, atol=1e-12)


def test_a_frame_that_gets_another_parent():
    tree = TransformTree("map", "base")
    first, second = FAST[:200], FAST[200:]
    tree.add(transforms(first, motion(first, 1), "map", "base"), static=False)
    tree.add(transforms([0.0], TURN[None], "map", "room"), static=True)
    tree.add(transforms(second, motion(second, 2), "room", "base"), static=False)
    stamps, poses = tree.take()
    assert stamps.tolist() == np.rint(FAST * SECOND).tolist()
    expected = np.concatenate([motion(first, 1), se3.compose(TURN, motion(second, 2))])
    np.testing.assert_allclose(poses, expected, atol=1e-12)


def test_unusable_ones_on_the_way_are_counted_and_passed_over():
    tree = TransformTree("map", "base")
    whole = transforms(FAST, motion(FAST, 1), "map", "base")
    bad = Transform(SECOND + 1, "map", "base", (np.nan, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    elsewhere = Transform(SECOND, "base", "arm", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    tree.add([*whole[:100], bad, elsewhere, *whole[100:]], static=False)
    assert tree.unusable == 1
    assert len(tree.take()[0]) == len(FAST)


def test_static_alone_is_no_trajectory():
    tree = TransformTree("map", "base")
    tree.add(transforms([0.0, 1.0], motion([0.0, 1.0], 1), "map", "base"), static=True)
    assert len(tree.take()[0]) == 0


def test_stamps_that_begin_anew():
    tree = TransformTree("map", "base")
    later = FAST + 100.0
    tree.add(transforms(later, motion(FAST, 1), "map", "base"), static=False)
    tree.add(transforms(FAST, motion(FAST, 1), "map", "base"), static=False)
    stamps, _ = tree.take()
    assert stamps.tolist() == np.rint(np.concatenate([later, FAST]) * SECOND).tolist()


def test_memory_is_bounded():
    tree = TransformTree("map", "base")
    for begin in range(0, 100, 5):
        seconds = begin + np.arange(0.0, 5.0, 0.01)
        # One edge on the way, of which another is never known; and one beside it.
        tree.add(transforms(seconds, motion(seconds, 1), "odom", "base"), static=False)
        tree.add(transforms(seconds, motion(seconds, 2), "base", "arm"), static=False)
        tree.take()
    kept = [len(history.values) for history in tree._edges.values()]
    assert max(kept) <= 1.1 * MEMORY / SECOND * 100 + 2


def test_why_nothing_can_be_composed():
    tree = TransformTree("map", "base")
    assert tree.problem is None
    tree.add(transforms([0.0], TURN[None], "odom", "base"), static=False)
    assert tree.problem == "there is no frame 'map'; there are base, odom"
    tree.add(transforms([0.0], TURN[None], "map", "dock"), static=True)
    assert tree.problem == "'map' and 'base' are not connected"
    tree.add(transforms([0.0], TURN[None], "map", "odom"), static=False)
    assert tree.problem is None


@pytest.mark.parametrize(
    ("position", "quaternion", "usable"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), True),
        ((0.0, np.nan, 0.0), (0.0, 0.0, 0.0, 1.0), False),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), False),
    ],
)
def test_unusable_transforms(position, quaternion, usable):
    assert Transform(0, "map", "base", position, quaternion).is_usable == usable


@pytest.mark.skipif(not BAG.exists(), reason="../shared/data is absent")
def test_a_real_tree_as_the_reader_of_bags_composes_it():
    highlevel = pytest.importorskip("rosbags.highlevel", reason="rosbags is not installed")
    from rosbags.typesys import Stores, get_typestore

    from trajeval_ros.files.bag import read_bag

    tree = TransformTree("map", "base_link")
    taken = []
    store = get_typestore(Stores.ROS2_JAZZY)
    with highlevel.AnyReader([BAG], default_typestore=store) as reader:
        connections = [c for c in reader.connections if c.topic in ("/tf", "/tf_static")]
        for connection, _, raw in reader.messages(connections):
            message = reader.deserialize(raw, connection.msgtype)
            for each in message.transforms:
                at, turned = each.transform.translation, each.transform.rotation
                transform = Transform(
                    each.header.stamp.sec * SECOND + each.header.stamp.nanosec,
                    each.header.frame_id,
                    each.child_frame_id,
                    (at.x, at.y, at.z),
                    (turned.x, turned.y, turned.z, turned.w),
                )
                tree.add([transform], connection.topic == "/tf_static")
            taken.append(tree.take())
    stamps = np.concatenate([each[0] for each in taken])
    poses = np.concatenate([each[1] for each in taken])
    (of_bag,) = read_bag(BAG, ["/tf:map.base_link"])
    # What came before the tree was known is not made up for.
    assert len(stamps) > 0.95 * len(of_bag)
    common, ours, theirs = np.intersect1d(stamps, of_bag.stamps, return_indices=True)
    assert len(common) == len(stamps)
    np.testing.assert_allclose(
        poses[ours],
        se3.from_position_quaternion(of_bag.positions[theirs], of_bag.quaternions[theirs]),
        atol=1e-9,
    )
