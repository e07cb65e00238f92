# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures, and the calibration they rest on: a perfect estimate scores as one."""

import numpy as np
import pytest
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import kstest
from twins import likelihood_twin as twin
from twins.trajectories import real_pair, walk

from trajeval_ros import se3
from trajeval_ros.likelihood.absolute import RunningAbsolute, absolute
from trajeval_ros.likelihood.figures import figures, p_value, p_value_of
from trajeval_ros.likelihood.first_order import absolute_first_order
from trajeval_ros.likelihood.gaussian import NOTHING, GaussianLogLikelihood
from trajeval_ros.likelihood.relative import relative


def test_likelihoods_add_up():
    a, b = GaussianLogLikelihood(3.0, -40.0, 6), GaussianLogLikelihood(8.0, -41.0, 6)
    assert a + b == GaussianLogLikelihood(11.0, -81.0, 12)
    assert (a + b).log_likelihood == pytest.approx(a.log_likelihood + b.log_likelihood)
    assert a + NOTHING == a
    standard = GaussianLogLikelihood(0.0, 0.0, 1)
    assert standard.log_likelihood == pytest.approx(-0.5 * np.log(2 * np.pi))


@pytest.mark.parametrize("chi2", [0.0, 1.0, 100.0, 130.0, 1e4])
def test_p_value_has_two_sides(chi2):
    tail = chi2_distribution(100)
    assert p_value(chi2, 100) == pytest.approx(2 * min(tail.cdf(chi2), tail.sf(chi2)))
    assert p_value(tail.median(), 100) == pytest.approx(1.0)


@pytest.mark.parametrize("dof", [1, 6, 100, 30_000])
def test_p_value_is_nothing_only_where_both_tails_are(dof):
    for ratio in np.concatenate([[-1e-18, 0.0], np.geomspace(1e-4, 1e4, 200)]):
        tail = chi2_distribution(dof)
        expected = 2 * min(tail.cdf(ratio * dof), tail.sf(ratio * dof))
        assert p_value(ratio * dof, dof) == pytest.approx(expected, rel=1e-6, abs=1e-307)


def test_figures():
    found = figures(GaussianLogLikelihood(400.0, -1000.0, 100), 20)
    assert found.chi2_per_dof == 4.0
    assert found.deviations == 2.0
    assert found.nats_per_pose == pytest.approx(-0.5 * (-600 + 100 * np.log(2 * np.pi)) / 20)


def test_figures_without_meaning_are_none():
    found = figures(NOTHING, 0)
    assert (found.chi2_per_dof, found.deviations, found.nats_per_pose) == (None,) * 3
    assert p_value_of(NOTHING) is p_value_of(None) is None
    assert figures(GaussianLogLikelihood(0.0, 0.0, 0), 1).nats_per_pose == 0.0
    assert figures(GaussianLogLikelihood(-1e-18, 0.0, 6), 2).deviations == 0.0


def correlated(count, half_life, std=1e-4):
    """Errors of a smooth process: correlated over a few poses, as between sparse samples."""
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) / half_life
    # Wendland's function: smooth, positive definite, and zero from a lag of one on.
    one = np.maximum(1.0 - lag, 0.0) ** 4 * (4.0 * lag + 1.0)
    return std**2 * np.kron(one, np.eye(6))


def p_values(seed, draws, count, half_life, as_joint):
    rng = np.random.default_rng(seed)
    v = correlated(count, half_life)
    lower = np.linalg.cholesky(v)
    rows = twin.block_rows(v, int(half_life)) if as_joint else twin.block_rows(v, 0)[:, 0]
    found = []
    for _ in range(draws):
        truth = walk(rng, count)
        xi = (lower @ rng.normal(size=6 * count)).reshape(count, 6)
        estimate = se3.exp(rng.normal(size=6)) @ truth @ se3.exp(xi)
        found.append((relative(truth, rows, estimate), absolute(truth, rows, estimate).likelihood))
    return found


def test_a_perfect_estimate_scores_as_one_under_the_joint_covariance():
    found = p_values(1, 150, count=40, half_life=8.0, as_joint=True)
    for likelihoods in zip(*found, strict=True):
        ratio = np.mean([value.chi2 / value.dof for value in likelihoods])
        # The standard deviation of chi2/dof is sqrt(2/dof) = 0.09, of the mean of 150 0.0075.
        assert ratio == pytest.approx(1.0, abs=0.03)
        p = [p_value_of(value) for value in likelihoods]
        assert kstest(p, "uniform").pvalue > 0.01


def test_the_independent_covariance_has_the_wrong_spread():
    found = p_values(1, 150, count=40, half_life=8.0, as_joint=False)
    p = [p_value_of(value) for value, _ in found]
    assert kstest(p, "uniform").pvalue < 1e-6


def test_first_order_is_the_same_under_the_joint_covariance():
    rng = np.random.default_rng(2)
    v = correlated(60, 20.0)
    truth = walk(rng, 60)
    xi = (np.linalg.cholesky(v) @ rng.normal(size=360)).reshape(60, 6)
    problem = truth, twin.block_rows(v, 20), truth @ se3.exp(xi)
    expected = relative(*problem).log_likelihood
    assert absolute_first_order(*problem).log_likelihood == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("names", [("kitti_00", "orb"), ("euroc_mh04", "pl_vio")], ids="/".join)
def test_a_perfect_estimate_scores_as_one_on_real_motion(names):
    """On a run of kilometres, too, for exact residuals; to first order only over a window.

    What the steps' errors leave out is of second order, but their sum has the whole run as its
    lever arm: over KITTI's 3.7 km, 2 mrad make 30 out of a chi2/dof of one.
    """
    truth, covariance, _ = real_pair(*names)
    rng = np.random.default_rng(3)
    xi = (np.linalg.cholesky(covariance) @ rng.normal(size=(len(truth), 6, 1)))[..., 0]
    problem = truth, covariance, truth @ se3.exp(xi)
    run = RunningAbsolute()
    run.update(*problem)
    for whole in (run.total, absolute(*problem).likelihood):
        assert whole.chi2 / whole.dof == pytest.approx(1.0, abs=0.05)
    window = relative(*(values[:200] for values in problem))
    assert window.chi2 / window.dof == pytest.approx(1.0, abs=0.15)
    if names[0] == "kitti_00":
        first_order = relative(*problem)
        assert first_order.chi2 / first_order.dof > 3.0
