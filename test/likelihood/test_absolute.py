# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The absolute likelihood against dense least squares, importance sampling and itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.special import logsumexp
from twins import likelihood_twin as twin
from twins.trajectories import (
    METRIC_PAIRS,
    MONOCULAR_PAIRS,
    band_covariance,
    draw,
    problems,
    random_covariance,
    real_pair,
    walk,
)

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import GAUGES, NONE, SE3, SIM3, YAW_TRANSLATION, Similarity
from trajeval_ros.alignment.observability import Motion, Status
from trajeval_ros.likelihood import search
from trajeval_ros.likelihood.absolute import Ending, RunningAbsolute, absolute
from trajeval_ros.likelihood.gaussian import CovarianceError
from trajeval_ros.likelihood.relative import relative

FEW = settings(max_examples=30)
by_gauge = pytest.mark.parametrize("gauge", GAUGES.values(), ids=lambda gauge: gauge.name)


def residuals(ground_truth, estimate, alignment):
    scaled = estimate.copy()
    scaled[:, :3, 3] *= alignment.scale
    return np.array(
        [
            se3.log(np.linalg.solve(true, alignment.pose @ pose))
            for true, pose in zip(ground_truth, scaled, strict=True)
        ]
    ).ravel()


@by_gauge
@pytest.mark.parametrize("size", [1e-12, 1e-4, 0.3, 1.0])
def test_the_volume_of_a_change_is_its_determinant(gauge, size):
    delta = size * np.random.default_rng(7).uniform(0.2, 1.0, size=gauge.dimension)
    _, expected = np.linalg.slogdet(gauge.rebase(delta, np.array([1.0, 2.0, 3.0])))
    assert gauge.log_volume(delta) == pytest.approx(expected, abs=1e-12)


def displaced(rng, problem, gauge):
    """The same problem with the estimate in a world that the gauge allows for."""
    ground_truth, covariance, estimate = problem
    back = se3.inverse(ground_truth[0] @ se3.inverse(estimate[0]))
    if gauge is NONE:
        return ground_truth, covariance, se3.inverse(back) @ estimate
    if gauge is YAW_TRANSLATION:
        turn = se3.exp(np.array([*rng.normal(size=3), 0.0, 0.0, rng.normal()]))
        return ground_truth, covariance, turn @ se3.inverse(back) @ estimate
    if gauge is SIM3:
        shrunk = estimate.copy()
        shrunk[:, :3, 3] *= 0.1
        return ground_truth, covariance, shrunk
    return problem


def simulated(seed, gauge, count=40, factor=1.0, std=(0.01, 0.01), bandwidth=0):
    rng = np.random.default_rng(seed)
    ground_truth = walk(rng, count, step=0.5)
    if bandwidth:
        covariance = band_covariance(rng, count, bandwidth, std)
        single = covariance[:, 0]
    else:
        covariance = single = random_covariance(rng, count, std)
    estimate = draw(rng, ground_truth, single, factor)
    return displaced(rng, (ground_truth, covariance, estimate), gauge)


@by_gauge
@pytest.mark.parametrize("bandwidth", [0, 2])
def test_is_dense_least_squares(gauge, bandwidth):
    ground_truth, covariance, estimate = simulated(1, gauge, factor=5.0, bandwidth=bandwidth)
    found = absolute(ground_truth, covariance, estimate, gauge)
    assert found.ending is Ending.CONVERGED
    v = twin.dense(covariance)
    lower = np.linalg.cholesky(v)
    # Another parametrization, about the world's origin, and numerical derivatives.
    origin = np.zeros(3)

    def white(delta):
        alignment = gauge.perturb(found.alignment, origin, delta)
        return np.linalg.solve(lower, residuals(ground_truth, estimate, alignment))

    d = gauge.dimension
    if d:
        best = least_squares(white, np.full(d, 1e-3), x_scale="jac", xtol=1e-15, ftol=1e-15)
        np.testing.assert_allclose(best.x, 0.0, atol=1e-6)
    jacobian = np.zeros((len(v), d))
    for k in range(d):
        h = np.zeros(d)
        h[k] = 1e-5
        jacobian[:, k] = (white(h) - white(-h)) / 2e-5
    chi2 = float((white(np.zeros(d)) ** 2).sum())
    log_det = np.linalg.slogdet(v)[1] + np.linalg.slogdet(jacobian.T @ jacobian)[1]
    assert found.likelihood.chi2 == pytest.approx(chi2, rel=1e-9)
    assert found.likelihood.log_det == pytest.approx(log_det, rel=1e-7)
    assert found.likelihood.dof == 6 * len(ground_truth) - d


@by_gauge
@pytest.mark.parametrize("std", [(0.01, 0.01), (0.1, 0.05)], ids=["fine", "coarse"])
def test_is_the_integral(gauge, std):
    """Against importance sampling: the integral over the Haar measure itself, without Laplace."""
    ground_truth, covariance, estimate = simulated(2, gauge, count=8, factor=1.0, std=std)
    found = absolute(ground_truth, covariance, estimate, gauge)
    if gauge is NONE:
        samples = np.zeros((1, 0))
        log_weight = np.zeros(1)
    else:
        rng = np.random.default_rng(3)
        d = gauge.dimension
        information = numerical_information(ground_truth, covariance, estimate, found, gauge)
        lower = np.linalg.cholesky(np.linalg.inv(information))
        # Student's t with 8 degrees of freedom: heavier tails than the integrand's.
        normal = rng.normal(size=(1500, d)) / np.sqrt(rng.chisquare(8, size=(1500, 1)) / 8)
        samples = normal @ lower.T
        log_weight = student_log_density(normal, 8) - np.log(np.diagonal(lower)).sum()
    log_terms = (
        np.array(
            [
                log_integrand(ground_truth, covariance, estimate, found, gauge, delta)
                for delta in samples
            ]
        )
        - log_weight
    )
    expected = logsumexp(log_terms) - np.log(len(log_terms))
    assert found.likelihood.log_likelihood == pytest.approx(expected, abs=0.05)


def numerical_information(ground_truth, covariance, estimate, found, gauge):
    centre = ground_truth[:, :3, 3].mean(axis=0)
    d = gauge.dimension
    columns = []
    for k in range(d):
        h = np.zeros(d)
        h[k] = 1e-5
        ahead, behind = (
            residuals(ground_truth, estimate, gauge.perturb(found.alignment, centre, s * h))
            for s in (1, -1)
        )
        columns.append((ahead - behind) / 2e-5)
    jacobian = np.array(columns).T
    return jacobian.T @ np.linalg.solve(twin.dense(covariance), jacobian)


def student_log_density(x, nu):
    from scipy.stats import multivariate_t

    return multivariate_t(np.zeros(x.shape[1]), np.eye(x.shape[1]), nu).logpdf(x)


def log_integrand(ground_truth, covariance, estimate, found, gauge, delta):
    """Log N(eps; 0, V) times the Haar density of the perturbation's coordinates."""
    centre = ground_truth[:, :3, 3].mean(axis=0)
    if gauge.dimension:
        alignment = gauge.perturb(found.alignment, centre, delta)
        full = gauge.expand(delta)
        # The measure of h(delta + d) h(delta)^-1: Exp's left Jacobian, within the subgroup, and
        # for the scale d(log s).
        jacobian = np.eye(7)
        if full[6] <= -1.0:
            return -np.inf
        jacobian[:6, :6] = se3.left_jacobian(full[:6])
        jacobian[6, 6] = 1.0 / (1.0 + full[6])
        free = list(gauge.free)
        log_density = np.linalg.slogdet(jacobian[np.ix_(free, free)])[1]
    else:
        alignment, log_density = found.alignment, 0.0
    eps = residuals(ground_truth, estimate, alignment).reshape(-1, 6)
    chi2 = np.einsum("mi,mij,mj", eps, np.linalg.inv(covariance), eps)
    return log_density - 0.5 * (
        chi2 + np.linalg.slogdet(covariance)[1].sum() + eps.size * np.log(2.0 * np.pi)
    )


@FEW
@given(problems(most=100))
def test_small_errors_are_first_order(problem):
    ground_truth, _, estimate = problem
    xi = se3.log(se3.inverse(ground_truth) @ ground_truth[0] @ se3.inverse(estimate[0]) @ estimate)
    near = ground_truth @ se3.exp(1e-6 * xi)
    covariance = np.broadcast_to(1e-8 * np.eye(6), (len(near), 6, 6))
    found = absolute(ground_truth, covariance, near)
    expected = relative(ground_truth, covariance, near).log_likelihood
    assert found.likelihood.log_likelihood == pytest.approx(expected, rel=1e-4, abs=1e-2)


@by_gauge
def test_running_equals_nonlinear_for_small_errors(gauge):
    problem = simulated(4, gauge, count=300, std=(1e-3, 1e-3))
    run = RunningAbsolute(gauge)
    run.update(*problem)
    found = absolute(*problem, gauge)
    assert run.total.dof == found.likelihood.dof
    assert run.total.log_likelihood == pytest.approx(found.likelihood.log_likelihood, rel=1e-3)
    np.testing.assert_allclose(run.alignment.pose, found.alignment.pose, atol=1e-3)
    np.testing.assert_allclose(
        run.covariance, found.covariance, atol=0.02 * np.abs(found.covariance).max()
    )


@FEW
@given(st.sampled_from(["none", "se3", "yaw_translation"]), st.integers(0, 3), st.data())
def test_cuts_do_not_matter(name, bandwidth, data):
    problem = data.draw(problems(bandwidth=bandwidth))
    cuts = sorted(data.draw(st.sets(st.integers(0, len(problem[0])), max_size=20)))
    whole, cut = (RunningAbsolute(GAUGES[name], bandwidth) for _ in range(2))
    whole.update(*problem)
    for piece in zip(*(np.split(values, cuts) for values in problem), strict=True):
        cut.update(*piece)
    assert cut.total.chi2 == pytest.approx(whole.total.chi2, rel=1e-7, abs=1e-7)
    assert cut.total.log_det == pytest.approx(whole.total.log_det, rel=1e-9, abs=1e-7)


@pytest.mark.parametrize("bandwidth", [0, 2])
def test_pieces_do_not_matter(bandwidth, monkeypatch):
    problem = simulated(8, SIM3, factor=5.0, bandwidth=bandwidth)
    expected = absolute(*problem, SIM3)
    monkeypatch.setattr(search, "_PIECE", 7)
    found = absolute(*problem, SIM3)
    assert found.likelihood.log_likelihood == pytest.approx(expected.likelihood.log_likelihood)
    assert found.likelihood.dof == expected.likelihood.dof
    np.testing.assert_allclose(found.alignment.pose, expected.alignment.pose, atol=1e-9)
    np.testing.assert_allclose(found.residual, expected.residual, atol=1e-9)


def test_the_estimates_world_does_not_matter():
    ground_truth, covariance, estimate = simulated(6, SE3, factor=5.0)
    rng = np.random.default_rng(7)
    for gauge in (SE3, SIM3):
        expected = absolute(ground_truth, covariance, estimate, gauge).likelihood
        moved = se3.exp(rng.normal(size=6)) @ estimate
        if gauge is SIM3:
            moved[:, :3, 3] *= 12.0
        found = absolute(ground_truth, covariance, moved, gauge).likelihood
        assert found.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-9)
        world, body = se3.exp(rng.normal(size=(2, 6)))
        if gauge is SIM3:
            # An offset would have to be scaled with the estimate.
            body[:3, 3] = 0.0
        adjoint = se3.adjoint(se3.inverse(body))
        found = absolute(
            world @ ground_truth @ body, adjoint @ covariance @ adjoint.T, estimate @ body, gauge
        ).likelihood
        assert found.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-9)


@pytest.mark.parametrize("kind", ["stuck", "on a line", "orientations at random"])
@pytest.mark.parametrize("gauge", [SE3, YAW_TRANSLATION, SIM3], ids=lambda gauge: gauge.name)
def test_worlds_do_not_matter_to_what_is_far_off(gauge, kind):
    # Where errors are radians there are many minima: the search must end in the same one.
    turning = np.array([0.0, 0.0, 1.0] if gauge is YAW_TRANSLATION else [1.0, 1.0, 1.0])
    for seed in range(12):
        rng = np.random.default_rng(seed)

        def world(rng=rng):
            made = np.eye(4)
            made[:3, :3] = se3.exp_so3(turning * rng.normal(size=3))
            made[:3, 3] = rng.normal(0.0, 10.0, 3)
            return made

        ground_truth = walk(rng, 60)
        covariance = random_covariance(rng, 60, std=(1e-3, 1e-3), spread=1.0)
        estimate = world() @ ground_truth
        if kind == "stuck":
            estimate[:] = estimate[20]
        elif kind == "on a line":
            estimate[:, :3, 3] = np.arange(60.0)[:, np.newaxis] * rng.normal(size=3)
        else:
            estimate[:, :3, :3] = se3.exp_so3(rng.normal(0.0, 2.0, (60, 3)))
        residuals = np.stack(
            [
                absolute(ground_truth, covariance, estimate, gauge).residual,
                absolute(world() @ ground_truth, covariance, world() @ estimate, gauge).residual,
            ]
        )
        chi2 = np.einsum("kma,mab,kmb->k", residuals, np.linalg.inv(covariance), residuals)
        assert chi2[0] == pytest.approx(chi2[1], rel=1e-6)


@pytest.mark.parametrize("names", METRIC_PAIRS, ids="/".join)
def test_converges_on_real_data(names):
    problem = real_pair(*names)
    found = absolute(*problem)
    assert found.ending is Ending.CONVERGED
    first_order = relative(*problem).log_likelihood
    assert found.likelihood.log_likelihood == pytest.approx(first_order, rel=0.1)
    run = RunningAbsolute()
    run.update(*problem)
    assert run.total.log_likelihood == pytest.approx(found.likelihood.log_likelihood, rel=1e-3)


@by_gauge
def test_start_does_not_matter(gauge):
    problem = simulated(8, gauge, factor=5.0)
    found = absolute(*problem, gauge)
    if gauge.dimension == 0:
        return
    centre = problem[0][:, :3, 3].mean(axis=0)
    rng = np.random.default_rng(9)
    for _ in range(5):
        far = gauge.perturb(found.alignment, centre, rng.uniform(-0.7, 0.7, gauge.dimension))
        again = absolute(*problem, gauge, far)
        assert again.ending is Ending.CONVERGED
        assert again.likelihood.chi2 == pytest.approx(found.likelihood.chi2, rel=1e-6)


def test_running_before_the_first_pose():
    run = RunningAbsolute()
    assert run.alignment is None
    assert run.covariance is None
    assert run.total.dof == 0
    with pytest.raises(ValueError, match="no pose"):
        absolute(np.zeros((0, 4, 4)), np.zeros((0, 6, 6)), np.zeros((0, 4, 4)))


def test_one_pose_has_no_error():
    problem = simulated(10, SE3, count=1)
    found = absolute(*problem)
    assert found.likelihood.dof == 0
    assert found.likelihood.log_likelihood == pytest.approx(0.0, abs=1e-9)
    run = RunningAbsolute()
    run.update(*problem)
    assert run.total.log_likelihood == pytest.approx(0.0, abs=1e-9)


def test_wrong_poses_and_covariances_are_refused():
    ground_truth, covariance, estimate = simulated(11, SE3, count=100)
    with pytest.raises(ValueError, match="not finite"):
        absolute(ground_truth, covariance, np.nan * estimate)
    covariance[90] *= -1.0
    for refuse in (absolute, RunningAbsolute().update):
        with pytest.raises(CovarianceError, match="pose 90 "):
            refuse(ground_truth, covariance, estimate)


def test_scale_applies_to_positions_alone():
    pose = se3.exp(np.arange(6.0))
    moved = Similarity(np.eye(4), 2.0).apply(pose)
    np.testing.assert_array_equal(moved[:3, :3], pose[:3, :3])
    np.testing.assert_array_equal(moved[:3, 3], 2.0 * pose[:3, 3])


@pytest.mark.parametrize("names", MONOCULAR_PAIRS, ids="/".join)
def test_monocular_runs_in_sim3(names):
    problem = real_pair(*names)
    found = absolute(*problem, SIM3)
    assert found.ending is Ending.CONVERGED
    assert found.observability.scale_observed
    assert found.likelihood.log_likelihood > absolute(*problem, SE3).likelihood.log_likelihood
    run = RunningAbsolute(SIM3)
    run.update(*problem)
    assert run.alignment.scale == pytest.approx(found.alignment.scale, rel=1e-2)
    assert run.total.log_likelihood == pytest.approx(found.likelihood.log_likelihood, rel=1e-2)


def still(count=30, jitter=0.0, std=1e-3):
    rng = np.random.default_rng(12)
    ground_truth = np.broadcast_to(walk(rng, 1), (count, 4, 4)).copy()
    covariance = random_covariance(rng, count, (std, std))
    estimate = draw(rng, ground_truth, covariance, jitter)
    return ground_truth, covariance, estimate


def straight(count=30, direction=(1.0, 0.0, 0.0)):
    ground_truth, covariance, estimate = still(count, 1.0)
    offset = np.outer(np.arange(count), direction)
    world = se3.compose(ground_truth[0], se3.inverse(estimate[0]))
    aligned = world @ estimate
    for poses in (ground_truth, aligned):
        poses[:, :3, 3] += offset
    return ground_truth, covariance, se3.inverse(world) @ aligned


@by_gauge
@pytest.mark.parametrize("jitter", [0.0, 1.0])
def test_rest(gauge, jitter):
    problem = displaced(np.random.default_rng(13), still(jitter=jitter), gauge)
    found = absolute(*problem, gauge)
    run = RunningAbsolute(gauge)
    run.update(*problem)
    assert found.observability.motion is Motion.STATIC
    if gauge is SIM3:
        assert found.observability.status is Status.SCALE_NOT_OBSERVED
        assert found.likelihood is None
        assert run.total is None
        assert np.isinf(found.covariance[6, 6])
        assert found.alignment.scale == run.alignment.scale == 1.0
    else:
        expected = Status.OBSERVED if gauge is NONE else Status.BY_ORIENTATIONS_ONLY
        assert found.observability.status is expected
        assert (
            len(found.observability.unobserved_axes) == {NONE: 0, YAW_TRANSLATION: 1, SE3: 3}[gauge]
        )
        assert found.likelihood.log_likelihood == pytest.approx(run.total.log_likelihood, abs=0.1)
    assert found.ending is Ending.CONVERGED
    free = [index for index in gauge.free if index != 6]
    assert np.linalg.matrix_rank(found.covariance[:6, :6], tol=1e-16) == len(free)
    np.testing.assert_array_equal(
        run.observability.unobserved_axes, found.observability.unobserved_axes
    )


def test_straight_line():
    problem = straight()
    found = absolute(*problem)
    assert found.observability.motion is Motion.STRAIGHT
    assert found.observability.status is Status.BY_ORIENTATIONS_ONLY
    np.testing.assert_allclose(abs(found.observability.unobserved_axes), [[1, 0, 0]], atol=1e-3)
    assert found.ending is Ending.CONVERGED
    level = absolute(*straight(direction=(0.6, 0.8, 0.0)), YAW_TRANSLATION)
    assert level.observability.status is Status.OBSERVED
    climb = absolute(*straight(direction=(0.0, 0.0, 1.0)), YAW_TRANSLATION)
    assert climb.observability.status is Status.BY_ORIENTATIONS_ONLY
    np.testing.assert_array_equal(climb.observability.unobserved_axes, [[0, 0, 1]])
    scaled = absolute(*straight(), SIM3)
    assert scaled.observability.status is Status.BY_ORIENTATIONS_ONLY
    assert scaled.observability.scale_observed
    assert scaled.likelihood is not None


def test_estimate_at_rest_has_no_scale():
    ground_truth, covariance, estimate = straight()
    found = absolute(ground_truth, covariance, np.broadcast_to(estimate[:1], estimate.shape), SIM3)
    assert found.observability.status is Status.SCALE_NOT_OBSERVED
    assert found.likelihood is None
