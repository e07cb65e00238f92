# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The thinned run, and the ellipsoids drawn from a covariance."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import se3
from trajeval_ros.online.results import Evaluations
from trajeval_ros.runs.trail import Trail, ellipsoids


def evaluations(first: int, count: int) -> Evaluations:
    poses = np.tile(np.eye(4), (count, 1, 1))
    covariance = np.tile(np.eye(6), (count, 1, 1))
    stamps = np.arange(first, first + count, dtype=np.int64)
    zeros = np.zeros(count)
    errors = np.zeros((count, 6))
    sampled = np.ones(count, dtype=bool)
    four = (zeros, zeros, zeros, zeros)
    last = (sampled, errors, stamps)
    return Evaluations(stamps, poses, covariance, poses, errors, errors, *four, *last)


@given(chunks=st.lists(st.integers(0, 60), max_size=30))
def test_bounded_and_evenly_spread(chunks: list[int]) -> None:
    trail = Trail(capacity=40, recent=7)
    count = 0
    for chunk in chunks:
        trail.add(evaluations(count, chunk))
        count += chunk
    assert trail.count == count
    kept = trail.run.stamps
    assert len(kept) <= 40
    assert len(kept) >= min(count, 20)
    if count:
        # Twin: every stride-th of all.
        stride = int(kept[1] - kept[0]) if len(kept) > 1 else 1
        np.testing.assert_array_equal(kept, np.arange(0, count, stride))
    np.testing.assert_array_equal(trail.recent.stamps, np.arange(max(0, count - 7), count))


def test_an_ellipsoid_is_the_positions_covariance() -> None:
    random = np.random.default_rng(3)
    poses = se3.exp(random.normal(0.0, 1.0, (50, 6)))
    factor = random.normal(0.0, 0.1, (50, 6, 6))
    covariance = factor @ np.swapaxes(factor, -1, -2)
    positions, quaternions, deviations = ellipsoids(poses, covariance)
    rotation = se3.from_position_quaternion(positions, quaternions)[:, :3, :3]
    squares = deviations[:, None, :] ** 2
    world = poses[:, :3, :3] @ covariance[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], -1, -2)
    np.testing.assert_allclose(
        (rotation * squares) @ np.swapaxes(rotation, -1, -2), world, atol=1e-9
    )
    np.testing.assert_array_equal(positions, poses[:, :3, 3])


def test_the_published_covariance_is_ross_convention() -> None:
    """Monte Carlo: the pose perturbed as the covariance says, seen about ROS's fixed axes."""
    random = np.random.default_rng(5)
    pose = se3.exp(np.array([1.0, -2.0, 0.5, 0.4, -0.8, 1.1]))
    factor = random.normal(0.0, 0.01, (6, 6))
    covariance = factor @ factor.T
    published = se3.covariance_to_fixed_axes(covariance, pose)
    noise = random.multivariate_normal(np.zeros(6), covariance, 200_000)
    perturbed = pose @ se3.exp(noise)
    moved = perturbed[:, :3, 3] - pose[:3, 3]
    turned = se3.log_so3(perturbed[:, :3, :3] @ pose[:3, :3].T)
    measured = np.cov(np.concatenate([moved, turned], axis=1).T)
    scale = np.sqrt(np.outer(np.diag(published), np.diag(published)))
    np.testing.assert_allclose(measured / scale, published / scale, atol=0.02)
