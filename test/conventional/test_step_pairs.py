# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs one step apart against the obvious loop and evo's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros.conventional.step_pairs import StepPairs


def walk(seed, count):
    """Stamps (M,) ns, irregular, and poses (M, 4, 4) whose x rotation entry is their number."""
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.integers(1, 200_000_000, size=count)) + 1_400_000_000_000_000_000
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.cumsum(
        rng.normal(size=(count, 3)) * rng.choice([0, 0.1, 1], count)[:, None], 0
    )
    other = poses.copy()
    other[:, :3, 3] += rng.normal(size=(count, 3)) * 0.02
    return stamps, poses, other


def obvious_pairs(amount, delta):
    """Pairs (i, j): from i to the first j where the amount since i has reached delta."""
    pairs, begin, so_far = [], 0, 0.0
    for j in range(1, len(amount) + 1):
        so_far += amount[j - 1]
        if so_far >= delta:
            pairs.append((begin, j))
            begin, so_far = j, 0.0
    return pairs


def pairs_in_batches(pairs, cuts, stamps, ground_truth, estimate):
    """The four stacks of poses that the batches' pairs make together."""
    parts = [
        pairs.update(*batch)
        for batch in zip(
            np.split(stamps, cuts),
            np.split(ground_truth, cuts),
            np.split(estimate, cuts),
            strict=True,
        )
    ]
    return [np.concatenate(stack) for stack in zip(*parts, strict=True)]


CASES = given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 300),
    st.floats(0.001, 30.0),
    st.lists(st.integers(0, 300), max_size=12).map(sorted),
)


@settings(max_examples=80)
@CASES
def test_by_path_is_evo_s(seed, count, delta, cuts):
    filters = pytest.importorskip("evo.core.filters", reason="evo is not installed")
    stamps, ground_truth, estimate = walk(seed, count)
    for along_ground_truth in (False, True):
        walked = ground_truth if along_ground_truth else estimate
        expected = filters.filter_pairs_by_path(list(walked), delta)
        steps = np.linalg.norm(np.diff(walked[:, :3, 3], axis=0), axis=-1)
        assert expected == obvious_pairs(steps, delta)
        pairs = StepPairs(delta, "m", along_ground_truth)
        result = pairs_in_batches(pairs, cuts, stamps, ground_truth, estimate)
        begins, ends = [i for i, _ in expected], [j for _, j in expected]
        for stack, poses, indices in zip(
            result,
            [ground_truth, ground_truth, estimate, estimate],
            [begins, ends] * 2,
            strict=True,
        ):
            np.testing.assert_array_equal(stack, poses[indices])
        if expected:
            longest = max(steps[i:j].sum() for i, j in expected)
            assert pairs.longest == pytest.approx(longest, rel=1e-12)
        else:
            assert pairs.longest is None


def assert_poses_of(expected, result, ground_truth, estimate):
    begins, ends = [i for i, _ in expected], [j for _, j in expected]
    np.testing.assert_array_equal(result[0], ground_truth[begins])
    np.testing.assert_array_equal(result[1], ground_truth[ends])
    np.testing.assert_array_equal(result[2], estimate[begins])
    np.testing.assert_array_equal(result[3], estimate[ends])


@settings(max_examples=80)
@CASES
def test_by_time(seed, count, delta, cuts):
    stamps, ground_truth, estimate = walk(seed, count)
    expected = obvious_pairs(np.diff(stamps), round(delta * 1e9))
    pairs = StepPairs(delta, "s")
    result = pairs_in_batches(pairs, cuts, stamps, ground_truth, estimate)
    assert_poses_of(expected, result, ground_truth, estimate)
    if expected:
        longest = max(stamps[j] - stamps[i] for i, j in expected)
        assert pairs.longest == pytest.approx(longest * 1e-9, rel=1e-15)


@settings(max_examples=80)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 60),
    st.integers(1, 12),
    st.lists(st.integers(0, 60), max_size=12).map(sorted),
)
def test_by_frames_is_evo_s(seed, count, delta, cuts):
    filters = pytest.importorskip("evo.core.filters", reason="evo is not installed")
    stamps, ground_truth, estimate = walk(seed, count)
    expected = filters.filter_pairs_by_index(list(estimate), delta)
    pairs = StepPairs(float(delta), "f")
    result = pairs_in_batches(pairs, cuts, stamps, ground_truth, estimate)
    assert_poses_of(expected, result, ground_truth, estimate)
    assert pairs.longest == (delta if expected else None)


def test_a_step_of_exactly_delta_is_a_pair():
    stamps = np.arange(31) * 100_000_000
    poses = np.tile(np.eye(4), (31, 1, 1))
    assert len(StepPairs(1.0, "s").update(stamps, poses, poses)[0]) == 3


def test_a_gap_is_one_pair_and_its_length_is_told():
    stamps = np.array([0, 1_000_000_000, 13_000_000_000, 14_000_000_000])
    poses = np.tile(np.eye(4), (4, 1, 1))
    pairs = StepPairs(1.0, "s")
    assert len(pairs.update(stamps, poses, poses)[0]) == 3
    assert pairs.longest == 12.0


@pytest.mark.parametrize("delta", [0.0, -1.0, np.nan, np.inf])
def test_bad_delta(delta):
    with pytest.raises(ValueError, match="delta must be positive"):
        StepPairs(delta, "s")


def test_bad_unit():
    with pytest.raises(ValueError, match="unknown unit 'rad'"):
        StepPairs(1.0, "rad")


def test_frames_are_whole():
    with pytest.raises(ValueError, match="whole number of frames"):
        StepPairs(1.5, "f")
