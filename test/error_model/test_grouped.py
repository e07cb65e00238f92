# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of both groups in C are those of NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.error_model.grouped import GroupedSteps
from trajeval_ros.error_model.process import Kind

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


def same(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-300)


@given(st.sampled_from(list(Kind)), st.integers(0, 50), st.integers(0, 2**32 - 1))
def test_both_say_the_same(kind, count, seed):
    rng = np.random.default_rng(seed)
    given = rng.uniform(-5.0, 2.0, (2, len(kind.names))), rng.uniform(1e-3, 5.0, count)
    factors = np.exp(rng.exponential(size=(count, 2)))
    found, expected = (GroupedSteps(kind, *given, factors) for _ in range(2))
    of_all, slopes = found.all, found.slopes
    with loops.left_out():
        for one, other in zip(of_all[:3], expected.all[:3], strict=True):
            same(one, other)
        assert of_all[3] == pytest.approx(expected.all[3], rel=1e-9, abs=1e-9)
        same(slopes.moves, expected.slopes.moves)
        same(slopes.prior, expected.slopes.prior)
        # By the time they are differences of what is by the deviation.
        size = np.abs(expected.slopes.noise).max(axis=0, initial=1e-300)
        np.testing.assert_allclose(slopes.noise / size, expected.slopes.noise / size, atol=1e-9)


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("interval", [0.0, np.nan])
def test_a_step_that_takes_no_time_has_no_likelihood(kind, interval):
    steps = GroupedSteps(
        kind, np.zeros((2, len(kind.names))), np.array([interval]), np.ones((1, 2))
    )
    with pytest.raises(np.linalg.LinAlgError):
        _ = steps.all
