# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model against positions: against a dense twin, and in simulation."""

from contextlib import nullcontext
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros import loops, se3
from trajeval_ros.alignment.gauge import GAUGES
from trajeval_ros.error_model.nuisances import Truth
from trajeval_ros.error_model.positions import _Data, fit_positions
from trajeval_ros.error_model.process import Kind
from trajeval_ros.likelihood.gaussian import CovarianceError

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

ARM, CLOCK, STD = np.array([0.3, -0.1, 0.8]), 0.03, 0.005
JITTER, SIZE, TIME = 0.02, 0.05, 5.0


def body(t: Array) -> Array:
    """A robot's poses."""
    poses = np.tile(np.eye(4), (len(t), 1, 1))
    turn = [0.3 * np.sin(0.7 * t), 0.3 * np.cos(0.5 * t), 1.5 * np.sin(0.3 * t)]
    way = [10.0 * np.sin(0.3 * t), 8.0 * np.sin(0.47 * t + 1.0), 1.5 * np.sin(0.2 * t)]
    poses[:, :3, :3] = se3.exp_so3(np.stack(turn, axis=1))
    poses[:, :3, 3] = np.stack(way, axis=1)
    return poses


class Antenna:
    """A point at `ARM`, known to `STD`, far from the origin."""

    def __init__(self, rng: np.random.Generator, count: int) -> None:
        self.noise = STD * rng.normal(size=(count, 3))

    def __call__(self, stamps: Stamps) -> Truth:
        t, count = 1e-9 * stamps, len(stamps)
        poses, twists = np.tile(np.eye(4), (count, 1, 1)), np.zeros((count, 6))
        poses[:, :3, 3] = self._at(t) + self.noise + 1e7
        twists[:, :3] = (self._at(t + 1e-4) - self._at(t - 1e-4)) / 2e-4
        covariances = np.tile(STD**2 * np.eye(6), (count, 1, 1))
        return Truth(poses, covariances, twists, np.ones(count, dtype=bool))

    @staticmethod
    def _at(t: Array) -> Array:
        poses = body(t)
        return np.asarray(poses[:, :3, 3] + poses[:, :3, :3] @ ARM)


def run(rng: np.random.Generator, kind: Kind, count: int = 400) -> tuple[Stamps, Array, Antenna]:
    """Stamps, an estimate with errors of a kind, and the ground truth."""
    step = 0.1
    t = step * np.arange(count)
    keep = np.exp(-step / TIME) if kind is Kind.WANDER else 1.0
    grows = SIZE * np.sqrt(1.0 - keep**2) if kind is Kind.WANDER else SIZE * np.sqrt(step)
    error = np.zeros((count, 3))
    error[0] = SIZE * rng.normal(size=3)
    for i in range(1, count):
        error[i] = keep * error[i - 1] + grows * rng.normal(size=3)
    estimate = body(t + CLOCK)
    estimate[:, :3, 3] += error + JITTER * rng.normal(size=(count, 3))
    estimate = se3.exp(np.array([1.0, 2.0, -3.0, 0.0, 0.0, 2.0])) @ estimate
    return np.round(1e9 * t).astype(np.int64), estimate, Antenna(rng, count)


@pytest.mark.parametrize(("kind", "gauge"), [(Kind.DRIFT, "se3"), (Kind.WANDER, "yaw_translation")])
def test_in_simulation_what_was_put_in_comes_out(kind: Kind, gauge: str) -> None:
    rng = np.random.default_rng(11)
    scores, jitters, sizes, others = [], [], [], 0
    for _ in range(6):
        found = fit_positions(*run(rng, kind), GAUGES[gauge])
        assert found is not None
        if found.kind is not kind:
            # One in twenty walks comes back by chance.
            others += 1
            continue
        assert found.likelihood.chi2 / found.likelihood.dof == pytest.approx(1.0, abs=0.02)
        wrong = [*(found.lever_arm - ARM), found.clock_offset - CLOCK]
        scores.append(wrong / np.sqrt(np.diagonal(found.covariance)))
        (value, std) = found.parameters["jitter_std"]
        assert std is not None
        jitters.append((value - JITTER) / std)
        (value, std) = found.parameters[f"{kind}_std"]
        assert std is not None
        sizes.append((value - SIZE) / std)
    assert others <= 1
    assert np.abs(scores).max() < 4.0
    assert 0.5 < np.std(scores) < 1.5
    assert np.abs(jitters).max() < 4.0
    assert np.abs(sizes).max() < 4.0


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@pytest.mark.parametrize("kind", [Kind.DRIFT, Kind.WANDER])
@settings(max_examples=30, deadline=None)
@given(count=st.integers(2, 60), unknowns=st.integers(4, 31), seed=st.integers(0, 999))
def test_whitened_columns_are_the_same_by_a_filter(
    kind: Kind, count: int, unknowns: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(count, 3, 3))
    data = _Data(
        rng.normal(size=(count, 3, unknowns + 1)),
        roots @ np.swapaxes(roots, 1, 2),
        rng.uniform(1e-3, 2.0, count - 1),
        np.zeros((4, unknowns + 1)),
        0.0,
    )
    data.columns[..., :3] = -np.eye(3)
    logs = rng.uniform(-2.0, 1.0, len(kind.names))
    white, log_det = data.whitened(kind, logs)
    with loops.left_out():
        expected, expected_log_det = data.whitened(kind, logs)
    np.testing.assert_allclose(white, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert log_det == pytest.approx(expected_log_det, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("kind", [Kind.DRIFT, Kind.WANDER])
@pytest.mark.parametrize("without", [nullcontext, loops.left_out])
def test_a_covariance_that_is_none_is_named(kind: Kind, without: Any) -> None:
    covariance = np.tile(np.eye(3), (9, 1, 1))
    covariance[4] = -50.0 * np.eye(3)
    data = _Data(np.ones((9, 3, 8)), covariance, np.ones(8), np.zeros((4, 8)), 0.0)
    with without(), pytest.raises(CovarianceError):
        data.whitened(kind, np.zeros(len(kind.names)))


@pytest.mark.parametrize("kind", [Kind.DRIFT, Kind.WANDER])
def test_the_likelihood_is_that_of_a_dense_twin(kind: Kind) -> None:
    rng = np.random.default_rng(5)
    count, size = 15, 45
    roots = rng.normal(size=(count, 3, 3))
    covariance = roots @ np.swapaxes(roots, 1, 2) + 0.1 * np.eye(3)
    columns = rng.normal(size=(count, 3, 9))
    columns[..., :3] = -np.eye(3)
    prior = np.zeros((4, 9))
    prior[:, 4:8] = np.eye(4)
    prior[:, 8] = rng.normal(size=4)
    gaps = rng.uniform(0.1, 2.0, count - 1)
    data = _Data(columns, covariance, gaps, prior, 0.0)
    logs = np.log([0.3, 0.7, 1.5])[: len(kind.names)]

    times = np.concatenate([[0.0], np.cumsum(gaps)])
    apart = np.abs(times[:, None] - times)
    # Of a walk from the first pose on; its first value is the world's translation.
    process = 0.49 * np.minimum(times[:, None], times)
    if kind is Kind.WANDER:
        process = 0.49 * np.exp(-apart / 1.5)
    dense = np.kron(process, np.eye(3)) + 0.09 * np.eye(size)
    for i in range(count):
        dense[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += covariance[i]
    everything = np.block([[dense, np.zeros((size, 4))], [np.zeros((4, size)), np.eye(4)]])
    rows = np.concatenate([columns.reshape(size, 9), prior])
    design, residual = rows[:, :-1], rows[:, -1]
    inverse = np.linalg.inv(everything)
    matrix = design.T @ inverse @ design
    left = residual - design @ np.linalg.solve(matrix, design.T @ inverse @ residual)
    twin = -0.5 * (
        left @ inverse @ left
        + np.linalg.slogdet(everything)[1]
        + np.linalg.slogdet(matrix)[1]
        + (size + 4 - 8) * np.log(2.0 * np.pi)
    )
    assert data.likelihood(kind, logs) == pytest.approx(twin, rel=1e-11)


def test_too_few_poses_have_no_model() -> None:
    rng = np.random.default_rng(1)
    assert fit_positions(*run(rng, Kind.DRIFT, 20), GAUGES["se3"]) is None
