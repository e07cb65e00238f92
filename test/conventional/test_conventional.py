# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The conventional figures against evo's on the same poses, and against themselves."""

import pathlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import GAUGES, Degeneracy, align_positions
from trajeval_ros.conventional import running as conventional
from trajeval_ros.conventional.distributions import EvenSample
from trajeval_ros.conventional.running import RunningConventional

DATA = pathlib.Path(__file__).parents[2] / ".." / "shared" / "data"
GAUGE_OPTIONS = {"none": (False, False), "se3": (True, False), "sim3": (True, True)}


def simulated(seed, count=400, noise=0.05, scale=1.0, turn=0.05):
    """Stamps at 10 Hz, ground truth on a smooth curve, and an estimate in a world of its own."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) * 0.1
    frequencies = rng.uniform(0.05, 0.4, size=(3, 6))
    coordinates = sum(
        np.sin(t[:, None] * f * 2 * np.pi + rng.uniform(0, 6, size=6)) for f in frequencies
    )
    ground_truth = se3.exp(coordinates * [3, 2, 1, 0.5, 0.5, 0.8])
    error = np.concatenate(
        (rng.normal(size=(count, 3)) * noise, rng.normal(size=(count, 3)) * turn), axis=1
    )
    world = se3.exp(rng.normal(size=6))
    estimate = se3.compose(world, ground_truth, se3.exp(error))
    estimate[:, :3, 3] *= scale
    return np.arange(count) * 100_000_000 + 1_400_000_000_000_000_000, ground_truth, estimate


def moved(alignment, poses):
    """The poses (n, 4, 4) under an alignment; the scale leaves rotations alone."""
    result = poses.copy()
    result[:, :3, :3] = alignment.rotation @ poses[:, :3, :3]
    result[:, :3, 3] = alignment.transform_positions(poses[:, :3, 3])
    return result


def evo_statistics(ground_truth, estimate, gauge, delta, unit, from_reference):
    """Evo's APE and RPE statistics, as ``{ate_translation: {rmse: ..}, ..}``."""
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed")
    from evo.core.trajectory import PosePath3D
    from evo.core.units import Unit

    reference = PosePath3D(poses_se3=list(ground_truth))
    aligned = PosePath3D(poses_se3=[pose.copy() for pose in estimate])
    if gauge == "yaw_translation":
        # Evo has no such gauge: it gets the estimate aligned by us.
        alignment = align_positions(estimate[:, :3, 3], ground_truth[:, :3, 3], gauge)
        aligned = PosePath3D(poses_se3=list(moved(alignment, estimate)))
    elif GAUGE_OPTIONS[gauge][0]:
        aligned.align(reference, correct_scale=GAUGE_OPTIONS[gauge][1])
    relations = {
        "translation": metrics.PoseRelation.translation_part,
        "rotation": metrics.PoseRelation.rotation_angle_rad,
    }
    result = {}
    for part, relation in relations.items():
        for name, metric in (
            ("ate", metrics.APE(relation)),
            (
                "re",
                metrics.RPE(
                    relation,
                    delta,
                    Unit.frames if unit == "frames" else Unit.meters,
                    pairs_from_reference=from_reference,
                ),
            ),
        ):
            metric.process_data((reference, aligned))
            result[f"{name}_{part}"] = metric.get_all_statistics()
            result[f"{name}_pairs"] = len(metric.error)
    return result


def run(stamps, ground_truth, estimate, gauge="se3", delta=1.0, unit="s", cuts=()):
    running = RunningConventional(gauge, delta, unit)
    for batch in zip(
        np.split(stamps, cuts), np.split(ground_truth, cuts), np.split(estimate, cuts), strict=True
    ):
        running.update(*batch)
    return running


def assert_equals_evo(running, expected, tolerance=1e-9):
    figures, distributions = running.figures(), running.distributions()
    assert figures.pairs == expected["re_pairs"]
    for name in ("ate_translation", "ate_rotation", "re_translation", "re_rotation"):
        assert getattr(figures, f"{name}_rmse") == pytest.approx(
            expected[name]["rmse"], rel=tolerance, abs=tolerance
        )
        distribution = getattr(distributions, name)
        for ours, evos in (
            *((same, same) for same in ("mean", "median", "std")),
            *(("minimum", "min"), ("maximum", "max")),
        ):
            assert getattr(distribution, ours) == pytest.approx(
                expected[name][evos], rel=tolerance, abs=tolerance
            )


@pytest.mark.parametrize("gauge", GAUGES)
@pytest.mark.parametrize(("unit", "delta"), [("s", 1.0), ("s", 0.1), ("m", 1.0), ("m", 5.0)])
@pytest.mark.parametrize(
    ("seed", "noise", "turn"), [(0, 0.05, 0.02), (1, 1e-4, 1e-4), (2, 0.5, 0.4)]
)
def test_equals_evo(gauge, unit, delta, seed, noise, turn):
    stamps, ground_truth, estimate = simulated(
        seed, noise=noise, turn=turn, scale=0.7 if gauge == "sim3" else 1.0
    )
    running = run(stamps, ground_truth, estimate, gauge, delta, unit, cuts=[1, 2, 50, 333])
    # At 10 Hz a step in seconds is one of evo's in frames.
    expected = evo_statistics(
        ground_truth,
        estimate,
        gauge,
        round(delta * 10) if unit == "s" else delta,
        "frames" if unit == "s" else "m",
        from_reference=gauge == "sim3",
    )
    assert_equals_evo(running, expected)


def read_associated(folder, estimate_file):
    """Poses of both files of the nearest stamps within 10 ms, one to one, as evo's association."""
    from evo.core import sync
    from evo.tools import file_interface

    reference = file_interface.read_tum_trajectory_file(str(DATA / folder / "groundtruth.txt"))
    estimate = file_interface.read_tum_trajectory_file(str(DATA / folder / estimate_file))
    reference, estimate = sync.associate_trajectories(reference, estimate, max_diff=0.01)
    increasing = np.concatenate(([True], np.diff(estimate.timestamps) > 0))
    stamps = np.round(estimate.timestamps * 1e9).astype(np.int64)[increasing]
    return (
        stamps,
        np.array(reference.poses_se3)[increasing],
        np.array(estimate.poses_se3)[increasing],
    )


@pytest.mark.parametrize("gauge", ["se3", "sim3"])
@pytest.mark.parametrize(
    ("folder", "file"),
    [
        ("tum_fr1_xyz", "rgbdslam.txt"),
        ("tum_fr1_xyz", "orb_kf_mono.txt"),
        ("tum_fr2_desk", "orb.txt"),
        ("euroc_v102", "estimate.txt"),
        ("euroc_mh04", "pl_vio.txt"),
        ("kitti_00", "orb.txt"),
    ],
)
def test_equals_evo_on_real_data(folder, file, gauge):
    if not DATA.is_dir():
        pytest.skip("the real trajectories (shared/data beside the repository) are not here")
    pytest.importorskip("evo", reason="evo is not installed")
    stamps, ground_truth, estimate = read_associated(folder, file)
    running = run(stamps, ground_truth, estimate, gauge, 1.0, "m", cuts=[7, 25])
    expected = evo_statistics(ground_truth, estimate, gauge, 1.0, "m", gauge == "sim3")
    if len(stamps) > conventional.CAPACITY:
        figures = running.figures()
        for name in ("ate_translation", "ate_rotation", "re_translation", "re_rotation"):
            assert getattr(figures, f"{name}_rmse") == pytest.approx(
                expected[name]["rmse"], rel=1e-9
            )
    else:
        assert_equals_evo(running, expected)


@settings(max_examples=30)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(GAUGES),
    st.sampled_from(["s", "m"]),
    st.lists(st.integers(0, 120), max_size=12).map(sorted),
)
def test_batches_do_not_matter(seed, gauge, unit, cuts):
    data = simulated(seed, 120)
    whole = run(*data, gauge, 0.7, unit)
    cut = RunningConventional(gauge, 0.7, unit)
    for batch in zip(*(np.split(part, cuts) for part in data), strict=True):
        cut.update(*batch)
        cut.figures()  # empties what waits for a batch
    for attribute in (
        "poses",
        "pairs",
        "ate_translation_rmse",
        "ate_rotation_rmse",
        "re_translation_rmse",
        "re_rotation_rmse",
        "re_longest_step",
    ):
        assert getattr(cut.figures(), attribute) == pytest.approx(
            getattr(whole.figures(), attribute), rel=1e-11
        )
    for part in ("ate_translation", "ate_rotation", "re_translation", "re_rotation"):
        ours, theirs = getattr(cut.distributions(), part), getattr(whole.distributions(), part)
        assert ours.median == pytest.approx(theirs.median, rel=1e-9)
        assert ours.maximum == pytest.approx(theirs.maximum, rel=1e-9)
        assert ours.mean == pytest.approx(theirs.mean, rel=1e-9)


@pytest.mark.parametrize("cuts", [[], [1, 2, 3, 700], range(0, 1000, 7)])
def test_a_spread_far_smaller_than_the_mean(monkeypatch, cuts):
    monkeypatch.setattr(conventional, "_BATCH", 1)
    errors = 1000.0 + 1e-6 * np.sin(np.arange(1000.0))
    poses = np.tile(np.eye(4), (1000, 1, 1))
    absolute, relative = poses.copy(), poses.copy()
    absolute[:, 0, 3] = errors
    relative[1:, 0, 3] = np.cumsum(errors[1:] * (-1.0) ** np.arange(999))  # there and back
    stamps = np.arange(1000) * 100_000_000
    ate = run(stamps, poses, absolute, "none", 0.1, cuts=cuts).distributions().ate_translation
    whole = run(stamps, poses, relative, "none", 0.1, cuts=cuts)
    re = whole.distributions().re_translation
    assert ate.std == pytest.approx(np.std(errors), rel=1e-6)
    assert re.std == pytest.approx(np.std(errors[1:]), rel=1e-6)
    assert ate.mean == pytest.approx(np.mean(errors), rel=1e-14)
    assert re.mean == pytest.approx(np.mean(errors[1:]), rel=1e-14)


def test_the_worlds_do_not_matter():
    stamps, ground_truth, estimate = simulated(4)
    moved = se3.compose(se3.exp(np.array([5.0, 6.0, 7.0, 1.0, -2.0, 0.5])), estimate)
    ours, theirs = (run(stamps, ground_truth, e).figures() for e in (estimate, moved))
    for name in ("ate_translation", "ate_rotation", "re_translation", "re_rotation"):
        assert getattr(ours, f"{name}_rmse") == pytest.approx(
            getattr(theirs, f"{name}_rmse"), rel=1e-11
        )


def test_a_perfect_estimate_scores_round_off():
    stamps, ground_truth, estimate = simulated(5, noise=0.0, turn=0.0)
    figures = run(stamps, ground_truth, estimate).figures()
    assert figures.ate_translation_rmse < 1e-13
    assert figures.ate_rotation_rmse < 1e-9
    assert figures.re_translation_rmse < 1e-13
    assert figures.re_rotation_rmse < 1e-13


@pytest.mark.parametrize("gauge", GAUGES)
def test_not_enough_data_is_none(gauge):
    stamps, ground_truth, estimate = simulated(6, 20)
    running = RunningConventional(gauge, 1.0, "s")
    nothing = running.figures()
    assert nothing.poses == nothing.pairs == 0
    assert nothing.alignment is None
    for figures in (nothing, running.distributions()):
        for part in ("ate_translation", "ate_rotation", "re_translation", "re_rotation"):
            name = part if hasattr(figures, part) else f"{part}_rmse"
            assert getattr(figures, name) is None

    running.update(stamps[:1], ground_truth[:1], estimate[:1])
    one = running.figures()
    assert (one.ate_translation_rmse is None) == (gauge != "none")
    assert (one.ate_rotation_rmse is None) == (gauge != "none")
    assert one.re_translation_rmse is None
    assert (running.distributions().ate_translation is None) == (gauge != "none")

    running.update(stamps[1:5], ground_truth[1:5], estimate[1:5])
    five = running.figures()
    assert five.ate_translation_rmse is not None
    assert five.pairs == 0
    assert five.re_rotation_rmse is None
    assert five.re_longest_step is None
    assert running.distributions().re_rotation is None


def test_a_straight_run_has_no_rotation_error():
    stamps, ground_truth, estimate = simulated(7, 50)
    for poses in (ground_truth, estimate):
        poses[:, :3, 3] = np.arange(50)[:, None] * [1.0, 2.0, 0.5]
    figures = run(stamps, ground_truth, estimate).figures()
    assert figures.alignment.degeneracy is Degeneracy.COLLINEAR
    assert figures.ate_translation_rmse < 1e-12
    assert figures.ate_rotation_rmse is None
    assert figures.re_translation_rmse is not None


def test_standing_still_shows_no_scale():
    stamps, ground_truth, estimate = simulated(8, 50)
    estimate[:, :3, 3] = 1.0
    running = run(stamps, ground_truth, estimate, "sim3")
    figures = running.figures()
    assert figures.alignment.degeneracy is Degeneracy.COINCIDENT
    assert figures.ate_translation_rmse is None
    assert figures.re_translation_rmse is None
    assert figures.re_rotation_rmse is not None
    assert running.distributions().re_translation is None


def test_beyond_the_capacity(monkeypatch):
    monkeypatch.setattr(conventional, "CAPACITY", 64)
    stamps, ground_truth, estimate = simulated(9, 1000)
    small = run(stamps, ground_truth, estimate, delta=0.1, cuts=range(0, 1000, 7))
    monkeypatch.undo()
    large = run(stamps, ground_truth, estimate, delta=0.1)
    assert large.distributions().sampled_poses == 1000
    assert small.distributions().sampled_poses == len(range(0, 1000, 16))
    assert small.distributions().sampled_pairs == len(range(0, 999, 16))
    # What is closed stays so; a maximum is never one of a sample where it need not be.
    assert small.figures().ate_rotation_rmse == pytest.approx(
        large.figures().ate_rotation_rmse, rel=1e-12
    )
    assert small.distributions().re_translation.maximum == pytest.approx(
        large.distributions().re_translation.maximum, rel=1e-12
    )
    assert small.distributions().re_rotation.mean == pytest.approx(
        large.distributions().re_rotation.mean, rel=1e-12
    )
    assert small.distributions().ate_translation.median == pytest.approx(
        large.distributions().ate_translation.median, rel=0.25
    )
    # Which rows are sampled depends on their number alone.
    sample, other = EvenSample(64, 1), EvenSample(64, 1)
    rows = np.arange(1000.0)[:, None]
    sample.update(rows)
    for part in np.split(rows, [1, 63, 64, 65, 200, 201, 900]):
        other.update(part)
    np.testing.assert_array_equal(sample.rows, rows[::16])
    np.testing.assert_array_equal(other.rows, rows[::16])


def test_refuses():
    stamps, ground_truth, estimate = simulated(10, 10)
    running = RunningConventional("se3", 1.0, "s")
    with pytest.raises(ValueError, match="unknown gauge"):
        RunningConventional("se2", 1.0, "s")
    with pytest.raises(ValueError, match="must be"):
        running.update(stamps, ground_truth, estimate[:9])
    with pytest.raises(ValueError, match="increase strictly"):
        running.update(stamps[::-1], ground_truth, estimate)
    broken = estimate.copy()
    broken[3, 0, 3] = np.nan
    with pytest.raises(ValueError, match="finite"):
        running.update(stamps, ground_truth, broken)
    running.update(stamps, ground_truth, estimate)
    with pytest.raises(ValueError, match="increase strictly"):
        running.update(stamps[-1:], ground_truth[-1:], estimate[-1:])
    assert running.figures().poses == 10


@pytest.mark.parametrize("gauge", ["se3", "yaw_translation", "sim3", "none"])
def test_rotation_of_a_body_that_stands_is_left_out(gauge):
    rng = np.random.default_rng(3)
    stamps = 50_000_000 * np.arange(400)
    poses = np.tile(np.eye(4), (2, 400, 1, 1))
    poses[:, :, :3, 3] = rng.normal(0.0, 2e-3, (2, 400, 3))
    running = RunningConventional(gauge, 1.0, "s")
    running.update(stamps, *poses)
    figures = running.figures()
    assert (figures.ate_rotation_rmse is None) == (gauge != "none")
    assert running.is_rotation_undetermined == (gauge != "none")
    # A body that moves, by no more than ten times the noise, shows it.
    poses[:, :, 0, 3] += 0.02 * np.sin(0.05 * np.arange(400))
    poses[:, :, 1, 3] += 0.02 * np.sin(0.09 * np.arange(400))
    moving = RunningConventional(gauge, 1.0, "s")
    moving.update(stamps, *poses)
    assert moving.figures().ate_rotation_rmse is not None
    assert not moving.is_rotation_undetermined
