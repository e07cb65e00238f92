# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms composed along a tree."""

import pathlib

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.files.bag import read_bag
from trajeval_ros.files.trajectory import TrajectoryFileError
from trajeval_ros.files.transforms import Edge, composed, finest, way

BAGS = pathlib.Path(__file__).parents[2] / ".." / "shared" / "data" / "rosbags"
SECOND = 1_000_000_000


def moving(seconds, seed):
    """A constant twist of its own, so that interpolation is exact."""
    twist = np.random.default_rng(seed).normal(size=6) * 0.2
    start = se3.exp(np.random.default_rng(seed + 100).normal(size=6))
    return se3.compose(start, se3.exp(np.asarray(seconds)[:, None] * twist))


def edge(seconds, seed):
    stamps = np.rint(np.asarray(seconds) * SECOND).astype(np.int64)
    return Edge.of(stamps, moving(seconds, seed), False)


def test_the_way_goes_up_and_down():
    edges = [("map", "odom"), ("odom", "base"), ("base", "imu"), ("world", "map"), ("a", "b")]
    assert way(edges, "map", "imu") == (
        (("map", "odom"), False),
        (("odom", "base"), False),
        (("base", "imu"), False),
    )
    assert way(edges, "imu", "world")[0] == (("base", "imu"), True)
    assert [backward for _, backward in way(edges, "imu", "world")] == [True] * 4
    assert way(edges, "map", "a") == ()


def test_composed_at_the_stamps_of_the_finest_edge():
    slow, fast = np.arange(1.0, 9.0, 0.5), np.arange(0.0, 10.0, 0.02)
    turn = se3.exp(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    edges = {
        ("map", "odom"): edge(slow, 1),
        ("odom", "base"): edge(fast, 2),
        ("imu", "base"): Edge.of(np.array([5]), turn[None], True),
    }
    steps = way(edges, "map", "imu")
    timed_by = finest(edges, steps)
    stamps, poses = composed(edges, steps, timed_by)
    assert timed_by == ("odom", "base")
    seconds = stamps / SECOND
    assert (seconds[0], seconds[-1]) == (1.0, 8.5)
    assert len(stamps) == 376
    expected = se3.compose(se3.compose(moving(seconds, 1), moving(seconds, 2)), se3.inverse(turn))
    np.testing.assert_allclose(poses, expected, atol=1e-12)
    back = composed(edges, way(edges, "imu", "map"), timed_by)[1]
    np.testing.assert_allclose(back, se3.inverse(expected), atol=1e-12)


def test_of_one_stamp_the_last_transform_counts_in_any_order():
    poses = moving([0.0, 1.0, 2.0, 3.0], 3)
    found = Edge.of(np.array([2, 1, 2, 0]) * SECOND, poses, False)
    assert found.stamps.tolist() == [0, SECOND, 2 * SECOND]
    np.testing.assert_array_equal(found.poses, poses[[3, 1, 2]])


@pytest.mark.skipif(not BAGS.is_dir(), reason="the real bags are not here")
def test_map_to_base_link_of_a_real_bag():
    pytest.importorskip("rosbags", reason="needs the extra bags")
    bag = BAGS / "nav2_turtlebot.mcap"
    (odometry,) = read_bag(bag, ["/odom"])
    composed_, direct = read_bag(bag, ["/tf:map.base_link", "/tf:map.odom"])
    assert composed_.remarks[0].startswith("/tf:map.base_link is composed of map to odom, odom to")
    assert len(composed_) > 1000
    assert (np.diff(composed_.stamps) > 0).all()
    assert len(direct) < len(composed_)
    assert direct.remarks == ()
    # The way is odometry's, in another world, up to what the map corrects.
    place = np.searchsorted(odometry.stamps, composed_.stamps).clip(0, len(odometry) - 1)
    aligned = align_positions(composed_.positions, odometry.positions[place], "se3")
    assert np.linalg.norm(odometry.positions.std(axis=0)) > 3.0
    assert aligned.rmse < 0.5
    with pytest.raises(TrajectoryFileError, match="there is no frame 'moon' on /tf; there are"):
        read_bag(bag, ["/tf:map.moon"])
