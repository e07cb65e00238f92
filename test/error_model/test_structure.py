# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where a search begins is the same by the loops in C and by NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.series import Series
from trajeval_ros.error_model.start import _correlations
from trajeval_ros.error_model.structure import _nonnegative, _variances, starts, structure

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")

SEEDS = st.integers(0, 2**32 - 1)


def both(function, *given):
    found = function(*given)
    with loops.left_out():
        return found, function(*given)


@given(SEEDS, st.integers(4, 400), st.sampled_from([0.0, 0.1, 0.9]), st.booleans())
def test_structure_functions(seed, count, gaps, alike):
    rng = np.random.default_rng(seed)
    intervals = np.where(rng.uniform(size=count - 1) < gaps, 5.0, rng.uniform(0.04, 0.06))
    errors = np.cumsum(rng.standard_t(2.0, (3, count)), axis=1)
    if alike:
        errors = np.round(errors)
    variance = rng.uniform(0.0, 0.1, count)
    series = Series(intervals, errors, variance, np.ones(count), np.ones(count - 1))
    for one, other in zip(*both(structure, series), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    # Of few lags the equations are nearly singular.
    for kind in Kind if count > 20 else ():
        for one, other in zip(*both(starts, kind, series), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-6)


@given(SEEDS, st.integers(1, 3), st.integers(3, 12))
def test_non_negative_least_squares(seed, size, count):
    rng = np.random.default_rng(seed)
    design = rng.uniform(size=(5, count, size))
    design[0, :, -1] = design[0, :, 0]  # the same twice
    values, weight = rng.normal(size=count) + 0.5, rng.uniform(0.1, 2.0, count)
    (best, cost), (expected, least) = both(_nonnegative, design, values, weight)
    scale = ((values * weight) ** 2).sum()
    np.testing.assert_allclose(cost, least, rtol=1e-9, atol=1e-9 * scale)
    np.testing.assert_allclose(best[1:], expected[1:], rtol=1e-6, atol=1e-6)
    assert (best >= 0.0).all()


@given(SEEDS, st.integers(1, 200), st.integers(2, 200), st.booleans())
def test_correlations_at_offsets(seed, count, others, varied):
    rng = np.random.default_rng(seed)
    when, when_truth = (np.cumsum(rng.uniform(0.01, 0.1, n)) for n in (count, others))
    speed, truth = 3.0 + rng.normal(size=count), np.sin(when_truth)
    if not varied:
        speed[:] = 1.0
    offsets = np.array([-1e9, -1.0, -0.01, 0.0, when_truth[0] - when[0], 0.5, 1e9])
    found, expected = both(_correlations, when, speed, when_truth, truth, offsets)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_what_is_not_a_number_stays_none():
    errors = np.random.default_rng(0).normal(size=(3, 50))
    errors[1, 7] = np.nan
    for found in both(_variances, errors, np.arange(50.0), np.array([1, 2, 5]), 1.5):
        assert np.isnan(found).all()
