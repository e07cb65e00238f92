# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is a covariance, and which can be factored, whatever the order of the arithmetic."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import lapack
from twins.trajectories import draw, random_covariance, walk

from trajeval_ros import se3
from trajeval_ros.likelihood.absolute import absolute
from trajeval_ros.likelihood.gaussian import is_indefinite, positive_definite


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


def test_units_do_not_matter():
    covariance = random_covariance(np.random.default_rng(4), 3, (1e3, 1e-7))
    assert not is_indefinite(covariance).any()
    covariance[:, 3, 4] = covariance[:, 4, 3] = 1.1 * np.sqrt(
        covariance[:, 3, 3] * covariance[:, 4, 4]
    )
    assert is_indefinite(covariance).all()
    # A singular one is one: a planar robot's, with no variance off its plane.
    assert not is_indefinite(np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 1.0])[None]).any()


@pytest.mark.parametrize("value", [1e20, 1e160, 1e308, -1e308])
def test_wild_entries_are_indefinite(value):
    covariance = np.tile(1e-4 * np.eye(6), (3, 1, 1))
    covariance[0, 1, 4] = covariance[0, 4, 1] = value
    covariance[1, 2, 3] = value
    covariance[2, 5, 5] = -abs(value)
    assert is_indefinite(covariance).all()
    # Beyond 1e100 no arithmetic survives it.
    assert is_indefinite(abs(value) * np.eye(6)[None]).all() == (abs(value) >= 1e100)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("entry", [1e30, 1e200, -1e308, 1.7e308])
def test_what_no_arithmetic_survives_is_none(entry):
    """Garbage, or "not known" as the largest double there is."""
    for place in ([0, 0], [1, 4]):
        matrix = np.eye(6)
        matrix[tuple(place)] = matrix[tuple(place[::-1])] = entry
        expected = entry < 0.0 or abs(entry) > 1e100 or place != [0, 0]
        found = is_indefinite(np.stack([np.eye(6), matrix]))
        assert found.tolist() == [False, expected]


def test_a_consistent_estimator_scores_one():
    rng = np.random.default_rng(1)
    truth = walk(rng, 2000)
    covariance = random_covariance(rng, 2000, (1e-3, 1e-3))
    own = random_covariance(rng, 2000, (5e-3, 2e-3), spread=1.0)
    eta = (np.linalg.cholesky(own) @ rng.normal(size=(2000, 6, 1)))[..., 0]
    estimate = draw(rng, truth, covariance) @ se3.exp(eta)
    nees = absolute(truth, covariance + own, estimate).likelihood
    assert nees.chi2 / nees.dof == pytest.approx(1.0, abs=0.06)
    alone = absolute(truth, covariance, estimate).likelihood
    assert alone.chi2 / alone.dof > 5.0
