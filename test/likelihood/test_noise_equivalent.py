# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise-equivalent error against a dense search, and against the noise that was put in."""

import numpy as np
import pytest
from scipy.optimize import minimize
from twins import likelihood_twin as twin
from twins.trajectories import METRIC_PAIRS, draw, random_covariance, real_pair, walk

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import NONE, SE3, YAW_TRANSLATION
from trajeval_ros.likelihood.absolute import absolute
from trajeval_ros.likelihood.noise_equivalent import noise_equivalent_error


def noisy(seed, translation_std, rotation_std, count=200):
    rng = np.random.default_rng(seed)
    truth = walk(rng, count)
    covariance = random_covariance(rng, count, (1e-3, 1e-3))
    eta = rng.normal(size=(count, 6)) * np.repeat([translation_std, rotation_std], 3)
    return truth, covariance, draw(rng, truth, covariance) @ se3.exp(eta)


def noise_of(problem, gauge=SE3):
    return noise_equivalent_error(*problem, gauge, absolute(*problem, gauge).alignment)


@pytest.mark.parametrize("stds", [(0.02, 0.005), (0.001, 0.01), (0.5, 0.3), (0.02, 0.0)])
def test_finds_the_noise_put_in(stds):
    found = noise_of(noisy(1, *stds))
    assert found.converged
    # 600 numbers each: 3 % is one standard deviation, where the noise is well above 1 mm.
    assert found.translation_std == pytest.approx(stds[0], rel=0.12)
    assert found.rotation_std == pytest.approx(stds[1], rel=0.12, abs=5e-4)


@pytest.mark.parametrize("gauge", [SE3, YAW_TRANSLATION, NONE], ids=lambda gauge: gauge.name)
def test_is_the_dense_maximum(gauge):
    truth, covariance, estimate = noisy(2, 0.004, 0.002, count=25)
    if gauge is not SE3:
        estimate = se3.compose(truth[0], se3.inverse(estimate[0])) @ estimate
    problem = truth, covariance, estimate
    found = noise_of(problem, gauge)

    def cost(log_std):
        added = np.diag(np.repeat(np.exp(2.0 * log_std), 3))
        return -absolute(truth, covariance + added, estimate, gauge).likelihood.log_likelihood

    best = minimize(cost, np.log([0.01, 0.01]), method="Nelder-Mead", options={"xatol": 1e-5})
    np.testing.assert_allclose(
        [found.translation_std, found.rotation_std], np.exp(best.x), rtol=5e-3
    )


def test_a_perfect_estimate_has_hardly_any():
    found = noise_of(noisy(3, 0.0, 0.0))
    assert found.converged
    assert found.translation_std < 3e-4
    assert found.rotation_std < 3e-4


def test_an_exact_estimate_has_none():
    truth, covariance, _ = noisy(4, 0.0, 0.0, count=30)
    found = noise_of((truth, covariance, truth))
    assert found.converged
    assert max(found.translation_std, found.rotation_std) < 1e-12


@pytest.mark.parametrize("names", METRIC_PAIRS, ids="/".join)
def test_real_windows(names):
    truth, covariance, estimate = (values[:300] for values in real_pair(*names))
    found = noise_of((truth, covariance, estimate))
    assert found.converged
    residual = absolute(truth, covariance, estimate).residual
    rms = np.sqrt((residual.reshape(-1, 2, 3) ** 2).mean(axis=(0, 2)))
    # It is close to the root mean square where errors are far above the ground truth's.
    np.testing.assert_allclose([found.translation_std, found.rotation_std], rms, rtol=0.5)


@pytest.mark.parametrize("variance", [1e100, 1e200, 1e300])
def test_boundless_covariances_have_a_finite_noise(variance):
    truth, _, estimate = noisy(7, 0.01, 0.01, count=30)
    covariance = np.tile(variance * np.eye(6), (30, 1, 1))
    found = noise_of((truth, covariance, estimate))
    assert np.isfinite([found.translation_std, found.rotation_std]).all()


def test_too_few_poses_are_refused():
    truth, covariance, estimate = noisy(5, 0.01, 0.01, count=1)
    alignment = absolute(truth, covariance, estimate).alignment
    with pytest.raises(ValueError, match="too few"):
        noise_equivalent_error(truth, covariance, estimate, SE3, alignment)


def test_joint_covariance_counts_by_its_diagonal():
    truth, covariance, estimate = noisy(6, 0.01, 0.01, count=30)
    rows = twin.block_rows(twin.dense(covariance), 2)
    alignment = absolute(truth, covariance, estimate).alignment
    assert noise_equivalent_error(truth, rows, estimate, SE3, alignment) == (
        noise_equivalent_error(truth, covariance, estimate, SE3, alignment)
    )
