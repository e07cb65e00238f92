# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The factors of outliers: each at its likeliest, and together at a point that stays."""

import numpy as np
import pytest
from error_model.test_search import PARAMETERS, alike, series
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.error_model.axes import Axes
from trajeval_ros.error_model.likelihood import Likelihood
from trajeval_ros.error_model.maximum import (
    _largest_within,
    _newton_step,
    _reweighted,
    climb,
    likeliest,
    penalised,
    promised,
    reweighted,
)
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.search import bounds

built = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


def with_outliers(count=120, seed=5):
    """Lost poses and leaps beside errors that are larger than the process says."""
    errors = 1e-2 * np.random.default_rng(seed).normal(size=(count, 6))
    data, _ = alike(count, seed, errors, 10.0)
    data.errors[20] += 0.3
    data.errors[40:] += 0.2
    return data


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("part", [0, 1], ids=["poses", "steps"])
def test_one_factor_gains_what_it_promises_and_no_other_gains_more(kind, part):
    here = Axes(kind, PARAMETERS[kind][0], series(with_outliers(), 0))
    square, rest = here.disturbances()[2 * part : 2 * part + 2]
    factors, gains = likeliest(square, rest, here.own_noise()[part], here.weights[part])

    def reached(number, factor):
        weights = [each.copy() for each in here.weights]
        weights[part][number] = factor
        return penalised(here.at(here.parameters, tuple(weights))) - penalised(here)

    for number in (3, 19, 20, 39, 40, 60):
        assert reached(number, factors[number]) == pytest.approx(gains[number], abs=1e-6)
        for other in (1.0, 0.5 * factors[number], 1.1 * factors[number], 1e4):
            assert reached(number, max(other, 1.0)) < gains[number] + 1e-6


def heavy_tailed(kind, seed):
    """Steps and jitter of Student's distribution with two degrees of freedom."""
    rng = np.random.default_rng(seed)
    errors = np.cumsum(2e-3 * rng.standard_t(2.0, (600, 6)), axis=0)
    errors += 1e-3 * rng.standard_t(2.0, (600, 6))
    data, _ = alike(600, seed, errors, 20.0)
    low, high = (each[0] for each in bounds(kind, data))
    return Axes(kind, PARAMETERS[kind][0], series(data, 0)), low, high


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_heavy_tails_end_at_a_point_that_stays(kind, seed):
    here, low, high = heavy_tailed(kind, seed)
    values = [penalised(here)]
    for _ in range(40):
        there = climb(here, low, high, 1e-3, 1)
        values.append(penalised(there))
        if there is here:
            break
        here = there
    assert (np.diff(values) >= 0.0).all()
    assert values[-1] - values[-2] < 0.1
    again = climb(here, low, high, 1e-3, 20)
    assert np.abs(again.parameters - here.parameters).max() < 0.2
    assert penalised(again) - penalised(here) < 0.2


@pytest.mark.parametrize("kind", list(Kind))
def test_likelier_factors_gain_until_others_promise_little(kind):
    here, low, high = heavy_tailed(kind, 1)
    found = reweighted(here, 1.0)
    assert penalised(found) > penalised(here) + 1.0
    assert np.array_equal(found.parameters, here.parameters)
    top = climb(here, low, high, 1e-3, 40)
    assert reweighted(top, 1.0) is top


@pytest.mark.parametrize("kind", list(Kind))
def test_a_maximum_promises_nothing_and_a_place_beside_it_does(kind):
    here, low, high = heavy_tailed(kind, 1)
    top = climb(here, low, high, 1e-3, 40)
    assert promised(top, low, high) < 0.1
    beside = top.at(np.clip(top.parameters - 0.5, low, high), top.weights)
    assert promised(beside, low, high) > 0.5


@given(st.integers(1, 30), st.integers(0, 40), st.integers(0, 2**32 - 1))
def test_the_largest_within_reach(count, reach, seed):
    values = np.random.default_rng(seed).normal(size=(count, 2)).clip(0.0)
    expected = [values[max(i - reach, 0) : i + reach + 1].max(axis=0) for i in range(count)]
    assert np.array_equal(_largest_within(values, reach), expected)


@st.composite
def steps(draw):
    """Where a step begins, near its bounds or far from them, and what is known there."""
    count = draw(st.integers(1, 8))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    root = rng.normal(size=(count, count))
    curvature = root @ root.T * np.exp(draw(st.floats(-6.0, 6.0)))
    low, high = -rng.uniform(0.0, 3.0, count), rng.uniform(0.0, 3.0, count)
    here = np.zeros(count)
    held = rng.uniform(size=count) < draw(st.sampled_from([0.0, 0.3, 1.0]))
    low[held] = high[held] = 0.0
    return here, np.exp(draw(st.floats(-6.0, 6.0))) * rng.normal(size=count), curvature, low, high


@built
@given(steps())
def test_c_steps_as_numpy(given):
    step, promised = _newton_step(*given)
    with loops.left_out():
        expected = _newton_step(*given)
    here, _, _, low, high = given
    assert ((here + step >= low) & (here + step <= high)).all()
    np.testing.assert_allclose(step, expected[0], rtol=1e-6, atol=1e-9)
    assert promised == pytest.approx(expected[1], rel=1e-6, abs=1e-9)


@built
@given(
    st.sampled_from(list(Kind)),
    st.integers(2, 300),
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 4, 64, 1024]),
)
def test_c_reweighs_as_numpy(kind, count, seed, apart):
    rng = np.random.default_rng(seed)
    errors = np.cumsum(5e-3 * rng.standard_t(1.0, (count, 6)), axis=0).clip(-1e3, 1e3)
    errors += 1e-3 * rng.standard_t(2.0, (count, 6))
    data, gauge = alike(count, seed % 1000, errors)
    of_one = Axes(kind, PARAMETERS[kind][0], series(data, 0))
    of_both = [Likelihood(kind, PARAMETERS[kind], data, gauge)] if count > 20 else []
    for here in (of_one, *of_both):
        for _ in range(3):
            weights, promised = _reweighted(here, apart)
            with loops.left_out():
                expected, all_promised = _reweighted(here, apart)
            assert promised == pytest.approx(all_promised, rel=1e-9, abs=1e-9)
            for one, other in zip(weights, expected, strict=True):
                np.testing.assert_allclose(one, other, rtol=1e-9)
            here = here.at(here.parameters, weights)


@built
def test_a_curvature_that_is_none_is_no_likelihood():
    given = np.zeros(2), np.ones(2), np.full((2, 2), np.nan), -np.ones(2), np.ones(2)
    with pytest.raises(np.linalg.LinAlgError):
        _newton_step(*given)
