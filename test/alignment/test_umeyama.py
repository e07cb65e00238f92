# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Umeyama's alignment against evo's, a numerical minimiser and its own definition."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import (
    GAUGES,
    Degeneracy,
    Moments,
    align,
    align_positions,
)

SEEDS = st.integers(0, 2**32 - 1)
LOG_SCALES = st.floats(-6.0, 4.0)


def random_pair(seed, count, log_extent=0.0, log_offset=0.0, log_noise=-2.0):
    """Positions and their noisy image under a random similarity, both (count, 3)."""
    rng = np.random.default_rng(seed)
    extent = 10.0**log_extent
    source = rng.normal(size=(count, 3)) * extent * rng.uniform(0.1, 1.0, size=3)
    source += rng.normal(size=3) * 10.0**log_offset
    rotation = se3.exp_so3(rng.normal(size=3))
    target = 1.3 * source @ rotation.T + rng.normal(size=3) * 10.0**log_offset
    return source, target + rng.normal(size=(count, 3)) * extent * 10.0**log_noise


def direct_rmse(alignment, source, target):
    residuals = target - alignment.transform_positions(source)
    return np.sqrt(np.mean(np.sum(residuals**2, axis=1)))


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(4, 200), LOG_SCALES, LOG_SCALES, st.floats(-9.0, 0.0), st.booleans())
def test_equals_evo(seed, count, log_extent, log_offset, log_noise, with_scale):
    geometry = pytest.importorskip("evo.core.geometry", reason="evo is not installed")
    # Evo's own threshold on the rank is absolute, 2e-16 m^2, and its sums are of squares.
    log_extent = max(log_extent, -3.0)
    log_offset = min(log_offset, log_extent + 2.0)
    source, target = random_pair(seed, count, log_extent, log_offset, log_noise)
    rotation, translation, scale = geometry.umeyama_alignment(source.T, target.T, with_scale)
    ours = align_positions(source, target, "sim3" if with_scale else "se3")
    np.testing.assert_allclose(ours.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(ours.scale, scale, rtol=1e-9)
    size = np.abs(source).max() + np.abs(target).max()
    np.testing.assert_allclose(ours.translation, translation, atol=1e-9 * size)
    assert ours.degeneracy is Degeneracy.NONE
    assert len(ours.unobserved_axes) == 0


@settings(max_examples=60, deadline=None)
@given(
    SEEDS,
    st.integers(1, 60),
    LOG_SCALES,
    LOG_SCALES,
    st.floats(-14.0, 0.0),
    st.sampled_from(GAUGES),
)
def test_rmse_is_the_residuals(seed, count, log_extent, log_offset, log_noise, gauge):
    source, target = random_pair(seed, count, log_extent, log_offset, log_noise)
    alignment = align_positions(source, target, gauge)
    size = np.abs(source).max() + np.abs(target).max()
    np.testing.assert_allclose(
        alignment.rmse, direct_rmse(alignment, source, target), rtol=1e-9, atol=1e-14 * size
    )


def test_rmse_of_a_perfect_estimate_is_round_off():
    source, _ = random_pair(1, 5000, log_extent=3.0)
    target = source @ se3.exp_so3(np.array([1.0, -2.0, 0.5])).T + 7.0
    # The difference of sums of squares would leave sqrt(2e-16) * 1000 m, some 1e-5 m.
    assert align_positions(source, target, "se3").rmse < 1e-11


@pytest.mark.parametrize("gauge", ["se3", "sim3", "yaw_translation"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_is_the_minimum(gauge, seed):
    source, target = random_pair(seed, 20, log_noise=-0.5)
    alignment = align_positions(source, target, gauge)

    def cost(x):
        turn = np.array([0.0, 0.0, x[2]]) if gauge == "yaw_translation" else x[:3]
        scale = alignment.scale * (np.exp(x[6]) if gauge == "sim3" else 1.0)
        moved = scale * source @ (se3.exp_so3(turn) @ alignment.rotation).T
        return np.mean(np.sum((target - moved - alignment.translation - x[3:6]) ** 2, axis=1))

    best = minimize(cost, np.full(7, 0.01), method="BFGS", options={"gtol": 1e-9})
    assert alignment.rmse**2 <= best.fun * (1 + 1e-12)
    np.testing.assert_allclose(alignment.rmse**2, best.fun, rtol=1e-6)


def test_yaw_leaves_z_alone_and_finds_the_angle():
    source, _ = random_pair(3, 30)
    target = source @ se3.exp_so3(np.array([0.0, 0.0, 2.5])).T + [1.0, 2.0, 3.0]
    alignment = align_positions(source, target, "yaw_translation")
    np.testing.assert_allclose(
        alignment.rotation, se3.exp_so3(np.array([0.0, 0.0, 2.5])), atol=1e-14
    )
    np.testing.assert_allclose(alignment.translation, [1.0, 2.0, 3.0], atol=1e-13)
    np.testing.assert_array_equal(alignment.rotation[2], [0.0, 0.0, 1.0])


def test_none_is_the_identity_with_the_offset_in_the_rmse():
    source, _ = random_pair(3, 30)
    alignment = align_positions(source, source + np.array([3.0, 0.0, 4.0]), "none")
    np.testing.assert_array_equal(alignment.rotation, np.eye(3))
    np.testing.assert_array_equal(alignment.translation, np.zeros(3))
    assert alignment.rmse == pytest.approx(5.0, rel=1e-14)
    assert alignment.degeneracy is Degeneracy.NONE


def test_reflection_is_not_a_rotation():
    source, _ = random_pair(5, 50)
    alignment = align_positions(source, source * [1.0, 1.0, -1.0], "se3")
    assert np.linalg.det(alignment.rotation) == pytest.approx(1.0)


@settings(max_examples=60, deadline=None)
@given(
    SEEDS,
    st.lists(st.integers(0, 12), min_size=1, max_size=12),
    LOG_SCALES,
    LOG_SCALES,
)
def test_moments_do_not_depend_on_the_cuts(seed, sizes, log_extent, log_offset):
    source, target = random_pair(seed, sum(sizes), log_extent, log_offset)
    whole = Moments.of(source, target)
    left = Moments.empty()
    right = Moments.empty()
    start = 0
    for size in sizes:
        left = left.updated(source[start : start + size], target[start : start + size])
        start += size
    for i in reversed(range(len(source))):
        right = Moments.of(source[i : i + 1], target[i : i + 1]).merged(right)
    for moments in (left, right):
        assert moments.count == whole.count == sum(sizes)
        size = 1e-300 + np.abs(source).max(initial=0.0) + np.abs(target).max(initial=0.0)
        np.testing.assert_allclose(moments.mean_source, whole.mean_source, atol=1e-14 * size)
        np.testing.assert_allclose(moments.mean_target, whole.mean_target, atol=1e-14 * size)
        np.testing.assert_allclose(
            moments.factor.T @ moments.factor,
            whole.factor.T @ whole.factor,
            atol=1e-13 * np.linalg.norm(whole.factor) * (np.linalg.norm(whole.factor) + size)
            + 1e-26 * size**2,
        )


def test_moments_are_the_sums():
    source, target = random_pair(11, 40)
    moments = Moments.of(source, target)
    c = (target - target.mean(axis=0)).T @ (source - source.mean(axis=0)) / 40
    np.testing.assert_allclose(moments.cross_covariance, c, atol=1e-14)
    np.testing.assert_allclose(
        moments.source_extent**2,
        np.sort(np.linalg.eigvalsh(np.cov(source.T, bias=True)))[::-1],
        rtol=1e-10,
    )
    assert moments.factor.shape == (6, 6)


@pytest.mark.parametrize(
    ("source", "target"),
    [
        (np.zeros((3, 3)), np.zeros((2, 3))),
        (np.zeros((3, 2)), np.zeros((3, 2))),
        (np.zeros(3), np.zeros(3)),
        (np.full((2, 3), np.nan), np.zeros((2, 3))),
        (np.zeros((2, 3)), np.full((2, 3), np.inf)),
    ],
)
def test_moments_refuse(source, target):
    with pytest.raises(ValueError, match="must"):
        Moments.of(source, target)


def test_no_points_and_unknown_gauges_are_refused():
    with pytest.raises(ValueError, match="no points"):
        align(Moments.empty(), "se3")
    with pytest.raises(ValueError, match="unknown gauge 'se2'"):
        align_positions(np.zeros((4, 3)), np.zeros((4, 3)), "se2")


@pytest.mark.parametrize("gauge", ["se3", "sim3"])
@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_line(gauge, offset):
    rng = np.random.default_rng(0)
    along = np.array([0.6, 0.0, 0.8])
    source = rng.normal(size=(50, 1)) * along + offset
    turn = se3.exp_so3(np.array([0.3, -0.4, 1.2]))
    target = source @ turn.T
    alignment = align_positions(source, target, gauge)
    assert alignment.degeneracy is Degeneracy.COLLINEAR
    assert alignment.unobserved_axes.shape == (1, 3)
    assert abs(alignment.unobserved_axes[0] @ turn @ along) == pytest.approx(1.0, abs=1e-8)
    assert alignment.rmse < 1e-15 + 1e-15 * offset * 10
    np.testing.assert_allclose(alignment.rotation @ along, turn @ along, atol=1e-7)
    # Of the free ones, that of the smallest angle.
    axis = alignment.unobserved_axes[0]
    angle = np.linalg.norm(se3.log_so3(alignment.rotation))
    for a in np.linspace(-3, 3, 41):
        other = se3.exp_so3(a * axis) @ alignment.rotation
        assert angle <= np.linalg.norm(se3.log_so3(other)) + 1e-9


def test_a_line_is_enough_for_yaw_unless_it_is_vertical():
    line = np.linspace(0.0, 5.0, 30)[:, np.newaxis] * [1.0, 2.0, 3.0]
    turn = se3.exp_so3(np.array([0.0, 0.0, -1.0]))
    alignment = align_positions(line, line @ turn.T, "yaw_translation")
    assert alignment.degeneracy is Degeneracy.NONE
    np.testing.assert_allclose(alignment.rotation, turn, atol=1e-13)
    mast = line * [0.0, 0.0, 1.0]
    alignment = align_positions(mast, mast, "yaw_translation")
    assert alignment.degeneracy is Degeneracy.VERTICAL
    np.testing.assert_array_equal(alignment.unobserved_axes, [[0.0, 0.0, 1.0]])


@pytest.mark.parametrize("gauge", ["se3", "sim3", "yaw_translation"])
def test_standing_still(gauge):
    source = np.tile([4.1e5, 5.2e6, 0.1], (100, 1))
    moving, _ = random_pair(0, 100)
    for alignment in (
        align_positions(source, source, gauge),
        align_positions(source, moving, gauge),
        align_positions(moving, source, gauge),
    ):
        assert alignment.degeneracy is Degeneracy.COINCIDENT
        assert alignment.scale_observed == (gauge != "sim3")
        assert alignment.scale == 1.0
        assert len(alignment.unobserved_axes) == (1 if gauge == "yaw_translation" else 3)
    np.testing.assert_allclose(
        align_positions(moving, source, gauge).rmse,
        np.sqrt(np.sum(np.var(moving, axis=0))),
        rtol=1e-9,
    )


def test_positions_whose_squares_are_nothing_have_no_scale():
    source, target = random_pair(0, 100)
    alignment = align_positions(1e-170 * source, target, "sim3")
    assert not alignment.scale_observed
    assert alignment.scale == 1.0


@pytest.mark.parametrize(
    ("gauge", "count", "expected"),
    [
        ("none", 1, Degeneracy.NONE),
        ("se3", 1, Degeneracy.TOO_FEW_POINTS),
        ("se3", 2, Degeneracy.TOO_FEW_POINTS),
        ("se3", 3, Degeneracy.NONE),
        ("sim3", 2, Degeneracy.TOO_FEW_POINTS),
        ("yaw_translation", 1, Degeneracy.TOO_FEW_POINTS),
        ("yaw_translation", 2, Degeneracy.NONE),
    ],
)
def test_few_points(gauge, count, expected):
    source, target = random_pair(0, count)
    assert align_positions(source, target, gauge).degeneracy is expected


def test_an_octahedron_inside_out_is_ambiguous():
    octahedron = np.concatenate((np.eye(3), -np.eye(3)))
    alignment = align_positions(octahedron, -octahedron, "se3")
    # As a set it is the same; point by point it is inverted, and every axis is as good.
    assert alignment.degeneracy is Degeneracy.AMBIGUOUS
    assert len(alignment.unobserved_axes) >= 1
