# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Positions without orientations: against dense twins, and in simulation."""

import pickle

import numpy as np
import numpy.typing as npt
import pytest

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import GAUGES
from trajeval_ros.likelihood.gaussian import CovarianceError, GaussianLogLikelihood
from trajeval_ros.likelihood.positions import LEVER_ARM_STD
from trajeval_ros.likelihood.running_positions import (
    PositionError,
    RunningPositions,
    position_error,
)

Array = npt.NDArray[np.float64]

ARM = np.array([0.3, -0.1, 0.8])


def run(
    rng: np.random.Generator,
    gauge: str = "se3",
    count: int = 200,
    std: float = 0.02,
    origin: float = 1e3,
) -> tuple[Array, Array, Array]:
    """Positions of a point at `ARM`, their covariances, and a perfect estimate of the body."""
    t = np.linspace(0.0, 60.0, count)
    body = np.tile(np.eye(4), (count, 1, 1))
    turn = [0.3 * np.sin(0.7 * t), 0.3 * np.cos(0.5 * t), 1.5 * np.sin(0.3 * t)]
    way = [10.0 * np.sin(0.3 * t), 8.0 * np.sin(0.47 * t + 1.0), 1.5 * np.sin(0.2 * t)]
    body[:, :3, :3] = se3.exp_so3(np.stack(turn, axis=1))
    body[:, :3, 3] = np.stack(way, axis=1) + origin
    root = std * rng.uniform(0.5, 1.5, (count, 1, 1)) * (np.eye(3) + 0.3 * np.tri(3, k=-1))
    positions = body[:, :3, 3] + body[:, :3, :3] @ ARM
    positions += (root @ rng.normal(size=(count, 3, 1)))[..., 0]
    world = {
        "none": np.eye(4),
        "yaw_translation": se3.exp(np.array([1.0, 2.0, -3.0, 0.0, 0.0, 2.0])),
    }.get(gauge, se3.exp(np.array([1.0, 2.0, -3.0, 0.3, 0.2, 2.0])))
    estimate = world @ body
    if gauge == "sim3":
        estimate[:, :3, 3] /= 2.0
    return positions, root @ np.swapaxes(root, 1, 2), estimate


def derivatives(found: PositionError, estimate: Array, gauge: str) -> Array:
    """Of the residual by the gauge's freedoms and the lever arm, by differences; (M, 3, d + 3)."""
    kind, step = GAUGES[gauge], 1e-5
    columns = []
    for index in range(kind.dimension + 3):
        both = []
        for sign in (1.0, -1.0):
            delta = np.zeros(kind.dimension + 3)
            delta[index] = sign * step
            moved = kind.perturb(found.alignment, found.centre, delta[:-3])
            aligned = moved.apply(estimate)
            arm = found.lever_arm + delta[-3:]
            both.append(-aligned[:, :3, 3] - aligned[:, :3, :3] @ arm)
        columns.append((both[0] - both[1]) / (2.0 * step))
    return np.stack(columns, axis=-1)


def integral(
    residual: Array, covariance: Array, design: Array, arm: Array
) -> GaussianLogLikelihood:
    """Dense: of ``N(r; 0, V)`` over the columns' unknowns, the last three under l's prior."""
    size = len(residual)
    rows = np.zeros((3, design.shape[1]))
    rows[:, -3:] = np.eye(3)
    everything = np.zeros((size + 3, size + 3))
    everything[:size, :size] = covariance
    everything[size:, size:] = LEVER_ARM_STD**2 * np.eye(3)
    j, r = np.concatenate([design, rows]), np.concatenate([residual, arm])
    inverse = np.linalg.inv(everything)
    matrix = j.T @ inverse @ j
    best = np.linalg.solve(matrix, j.T @ inverse @ r)
    left = r - j @ best
    return GaussianLogLikelihood(
        float(left @ inverse @ left),
        float(np.linalg.slogdet(everything)[1] + np.linalg.slogdet(matrix)[1]),
        len(r) - design.shape[1],
    )


@pytest.mark.parametrize("gauge", GAUGES)
@pytest.mark.parametrize("count", [12, 60])
def test_both_likelihoods_are_those_of_dense_twins(gauge: str, count: int) -> None:
    positions, covariance, estimate = run(np.random.default_rng(count), gauge, count, origin=10.0)
    found = position_error(positions, covariance, estimate, GAUGES[gauge])
    assert found.absolute is not None
    assert found.relative is not None
    design = derivatives(found, estimate, gauge)
    residual = found.residual(positions, estimate)
    assert found.rmse == pytest.approx(np.sqrt((residual**2).sum(axis=1).mean()), rel=1e-9)
    steps = np.diff(residual, axis=0)
    assert found.step_rmse == pytest.approx(np.sqrt((steps**2).sum(axis=1).mean()), rel=1e-9)
    size, width = 3 * count, design.shape[-1]
    dense = np.zeros((size, size))
    for i, block in enumerate(covariance):
        dense[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    flat = design.reshape(size, width)
    twin = integral(residual.reshape(-1), dense, flat, found.lever_arm)
    assert found.absolute.log_likelihood == pytest.approx(twin.log_likelihood, rel=1e-7)
    assert found.absolute.dof == twin.dof
    # At the optimum, as far as the residuals allow.
    assert found.absolute.chi2 == pytest.approx(twin.chi2, rel=1e-7)

    differences = np.kron(np.diff(np.eye(count), axis=0), np.eye(3))
    free = [place for place, freedom in enumerate(GAUGES[gauge].free) if freedom >= 3]
    kept = [*free, *range(width - 3, width)]
    twin = integral(
        differences @ residual.reshape(-1),
        differences @ dense @ differences.T,
        (differences @ flat)[:, kept],
        found.lever_arm,
    )
    assert found.relative.log_likelihood == pytest.approx(twin.log_likelihood, rel=1e-7)
    assert found.relative.dof == twin.dof


@pytest.mark.parametrize("gauge", ["se3", "yaw_translation", "sim3"])
def test_displacements_say_what_positions_say(gauge: str) -> None:
    for count in (10, 100, 2000):
        data = run(np.random.default_rng(count), gauge, count)
        found = position_error(*data, GAUGES[gauge])
        assert found.absolute is not None
        assert found.relative is not None
        assert found.relative.dof == found.absolute.dof
        assert found.relative.log_likelihood == pytest.approx(
            found.absolute.log_likelihood, rel=1e-11
        )


@pytest.mark.parametrize("gauge", GAUGES)
def test_in_simulation_the_covariances_hold(gauge: str) -> None:
    rng = np.random.default_rng(7)
    ratios, scores = [], []
    for _ in range(60):
        found = position_error(*run(rng, gauge), GAUGES[gauge])
        assert found.absolute is not None
        ratios.append(found.absolute.chi2 / found.absolute.dof)
        scores.append((found.lever_arm - ARM) / found.lever_arm_std)
    assert 0.98 <= np.mean(ratios) <= 1.02
    assert np.abs(scores).max() < 5.0
    assert (np.abs(scores) < 2.5).mean() > 0.97
    # The larger of three estimates of the variance is too large by some chance.
    assert 0.75 <= np.std(scores) <= 1.15


def test_coordinates_of_a_country_lose_no_digit() -> None:
    near, far = (
        position_error(*run(np.random.default_rng(3), origin=origin), GAUGES["se3"])
        for origin in (0.0, 1e7)
    )
    assert near.absolute is not None
    assert far.absolute is not None
    assert far.absolute.chi2 == pytest.approx(near.absolute.chi2, rel=1e-5)
    assert far.lever_arm == pytest.approx(near.lever_arm, abs=1e-6)


def still(count: int = 50) -> Array:
    return np.tile(np.eye(4), (count, 1, 1))


def straight(count: int = 50) -> Array:
    poses = still(count)
    poses[:, 0, 3] = np.linspace(0.0, 20.0, count)
    return poses


@pytest.mark.parametrize("poses", [still(), straight(), straight(2)])
def test_an_alignment_that_the_motion_does_not_show_has_no_likelihood(poses: Array) -> None:
    noise = 1e-3 * np.random.default_rng(0).normal(size=(len(poses), 3))
    covariance = np.tile(1e-6 * np.eye(3), (len(poses), 1, 1))
    found = position_error(poses[:, :3, 3] + noise, covariance, poses, GAUGES["se3"])
    assert found.absolute is None
    assert found.relative is None
    assert found.rmse < 1e-2
    assert found.lever_arm_std.max() > 1.0


@pytest.mark.parametrize("gauge", ["se3", "yaw_translation", "sim3"])
def test_on_the_spot_the_noise_of_the_estimate_shows_no_lever_arm(gauge: str) -> None:
    rng = np.random.default_rng(0)
    count, std = 600, 1e-3
    poses = still(count)
    turn = np.zeros((count, 3))
    turn[:, 2] = np.linspace(0.0, 30.0, count)
    poses[:, :3, :3] = se3.exp_so3(turn)
    antenna = poses[:, :3, :3] @ np.array([0.3, 0.0, 0.0]) + rng.normal(0.0, std, (count, 3))
    poses[:, :3, 3] += rng.normal(0.0, std, (count, 3))
    covariance = np.tile(std**2 * np.eye(3), (count, 1, 1))
    assert not position_error(antenna, covariance, poses, GAUGES[gauge]).shows_lever_arm
    poses[:, :2, 3] += rng.normal(0.0, 0.1, (count, 2))
    antenna[:, :2] += poses[:, :2, 3]
    assert position_error(antenna, covariance, poses, GAUGES[gauge]).shows_lever_arm


def test_on_a_straight_line_without_a_free_rotation_there_is_one() -> None:
    poses = straight()
    covariance = np.tile(1e-6 * np.eye(3), (len(poses), 1, 1))
    noise = 1e-3 * np.random.default_rng(0).normal(size=(len(poses), 3))
    found = position_error(poses[:, :3, 3] + noise, covariance, poses, GAUGES["none"])
    assert found.absolute is not None
    assert found.absolute.chi2 / found.absolute.dof == pytest.approx(1.0, abs=0.3)


def test_what_is_no_data_is_refused() -> None:
    positions, covariance, estimate = run(np.random.default_rng(0), count=10)
    with pytest.raises(ValueError, match="not two poses"):
        position_error(positions[:1], covariance[:1], estimate[:1], GAUGES["se3"])
    wrong = covariance.copy()
    wrong[4] = 0.0
    with pytest.raises(CovarianceError) as raised:
        position_error(positions, wrong, estimate, GAUGES["se3"])
    assert raised.value.index == 4
    lost = positions.copy()
    lost[3, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        position_error(lost, covariance, estimate, GAUGES["se3"])


@pytest.mark.parametrize("count", [10, 23, 29])
def test_of_few_poses_that_drift_no_lever_arm_is_beyond_doubt(count: int) -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        positions, covariance, estimate = run(rng, count=count)
        drift = np.cumsum(rng.normal(0.0, 0.2, (count, 3)), axis=0)
        found = position_error(positions + drift, covariance, estimate, GAUGES["se3"])
        assert (np.abs(found.lever_arm - ARM) < 4.5 * found.lever_arm_std).all()


def assert_same(one: PositionError, other: PositionError) -> None:
    for mine, others in ((one.absolute, other.absolute), (one.relative, other.relative)):
        assert mine is not None
        assert others is not None
        assert mine.dof == others.dof
        assert mine.log_likelihood == pytest.approx(others.log_likelihood, rel=1e-9)
        assert mine.chi2 == pytest.approx(others.chi2, rel=1e-9)
    assert one.lever_arm == pytest.approx(other.lever_arm, rel=1e-9)
    assert one.lever_arm_std == pytest.approx(other.lever_arm_std, rel=1e-7)
    assert one.alignment.pose == pytest.approx(other.alignment.pose, rel=1e-9, abs=1e-9)
    assert (one.rmse, one.step_rmse) == pytest.approx((other.rmse, other.step_rmse), rel=1e-9)
    assert one.shows_lever_arm == other.shows_lever_arm


@pytest.mark.parametrize("gauge", GAUGES)
@pytest.mark.parametrize("drift", [0.0, 0.05])
def test_it_does_not_matter_how_the_poses_are_cut(gauge: str, drift: float) -> None:
    """Nor how often one asks on the way."""
    rng = np.random.default_rng(3)
    positions, covariance, estimate = run(rng, gauge, 700, origin=50.0)
    positions += np.cumsum(rng.normal(0.0, drift, positions.shape), axis=0)
    # A gap: known to a metre, between poses known to centimetres.
    covariance[300:310] += np.eye(3)
    whole = position_error(positions, covariance, estimate, GAUGES[gauge])
    running, begin = RunningPositions(GAUGES[gauge]), 0
    while begin < len(positions):
        here = slice(begin, begin + int(rng.integers(1, 40)))
        running.update(positions[here], covariance[here], estimate[here])
        running.error()
        begin = here.stop
    found = running.error()
    assert found is not None
    assert_same(found, whole)
    assert running.count == len(positions)


def test_its_memory_does_not_grow() -> None:
    positions, covariance, estimate = run(np.random.default_rng(3), count=500)
    running, sizes = RunningPositions(GAUGES["se3"]), []
    for _ in range(40):
        running.update(positions, covariance, estimate)
        assert running.error() is not None
        sizes.append(len(pickle.dumps(running)))
    assert running.count == 20_000
    assert max(sizes) < 1.2e6


def test_a_covariance_that_is_none_costs_no_other_pose() -> None:
    positions, covariance, estimate = run(np.random.default_rng(0), count=40)
    running = RunningPositions(GAUGES["se3"])
    running.update(positions[:20], covariance[:20], estimate[:20])
    wrong = covariance[20:].copy()
    wrong[3] = -np.eye(3)
    with pytest.raises(CovarianceError) as raised:
        running.update(positions[20:], wrong, estimate[20:])
    assert raised.value.index == 3
    running.update(positions[20:], covariance[20:], estimate[20:])
    found = running.error()
    assert found is not None
    assert_same(found, position_error(positions, covariance, estimate, GAUGES["se3"]))
