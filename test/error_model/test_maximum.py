# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The factors of outliers: each at its likeliest, and together at a point that stays."""

import numpy as np
import pytest
from error_model.test_search import PARAMETERS, alike, series
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.error_model.axes import Axes
from trajeval_ros.error_model.maximum import _largest_within, climb, likeliest, penalised
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.search import bounds


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


@given(st.integers(1, 30), st.integers(0, 40), st.integers(0, 2**32 - 1))
def test_the_largest_within_reach(count, reach, seed):
    values = np.random.default_rng(seed).normal(size=(count, 2)).clip(0.0)
    expected = [values[max(i - reach, 0) : i + reach + 1].max(axis=0) for i in range(count)]
    assert np.array_equal(_largest_within(values, reach), expected)
