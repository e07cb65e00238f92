# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The restricted likelihood, its gradient and innovations, against the dense covariance."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import error_model_twin as twin

from trajeval_ros import se3
from trajeval_ros.error_model.information import Factor
from trajeval_ros.error_model.likelihood import Data, Likelihood, clustered_ratio
from trajeval_ros.error_model.process import Kind, steps

PARAMETERS = {
    Kind.DRIFT: np.log([[2e-3, 1e-2], [1e-3, 5e-3]]),
    Kind.VELOCITY: np.log([[2e-3, 1e-2, 0.03, 0.5], [1e-3, 5e-3, 0.02, 0.3]]),
    Kind.WANDER: np.log([[2e-3, 1e-2, 0.5], [1e-3, 5e-3, 0.8]]),
}


def problem(count, seed, columns=9):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, 6, 6)) * 1e-3
    position = np.cumsum(rng.normal(size=(count, 3)) * 0.05, axis=0)
    gauge = np.tile(np.eye(6), (count, 1, 1))
    gauge[:, :3, 3:] = -se3.hat(position)
    data = Data(
        np.cumsum(rng.uniform(0.01, 0.2, count)),
        rng.normal(size=(count, 6)) * 1e-2,
        root @ np.swapaxes(root, 1, 2) + 1e-7 * np.eye(6),
        np.diff(position, axis=0),
        rng.normal(size=(count, 6, columns)),
        rng.uniform(1e-3, 1e-1, columns),
        rng.uniform(0.5, 2.0, (count, 2)),
        rng.uniform(0.5, 2.0, (count - 1, 2)),
    )
    return data, gauge


@pytest.mark.parametrize("kind", list(Kind))
@settings(max_examples=10, deadline=None)
@given(count=st.integers(4, 40), seed=st.integers(0, 999))
def test_likelihood_is_the_dense_one(kind, count, seed):
    data, gauge = problem(count, seed)
    parameters = PARAMETERS[kind] + np.random.default_rng(seed).normal(size=(2, 1)) * 0.5
    found = Likelihood(kind, parameters, data, gauge)
    value, theta = twin.log_likelihood(kind, parameters, data, gauge)
    assert found.value == pytest.approx(value, rel=1e-8, abs=1e-7)
    np.testing.assert_allclose(found.theta[:9], theta, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("kind", list(Kind))
def test_likelihood_of_two_hundred_poses_is_the_dense_one(kind):
    data, gauge = problem(200, 7)
    found = Likelihood(kind, PARAMETERS[kind], data, gauge)
    value, _ = twin.log_likelihood(kind, PARAMETERS[kind], data, gauge)
    assert found.value == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("count", [2, 30])
def test_gradient_is_that_of_the_dense_likelihood(kind, count):
    data, gauge = problem(count, 3, columns=9 if count > 2 else 1)
    parameters = PARAMETERS[kind]
    gradient = Likelihood(kind, parameters, data, gauge).gradient()
    step = 1e-4
    for index in np.ndindex(parameters.shape):
        moved = np.zeros_like(parameters)
        moved[index] = step
        # Of fourth order, so that only round-off is left.
        one, two = (
            (
                twin.log_likelihood(kind, parameters + size * moved, data, gauge)[0]
                - twin.log_likelihood(kind, parameters - size * moved, data, gauge)[0]
            )
            / (2 * size * step)
            for size in (1, 2)
        )
        expected = (4 * one - two) / 3
        scale = max(np.abs(gradient).max(), 1.0)
        assert gradient[index] == pytest.approx(expected, abs=2e-7 * scale)


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("count", [2, 25])
def test_average_information_is_the_dense_one(kind, count):
    data, gauge = problem(count, 3, columns=9 if count > 2 else 1)
    found = Likelihood(kind, PARAMETERS[kind], data, gauge).average_information()
    expected = twin.average_information(kind, PARAMETERS[kind], data, gauge)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("kind", list(Kind))
def test_poses_scores_add_up_to_the_gradient(kind):
    data, gauge = problem(30, 4)
    found = Likelihood(kind, PARAMETERS[kind], data, gauge)
    assert found.scores().shape == (30, 2, len(kind.names))
    np.testing.assert_allclose(found.scores().sum(axis=0), found.gradient(), rtol=1e-12)


@pytest.mark.parametrize("kind", list(Kind))
def test_slopes_of_the_steps_are_their_derivatives(kind):
    intervals = np.array([1e-3, 0.02, 0.3, 4.0])
    parameters = PARAMETERS[kind][0]
    found = steps(kind, parameters, intervals)
    for j in range(len(parameters)):
        moved = np.zeros(len(parameters))
        moved[j] = 1e-5
        later, earlier = (steps(kind, parameters + s * moved, intervals) for s in (1, -1))
        for name, slope in (
            ("transition", found.slope_transition[j]),
            ("noise", found.slope_noise[j]),
            ("prior", found.slope_prior[j]),
        ):
            expected = (getattr(later, name) - getattr(earlier, name)) / 2e-5
            np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-12)


def test_a_step_of_velocity_error_is_two_halves():
    parameters = PARAMETERS[Kind.VELOCITY][0]
    whole = steps(Kind.VELOCITY, parameters, np.array([0.08]))
    half = steps(Kind.VELOCITY, parameters, np.array([0.04]))
    f, q = half.transition[0], half.noise[0]
    np.testing.assert_allclose(whole.transition[0], f @ f, rtol=1e-12)
    np.testing.assert_allclose(whole.noise[0], f @ q @ f.T + q, rtol=1e-8)


@pytest.mark.parametrize("kind", list(Kind))
def test_innovations_are_white_and_add_up_to_chi2(kind):
    data, gauge = problem(60, 5)
    # Hardly a prior, so that its share of chi2 does not show.
    data = replace(data, precision=np.full(9, 1e-9))
    found = Likelihood(kind, PARAMETERS[kind], data, gauge)
    white = found.innovations()
    assert (white**2).sum() == pytest.approx(found.chi2, rel=1e-7)


@settings(max_examples=20, deadline=None)
@given(count=st.integers(1, 30), size=st.integers(1, 12), seed=st.integers(0, 999))
def test_covariances_are_blocks_of_the_inverse(count, size, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, size, size))
    diagonal = root @ np.swapaxes(root, 1, 2) + 5.0 * size * np.eye(size)
    below = rng.normal(size=(count - 1, size, size))
    dense = np.zeros((count * size, count * size))
    for i in range(count):
        here = slice(i * size, (i + 1) * size)
        dense[here, here] = diagonal[i]
        if i:
            earlier = slice((i - 1) * size, i * size)
            dense[here, earlier], dense[earlier, here] = below[i - 1], below[i - 1].T
    factor = Factor.of(diagonal, below)
    own, beside = factor.covariances(diagonal, below)
    inverse = np.linalg.inv(dense).reshape(count, size, count, size)
    assert factor.log_det == pytest.approx(np.linalg.slogdet(dense)[1])
    for i in range(count):
        np.testing.assert_allclose(own[i], inverse[i, :, i], rtol=0, atol=1e-12)
        if i:
            np.testing.assert_allclose(beside[i - 1], inverse[i, :, i - 1], rtol=0, atol=1e-12)


def test_the_scatter_of_the_scores_tells_of_errors_larger_than_the_model_says():
    data, gauge = problem(600, 11)
    rng = np.random.default_rng(0)
    jitter = np.repeat(data.measured * np.exp(2.0 * PARAMETERS[Kind.DRIFT][:, 0]), 3, axis=1)
    root = np.linalg.cholesky(data.covariance + jitter[:, None] * np.eye(6))
    data = replace(data, errors=(root @ rng.normal(size=(600, 6, 1)))[..., 0])
    usual = Likelihood(Kind.DRIFT, np.log([[2e-3, 1e-6], [1e-3, 1e-6]]), data, gauge)
    ratio = clustered_ratio(*usual.whitened(), usual.theta_covariance, 40)
    np.testing.assert_allclose(ratio, 1.0, atol=0.5)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.15)
    tripled = replace(data, errors=3.0 * data.errors)
    larger = Likelihood(Kind.DRIFT, usual.parameters, tripled, gauge)
    tripled_ratio = clustered_ratio(*larger.whitened(), larger.theta_covariance, 40)
    np.testing.assert_allclose(tripled_ratio, 3.0 * ratio, rtol=1e-6)
