# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The loops in C beside the blocks in NumPy; `test_regression` holds either to dense algebra."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.ground_truth.factors import MarkovFactor, Observed
from trajeval_ros.ground_truth.hyperparameters import Component, GroupHyperparameters
from trajeval_ros.ground_truth.kernel_sum import KernelSum
from trajeval_ros.ground_truth.kernels import Exponential, Matern32, Matern52, Matern72
from trajeval_ros.ground_truth.recursion import RecursiveFactor

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")

KERNELS = (Matern52(), Matern72(), Matern32(), Exponential())


def a_kernel(rng, groups, kernels):
    """Standard deviations of 1 mm to 3 m, one of them zero now and then; 20 ms to 20 s."""

    def component():
        std = 0.0 if rng.uniform() < 0.1 else 10.0 ** rng.uniform(-3, 0.5)
        return Component(std, 10.0 ** rng.uniform(-1.7, 1.3))

    each = [tuple(component() for _ in kernels) for _ in range(groups)]
    if rng.uniform() < 0.3:
        each = [each[0]] * groups
    return KernelSum.of(kernels, tuple(GroupHyperparameters(one, 1e-3) for one in each))


def some_samples(rng, count, groups, coordinates, interval):
    """At uneven intervals, some of which are zero and some gaps; noise of 0.01 to 0.1 of σ."""
    steps = rng.uniform(0.2, 1.8, count) * interval
    steps[rng.uniform(size=count) < 0.02] = 0.0
    steps[rng.uniform(size=count) < 0.02] += 10.0 ** rng.uniform(0, 6)
    values = rng.normal(size=(count, groups, coordinates))
    return Observed(np.cumsum(steps), values, 10.0 ** rng.uniform(-3, -1, (count, groups)))


def both(kernel, observed, cuts=()):
    groups, coordinates = observed.values.shape[1:]
    pair = [
        kind(kernel, np.full(groups, 1e-6), coordinates) for kind in (RecursiveFactor, MarkovFactor)
    ]
    for factor in pair:
        for end in sorted({*cuts, len(observed.times)} - {0}):
            part = Observed(observed.times[:end], observed.values[:end], observed.noise[:end])
            factor.extend(part)
    return pair


def agree(mine, other, scale=0.0):
    scale = max(scale, np.abs(other).max(initial=1e-30))
    np.testing.assert_allclose(mine, other, rtol=0, atol=1e-9 * scale)


@given(
    count=st.integers(1, 150),
    groups=st.integers(1, 6),
    coordinates=st.integers(1, 4),
    kernels=st.permutations(KERNELS),
    parts=st.integers(1, 4),
    interval=st.sampled_from([1e-4, 1e-3, 1e-2, 0.1, 1.0, 100.0]),
    cuts=st.sets(st.integers(1, 150), max_size=3),
    kinds=st.integers(1, 2),
    seed=st.integers(0, 9999),
)
def test_it_is_the_factor_in_blocks(
    count, groups, coordinates, kernels, parts, interval, cuts, kinds, seed
):
    rng = np.random.default_rng(seed)
    kernel = a_kernel(rng, groups, tuple(kernels[:parts]))
    observed = some_samples(rng, count, groups, coordinates, interval)
    loop, blocks = both(kernel, observed, {cut for cut in cuts if cut < count})
    assert loop.count == blocks.count == count
    agree(loop.pivots[:, :count], blocks.pivots[:, :count])
    agree(loop.white[:, :count], blocks.white[:, :count])
    agree(loop.sums[:, :count], blocks.sums[:, :count])
    if count > 1:
        news = (np.moveaxis(each.innovations(1), -1, 0) for each in (loop, blocks))
        for one, other in zip(*news, strict=True):
            agree(one, other, np.abs(blocks.sums[:, :count, -1]).max())
    # Around the samples, at them, and far away.
    times = np.concatenate(
        [
            rng.uniform(-0.2, observed.times[-1] + 0.2, 5),
            observed.times[rng.integers(0, count, 2)],
            observed.times[-1] + np.array([1e-9, 1e3, 1e9]),
            [-1e6],
        ]
    )
    counts = rng.integers(1, count + 1, len(times))
    stds = np.sqrt(kernel.variances.max(axis=(1, 2)))
    found, explained = loop.products(times, counts, kinds)
    expected = blocks.products(times, counts, kinds)
    for kind in range(kinds):
        agree(found[kind], expected[0][kind], stds[kind] * np.abs(blocks.white[:, :count]).max())
        agree(explained[kind], expected[1][kind], stds[kind] ** 2)
    white = loop.whitened(times, counts)
    agree(white, blocks.whitened(times, counts), stds[0])
    agree(loop.weights(white, counts), blocks.weights(white, counts))


@pytest.mark.parametrize("interval", [1e-4, 1e-3, 1e-2])
def test_digits_depend_on_no_batch(interval):
    rng = np.random.default_rng(3)
    kernel, observed = a_kernel(rng, 2, KERNELS), some_samples(rng, 100, 2, 3, interval)
    (whole, _), (grown, _) = both(kernel, observed), both(kernel, observed, range(100))
    np.testing.assert_array_equal(whole.pivots[:, :100], grown.pivots[:, :100])
    np.testing.assert_array_equal(whole.white[:, :100], grown.white[:, :100])
    times, counts = rng.uniform(0.0, observed.times[-1], 9), rng.integers(1, 101, 9)
    together = whole.products(times, counts, 2)
    for i in range(9):
        one = slice(i, i + 1)
        alone = grown.products(times[one], counts[one], 2)
        for mine, other in zip(alone, together, strict=True):
            np.testing.assert_array_equal(mine[:, :, 0], other[:, :, i])


def test_many_samples_close_together_are_as_exact_as_in_blocks():
    # Σ of the round-off of a thousand transitions close to the identity.
    kernel = KernelSum.of(
        (Matern72(),), (GroupHyperparameters((Component(1000.0, 1000.0),), 1e-3),)
    )
    count = 1024
    observed = Observed(1e-4 * np.arange(count), np.zeros((count, 1, 1)), np.full((count, 1), 1e-6))
    loop, blocks = both(kernel, observed)
    np.testing.assert_allclose(loop.pivots, blocks.pivots, rtol=0.01)


def test_no_query_and_no_sample_more_are_nothing():
    rng = np.random.default_rng(0)
    loop, _ = both(a_kernel(rng, 2, KERNELS), some_samples(rng, 20, 2, 3, 0.01))
    none = np.empty(0), np.empty(0, dtype=np.intp)
    found, explained = loop.products(*none, 2)
    assert found.shape == (2, 2, 0, 4)
    assert explained.shape == (2, 2, 0)
    assert loop.whitened(*none).shape == (2, 0, 32)


def test_what_is_not_positive_definite_is_refused_and_nothing_is_taken():
    rng = np.random.default_rng(1)
    kernel, observed = a_kernel(rng, 2, KERNELS), some_samples(rng, 60, 2, 3, 0.01)
    noise = observed.noise.copy()
    noise[45, 1] = -100.0
    loop = RecursiveFactor(kernel, np.full(2, 1e-6), 3)
    loop.extend(Observed(observed.times[:21], observed.values[:21], observed.noise[:21]))
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        loop.extend(Observed(observed.times, observed.values, noise))
    assert loop.count == 21
    loop.extend(observed)
    whole, _ = both(kernel, observed)
    np.testing.assert_array_equal(loop.pivots[:, :60], whole.pivots[:, :60])
    np.testing.assert_array_equal(loop.sums[:, :60], whole.sums[:, :60])
