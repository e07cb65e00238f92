# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A batch of queries by one loop in C beside NumPy's way through the same factors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.ground_truths import at, cut, ground_truth, patterns, regular, sampled, shapes
from twins.runs import SECOND, motion

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth.at_once import Answers
from trajeval_ros.ground_truth.joint import JointCovariance
from trajeval_ros.ground_truth.segment import Samples

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


def learned(stamp_shared=0.0):
    """The process of one that stood still before it moved."""
    times = regular(30.0, 50.0)
    truth = ground_truth(sampled(times, lambda s: motion(np.maximum(s - 12.0, 0.0))), None)
    truth.conclude()
    return replace(truth._process(0), stamp_std=1e-3, stamp_shared=stamp_shared)


def some_queries(samples, rng, count=60):
    """At samples and between them, the first and the last one too, each by samples of its own."""
    between = rng.integers(samples.stamps[0], samples.stamps[-1] + 1, count)
    stamps = np.sort(
        np.concatenate([samples.stamps[[0, -1]], rng.choice(samples.stamps, 8), between])
    )
    after = np.searchsorted(samples.stamps, stamps)
    ahead = rng.integers(0, 4, len(stamps))
    return stamps, samples.stamps[np.minimum(after + ahead, len(samples) - 1)]


def agree(found, expected):
    np.testing.assert_allclose(found.poses, expected.poses, rtol=0, atol=1e-12)
    pairs = [(found.covariances, expected.covariances)]
    if expected.twists is not None:
        pairs += [
            (found.twists.means[:, None], expected.twists.means[:, None]),
            (found.twists.covariances, expected.twists.covariances),
        ]
    else:
        assert found.twists is None
    for one, other in pairs:
        size = np.abs(other).max(axis=(1, 2), keepdims=True)
        size[size == 0.0] = 1.0  # a single sample tells of no twist
        np.testing.assert_allclose(one / size, other / size, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(found.sampled, expected.sampled)
    np.testing.assert_array_equal(found.nearest, expected.nearest)


def both(truth, stamps, until, twists):
    """By C, and segment after segment as the joint covariance needs it."""
    found = truth.posterior(stamps, until, twists=twists)
    return found, truth.posterior(stamps, until, JointCovariance(), twists=twists)


@given(
    times=patterns(),
    shape=shapes,
    twists=st.booleans(),
    own=st.booleans(),
    seed=st.integers(0, 999),
)
@settings(max_examples=40)
def test_it_is_what_the_segments_say_one_by_one(times, shape, twists, own, seed):
    rng = np.random.default_rng(seed)
    samples = sampled(times)
    if own:  # of each sample: six groups of one coordinate
        square = rng.normal(size=(len(samples), 6, 6)) * 1e-3
        samples = replace(
            samples, covariances=square @ np.swapaxes(square, 1, 2) + 1e-6 * np.eye(6)
        )
    truth = ground_truth(samples, shape=shape)
    agree(*both(truth, *some_queries(samples, rng), twists))


@pytest.mark.parametrize("shared", [0.0, 2e-3])
def test_epochs_of_a_segment_and_stamps_that_are_off_together(shared):
    seconds = regular(40.0, 50.0)
    noise = np.random.default_rng(0).normal(size=(len(seconds), 6))
    noise *= np.where(seconds % 14.0 > 7.0, 2e-2, 1e-3)[:, None]
    samples = Samples(at(seconds), motion(seconds) @ se3.exp(noise), None)
    truth = ground_truth(samples, learned(shared))
    truth._advance()
    assert any(len(each.segment.epochs) > 1 for each in truth._segmentation)
    stamps, until = some_queries(samples, np.random.default_rng(1), 400)
    for twists in (False, True):
        agree(*both(truth, stamps, until, twists))


@given(cuts=st.sets(st.integers(1, 599), max_size=4), seed=st.integers(0, 999))
@settings(max_examples=10)
def test_digits_depend_on_no_batch_and_no_order(cuts, seed):
    rng = np.random.default_rng(seed)
    samples = sampled(regular(12.0, 50.0))
    whole, grown = ground_truth(samples), ground_truth()
    for part in cut(samples, cuts):
        grown.append(part)
        grown._advance()
    stamps, until = some_queries(samples, rng)
    expected = whole.posterior(stamps, until, twists=True)
    order = rng.permutation(len(stamps))
    for some in np.array_split(order, 5):
        found = grown.posterior(stamps[some], until[some], twists=True)
        np.testing.assert_array_equal(found.poses, expected.poses[some])
        np.testing.assert_array_equal(found.covariances, expected.covariances[some])
        np.testing.assert_array_equal(found.twists.means, expected.twists.means[some])


def test_a_query_before_what_is_retained_is_refused_either_way():
    samples = sampled(regular(20.0, 50.0))
    truth = ground_truth(samples)
    truth.forget(int(samples.stamps[800]))
    stamps = samples.stamps[[10]]
    for joint in (None, JointCovariance()):
        with pytest.raises(ValueError, match="before the retained segments"):
            truth.posterior(stamps, stamps + SECOND // 10, joint)


def test_none_asked_and_nobody_who_answers():
    none = np.empty(0, dtype=np.int64)
    answers = Answers(none, none, none, twists=True)
    answers.add([])
    assert answers.are_whole
    assert answers.poses.shape == (0, 4, 4)
    truth = ground_truth(sampled(regular(4.0, 50.0)))
    found = truth.posterior(none, none, twists=True)
    assert found.twists.covariances.shape == (0, 6, 6)


def test_a_kernel_that_is_not_markov_and_one_without_loops_answer_too():
    samples = sampled(regular(6.0, 20.0))
    stamps, until = some_queries(samples, np.random.default_rng(2))
    smooth = ground_truth(samples, kernel="squared_exponential")
    agree(*both(smooth, stamps, until, True))
    with loops.left_out():
        expected = ground_truth(samples).posterior(stamps, until, twists=True)
    found = ground_truth(samples).posterior(stamps, until, twists=True)
    np.testing.assert_allclose(found.poses, expected.poses, rtol=0, atol=1e-9)
    size = np.abs(expected.covariances).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(found.covariances / size, expected.covariances / size, atol=1e-9)
