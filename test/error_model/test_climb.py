# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A chain's climb in C takes the steps that the climb in Python takes."""

import numpy as np
import pytest
from error_model.test_search import PARAMETERS, alike, series
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.error_model.axes import Axes, climbed
from trajeval_ros.error_model.maximum import climb, penalised
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.search import bounds

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


@st.composite
def begins(draw):
    """Where a climb begins, far from the maximum or near it, of errors with tails or without."""
    kind = draw(st.sampled_from(list(Kind)))
    count = draw(st.integers(100, 300))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    freedoms = draw(st.sampled_from([1.0, 3.0, 1e6]))
    errors = np.cumsum(2e-3 * rng.standard_t(freedoms, (count, 6)).clip(-1e4, 1e4), axis=0)
    errors += 1e-3 * rng.standard_t(freedoms, (count, 6)).clip(-1e4, 1e4)
    data, _ = alike(count, seed % 1000, errors, 20.0)
    low, high = (each[0] for each in bounds(kind, data))
    apart = draw(st.sampled_from([0.1, 0.7])) * rng.normal(size=len(low))
    return kind, np.clip(PARAMETERS[kind][0] + apart, low, high), series(data, 0), low, high


RULES = st.tuples(
    st.sampled_from([5e-3, 0.05, 0.5]),
    st.integers(0, 20),
    st.booleans(),
    st.booleans(),
)


@given(begins(), RULES)
def test_c_climbs_as_python(begin, rules):
    kind, parameters, data, low, high = begin
    gain, steps, near, weighted = rules
    given = low, high, gain, steps
    how = {"near": near, "weighted": weighted}
    found = climbed(kind, parameters, data, *given, **how)
    expected = climb(Axes(kind, parameters, data), *given, **how)
    assert penalised(found) == pytest.approx(penalised(expected), rel=1e-9, abs=1e-9)
    np.testing.assert_allclose(found.parameters, expected.parameters, rtol=1e-9, atol=1e-7)
    for one, other in zip(found.weights, expected.weights, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7)
    # What it has left behind is of where it is.
    there = Axes(kind, found.parameters, found.series)
    assert found.value == pytest.approx(there.value, rel=1e-12)
    for name in ("states", "residual", "moves"):
        np.testing.assert_allclose(getattr(found, name), getattr(there, name), rtol=1e-12)
    np.testing.assert_allclose(found.gradient(), there.gradient(), rtol=1e-12)
    np.testing.assert_allclose(found.average_information(), there.average_information(), rtol=1e-12)
    for one, other in zip(found.disturbances(), there.disturbances(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


@pytest.mark.parametrize("kind", list(Kind))
def test_c_and_numpy_end_at_the_same_maximum(kind):
    errors = np.cumsum(2e-3 * np.random.default_rng(3).standard_t(2.0, (400, 6)), axis=0)
    data, _ = alike(400, 3, errors, 20.0)
    low, high = (each[0] for each in bounds(kind, data))
    begin = kind, PARAMETERS[kind][0], series(data, 0), low, high, 1e-9, 100
    found = climbed(*begin, weighted=False)
    with loops.left_out():
        expected = climbed(*begin, weighted=False)
    assert found.value == pytest.approx(expected.value, abs=1e-6)
    np.testing.assert_allclose(found.parameters, expected.parameters, atol=1e-4)


def test_where_there_is_no_likelihood_there_is_no_climb():
    data, _ = alike(20, 1, np.full((20, 6), np.nan))
    begin = PARAMETERS[Kind.DRIFT][0], series(data, 0), np.full(2, -9.0), np.full(2, 9.0)
    with pytest.raises(np.linalg.LinAlgError):
        climbed(Kind.DRIFT, *begin, 0.1, 5)
