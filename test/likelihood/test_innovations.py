# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The errors given the past ones: the loop in C beside LAPACK."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops, se3
from trajeval_ros.likelihood.gaussian import CovarianceError
from trajeval_ros.likelihood.innovations import _by_lapack, _by_loop

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


def steps(count, seed, lever_arm=1.0):
    """Errors, adjoints and noise of steps, and the gauge's error before them."""
    rng = np.random.default_rng(seed)
    twists = rng.normal(size=(count, 6)) * [*3 * [lever_arm], *3 * [0.5]]
    root = rng.normal(size=(count + 1, 6, 6)) * 10.0 ** rng.uniform(-2.0, 0.0, (count + 1, 1, 1))
    noise = root @ root.swapaxes(-1, -2) + 1e-6 * np.eye(6)
    error = 10.0 ** rng.uniform(-6.0, 1.0) * rng.normal(size=(count, 6))
    return error, se3.adjoint(se3.exp(twists)), noise[1:], rng.normal(size=6), noise[0]


@given(st.integers(0, 12), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0, 10.0]))
def test_loop_and_lapack_agree(count, seed, lever_arm):
    given_ = steps(count, seed, lever_arm)
    before = [each.copy() for each in given_]
    for found, expected in zip(_by_loop(*given_), _by_lapack(*given_), strict=True):
        scale = np.abs(expected).max(initial=1e-300)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * scale)
    for one, other in zip(given_, before, strict=True):
        assert np.array_equal(one, other)


def test_one_after_another_is_as_all_at_once():
    error, adjoint, noise, mean, spread = steps(9, 1)
    whole = _by_loop(error, adjoint, noise, mean, spread)
    chi2 = []
    for i in range(9):
        one = slice(i, i + 1)
        part, _, mean, spread = _by_loop(error[one], adjoint[one], noise[one], mean, spread)
        chi2.append(part[0])
    np.testing.assert_allclose(chi2, whole[0], rtol=1e-12)
    np.testing.assert_allclose(spread, whole[3], rtol=0, atol=1e-12 * np.abs(whole[3]).max())


def test_both_name_the_step_without_a_factor():
    error, adjoint, noise, mean, spread = steps(5, 2)
    noise[3] = -1e6 * np.eye(6)
    for way in (_by_loop, _by_lapack):
        with pytest.raises(CovarianceError) as caught:
            way(error, adjoint, noise, mean, spread)
        assert caught.value.index == 3
