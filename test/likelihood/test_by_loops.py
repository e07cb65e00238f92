# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Running likelihoods by the loops in C: as NumPy has them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops, se3
from trajeval_ros.likelihood.absolute import RunningAbsolute
from trajeval_ros.likelihood.first_order import FirstOrderAbsolute
from trajeval_ros.likelihood.gaussian import CovarianceError, are_positive, positive_definite
from trajeval_ros.likelihood.information import Information
from trajeval_ros.likelihood.relative import RunningRelative, relative_error

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")

seeds = st.integers(0, 2**32 - 1)


def both(function):
    """What a function returns by the loops, and without."""
    with_them = function()
    with loops.left_out():
        return with_them, function()


def run(seed, count, scale=1.0):
    """Ground truth, covariance and estimate of a walk."""
    rng = np.random.default_rng(seed)
    steps = se3.exp(rng.normal(size=(count, 6)) * [scale, scale, scale, 0.3, 0.3, 0.3])
    truth = steps.copy()
    for i in range(1, count):
        truth[i] = truth[i - 1] @ steps[i]
    errors = se3.exp(1e-2 * rng.normal(size=(count, 6)))
    roots = np.eye(6) + 0.3 * np.tril(rng.normal(size=(count, 6, 6)), -1)
    roots *= 10.0 ** rng.uniform(-3, 0, size=(count, 1, 1))
    covariance = roots @ roots.swapaxes(-1, -2)
    return truth, covariance, se3.exp(rng.normal(size=6)) @ truth @ errors


@given(
    seeds, st.lists(st.integers(1, 40), min_size=1, max_size=4), st.sampled_from([1e-2, 1.0, 10.0])
)
def test_running_figures(seed, sizes, scale):
    truth, covariance, estimate = run(seed, sum(sizes), scale)

    def figures():
        relative, first, absolute = RunningRelative(), FirstOrderAbsolute(), RunningAbsolute()
        chi2, log_det = [], []
        for begin, size in zip(np.cumsum([0, *sizes[:-1]]), sizes, strict=True):
            part = slice(begin, begin + size)
            steps = relative.update(truth[part], covariance[part], estimate[part])
            chi2 += steps.chi2.tolist()
            log_det += steps.log_det.tolist()
            first.update(truth[part], covariance[part], estimate[part], steps.error)
            absolute.update(truth[part], covariance[part], estimate[part])
        totals = (first.total, absolute.total)
        return chi2, log_det, [(t.chi2, t.log_det, t.dof) for t in totals]

    for found, expected in zip(*both(figures), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


@given(seeds, st.integers(0, 20), st.sampled_from([1e-9, 1.0, 1e3]))
def test_the_same_steps(seed, count, scale):
    truth, _, estimate = run(seed, count, scale)
    for found, expected in zip(*both(lambda: relative_error(truth, estimate)), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * max(scale, 1.0))


@given(seeds, st.lists(st.sampled_from([0.0, 1e-17, 1e-16, 2e-14, 1e-3]), min_size=1, max_size=5))
def test_the_same_are_positive_definite(seed, smallest):
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(smallest), 6, 6)))
    values = np.ones((len(smallest), 6))
    values[:, 0] = smallest
    covariance = (axes * values[:, None]) @ axes.swapaxes(-1, -2)
    found, expected = both(lambda: positive_definite(covariance))
    assert np.array_equal(found, expected)
    # What C is sure of, every order of the sums is.
    assert are_positive(covariance) <= expected.all()


@pytest.mark.parametrize("place", [0, 3])
@pytest.mark.parametrize("wrong", [np.nan, -1.0, 0.0])
def test_the_same_covariance_is_none(place, wrong):
    truth, covariance, estimate = run(5, 6)
    covariance[place, 2, 2] = wrong

    def index(running):
        with pytest.raises(CovarianceError) as error:
            running.update(truth, covariance, estimate)
        return error.value.index

    for kind in (RunningRelative, FirstOrderAbsolute, RunningAbsolute):
        assert both(lambda k=kind: index(k())) == (place, place)


@given(seeds, st.integers(0, 7), st.integers(0, 30))
def test_information(seed, dimension, rows):
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(rows, dimension + 1)) * 10.0 ** rng.uniform(-6, 6, dimension + 1)

    def summed():
        half = rows // 2
        both_halves = Information.none(dimension).absorb(columns[:half], 1.0)
        found = both_halves.absorb(columns[half:], 2.0)
        triangle = np.concatenate([found.root, found.offset[:, None]], axis=1)
        return triangle.T @ triangle, found.chi2, found.root

    (square, chi2, root), (expected, its_chi2, _) = both(summed)
    size = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    assert (np.abs(square - expected) <= 1e-9 * size + 1e-300).all()
    assert chi2 == pytest.approx(its_chi2, rel=1e-9, abs=1e-12 * (expected[-1, -1] + its_chi2))
    assert not np.tril(root, -1).any()


@pytest.mark.parametrize("place", range(4))
def test_what_is_not_a_number_stays_none(place):
    """As a maximum that leaves NaN out it would be no residual at all."""
    columns = np.random.default_rng(0).normal(size=(4, 3))
    columns[place] = np.nan
    for found in both(lambda: Information.none(2).absorb(columns, 0.0)):
        assert np.isnan(found.root[0]).all()
        assert np.isnan(found.chi2)
