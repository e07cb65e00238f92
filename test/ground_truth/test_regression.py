# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import gp_twin

from trajeval_ros import loops
from trajeval_ros.ground_truth.factors import Observed
from trajeval_ros.ground_truth.hyperparameters import Component, GroupHyperparameters
from trajeval_ros.ground_truth.kernels import (
    Exponential,
    Matern32,
    Matern52,
    Matern72,
    SquaredExponential,
)
from trajeval_ros.ground_truth.regression import Regression, scale

KERNELS = (Matern52(), Matern72(), Matern32(), Exponential())
NAMES = ("Matern52", "Matern72", "Matern32", "Exponential")


def a_group(parts=4, noise=1e-3):
    numbers = ((0.4, 1.3), (0.3, 0.9), (0.02, 0.4), (0.003, 0.05))
    return GroupHyperparameters(tuple(Component(*each) for each in numbers[:parts]), noise)


def samples(count, seed=0, interval=0.05):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.2, 1.8, count)) * interval
    times -= times[0]
    values = np.sin(times[:, None] * [1.0, 2.0, 3.0]) + rng.normal(0.0, 1e-3, (count, 3))
    return times, values, rng.uniform(0.5, 2.0, count) * 1e-6


def another_group(parts=4):
    numbers = ((0.1, 0.7), (0.0, 1.0), (0.05, 0.2), (0.001, 0.02))
    return GroupHyperparameters(tuple(Component(*each) for each in numbers[:parts]), 2e-3)


def conditioned(groups, times, values, noise, batches=1, kernels=KERNELS):
    """Groups that have the same samples, one with a tenth of the other's noise."""
    regression = Regression(kernels, groups, values.shape[1])
    for end in np.linspace(0, len(times), batches + 1).astype(int)[1:]:
        regression.extend(Observed(times[:end], *both(values[:end], noise[:end], len(groups))))
    return regression


def same(mine, other, kernels):
    """To the bit where samples are taken one by one in C; in NumPy, as BLAS orders its sums."""
    if loops.there() and len(kernels) > 1:
        np.testing.assert_array_equal(mine, other)
    else:
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-12)


def both(values, noise, groups=2):
    shares = 0.1 ** np.arange(groups)
    return np.repeat(values[:, None], groups, axis=1), noise[:, None] * shares


@given(
    count=st.integers(1, 90),
    parts=st.integers(1, 4),
    batches=st.integers(1, 5),
    seed=st.integers(0, 99),
    kernel=st.sampled_from([*NAMES, "SquaredExponential", None]),
)
def test_posterior_is_the_dense_one(count, parts, batches, seed, kernel):
    one = {type(k).__name__: k for k in (*KERNELS, SquaredExponential())}
    kernels, names = (KERNELS, NAMES) if kernel is None else ((one[kernel],), (kernel,))
    parts = min(parts, len(kernels))
    groups = a_group(parts), another_group(parts)
    times, values, noise = samples(count, seed)
    regression = conditioned(groups, times, values, noise, min(batches, count), kernels)
    rng = np.random.default_rng(seed)
    asked = rng.uniform(-0.2, times[-1] + 0.2, 7)
    counts = rng.integers(1, count + 1, 7)
    mean, variance = regression.posterior(asked, counts)
    for g, group in enumerate(groups):
        for i, n in enumerate(counts):
            own = noise[:n] * 0.1**g
            expected, covariance = gp_twin.posterior(
                names, group.components, times[:n], values[:n], own, asked[i : i + 1]
            )
            np.testing.assert_allclose(mean[i, g], expected[0], rtol=0, atol=1e-9)
            np.testing.assert_allclose(variance[i, g], covariance[0, 0], rtol=1e-6, atol=1e-12)


def test_posterior_across_gaps_is_the_dense_one():
    groups, (times, values, noise) = (a_group(), another_group()), samples(130)
    times = times + 70.0 * (np.arange(130) > 31) + 1e5 * (np.arange(130) > 100)
    regression = conditioned(groups, times, values, noise)
    asked, counts = times[[20, 60, 120]] + 0.01, np.array([40, 80, 130])
    mean, variance = regression.posterior(asked, counts)
    for i, n in enumerate(counts):
        expected, covariance = gp_twin.posterior(
            NAMES, groups[0].components, times[:n], values[:n], noise[:n], asked[i : i + 1]
        )
        np.testing.assert_allclose(mean[i, 0], expected[0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(variance[i, 0], covariance[0, 0], rtol=1e-6)


@pytest.mark.parametrize("kernels", [KERNELS, (SquaredExponential(),)])
def test_truncated_answer_is_that_of_a_process_built_on_the_truncated_data(kernels):
    groups, (times, values, noise) = (a_group(len(kernels)),), samples(150)
    whole = conditioned(groups, times, values, noise, kernels=kernels)
    asked = np.linspace(0.0, times[40], 25)
    for n in (1, 31, 32, 33, 64, 100):
        part = conditioned(groups, times[:n], values[:n], noise[:n], kernels=kernels)
        counts = np.full(25, n)
        for mine, other in zip(
            whole.posterior(asked, counts), part.posterior(asked, counts), strict=True
        ):
            same(mine, other, kernels)
        same(whole.squares(counts), part.squares(counts), kernels)


@pytest.mark.parametrize("kernels", [KERNELS, (SquaredExponential(),)])
def test_digits_do_not_depend_on_the_batches(kernels):
    groups = a_group(len(kernels)), another_group(len(kernels))
    times, values, noise = samples(200)
    whole = conditioned(groups, times, values, noise, kernels=kernels)
    asked = np.sort(np.random.default_rng(1).uniform(0.0, times[-1], 30))
    counts = np.minimum(np.searchsorted(times, asked + 0.3) + 1, len(times))
    mean, variance = whole.posterior(asked, counts)
    grown = Regression(kernels, groups, 3)
    for i, n in enumerate(counts):
        if n > grown.count:
            grown.extend(Observed(times[:n], *both(values[:n], noise[:n])))
        one_mean, one_variance = grown.posterior(asked[i : i + 1], counts[i : i + 1])
        same(one_mean[0], mean[i], kernels)
        same(one_variance[0], variance[i], kernels)


def test_scale_follows_the_data_from_the_prior():
    group, (times, values, noise) = a_group(), samples(80)
    regression = conditioned((group,), times, values, noise)
    counts = np.array([1, 2, 20, 80])
    squares = regression.squares(counts)[:, 0]
    for n, value in zip(counts, squares, strict=True):
        expected = gp_twin.square(NAMES, group.components, times[:n], values[:n], noise[:n])
        assert value == pytest.approx(expected, rel=1e-5, abs=1e-5)
    factors = scale(squares, counts, 3, 0.5)
    assert factors[0] == pytest.approx(1.0, abs=1e-4)
    assert factors[3] == pytest.approx((gp_twin.NU + squares[3]) / (gp_twin.NU + 3 * 79))
    assert scale(np.zeros(1), np.array([1000]), 3, 0.5)[0] == 0.5


def test_variance_never_falls_below_round_off():
    group = GroupHyperparameters((Component(100.0, 60.0),), 1e-9)
    times = np.linspace(0.0, 1.0, 100)
    values = np.zeros((100, 3))
    regression = conditioned((group,), times, values, np.full(100, 1e-8))
    _, variance = regression.posterior(times, np.full(100, 100))
    assert (variance > 0.0).all()


def test_samples_at_one_time_are_refused():
    group = GroupHyperparameters((Component(1.0, 1.0),), 1e-12)
    regression = Regression((Matern52(),), (group,), 1)
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        regression.extend(Observed(np.zeros(3), np.zeros((3, 1, 1)), np.full((3, 1), -1e-3)))


@pytest.mark.parametrize("smooth", [0.0, 1000.0])
@pytest.mark.parametrize("length", [10.0, 1000.0])
def test_least_noise_beside_the_largest_signal(smooth, length):
    # What the parameters allow: noise of a millionth of σ, and many samples within a length scale.
    components = (Component(1000.0, length), Component(smooth, length))
    times = np.arange(1024) * 1e-4
    regression = conditioned(
        (GroupHyperparameters(components, 1e-3),), times, np.zeros((1024, 3)), np.full(1024, 1e-6)
    )
    mean, variance = regression.posterior(times, np.full(1024, 1024))
    assert (np.abs(mean) < 1e-3).all()
    assert (variance > 0.0).all()


def test_samples_that_are_refused_leave_the_others():
    group = GroupHyperparameters((Component(1.0, 1.0),), 1e-3)
    times = np.arange(40.0)
    values, noise = both(np.sin(times)[:, None], np.full(40, 1e-6), 1)
    regression = Regression((Matern52(),), (group,), 1)
    regression.extend(Observed(times[:33], values[:33], noise[:33]))
    before = regression.posterior(np.array([20.5]), np.array([33]))
    bad = noise.copy()
    bad[36] = -2.0
    with pytest.raises(np.linalg.LinAlgError):
        regression.extend(Observed(times, values, bad))
    assert regression.count == 33
    regression.extend(Observed(times, values, noise))
    after = regression.posterior(np.array([20.5]), np.array([33]))
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@given(
    count=st.integers(1, 90),
    parts=st.integers(1, 4),
    seed=st.integers(0, 99),
    kernel=st.sampled_from(["Matern32", "Matern52", "Matern72", "SquaredExponential", None]),
)
def test_slope_is_the_dense_derivative_of_the_motion(count, parts, seed, kernel):
    one = {type(k).__name__: k for k in (*KERNELS, SquaredExponential())}
    kernels, names = (KERNELS, NAMES) if kernel is None else ((one[kernel],), (kernel,))
    parts = min(parts, len(kernels))
    groups = a_group(parts), another_group(parts)
    times, values, noise = samples(count, seed)
    regression = conditioned(groups, times, values, noise, 1, kernels)
    rng = np.random.default_rng(seed)
    asked = rng.uniform(-0.2, times[-1] + 0.2, 7)
    counts = rng.integers(1, count + 1, 7)
    means, variances = regression.motion(asked, counts)
    for both, alone in zip((means, variances), regression.posterior(asked, counts), strict=True):
        np.testing.assert_allclose(both[0], alone, rtol=1e-9, atol=1e-15)
    mean, variance = means[1], variances[1]
    for g, group in enumerate(groups):
        for i, n in enumerate(counts):
            expected, covariance = gp_twin.slope(
                names, group.components, times[:n], values[:n], noise[:n] * 0.1**g, asked[i]
            )
            scale = np.sqrt(sum(c.std**2 / c.length_scale**2 for c in group.components))
            np.testing.assert_allclose(mean[i, g], expected, rtol=1e-6, atol=1e-6 * scale)
            np.testing.assert_allclose(variance[i, g], covariance, rtol=1e-5, atol=1e-9 * scale**2)


def test_slope_is_the_derivative_of_the_mean_where_all_is_motion():
    times, values, noise = samples(80)
    group = a_group(3)
    regression = conditioned((group,), times, values, noise)
    asked, counts, step = np.linspace(0.3, times[-1] - 0.3, 40), np.full(40, 80), 1e-5
    later, earlier = (regression.posterior(asked + sign * step, counts)[0] for sign in (1, -1))
    slope = regression.motion(asked, counts)[0][1]
    np.testing.assert_allclose(slope, (later - earlier) / (2 * step), rtol=0, atol=1e-6)
