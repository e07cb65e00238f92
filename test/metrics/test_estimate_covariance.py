# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimate's covariance: added up, and looked at before it is believed."""

import numpy as np
import pytest
from twins.trajectories import band_covariance, draw, random_covariance, walk

from trajeval_ros import se3
from trajeval_ros.metrics.absolute import absolute
from trajeval_ros.metrics.estimate_covariance import (
    CovarianceFault,
    add_estimate_covariance,
    covariance_faults,
    is_indefinite,
)


def test_a_consistent_estimator_scores_one():
    rng = np.random.default_rng(1)
    truth = walk(rng, 2000)
    covariance = random_covariance(rng, 2000, (1e-3, 1e-3))
    own = random_covariance(rng, 2000, (5e-3, 2e-3), spread=1.0)
    eta = (np.linalg.cholesky(own) @ rng.normal(size=(2000, 6, 1)))[..., 0]
    estimate = draw(rng, truth, covariance) @ se3.exp(eta)
    nees = absolute(truth, add_estimate_covariance(covariance, own), estimate).likelihood
    assert nees.chi2 / nees.dof == pytest.approx(1.0, abs=0.06)
    alone = absolute(truth, covariance, estimate).likelihood
    assert alone.chi2 / alone.dof > 5.0


def test_adds_to_each_poses_own():
    rng = np.random.default_rng(2)
    rows = band_covariance(rng, 5, 2)
    own = random_covariance(rng, 5)
    total = add_estimate_covariance(rows, own)
    np.testing.assert_array_equal(total[:, 0], rows[:, 0] + own)
    np.testing.assert_array_equal(total[:, 1:], rows[:, 1:])
    np.testing.assert_array_equal(add_estimate_covariance(rows[:, 0], own), total[:, 0])


def test_faults_are_counted():
    good = random_covariance(np.random.default_rng(3), 6)
    assert covariance_faults(good) == {}
    assert covariance_faults(good[:0]) == {}
    assert covariance_faults(good[:1]) == {}
    assert covariance_faults(np.repeat(good[:1], 4, axis=0)) == {CovarianceFault.CONSTANT: 4}
    bad = good.copy()
    bad[0, 2, 3] = np.nan
    bad[1] = 0.0
    bad[2] *= -1.0
    bad[3, 0, 1] += 0.5 * np.sqrt(bad[3, 0, 0] * bad[3, 1, 1])
    assert covariance_faults(bad) == {
        CovarianceFault.NOT_FINITE: 1,
        CovarianceFault.ZERO: 1,
        CovarianceFault.INDEFINITE: 2,
    }


def test_units_do_not_matter():
    covariance = random_covariance(np.random.default_rng(4), 3, (1e3, 1e-7))
    assert not is_indefinite(covariance).any()
    covariance[:, 3, 4] = covariance[:, 4, 3] = 1.1 * np.sqrt(
        covariance[:, 3, 3] * covariance[:, 4, 4]
    )
    assert is_indefinite(covariance).all()
    # A singular one is one: a planar robot's, with no variance off its plane.
    assert not is_indefinite(np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 1.0])[None]).any()
