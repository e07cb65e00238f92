# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The relative likelihood against its dense definition, and against itself in other frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import likelihood_twin as twin
from twins.trajectories import (
    METRIC_PAIRS,
    band_covariance,
    draw,
    problems,
    random_covariance,
    real_pair,
    walk,
)

from trajeval_ros import loops, se3
from trajeval_ros.likelihood.absolute import RunningAbsolute
from trajeval_ros.likelihood.first_order import FirstOrderAbsolute, absolute_first_order
from trajeval_ros.likelihood.gaussian import CovarianceError
from trajeval_ros.likelihood.relative import (
    RunningRelative,
    relative,
    relative_error,
    steps_likelihood,
)

FEW = settings(max_examples=40)


def by_se3(bandwidth):
    return RunningAbsolute(bandwidth=bandwidth)


def running(ground_truth, covariance, estimate, cuts=()):
    bandwidth = 0 if covariance.ndim == 3 else covariance.shape[1] - 1
    run = RunningRelative(bandwidth)
    pieces = [
        run.update(*piece)
        for piece in zip(
            np.split(ground_truth, cuts),
            np.split(covariance, cuts),
            np.split(estimate, cuts),
            strict=True,
        )
    ]
    return run, pieces


@FEW
@given(problems(most=30))
def test_is_the_dense_gaussian(problem):
    chi2, log_det = twin.relative(*problem)
    for found in (relative(*problem), running(*problem)[0].total):
        assert found.dof == 6 * (len(problem[0]) - 1)
        # The twin inverts the dense matrix: it is the one that loses digits.
        assert found.chi2 == pytest.approx(chi2, rel=1e-5, abs=1e-9)
        assert found.log_det == pytest.approx(log_det, rel=1e-6, abs=1e-5)


def test_is_scipys_gaussian():
    rng = np.random.default_rng(1)
    ground_truth = walk(rng, 12)
    covariance = random_covariance(rng, 12)
    estimate = draw(rng, ground_truth, covariance, 2.0)
    expected = twin.relative_by_scipy(ground_truth, covariance, estimate)
    assert relative(ground_truth, covariance, estimate).log_likelihood == pytest.approx(expected)


@FEW
@given(st.integers(1, 5).flatmap(lambda p: problems(most=25, bandwidth=p)))
def test_joint_is_the_dense_gaussian(problem):
    chi2, log_det = twin.relative(*problem)
    for found in (relative(*problem), running(*problem)[0].total):
        assert found.chi2 == pytest.approx(chi2, rel=1e-5, abs=1e-9)
        assert found.log_det == pytest.approx(log_det, rel=1e-6, abs=1e-5)


@FEW
@given(problems())
def test_window_is_the_run(problem):
    window, run = relative(*problem), running(*problem)[0].total
    assert window.chi2 == pytest.approx(run.chi2, rel=1e-9, abs=1e-9)
    assert window.log_det == pytest.approx(run.log_det, rel=1e-7, abs=1e-4)


@FEW
@given(st.integers(0, 4), st.data())
def test_cuts_do_not_matter(bandwidth, data):
    problem = data.draw(problems(most=60, bandwidth=bandwidth))
    count = len(problem[0])
    cuts = sorted(data.draw(st.sets(st.integers(0, count), max_size=20)))
    whole, (steps,) = running(*problem)
    cut, pieces = running(*problem, cuts)
    # A band factor's round-off depends on where the band is cut.
    tolerance = 1e-9 if bandwidth else 1e-12
    chi2 = np.concatenate([piece.chi2 for piece in pieces])
    log_det = np.concatenate([piece.log_det for piece in pieces])
    np.testing.assert_allclose(chi2, steps.chi2, rtol=tolerance, atol=100 * tolerance)
    np.testing.assert_allclose(log_det, steps.log_det, rtol=tolerance, atol=100 * tolerance)
    assert cut.total.chi2 == pytest.approx(whole.total.chi2, rel=tolerance, abs=100 * tolerance)
    error = np.concatenate([piece.error for piece in pieces])
    np.testing.assert_allclose(error, relative_error(problem[0], problem[2])[0], atol=1e-15)


def test_steps_sum_to_the_total():
    rng = np.random.default_rng(2)
    ground_truth = walk(rng, 50)
    covariance = random_covariance(rng, 50)
    run, (first, second) = running(
        ground_truth, covariance, draw(rng, ground_truth, covariance), [20]
    )
    assert len(first.chi2) == 19
    assert len(second.chi2) == 30
    total = first.log_likelihood.sum() + second.log_likelihood.sum()
    assert run.total.log_likelihood == pytest.approx(total, rel=1e-12)


@FEW
@given(problems(most=40), st.integers(0, 2**32 - 1))
def test_worlds_and_body_frames_do_not_matter(problem, seed):
    ground_truth, covariance, estimate = problem
    a, b, body = se3.exp(np.random.default_rng(seed).normal(size=(3, 6)))
    # The window's log-determinant is as good as the factor of the explicit Q V Q^T: 1e-8 of itself
    # with covariances eight orders of magnitude apart.
    expected = relative(*problem)
    moved = relative(a @ ground_truth, covariance, b @ estimate)
    assert moved.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-8, abs=1e-5)
    adjoint = se3.adjoint(se3.inverse(body))
    turned = relative(ground_truth @ body, adjoint @ covariance @ adjoint.T, estimate @ body)
    assert turned.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-8, abs=1e-5)


@FEW
@given(problems())
def test_equals_first_order_absolute(problem):
    found, absolute = running(*problem)[0].total, absolute_first_order(*problem)
    assert found.log_likelihood == pytest.approx(absolute.log_likelihood, rel=1e-9, abs=1e-7)
    assert found.dof == absolute.dof


def test_adjoint_as_printed_does_not():
    rng = np.random.default_rng(3)
    ground_truth = walk(rng, 20)
    covariance = random_covariance(rng, 20)
    problem = ground_truth, covariance, draw(rng, ground_truth, covariance)
    expected = absolute_first_order(*problem)
    assert twin.relative(*problem) == pytest.approx((expected.chi2, expected.log_det), rel=1e-9)
    printed = twin.relative(*problem, as_printed=True)
    assert abs(sum(printed) - expected.chi2 - expected.log_det) > 1.0


@pytest.mark.parametrize("names", METRIC_PAIRS, ids="/".join)
def test_equals_first_order_absolute_on_real_data(names):
    problem = real_pair(*names)
    expected = absolute_first_order(*problem).log_likelihood
    assert running(*problem)[0].total.log_likelihood == pytest.approx(expected, rel=1e-11)
    assert relative(*problem).log_likelihood == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("names", METRIC_PAIRS, ids="/".join)
def test_joint_equals_first_order_absolute_on_real_data(names):
    ground_truth, covariance, estimate = real_pair(*names)
    # Wendland's function of the lag: positive definite, and zero from five poses on.
    lag = np.arange(5) / 5.0
    rows = ((1.0 - lag) ** 4 * (4.0 * lag + 1.0))[None, :, None, None] * covariance[:, None]
    problem = ground_truth, rows, estimate
    expected = absolute_first_order(*problem).log_likelihood
    assert running(*problem)[0].total.log_likelihood == pytest.approx(expected, rel=1e-11)
    assert relative(*problem).log_likelihood == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("bandwidth", [0, 2])
def test_few_poses(bandwidth):
    rng = np.random.default_rng(4)
    ground_truth = walk(rng, 2)
    covariance = band_covariance(rng, 2, bandwidth)
    run = RunningRelative(bandwidth)
    assert len(run.update(ground_truth[:0], covariance[:0], ground_truth[:0]).chi2) == 0
    assert len(run.update(ground_truth[:1], covariance[:1], ground_truth[:1]).chi2) == 0
    assert run.total.dof == 0
    assert relative(ground_truth[:1], covariance[:1], ground_truth[:1]).log_likelihood == 0.0
    assert len(run.update(ground_truth[1:], covariance[1:], ground_truth[1:]).chi2) == 1
    assert run.total.dof == 6


@pytest.mark.parametrize("bandwidth", [0, 2])
@pytest.mark.parametrize("kind", [RunningRelative, FirstOrderAbsolute, by_se3])
def test_wrong_covariance_is_refused_and_leaves_no_trace(bandwidth, kind):
    rng = np.random.default_rng(5)
    ground_truth = walk(rng, 200)
    covariance = band_covariance(rng, 200, bandwidth)
    estimate = draw(rng, ground_truth, covariance[:, 0])
    run, expected = kind(bandwidth), kind(bandwidth)
    expected.update(ground_truth, covariance, estimate)
    for wrong in (-1.0, np.nan):
        bad = covariance.copy()
        bad[0, 0] *= wrong
        with pytest.raises(CovarianceError, match="pose 0 "):
            run.update(ground_truth, bad, estimate)
    run.update(ground_truth[:10], covariance[:10], estimate[:10])
    for index in (4, 104):
        for wrong in (-1.0, np.nan):
            bad = covariance[10:].copy()
            bad[index, 0] *= wrong
            with pytest.raises(CovarianceError, match=f"pose {index} ") as caught:
                run.update(ground_truth[10:], bad, estimate[10:])
            assert caught.value.index == index
    broken = ground_truth[10:].copy()
    broken[100] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        run.update(broken, covariance[10:], estimate[10:])
    run.update(ground_truth[10:], covariance[10:], estimate[10:])
    assert run.total.log_likelihood == pytest.approx(expected.total.log_likelihood, rel=1e-10)


def test_a_band_without_digits_is_refused():
    """An estimate's own covariance that says nothing, for a few poses: chi2 was below zero."""
    rng = np.random.default_rng(1)
    ground_truth = walk(rng, 40)
    covariance = random_covariance(rng, 40, (1e-3, 1e-3))
    estimate = draw(rng, ground_truth, covariance)
    refused = 0
    for variance in 10.0 ** np.arange(0.0, 21.0, 2.0):
        large = covariance.copy()
        large[10:16, :3, :3] += variance * np.eye(3)
        reference = RunningRelative().update(ground_truth, large, estimate).total
        try:
            with loops.left_out():
                found = steps_likelihood(*relative_error(ground_truth, estimate), large)
        except CovarianceError:
            refused += 1
        else:
            assert found.chi2 == pytest.approx(reference.chi2, rel=1e-6)
            assert found.log_det == pytest.approx(reference.log_det, rel=1e-6)
        if loops.there():
            by_loop = steps_likelihood(*relative_error(ground_truth, estimate), large)
            assert by_loop.chi2 == pytest.approx(reference.chi2, rel=1e-9)
            assert by_loop.log_det == pytest.approx(reference.log_det, rel=1e-9)
    assert 0 < refused < 11


@pytest.mark.filterwarnings("error")
def test_a_step_as_long_as_the_earth_is_refused():
    """Its lever arm leaves no digit of the noise: no NaN, but a pose that is named."""
    rng = np.random.default_rng(2)
    ground_truth = walk(rng, 60)
    covariance = random_covariance(rng, 60, (1e-3, 1e-3))
    ground_truth[20:, :3, 3] *= 1e9
    with pytest.raises(CovarianceError):
        RunningRelative().update(ground_truth, covariance, ground_truth)
