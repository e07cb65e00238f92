# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likelihood by the filter in C, and the dense one; each by itself is in test_learning."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.ground_truth.kernels import (
    Exponential,
    Matern32,
    Matern52,
    Matern72,
    SquaredExponential,
)
from trajeval_ros.ground_truth.likelihood import Likelihood, Record
from trajeval_ros.ground_truth.models import MODELS

built = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")

KERNELS = MODELS["matern52"].kernels
USUAL = np.log([0.3, 1.0, 0.5, 1.5, 0.02, 0.4, 2e-3, 0.07, 3e-3])


def record(rng, count, coordinates=3, interval=0.1):
    times = np.cumsum(rng.uniform(0.5, 1.5, count)) * interval
    values = np.sin(times[:, None] * rng.uniform(1.0, 3.0, coordinates))
    values += rng.normal(0.0, 2e-3, values.shape)
    return Record(times, values, rng.uniform(0.0, 1e-6, count))


def both(kernels, records, natural):
    looped = Likelihood(kernels, records)(natural)
    with loops.left_out():
        return looped, Likelihood(kernels, records)(natural)


def assert_alike(found, dense):
    assert np.isfinite(dense.value)
    np.testing.assert_allclose(found.values, dense.values, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.fits, dense.fits, rtol=1e-9, atol=1e-12)
    assert found.value == pytest.approx(dense.value, rel=1e-9, abs=1e-8)
    # A slope is a difference of two numbers that may be larger.
    unit = np.abs(dense.gradient).max() + 1.0
    np.testing.assert_allclose(found.gradient / unit, dense.gradient / unit, atol=1e-9)
    unit = np.abs(dense.information).max() + 1.0
    np.testing.assert_allclose(found.information / unit, dense.information / unit, atol=1e-9)


@built
@settings(max_examples=60, deadline=None)
@given(
    kinds=st.lists(
        st.sampled_from([Exponential, Matern32, Matern52, Matern72]), min_size=1, max_size=5
    ),
    counts=st.lists(st.integers(2, 40), min_size=1, max_size=4),
    coordinates=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
    rest=st.lists(st.sampled_from([0.0, 1e-6, 30.0, 1e5]), max_size=4),
)
def test_the_loop_is_the_dense_likelihood(kinds, counts, coordinates, seed, rest):
    rng = np.random.default_rng(seed)
    records = [record(rng, count, coordinates) for count in counts]
    for gap in rest:  # equal and nearly equal stamps, and gaps longer than the processes know of
        each = records[rng.integers(len(records))]
        at = rng.integers(1, len(each.times))
        each.times[at:] += gap - (each.times[at] - each.times[at - 1])
    stds = np.exp(rng.normal(-1.0, 1.0, len(kinds)))
    lengths = np.exp(rng.normal(0.0, 1.5, len(kinds)))
    noise = stds.max() * np.exp(rng.uniform(-5.0, 0.0))  # less, and the dense one loses digits
    natural = np.log([*np.column_stack([stds, lengths]).ravel(), noise])
    assert_alike(*both(tuple(kind() for kind in kinds), records, natural))


@built
def test_a_long_record_is_the_dense_one():
    rng = np.random.default_rng(3)
    assert_alike(*both(KERNELS, [record(rng, 600, interval=0.01), record(rng, 30)], USUAL))


@built
def test_ten_thousand_samples_have_the_slope_of_their_differences():
    likelihood = Likelihood(KERNELS, [record(np.random.default_rng(4), 10_000, interval=0.01)])
    gradient = likelihood(USUAL).gradient
    for i, step in enumerate(1e-4 * np.eye(len(USUAL))):
        difference = likelihood(USUAL + step).value - likelihood(USUAL - step).value
        assert gradient[i] == pytest.approx(difference / 2e-4, rel=1e-5, abs=1e-2)


@pytest.mark.parametrize("kernels", [KERNELS, (Matern52(), SquaredExponential())])
def test_sets_of_records_are_as_each_by_itself(kernels):
    rng = np.random.default_rng(10)
    records = [record(rng, count) for count in (5, 48, 17, 30, 6, 48, 2)]
    sets = [1, 0, 1, 2, 0, 2, 2]
    natural = USUAL[: 2 * len(kernels) + 1] + rng.normal(0.0, 0.3, (3, 2 * len(kernels) + 1))
    together = Likelihood(kernels, records, sets)(natural)
    for number in range(3):
        places = [place for place, each in enumerate(sets) if each == number]
        alone = Likelihood(kernels, [records[place] for place in places])(natural[number])
        np.testing.assert_allclose(together.values[places], alone.values, rtol=1e-12)
        np.testing.assert_allclose(together.fits[places], alone.fits, rtol=1e-12)
        np.testing.assert_allclose(together.gradient[number], alone.gradient, rtol=1e-10)
        np.testing.assert_allclose(together.information[number], alone.information, rtol=1e-10)
    assert together.value == pytest.approx(together.values.sum())


@pytest.mark.parametrize("kernels", [KERNELS, (Matern52(), SquaredExponential())])
def test_records_may_be_there_several_times(kernels):
    rng = np.random.default_rng(12)
    records = [record(rng, count) for count in (5, 48, 17)]
    natural = USUAL[: 2 * len(kernels) + 1] + rng.normal(0.0, 0.3, (3, 2 * len(kernels) + 1))
    sets = [[0, 1, 2], [2, 2, 1]]
    twice = Likelihood(kernels, records, sets)(natural)
    listed = Likelihood(kernels, [*records, *records], [0, 1, 2, 2, 2, 1])(natural)
    np.testing.assert_allclose(twice.values, listed.values, rtol=1e-12)
    np.testing.assert_allclose(twice.gradient, listed.gradient, rtol=1e-10)


@built
def test_a_set_that_is_impossible_leaves_the_others():
    records = [record(np.random.default_rng(11), count) for count in (9, 9, 12)]
    found = Likelihood(KERNELS, records, [0, 1, 0])(np.array([USUAL, np.full(9, np.nan)]))
    alone = Likelihood(KERNELS, [records[0], records[2]])(USUAL)
    assert found.values[[0, 2]].tolist() == alone.values.tolist()
    assert found.values[1] == found.value == -np.inf


@built
def test_other_kernels_are_dense_with_the_loop_too():
    records = [record(np.random.default_rng(5), 20)]
    looped, dense = both(
        (SquaredExponential(), Matern52()), records, np.log([0.3, 1, 0.2, 1, 1e-2])
    )
    assert looped.value == pytest.approx(dense.value, rel=1e-12)
    np.testing.assert_allclose(looped.gradient, dense.gradient, rtol=1e-9)
    np.testing.assert_allclose(looped.information, dense.information, rtol=1e-9)


@built
def test_a_record_alone_is_what_it_is_among_others():
    rng = np.random.default_rng(6)
    records = [record(rng, count) for count in (48, 5, 17, 1)]
    together = Likelihood(KERNELS, records)(USUAL)
    alone = [Likelihood(KERNELS, [each])(USUAL) for each in records]
    assert together.values.tolist() == [each.value for each in alone]
    np.testing.assert_allclose(together.gradient, sum(each.gradient for each in alone), rtol=1e-12)


def test_one_sample_says_nothing():
    found = Likelihood(KERNELS, [record(np.random.default_rng(7), 1)])(USUAL)
    assert found.value == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(found.gradient, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.information, 0.0, atol=1e-12)


@built
@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize("place", [0, 2, 8])
def test_what_is_no_covariance_is_impossible(number, place):
    natural = USUAL.copy()
    natural[place] = number
    found = Likelihood(KERNELS, [record(np.random.default_rng(8), 9)])(natural)
    assert found.value == -np.inf
    assert (found.values == -np.inf).all()


@built
def test_little_noise_beside_much_motion_is_exact():
    """Against fifty digits: K's condition is 1e14, and a dense factor is off by 4e-6."""
    each = record(np.random.default_rng(9), 15, coordinates=2, interval=0.02)
    natural = np.log([30.0, 2.0, 1e-5])
    found = Likelihood((Matern52(),), [Record(each.times, each.values, 0 * each.times)])(natural)
    mpmath = pytest.importorskip("mpmath")
    with mpmath.workdps(50):
        std, length, noise = (mpmath.mpf(float(np.exp(p))) for p in natural)
        t, size = [mpmath.mpf(float(s)) for s in each.times], len(each.times)
        covariance = mpmath.matrix(size, size)
        for i in range(size):
            for j in range(size):
                a = mpmath.sqrt(5) * abs(t[i] - t[j]) / length
                covariance[i, j] = std**2 * (1 + a + a * a / 3) * mpmath.exp(-a)
            covariance[i, i] += noise**2
        inverse, ones = covariance**-1, mpmath.ones(size, 1)
        information = (ones.T * inverse * ones)[0]
        x = mpmath.matrix(each.values.tolist())
        square = mpmath.mpf(0)
        for c in range(2):
            column = x[:, c]
            column -= ones * ((ones.T * inverse * column)[0] / information)
            square += (column.T * inverse * column)[0]
        nu, d = mpmath.mpf(20), mpmath.mpf(2 * (size - 1))
        expected = mpmath.loggamma((nu + d) / 2) - mpmath.loggamma(nu / 2)
        expected -= d / 2 * mpmath.log(nu * mpmath.pi)
        expected -= mpmath.log(mpmath.det(covariance)) + mpmath.log(information)
        expected -= (nu + d) / 2 * mpmath.log(1 + square / nu)
    assert found.value == pytest.approx(float(expected), abs=1e-6)


@built
def test_whole_numbers_and_other_orders_of_memory_are_read_as_what_they_are():
    values = np.random.default_rng(0).integers(-9, 9, (20, 3))
    usual = Record(np.arange(20.0), values.astype(float), np.zeros(20))
    wanted = Likelihood(KERNELS, [usual])(USUAL).value
    whole = Record(np.arange(20), values, np.zeros(20, dtype=int))
    turned = Record(usual.times, np.asfortranarray(usual.values), usual.variances)
    for given_record in (whole, turned):
        assert Likelihood(KERNELS, [given_record])(USUAL).value == wanted
    rows = np.asfortranarray(np.stack([USUAL, USUAL]))
    assert Likelihood(KERNELS, [usual] * 2, [0, 1])(rows).value == pytest.approx(2 * wanted)
