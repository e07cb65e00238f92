# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories and covariances for the tests of the likelihoods."""

import pathlib

import numpy as np
import pytest
from hypothesis import strategies as st

from trajeval_ros import se3

DATA = pathlib.Path(__file__).parents[2] / ".." / "shared" / "data"
METRIC_PAIRS = (
    ("tum_fr1_xyz", "rgbdslam"),
    ("tum_fr2_desk", "orb"),
    ("euroc_mh04", "pl_vio"),
    ("euroc_mh04", "vins_mono"),
    ("euroc_v102", "estimate"),
    ("kitti_00", "orb"),
    ("kitti_00", "sptam"),
)
MONOCULAR_PAIRS = (("tum_fr1_xyz", "orb_kf_mono"), ("tum_fr2_desk", "orb_kf_mono"))


def walk(rng, count, step=0.2, turn=0.2):
    """Poses (count, 4, 4) along a random walk, from a random pose on."""
    steps = se3.exp(rng.normal(size=(count, 6)) * ([step] * 3 + [turn] * 3))
    steps[0] = se3.exp(rng.normal(size=6))
    return np.array(list(_accumulate(steps)))


def _accumulate(steps):
    pose = np.eye(4)
    for step in steps:
        pose = pose @ step
        yield pose


def random_covariance(rng, count, std=(0.01, 0.01), spread=0.0):
    """Positive definite (count, 6, 6), not diagonal; each scaled by up to ``10^(+-spread)``."""
    factor = rng.normal(size=(count, 6, 6)) * 0.3 + np.eye(6)
    factor = factor * np.repeat(std, 3)[:, None]
    scale = 10.0 ** rng.uniform(-spread, spread, size=(count, 1, 1))
    return scale * (factor @ factor.swapaxes(-1, -2))


def band_covariance(rng, count, bandwidth, std=(0.01, 0.01)):
    """Block rows (count, bandwidth + 1, 6, 6) of a positive definite V = L L^T, L banded."""
    lower = np.zeros((6 * count, 6 * count))
    for i in range(count):
        for j in range(max(0, i - bandwidth), i + 1):
            block = rng.normal(size=(6, 6)) * 0.2 + np.eye(6) * (1.0 if i == j else 0.5)
            lower[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] = block
        diagonal = lower[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        diagonal[:] = np.tril(diagonal, -1) + np.diag(0.5 + np.abs(np.diagonal(diagonal)))
    scale = np.tile(np.repeat(std, 3), count)
    v = scale[:, None] * (lower @ lower.T) * scale
    rows = np.zeros((count, bandwidth + 1, 6, 6))
    for i in range(count):
        for k in range(min(i, bandwidth) + 1):
            j = i - k
            rows[i, k] = v[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
    return rows


def draw(rng, ground_truth, covariance, factor=1.0):
    """An estimate whose errors are drawn from independent covariances, in a world of its own."""
    lower = np.linalg.cholesky(covariance)
    xi = factor * (lower @ rng.normal(size=(len(ground_truth), 6, 1)))[..., 0]
    return se3.inverse(se3.exp(rng.normal(size=6))) @ ground_truth @ se3.exp(xi)


@st.composite
def problems(draw_value, most=200, bandwidth=0):
    """Ground truth, covariance and estimate, of 2 to ``most`` poses.

    Covariances over eight orders of magnitude; errors from none to a hundred standard deviations.
    """
    rng = np.random.default_rng(draw_value(st.integers(0, 2**32 - 1)))
    count = draw_value(st.integers(2, most))
    std = 10.0 ** np.array([draw_value(st.floats(-4, 0)), draw_value(st.floats(-4, -1))])
    step = draw_value(st.sampled_from([0.0, 1e-3, 0.1, 2.0]))
    turn = draw_value(st.sampled_from([0.0, 0.01, 0.3, 2.0]))
    truth = walk(rng, count, step, turn)
    if bandwidth:
        covariance = band_covariance(rng, count, bandwidth, std)
        single = covariance[:, 0]
    else:
        spread = draw_value(st.sampled_from([0.0, 1.0, 2.0]))
        covariance = single = random_covariance(rng, count, std, spread)
    # Rotations stay within what a logarithm can tell.
    factor = draw_value(st.sampled_from([0.0, 1.0, min(100.0, 0.3 / std[1])]))
    return truth, covariance, draw(rng, truth, single, factor)


def real_pair(dataset, estimate, translation_std=1e-3, rotation_std=2e-3):
    """Ground truth interpolated at the estimate's stamps, a fixed covariance, and the estimate.

    A crude model, for real motions and real errors; gaps over half a second are left out.
    """
    folder = DATA / dataset
    if not (folder / f"{estimate}.txt").exists():
        pytest.skip(f"no {dataset}/{estimate} beside the repository (shared/data)")
    reference = np.loadtxt(folder / "groundtruth.txt")
    rows = np.loadtxt(folder / f"{estimate}.txt")
    poses = se3.from_position_quaternion(reference[:, 1:4], reference[:, 4:8])
    before = np.searchsorted(reference[:, 0], rows[:, 0], side="right") - 1
    inside = (before >= 0) & (before < len(reference) - 1)
    before, rows = before[inside], rows[inside]
    gap = reference[before + 1, 0] - reference[before, 0]
    before, rows, gap = before[gap < 0.5], rows[gap < 0.5], gap[gap < 0.5]
    weight = (rows[:, 0] - reference[before, 0]) / gap
    truth = se3.interpolate(poses[before], poses[before + 1], weight)
    variance = np.diag(np.repeat([translation_std, rotation_std], 3) ** 2)
    covariance = np.broadcast_to(variance, (len(truth), 6, 6)).copy()
    return truth, covariance, se3.from_position_quaternion(rows[:, 1:4], rows[:, 4:8])
