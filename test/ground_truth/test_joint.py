# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The covariance of the ground truth's errors at different times."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from twins import joint_twin
from twins.ground_truths import GIVEN, SHAPE, at, ground_truth, patterns, regular, sampled, shapes
from twins.runs import SECOND

from trajeval_ros import se3
from trajeval_ros.ground_truth.hyperparameters import (
    Component,
    GroupHyperparameters,
    Hyperparameters,
)
from trajeval_ros.ground_truth.joint import JointCovariance
from trajeval_ros.ground_truth.segmentation import Segmentation
from trajeval_ros.ground_truth.trajectory import GroundTruth, Settings
from trajeval_ros.likelihood.joint import JointFactor


class Asker:
    """A ground truth, and the poses that have been asked of it."""

    def __init__(self, truth):
        self.truth = truth
        self.joint = JointCovariance()

    def posterior(self, stamps, until):
        return self.truth.posterior(stamps, until, self.joint)


def joint_truth(samples, hyperparameters=GIVEN, shape=SHAPE, kernel="matern52"):
    truth = GroundTruth(Settings(kernel, hyperparameters, 1e-6, 1e-6, shape))
    truth.append(samples)
    return Asker(truth)


def until(samples, stamps, lag=0.3):
    """The lag rule."""
    after = np.searchsorted(samples.stamps, stamps + round(lag * SECOND))
    return samples.stamps[np.minimum(after, len(samples) - 1)]


def spread(samples, count):
    """Stamps over the time of the samples."""
    return np.unique(np.linspace(samples.stamps[0], samples.stamps[-1], count).astype(np.int64))


@pytest.mark.parametrize("rates", [(20.0, 7.0), (2.0, 8.0)])
@pytest.mark.parametrize("lag", [0.0, 0.3, 100.0])
def test_is_the_dense_twin(rates, lag):
    samples = sampled(regular(60.0 / rates[0] + 2.0, rates[0]))
    stamps = at(0.05 + np.arange(24) / rates[1])
    stamps = stamps[stamps < samples.stamps[-1]]
    last = until(samples, stamps, lag)
    truth = joint_truth(samples)
    answer = truth.posterior(stamps, last)
    v = joint_twin.from_rows(answer.covariances, answer.cross)
    segmentation = Segmentation(SHAPE)
    list(segmentation.append(samples))
    expected = joint_twin.joint(segmentation, truth.truth._process(0), stamps, last)
    std = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(v / std / std[:, None], expected / std / std[:, None], atol=1e-7)
    assert np.abs(v[:6, -6:]).max() == 0.0 or lag == 0.0 or rates[0] < 5.0


@given(
    times=patterns(),
    shape=shapes,
    count=st.integers(2, 120),
    lag=st.sampled_from([0.0, 0.3, 1e3]),
    kernel=st.sampled_from(["matern52", "matern32", "squared_exponential"]),
    std=st.sampled_from([1e-2, 1.0, 100.0]),
    noise=st.sampled_from([1e-4, 1e-2]),
    length=st.sampled_from([0.05, 1.5, 30.0]),
)
@settings(max_examples=20, deadline=None)
def test_is_positive_definite_with_the_posterior_s_marginals(
    times, shape, count, lag, kernel, std, noise, length
):
    times = times[np.diff(times, prepend=-1.0) > 1e-3]
    assume(len(times) > 2)
    samples = sampled(times)
    group = GroupHyperparameters((Component(std, length),), noise)
    given_ones = Hyperparameters(group, group)
    # Anything from all over to all within a thousandth of the time.
    for share in (1.0, 1e-3):
        stamps = samples.stamps[0] + np.unique(
            (share * (samples.stamps[-1] - samples.stamps[0]) * np.linspace(0, 1, count)).astype(
                np.int64
            )
        )
        last = until(samples, stamps, lag)
        answer = joint_truth(samples, given_ones, shape, kernel).posterior(stamps, last)
        expected = ground_truth(samples, given_ones, shape, kernel).posterior(stamps, last)
        size = np.abs(expected.covariances).max()
        np.testing.assert_allclose(
            answer.covariances, expected.covariances, rtol=0, atol=1e-9 * size
        )
        rows = JointFactor().update(answer.covariances, answer.cross)
        assert np.isfinite(rows.log_dets).all()


@given(
    times=patterns(),
    cuts=st.lists(st.integers(0, 60), max_size=6),
    kernel=st.sampled_from(["matern52", "squared_exponential"]),
)
@settings(max_examples=10, deadline=None)
def test_batches_of_queries_do_not_matter(times, cuts, kernel):
    samples = sampled(times)
    stamps = spread(samples, 60)
    last = until(samples, stamps)
    whole = joint_truth(samples, kernel=kernel).posterior(stamps, last)
    truth, found = joint_truth(samples, kernel=kernel), []
    for piece in np.split(np.arange(len(stamps)), sorted(cuts)):
        if len(piece):
            truth.truth.forget(int(stamps[piece[0]]))
            found += truth.posterior(stamps[piece], last[piece]).cross
    assert len(found) == len(whole.cross)
    for actual, expected in zip(found, whole.cross, strict=True):
        # Round-off of what BLAS does with arrays that lie elsewhere in memory.
        size = np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-9 * size)


def test_a_change_of_the_body_frame_goes_along_by_the_adjoint():
    change = se3.exp(np.array([0.3, -0.2, 0.5, 0.4, 1.0, -0.7]))
    samples = sampled(regular(6.0, 10.0))
    stamps = spread(samples, 40)
    last = until(samples, stamps)
    answer = joint_truth(samples).posterior(stamps, last)
    # Rotated: the translation's process is that of another point otherwise.
    change[:3, 3] = 0.0
    turned = sampled(regular(6.0, 10.0))
    turned = type(turned)(turned.stamps, turned.poses @ change)
    other = joint_truth(turned).posterior(stamps, last)
    adjoint = se3.adjoint(se3.inverse(change))
    for actual, expected in zip(other.cross, answer.cross, strict=True):
        size = np.abs(expected).max(initial=1e-12)
        np.testing.assert_allclose(actual, adjoint @ expected @ adjoint.T, rtol=0, atol=1e-6 * size)


def test_neighbours_are_correlated_and_strangers_are_not():
    samples = sampled(regular(60.0, 1.0))
    stamps = at(np.arange(100.0, 600.0) * 0.05)
    answer = joint_truth(samples).posterior(stamps, until(samples, stamps))
    own = np.sqrt(np.diagonal(answer.covariances, axis1=1, axis2=2))
    last = np.array([np.diagonal(c[-1]) if len(c) else np.zeros(6) for c in answer.cross])
    # Across a sample the size of the error changes tenfold from one to the next.
    assert np.median(last[1:] / own[1:] / own[:-1]) > 0.95
    assert 20 < max(len(c) for c in answer.cross) < 250


def test_memory_is_bounded():
    samples = sampled(regular(60.0, 20.0))
    truth = joint_truth(samples)
    stamps = spread(samples, 1200)
    last = until(samples, stamps)
    reach = []
    for i in range(0, len(stamps), 20):
        cross = truth.posterior(stamps[i : i + 20], last[i : i + 20]).cross
        reach += [len(c) for c in cross]
        assert len(truth.joint._remembered) <= 3
        assert sum(len(q.stamps) for q in truth.joint._remembered.values()) < 120
    assert max(reach) < 60
