# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which covariances can be factored, whatever the order of the arithmetic."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import lapack

from trajeval_ros.metrics.gaussian import positive_definite


def covariance(seed, variances):
    """With these eigenvalues, (6,), about axes of any direction."""
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))
    return (axes * variances) @ axes.T


@given(
    seed=st.integers(0, 2**32 - 1),
    exponents=st.lists(st.floats(-20.0, 20.0), min_size=6, max_size=6),
)
def test_what_is_positive_definite_has_a_factor(seed, exponents):
    matrix = covariance(seed, 10.0 ** np.array(exponents))
    if positive_definite(matrix[None])[0]:
        for order in (np.arange(6), np.arange(6)[::-1]):
            _, wrong = lapack.dpotrf(matrix[np.ix_(order, order)], lower=1)
            assert wrong == 0


@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((6, 6)),
        np.full((6, 6), np.nan),
        np.diag([1.0, 1.0, 1.0, 1.0, 1.0, np.inf]),
        np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1.0]),
        np.ones((6, 6)),
        covariance(0, np.array([1e12, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6])),
    ],
)
def test_each_is_judged_by_itself(matrix):
    good = np.diag([1e-12, 1e12, 1.0, 1e-30, 1e30, 1e-6])
    assert positive_definite(np.stack([good, matrix, good])).tolist() == [True, False, True]
    assert positive_definite(matrix[None]).tolist() == [False]


def test_none_at_all():
    assert positive_definite(np.zeros((0, 6, 6))).shape == (0,)
