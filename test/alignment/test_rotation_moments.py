# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The mean squared angle from moments against the angles themselves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros import se3
from trajeval_ros.alignment.rotation_moments import CELL, RotationMoments


def rms_angle(rotations):
    return np.sqrt(np.mean(np.sum(se3.log_so3(rotations) ** 2, axis=-1)))


def errors_up_to(rng, angle, count):
    """Rotations (count, 3, 3) of random axes, angles between a fifth of it and all of it."""
    axes = rng.normal(size=(count, 3))
    axes *= rng.uniform(0.2, 1.0, size=(count, 1)) / np.linalg.norm(axes, axis=-1, keepdims=True)
    return se3.exp_so3(angle * axes)


def from_moments(rotations, alignment):
    moments = RotationMoments()
    moments.update(rotations)
    return np.sqrt(moments.mean_square_angle(alignment))


@settings(max_examples=150)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 300),
    st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2, 0.03, 0.1, 0.2, 0.4, 0.8, 1.5, 2.0]),
    st.sampled_from([0.0, 1e-9, 1e-3, 0.03, 0.3, 1.0]),
)
def test_equals_the_angles(seed, count, angle, offset):
    rng = np.random.default_rng(seed)
    alignment = se3.exp_so3(rng.normal(size=3))
    offset_axis = rng.normal(size=3)
    off = se3.exp_so3(offset * offset_axis / np.linalg.norm(offset_axis))
    rotations = alignment.T @ off @ errors_up_to(rng, angle, count)
    direct = rms_angle(alignment @ rotations)
    # The sums cancel where the first pose, the origin of the chart, is far off and all is well.
    floor = 3e-9 * min(angle, CELL) + 1e-14
    relative = 1e-9 if angle + offset < 0.5 else 1e-7
    assert from_moments(rotations, alignment) == pytest.approx(direct, rel=relative, abs=floor)


@settings(max_examples=100)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3.0))
def test_the_worst_place_in_a_cell(seed, angle):
    """All rotations at one corner of a cell: nothing averages out."""
    rng = np.random.default_rng(seed)
    corner = np.where(rng.random(3) < 0.5, -1.0, 1.0) * 0.4999 * CELL
    axis = rng.normal(size=3)
    alignment = se3.exp_so3(angle * axis / np.linalg.norm(axis))
    rotations = np.stack((np.eye(3), *[se3.exp_so3(corner)] * 50))
    direct = rms_angle(alignment @ rotations)
    largest = np.linalg.norm(se3.log_so3(alignment @ rotations), axis=-1).max()
    if largest < 2.5:
        assert from_moments(rotations, alignment) == pytest.approx(direct, rel=1e-7)
    assert from_moments(rotations, alignment) == pytest.approx(direct, rel=1e-2)


def test_half_turns_stay_within_a_percent():
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(2000, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    rotations = se3.exp_so3(axes * rng.uniform(3.0, np.pi, size=(2000, 1)))
    assert from_moments(rotations, np.eye(3)) == pytest.approx(rms_angle(rotations), rel=1e-2)


def test_a_body_frame_that_differs():
    """Camera axes scored against body axes: errors of 120 degrees, spread over a sphere."""
    rng = np.random.default_rng(1)
    ground_truth = se3.exp_so3(rng.normal(size=(3000, 3)))
    swapped = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    rotations = ground_truth @ swapped @ np.swapaxes(ground_truth, -1, -2)
    assert from_moments(rotations, np.eye(3)) == pytest.approx(np.deg2rad(120.0), rel=1e-9)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 40), min_size=1, max_size=10))
def test_batches_do_not_matter(seed, sizes):
    rng = np.random.default_rng(seed)
    rotations = errors_up_to(rng, 0.5, sum(sizes) + 1)
    whole, cut = RotationMoments(), RotationMoments()
    whole.update(rotations)
    for part in np.split(rotations, np.cumsum(sizes)):
        cut.update(part)
    assert cut.count == whole.count == len(rotations)
    assert cut.cells == whole.cells
    assert cut.mean_square_angle(np.eye(3)) == pytest.approx(
        whole.mean_square_angle(np.eye(3)), rel=1e-12
    )


def test_memory_does_not_grow_with_the_run():
    rng = np.random.default_rng(2)
    moments = RotationMoments()
    for _ in range(20):
        moments.update(errors_up_to(rng, 0.05, 10_000))
    assert moments.count == 200_000
    assert moments.cells <= 27


def test_nothing_yet():
    moments = RotationMoments()
    moments.update(np.zeros((0, 3, 3)))
    with pytest.raises(ValueError, match="no rotations"):
        moments.mean_square_angle(np.eye(3))
