# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What independent poses say of their alignment: the loop in C beside NumPy."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trajeval_ros import loops, se3
from trajeval_ros.alignment.gauge import GAUGES, SIM3, Similarity
from trajeval_ros.likelihood.absolute import RunningAbsolute, absolute
from trajeval_ros.likelihood.band import BandFactor
from trajeval_ros.likelihood.first_order import FirstOrderAbsolute
from trajeval_ros.likelihood.gaussian import CovarianceError
from trajeval_ros.likelihood.search import Problem

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


def problem(count, seed, gauge, angle=0.3):
    """Poses whose residuals turn by about such an ``angle``, and an alignment."""
    rng = np.random.default_rng(seed)
    truth = se3.exp(rng.normal(size=(count, 6)) * [5.0, 5.0, 1.0, 1.0, 1.0, 2.0])
    turns = rng.normal(size=(count, 3))
    turns *= angle / np.maximum(np.linalg.norm(turns, axis=1, keepdims=True), 1e-9)
    error = np.concatenate([rng.normal(size=(count, 3)), turns], axis=1)
    alignment = Similarity(se3.exp(rng.normal(size=6)), 1.3 if gauge.has_scale else 1.0)
    estimate = se3.inverse(alignment.pose) @ truth @ se3.exp(error)
    estimate[:, :3, 3] /= alignment.scale
    root = rng.normal(size=(count, 6, 6))
    covariance = root @ root.swapaxes(-1, -2) + 0.1 * np.eye(6)
    return Problem(truth, estimate, covariance, gauge, rng.normal(size=3)), alignment


@given(
    st.integers(0, 7),
    st.integers(0, 2**32 - 1),
    st.sampled_from(sorted(GAUGES)),
    st.sampled_from([0.0, 1e-12, 1e-6, 0.3, 1.9, 2.1, np.pi - 1e-6]),
)
@example(3, 0, "sim3", 0.0)
def test_loop_and_numpy_agree(count, seed, name, angle):
    by_loop, alignment = problem(count, seed, GAUGES[name], angle)
    by_numpy = by_loop._replace(factor=BandFactor.of(by_loop.factor[:, None]))
    if count == 0:
        assert by_loop.chi2(alignment) == 0.0
        return
    chi2 = by_numpy.chi2(alignment)
    assert by_loop.chi2(alignment) == pytest.approx(chi2, rel=1e-9)
    found, expected = by_loop.linearize(alignment), by_numpy.linearize(alignment)
    for one, other in (
        (found.root.T @ found.root, expected.root.T @ expected.root),
        (found.root.T @ found.offset, expected.root.T @ expected.offset),
        (
            found.chi2 + found.offset @ found.offset,
            expected.chi2 + expected.offset @ expected.offset,
        ),
        (found.log_det, expected.log_det),
    ):
        scale = np.abs(other).max(initial=1.0)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * scale)
    assert found.count == expected.count
    assert np.array_equal(found.root, np.triu(found.root))


def with_and_without(ask):
    with loops.left_out():
        expected = ask()
    return ask(), expected


@pytest.mark.parametrize("name", sorted(GAUGES))
def test_a_run_has_the_same_figures(name):
    poses, _ = problem(200, 5, GAUGES[name])
    # So that the scale is determined.
    poses = poses._replace(factor=1e-4 * poses.factor)

    def ask():
        running, first_order = RunningAbsolute(GAUGES[name]), FirstOrderAbsolute()
        for part in (slice(0, 70), slice(70, 71), slice(71, 200)):
            some = poses.ground_truth[part], poses.factor[part], poses.estimate[part]
            running.update(*some)
            first_order.update(*some)
        whole = absolute(poses.ground_truth, poses.factor, poses.estimate, GAUGES[name])
        return (
            (running.total, first_order.total, whole.likelihood),
            running.alignment,
            whole.residual,
        )

    found, expected = with_and_without(ask)
    for one, other in zip(found[0], expected[0], strict=True):
        assert one.log_likelihood == pytest.approx(other.log_likelihood, rel=1e-9)
        assert one.dof == other.dof
    np.testing.assert_allclose(found[1].pose, expected[1].pose, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[2], expected[2], rtol=1e-7, atol=1e-7)


def test_both_name_the_pose_without_a_factor():
    poses, _ = problem(9, 1, SIM3)
    poses.factor[7] = -np.eye(6)

    def ask():
        with pytest.raises(CovarianceError) as caught:
            absolute(poses.ground_truth, poses.factor, poses.estimate, SIM3)
        return caught.value.index

    assert with_and_without(ask) == (7, 7)


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_pose_that_is_not_finite_is_refused():
    poses, _ = problem(9, 1, SIM3)
    poses.estimate[4, 0, 3] = np.inf

    def ask():
        running = RunningAbsolute(SIM3)
        with pytest.raises(ValueError, match="a pose is not finite"):
            running.update(poses.ground_truth, poses.factor, poses.estimate)
        return running.alignment

    assert with_and_without(ask) == (None, None)
