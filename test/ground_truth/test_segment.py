# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth.segment import Samples, Segment


def poses_of(vectors, positions):
    poses = np.tile(np.eye(4), (len(vectors), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = se3.exp_so3(vectors), positions
    return poses


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@given(
    count=st.integers(1, 30),
    step=st.sampled_from([0.0, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 2.0]),
    start=st.sampled_from([0.0, 1e-9, 1.0, np.pi - 1e-7, np.pi, 3.5]),
    deviation=st.sampled_from([0.0, 1e-7]),
    known=st.integers(1, 30),
    seed=st.integers(0, 999),
)
def test_the_loop_has_the_coordinates_of_numpy(count, step, start, deviation, known, seed):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angles = start + step * np.arange(count)
    wobble = 0.1 * step * rng.normal(size=(count, 3))
    poses = poses_of(angles[:, None] * axis + wobble, 100.0 * rng.normal(size=(count, 3)))
    poses[0] = poses_of(rng.normal(size=(1, 3)), rng.normal(size=(1, 3)))[0]
    poses[1:] = poses[0] @ poses[1:]
    poses[:, :3, :3] += deviation * rng.normal(size=(count, 3, 3))
    samples = Samples(np.arange(count), poses)

    def coordinates():
        segment = Segment(samples[:known])
        following = segment.following(samples.poses[known:])
        segment.append(samples[known:], following)
        return segment.coordinates

    found = coordinates()
    with loops.left_out():
        expected = coordinates()
    assert found.shape == (count, 6)
    np.testing.assert_allclose(found[:, :3], expected[:, :3], rtol=0, atol=1e-11)
    # At the angle of pi itself either sign is right, and which it is, round-off decides.
    turned = se3.exp_so3(expected[:, 3:])
    np.testing.assert_allclose(se3.exp_so3(found[:, 3:]), turned, rtol=0, atol=1e-9)
    if start < 2.0:
        np.testing.assert_allclose(found[:, 3:], expected[:, 3:], rtol=0, atol=1e-9)
