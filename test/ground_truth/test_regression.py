# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import gp_twin

from trajeval_ros.ground_truth.hyperparameters import Component, GroupHyperparameters
from trajeval_ros.ground_truth.kernels import Exponential, Matern32, Matern52
from trajeval_ros.ground_truth.regression import Regression, scale

KERNELS = (Matern52(), Matern32(), Exponential())
NAMES = ("Matern52", "Matern32", "Exponential")


def a_group(parts=3, noise=1e-3):
    components = (Component(0.4, 1.3), Component(0.02, 0.4), Component(0.003, 0.05))[:parts]
    return GroupHyperparameters(components, noise)


def samples(count, seed=0, interval=0.05):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.2, 1.8, count)) * interval
    times -= times[0]
    values = np.sin(times[:, None] * [1.0, 2.0, 3.0]) + rng.normal(0.0, 1e-3, (count, 3))
    return times, values, rng.uniform(0.5, 2.0, count) * 1e-6


def conditioned(group, times, values, noise, batches=1):
    regression = Regression(KERNELS, group, values.shape[1])
    for end in np.linspace(0, len(times), batches + 1).astype(int)[1:]:
        regression.extend(times[:end], values[:end], noise[:end])
    return regression


@given(
    count=st.integers(1, 90),
    parts=st.integers(1, 3),
    batches=st.integers(1, 5),
    seed=st.integers(0, 99),
)
def test_posterior_is_the_dense_one(count, parts, batches, seed):
    group = a_group(parts)
    times, values, noise = samples(count, seed)
    regression = conditioned(group, times, values, noise, min(batches, count))
    rng = np.random.default_rng(seed)
    asked = rng.uniform(-0.2, times[-1] + 0.2, 7)
    counts = rng.integers(1, count + 1, 7)
    mean, variance = regression.posterior(asked, counts)
    for i, n in enumerate(counts):
        expected, covariance = gp_twin.posterior(
            NAMES, group.components, times[:n], values[:n], noise[:n], asked[i : i + 1]
        )
        np.testing.assert_allclose(mean[i], expected[0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(variance[i], covariance[0, 0], rtol=1e-6, atol=1e-12)


def test_truncated_answer_is_that_of_a_process_built_on_the_truncated_data():
    group, (times, values, noise) = a_group(), samples(150)
    whole = conditioned(group, times, values, noise)
    asked = np.linspace(0.0, times[40], 25)
    for n in (1, 31, 32, 33, 64, 100):
        part = conditioned(group, times[:n], values[:n], noise[:n])
        counts = np.full(25, n)
        for mine, other in zip(
            whole.posterior(asked, counts), part.posterior(asked, counts), strict=True
        ):
            np.testing.assert_array_equal(mine, other)
        np.testing.assert_array_equal(whole.squares(counts), part.squares(counts))


def test_digits_do_not_depend_on_the_batches():
    group, (times, values, noise) = a_group(), samples(200)
    whole = conditioned(group, times, values, noise)
    asked = np.sort(np.random.default_rng(1).uniform(0.0, times[-1], 30))
    counts = np.minimum(np.searchsorted(times, asked + 0.3) + 1, len(times))
    mean, variance = whole.posterior(asked, counts)
    grown = Regression(KERNELS, group, 3)
    for i, n in enumerate(counts):
        if n > grown.count:
            grown.extend(times[:n], values[:n], noise[:n])
        one_mean, one_variance = grown.posterior(asked[i : i + 1], counts[i : i + 1])
        np.testing.assert_array_equal(one_mean[0], mean[i])
        np.testing.assert_array_equal(one_variance[0], variance[i])


@pytest.mark.parametrize("count", [2, 40, 130])
def test_covariance_is_the_dense_one(count):
    group, (times, values, noise) = a_group(), samples(count)
    regression = conditioned(group, times, values, noise)
    asked = np.linspace(-0.1, times[-1] + 0.1, 12)
    covariance = regression.covariance(asked, np.full(12, count))
    _, expected = gp_twin.posterior(NAMES, group.components, times, values, noise, asked)
    np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(
        np.diag(covariance), regression.posterior(asked, np.full(12, count))[1], rtol=1e-6
    )


def test_covariance_of_two_queries_is_given_the_larger_of_their_sets():
    group, (times, values, noise) = a_group(), samples(60)
    regression = conditioned(group, times, values, noise)
    asked, counts = np.array([times[10], times[12] + 0.01]), np.array([15, 40])
    covariance = regression.covariance(asked, counts)
    given_all = regression.covariance(asked, np.array([40, 40]))
    assert covariance[0, 1] == pytest.approx(given_all[0, 1], rel=1e-9)
    assert covariance[1, 1] == pytest.approx(given_all[1, 1], rel=1e-9)
    assert covariance[0, 0] > given_all[0, 0]


def test_scale_follows_the_data_from_the_prior():
    group, (times, values, noise) = a_group(), samples(80)
    regression = conditioned(group, times, values, noise)
    counts = np.array([1, 2, 20, 80])
    squares = regression.squares(counts)
    for n, value in zip(counts, squares, strict=True):
        expected = gp_twin.square(NAMES, group.components, times[:n], values[:n], noise[:n])
        assert value == pytest.approx(expected, rel=1e-5, abs=1e-5)
    factors = scale(squares, counts, 3, 0.5)
    assert factors[0] == pytest.approx(1.0, abs=1e-4)
    assert factors[3] == pytest.approx((20.0 + squares[3]) / (20.0 + 3 * 79))
    assert scale(np.zeros(1), np.array([1000]), 3, 0.5)[0] == 0.5


def test_variance_never_falls_below_round_off():
    group = GroupHyperparameters((Component(100.0, 60.0),), 1e-9)
    times = np.linspace(0.0, 1.0, 100)
    values = np.zeros((100, 3))
    regression = conditioned(group, times, values, np.full(100, 1e-8))
    _, variance = regression.posterior(times, np.full(100, 100))
    assert (variance > 0.0).all()


def test_samples_at_one_time_are_refused():
    group = GroupHyperparameters((Component(1.0, 1.0),), 1e-12)
    regression = Regression((Matern52(),), group, 1)
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        regression.extend(np.zeros(3), np.zeros((3, 1)), np.full(3, -1e-3))
