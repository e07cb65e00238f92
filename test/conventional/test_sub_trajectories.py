# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors over sub-trajectories against their definitions, read as loops, and evo's."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import sub_trajectory_twin as twin

from trajeval_ros import se3
from trajeval_ros.conventional.sub_trajectories import (
    BOX_QUANTILES,
    all_pairs,
    boxes,
    growth,
    is_noise,
    kitti_drift,
    nearest_ahead,
    path_along,
)

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def drive(metres, seed=0, step=1.0, noise=0.02, count=None):
    """Poses (M, 4, 4) of a car, and an estimate that drifts from pose to pose; stamps at 10 Hz."""
    rng = np.random.default_rng(seed)
    count = round(metres / step) + 1 if count is None else count
    steps = np.zeros((count, 6))
    steps[1:, 0] = step * rng.uniform(0.5, 1.5, count - 1)
    steps[1:, 5] = 0.05 * np.cumsum(rng.normal(size=count - 1)) / count**0.5
    wrong = steps + noise * rng.normal(size=steps.shape) * [1, 1, 1, 0.1, 0.1, 0.1]
    wrong[0] = [3.0, -2.0, 1.0, 0.1, 0.2, 0.3]
    stamps = np.arange(count, dtype=np.int64) * 100_000_000
    return stamps, chain(steps), chain(wrong)


def chain(steps):
    poses = [se3.exp(steps[0])]
    for each in se3.exp(steps[1:]):
        poses.append(poses[-1] @ each)
    return np.array(poses)


def covariance(count, std):
    return np.tile(np.diag([std**2] * 6), (count, 1, 1))


# -- KITTI ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("metres", "seed"), [(150.0, 1), (480.0, 2), (1300.0, 3)])
def test_the_benchmark_s_drift(metres, seed):
    _, truth, estimate = drive(metres, seed)
    rows = twin.kitti(truth, estimate)
    found = kitti_drift(truth, estimate)
    assert found.overall.subsequences == len(rows)
    assert found.overall.translation == pytest.approx(rows[:, 1].mean(), rel=1e-9)
    assert found.overall.rotation == pytest.approx(rows[:, 2].mean(), rel=1e-6)
    lengths = sorted(set(rows[:, 0]))
    assert [drift.length for drift in found.by_length] == lengths
    for drift in found.by_length:
        own = rows[rows[:, 0] == drift.length]
        assert drift.subsequences == len(own)
        assert drift.translation == pytest.approx(own[:, 1].mean(), rel=1e-9)
        assert drift.rotation == pytest.approx(own[:, 2].mean(), rel=1e-6)


def test_a_known_drift():
    # Ten centimetres too long and a milliradian turned each metre: no more, no less.
    count = 1200
    truth = chain(np.tile([1.0, 0, 0, 0, 0, 0], (count, 1)))
    long = kitti_drift(truth, chain(np.tile([1.1, 0, 0, 0, 0, 0], (count, 1)))).overall
    # A sub-trajectory of 100 m is of 101 steps: the first pose that is beyond.
    assert long.translation == pytest.approx(0.1, rel=0.011)
    assert long.rotation == 0.0
    turned = kitti_drift(truth, chain(np.tile([1.0, 0, 0, 0, 0, 1e-3], (count, 1)))).overall
    assert turned.rotation == pytest.approx(1e-3, rel=0.011)
    # Its metre is its own in sim3.
    scaled = chain(np.tile([0.5, 0, 0, 0, 0, 0], (count, 1)))
    assert kitti_drift(truth, scaled, 2.0).overall.translation == pytest.approx(0.0, abs=1e-12)


def test_neither_frame_changes_it():
    _, truth, estimate = drive(300.0, 4)
    moved = se3.exp(np.array([5.0, 6.0, 7.0, 0.4, 0.5, 0.6])) @ estimate
    assert kitti_drift(truth, moved).overall.translation == pytest.approx(
        kitti_drift(truth, estimate).overall.translation, rel=1e-9
    )


def test_itself_has_no_drift_and_a_short_path_none_to_tell():
    _, truth, estimate = drive(300.0, 5)
    itself = kitti_drift(truth, truth)
    assert (itself.overall.translation, itself.overall.rotation) == (
        pytest.approx(0.0, abs=1e-12),
        pytest.approx(0.0, abs=1e-9),
    )
    short = path_along(truth) <= 100.0
    assert kitti_drift(truth[short], estimate[short]) is None
    for count in (0, 1, 2):
        assert kitti_drift(truth[:count], estimate[:count]) is None
    assert kitti_drift(np.tile(np.eye(4), (500, 1, 1)), estimate[:500]) is None


def test_real_drift_is_that_of_the_definition():
    folder = DATA / "kitti_00"
    if not folder.is_dir():
        pytest.skip(f"the real data is not here: {folder}")
    poses = []
    for name in ("groundtruth", "orb"):
        rows = np.loadtxt(folder / f"{name}.txt")
        poses.append((rows[:, 0], se3.from_position_quaternion(rows[:, 1:4], rows[:, 4:])))
    (t, truth), (s, estimate) = poses
    near = np.array([int(np.argmin(np.abs(t - each))) for each in s[:1500]])
    truth, estimate = truth[near], estimate[:1500]
    rows = twin.kitti(truth, estimate)
    found = kitti_drift(truth, estimate)
    assert len(rows) > 100
    assert found.overall.translation == pytest.approx(rows[:, 1].mean(), rel=1e-7)
    assert found.overall.rotation == pytest.approx(rows[:, 2].mean(), rel=1e-5)


# -- standing ------------------------------------------------------------------------------------


def test_the_path_of_a_body_that_stands_is_noise():
    rng = np.random.default_rng(7)
    for rate, std in ((10, 0.02), (200, 0.001), (1, 0.5)):
        count = 2000
        stamps = np.arange(count, dtype=np.int64) * (10**9 // rate)
        poses = np.tile(np.eye(4), (count, 1, 1))
        poses[:, :3, 3] = std * rng.normal(size=(count, 3))
        assert is_noise(stamps, poses, covariance(count, std))
    # Standing at one pose exactly is no noise, and no path.
    still = np.tile(np.eye(4), (50, 1, 1))
    assert path_along(still)[-1] == 0.0
    assert boxes(still, still) == ()


def test_the_path_of_a_body_that_moves_is_none():
    stamps, truth, _ = drive(200.0, 8)
    assert not is_noise(stamps, truth, covariance(len(truth), 0.02))
    # A hand that shakes twice a second, known to a tenth of a millimetre.
    count = 1000
    t = np.arange(count) / 50.0
    shaken = np.tile(np.eye(4), (count, 1, 1))
    shaken[:, 0, 3] = 0.1 * np.sin(2 * np.pi * 2.0 * t)
    nanoseconds = (t * 1e9).astype(np.int64)
    assert not is_noise(nanoseconds, shaken, covariance(count, 1e-4))
    # A smooth error, as a posterior has, makes no path longer.
    slow = np.tile(np.eye(4), (count, 1, 1))
    slow[:, 0, 3] = 1.5 * t
    assert not is_noise(nanoseconds, slow, covariance(count, 0.2))
    assert not is_noise(stamps[:1], truth[:1], covariance(1, 1.0))


# -- boxes ---------------------------------------------------------------------------------------


def test_boxes_are_of_a_tenth_to_a_half():
    _, truth, estimate = drive(120.0, 9)
    place = twin.path(truth)
    found = boxes(truth, estimate)
    assert len(found) == 5
    for share, box in zip((0.1, 0.2, 0.3, 0.4, 0.5), found, strict=True):
        length = share * place[-1]
        pairs = twin.nearest_ahead(place, length, 0.2 * length)
        errors = np.array(
            [twin.error(truth[i], truth[j], estimate[i], estimate[j]) for i, j in pairs]
        )
        assert box.length == pytest.approx(length, rel=1e-12)
        assert box.subsequences == len(pairs)
        for values, own in ((box.translation, errors[:, 0]), (box.rotation, errors[:, 1])):
            quantiles = np.percentile(own, [0, 5, 25, 50, 75, 95, 100])
            np.testing.assert_allclose(values, quantiles, rtol=1e-7, atol=1e-9)


# -- pairs ---------------------------------------------------------------------------------------


@settings(max_examples=150)
@given(
    st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0, 3.0]), max_size=25),
    st.sampled_from([0.25, 0.5, 1.0, 1.7, 4.0]),
    st.sampled_from([0.0, 0.1, 1.0, 10.0]),
)
def test_the_nearest_ahead(steps, ahead, tolerance):
    # Exact in binary, so that ties are ties.
    place = np.concatenate(([0.0], np.cumsum(steps)))
    begin, end = nearest_ahead(place, ahead, tolerance)
    assert list(zip(begin.tolist(), end.tolist(), strict=True)) == twin.nearest_ahead(
        place.tolist(), ahead, tolerance
    )


@pytest.mark.parametrize("unit", ["f", "m"])
@pytest.mark.parametrize("delta", [1, 7])
@pytest.mark.parametrize("scale", [None, 0.9])
def test_all_pairs_are_evo_s(unit, delta, scale):
    metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PosePath3D

    stamps, truth, estimate = drive(60.0, 10, step=0.3)
    scaled = estimate.copy()
    scaled[:, :3, 3] *= 1.0 if scale is None else scale
    found = all_pairs(stamps, truth, estimate, float(delta), unit, scale)
    for relation, ours in (
        (metrics.PoseRelation.translation_part, found.translation),
        (metrics.PoseRelation.rotation_angle_rad, found.rotation),
    ):
        rpe = metrics.RPE(
            relation,
            float(delta),
            metrics.Unit.frames if unit == "f" else metrics.Unit.meters,
            all_pairs=True,
            pairs_from_reference=scale is not None,
        )
        rpe.process_data((PosePath3D(poses_se3=truth), PosePath3D(poses_se3=scaled)))
        np.testing.assert_allclose(ours, rpe.error, atol=1e-9)


def test_all_pairs_by_time():
    stamps, truth, estimate = drive(60.0, 11)
    stamps = stamps + (stamps > 3_000_000_000) * 5_000_000_000
    pairs = twin.nearest_ahead((stamps * 1e-9).tolist(), 0.55, 0.055)
    expected = [twin.error(truth[i], truth[j], estimate[i], estimate[j])[0] for i, j in pairs]
    found = all_pairs(stamps, truth, estimate, 0.55, "s")
    np.testing.assert_allclose(found.translation, expected, atol=1e-9)
    # None over the gap.
    assert found.count < len(stamps) - 6
    for count in (0, 1):
        for unit in ("s", "m", "f"):
            few = all_pairs(stamps[:count], truth[:count], estimate[:count], 1.0, unit)
            assert few.count == 0


# -- growth --------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_growth_is_of_the_pairs_that_are_so_far_apart(scale):
    stamps, truth, estimate = drive(400.0, 4)
    for place in (stamps * 1e-9, path_along(truth)):
        found = growth(place, truth, estimate, scale)
        lengths = [box.length for box in found]
        assert lengths == sorted(lengths)
        assert 0.2 * (place[-1] - place[0]) <= lengths[-1] <= 0.5 * (place[-1] - place[0])
        for box in found:
            errors = []
            for i in range(len(place) - 1):
                ahead = [abs(place[j] - place[i] - box.length) for j in range(i + 1, len(place))]
                j = i + 1 + int(np.argmin(ahead))
                if ahead[j - i - 1] <= 0.1 * box.length:
                    true = np.linalg.inv(truth[i]) @ truth[j]
                    moved = np.linalg.inv(estimate[i]) @ estimate[j]
                    errors.append(np.linalg.norm(scale * moved[:3, 3] - true[:3, 3]))
            assert box.subsequences == len(errors)
            np.testing.assert_allclose(
                box.translation, np.quantile(errors, BOX_QUANTILES), rtol=1e-7
            )


def test_growth_of_many_poses_is_of_some_hundred_pairs():
    stamps, truth, estimate = drive(5000.0, 5)
    found = growth(stamps * 1e-9, truth, estimate)
    assert max(box.subsequences for box in found) <= 500
    assert len(found) <= 10
    # It drifts.
    medians = [box.translation[3] for box in found]
    assert medians[-1] > 10.0 * medians[0]


def test_growth_of_nothing():
    poses = np.tile(np.eye(4), (3, 1, 1))
    assert growth(np.zeros(0), poses[:0], poses[:0]) == ()
    assert growth(np.zeros(1), poses[:1], poses[:1]) == ()
    assert growth(np.zeros(3), poses, poses) == ()
