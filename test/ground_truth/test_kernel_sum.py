# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A sum of Markov kernels against the same sum of its kernels one by one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.ground_truth.hyperparameters import Component, GroupHyperparameters
from trajeval_ros.ground_truth.kernel_sum import KernelSum, MarkovSum
from trajeval_ros.ground_truth.kernels import (
    Exponential,
    Matern32,
    Matern52,
    Matern72,
)

KERNELS = (Matern52(), Matern72(), Matern32(), Exponential())
FIRST = ((0.4, 1.3), (0.3, 0.9), (0.02, 0.4), (0.003, 0.05))
LIVELIER = tuple((4.0 * std, length) for std, length in FIRST)
OTHER = ((0.1, 0.7), (0.0, 1.0), (0.05, 0.2), (0.001, 0.02))


def group(numbers):
    return GroupHyperparameters(tuple(Component(*each) for each in numbers), 1e-3)


def both(kernels, *numbers):
    markov = KernelSum.of(kernels, tuple(group(each[: len(kernels)]) for each in numbers))
    assert isinstance(markov, MarkovSum)
    return markov, KernelSum(markov._kernels, markov._variances, markov._lengths)


@given(
    kernels=st.permutations(KERNELS).flatmap(lambda k: st.integers(1, 4).map(lambda n: k[:n])),
    numbers=st.lists(st.sampled_from([FIRST, LIVELIER, OTHER]), min_size=1, max_size=4),
    seed=st.integers(0, 99),
)
def test_is_the_sum_of_its_kernels(kernels, numbers, seed):
    markov, plain = both(tuple(kernels), *numbers)
    apart = np.random.default_rng(seed).choice([-1.0, 1.0], (3, 20)) * np.logspace(-9, 2, 20)
    apart[:, 0] = 0.0
    found, expected = markov.cross(apart, 2), plain.cross(apart, 2)
    assert found.shape == (2, len(numbers), 3, 20)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(markov(np.abs(apart)), expected[0], rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(markov.variances, plain.variances, rtol=1e-12)
    np.testing.assert_allclose(markov.variances[0, :, 0], expected[0, :, 0, 0], rtol=1e-12)


@given(
    kernels=st.permutations(KERNELS),
    numbers=st.lists(st.sampled_from([FIRST, LIVELIER, OTHER]), min_size=1, max_size=3),
    times=st.tuples(*[st.floats(0.0, 3.0)] * 3),
)
def test_is_markov(kernels, numbers, times):
    markov, plain = both(tuple(kernels), *numbers)
    before, between, after = (markov.powers(np.array([[each]])) for each in times)
    past, step = markov.past(before, 2)[:, :, 0, 0], markov.transition(between)[:, 0]
    future = markov.future(after, 2)[:, :, 0, 0]
    apart = np.array([[sum(times)]])
    later, earlier = (plain.cross(sign * apart, 2)[:, :, 0, 0] for sign in (1, -1))
    value, slope = np.einsum("gi,gij,kgj->kg", past[0], step, future)
    np.testing.assert_allclose(value, later[0], rtol=1e-12)
    np.testing.assert_allclose(slope, later[1], rtol=1e-9, atol=1e-12)
    slope = np.einsum("gi,gij,gj->g", past[1], step, future[0])
    if sum(times) > 0.0:
        np.testing.assert_allclose(slope, earlier[1], rtol=1e-9, atol=1e-12)


def test_slope_is_the_derivative_of_what_moves():
    markov, _ = both(KERNELS[:3], FIRST, OTHER)
    apart, step = np.array([[-2.0, -0.3, 0.2, 1.7]]), 1e-6
    expected = (markov.cross(apart + step)[0] - markov.cross(apart - step)[0]) / (2.0 * step)
    np.testing.assert_allclose(markov.cross(apart, 2)[1], expected, rtol=1e-7, atol=1e-9)
