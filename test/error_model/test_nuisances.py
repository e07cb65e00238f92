# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a fit takes of its poses: C says what NumPy says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops, se3
from trajeval_ros.error_model.nuisances import COUNT, OBSERVED_STD, Nuisances, Truth, prepare
from trajeval_ros.error_model.observed import _varied, shown

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")


@st.composite
def fitted(draw):
    """An estimate near a ground truth, or turned far from it, that moves or stands."""
    count = draw(st.integers(1, 60))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    stamps = 10**18 + np.cumsum(rng.integers(10**7, 10**8, count))
    motion = draw(st.sampled_from([0.0, 0.02, 0.5])) * rng.normal(size=(count, 6))
    poses = se3.exp(np.cumsum(motion, axis=0)) @ se3.exp(rng.normal(size=6))
    poses[:, :3, 3] += draw(st.sampled_from([0.0, 1e4]))
    apart = draw(st.sampled_from([0.0, 1e-4, 0.3, 2.0])) * rng.normal(size=(count, 6))
    root = rng.normal(size=(count, 6, 6)) * 10.0 ** draw(st.integers(-4, 0))
    twists = rng.normal(size=(count, 6))
    truth = Truth(poses, root @ root.swapaxes(1, 2), twists, np.ones(count, np.bool_))
    moved = Nuisances.none().moved(draw(st.sampled_from([0.0, 0.3])) * rng.normal(size=9))
    estimate = se3.exp(rng.normal(size=6)) @ poses @ se3.exp(apart)
    return stamps, estimate, truth, moved


def assert_close(found, expected):
    np.testing.assert_allclose(
        found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max(initial=0.0)
    )


@given(fitted())
def test_both_prepare_the_same(given):
    (data, gauge), (stamps, *_) = prepare(*given), given
    with loops.left_out():
        expected, expected_gauge = prepare(*given)
    np.testing.assert_allclose(gauge, expected_gauge, rtol=1e-9, atol=1e-9)
    # Positions, of up to 10 km, are sums of steps, and of what headings move.
    size = max(np.abs(expected.nuisances).max(), 1.0)
    np.testing.assert_allclose(
        data.errors, expected.errors, rtol=1e-9, atol=1e-11 * size * len(stamps)
    )
    for name in ("covariance", "nuisances", "precision", "times", "measured", "moved"):
        assert_close(getattr(data, name), getattr(expected, name))
    np.testing.assert_allclose(data.travel, expected.travel, rtol=1e-9, atol=1e-11 * size)
    jitter = np.array([1e-4, 1e-6])
    squares, errors = _varied(jitter, data, gauge)
    with loops.left_out():
        expected_squares, expected_errors = _varied(jitter, data, gauge)
    assert squares.shape == (6 + COUNT, 6 + COUNT)
    scale = np.sqrt(np.diag(expected_squares) + 1e-300)
    assert_close(squares / scale / scale[:, None], expected_squares / scale / scale[:, None])
    assert_close(errors, expected_errors)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("motion", ["none", "straight", "any"])
def test_both_show_the_same(seed, motion):
    rng = np.random.default_rng(seed)
    steps = 0.1 * rng.normal(size=(80, 6))
    if motion != "any":
        steps[:] = [0.1 if motion == "straight" else 0.0, *[0.0] * 5]
    poses = se3.exp(np.cumsum(steps, axis=0))
    root = 1e-3 * rng.normal(size=(80, 6, 6))
    stamps = np.arange(80) * 10**8
    truth = Truth(poses, root @ root.swapaxes(1, 2), 10.0 * steps, np.ones(80, np.bool_))
    data, gauge = prepare(stamps, poses, truth, Nuisances.none())
    # As found, with the alignment's after the nuisances; of some directions less is told.
    size = COUNT + 6 * (seed % 2)
    axes, _ = np.linalg.qr(rng.normal(size=(size, size)))
    std = np.concatenate([OBSERVED_STD, np.ones(size - COUNT)])
    covariance = std[:, None] * (axes * 10.0 ** rng.uniform(-3.0, 1.0, size)) @ axes.T * std
    theta = std * rng.normal(size=size)
    given = theta, covariance, np.array([1e-4, 1e-6]), data, gauge
    found, known = shown(*given)
    with loops.left_out():
        expected, expected_known = shown(*given)
    np.testing.assert_allclose(found / OBSERVED_STD, expected / OBSERVED_STD, atol=1e-7)
    units = OBSERVED_STD * OBSERVED_STD[:, None]
    np.testing.assert_allclose(known / units, expected_known / units, rtol=1e-7, atol=1e-7)
    if motion != "any":  # what the motion does not show has a large variance
        assert np.linalg.eigvalsh(known / units)[-1] > 99.0
