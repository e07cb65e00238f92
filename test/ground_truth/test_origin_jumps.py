# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps of the origin where samples are rare or within a gap; what only looks like one."""

from pathlib import Path

import numpy as np
import pytest
from twins.profiles import KINDS, Profile, noisy
from twins.runs import START

from trajeval_ros import loops, se3
from trajeval_ros.files.tum import read_tum
from trajeval_ros.ground_truth.faults import Faults
from trajeval_ros.ground_truth.jumps import Memory, errors
from trajeval_ros.ground_truth.screen import Screen
from trajeval_ros.ground_truth.segment import Samples

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
ACCURACY = (5e-4, np.radians(0.05))
RATES = (1e9, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5)
SEED = 3


def screened(samples, batch=50):
    """The samples let through, the cuts, and the jumps named."""
    faults = Faults()
    screen = Screen(ACCURACY, faults)
    found = [screen.accept(samples[k : k + batch]) for k in range(0, len(samples), batch)]
    found.append(screen.conclude())
    passed = sum((each.samples for each in found[1:]), start=found[0].samples)
    cuts = [cut for each in found for cut in each.cuts]
    return passed, cuts, [fault for fault in faults.found if fault.code == "origin_jump"]


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
def test_the_loop_remembers_what_numpy_does():
    rng = np.random.default_rng(SEED)
    stamps = START + np.cumsum(rng.integers(1, 20_000_000, 9000))
    samples = Samples(stamps, noisy(rng, flight(1e-9 * (stamps - START)), 1e-3, 1e-3))
    whole, parts = Memory(), Memory()
    whole.add(samples)
    with loops.left_out():
        for begin in range(0, len(samples), 700):
            parts.add(samples[begin : begin + 700])
    assert len(whole._known) == 2048
    np.testing.assert_array_equal(whole._known.stamps, parts._known.stamps)
    np.testing.assert_array_equal(whole._known.poses, parts._known.poses)


def at(times, poses):
    return Samples(START + np.rint(np.asarray(times) * 1e9).astype(np.int64), poses)


def flight(times):
    """A smooth flight, 0.8 m/s."""
    s = np.asarray(times)[:, None]
    poses = np.tile(np.eye(4), (len(s), 1, 1))
    poses[:, :3, 3] = np.sin(s * [0.4, 0.31, 0.23] + [0.0, 0.4, 1.0]) * [1.8, 1.5, 0.8]
    poses[:, :3, :3] = se3.exp_so3(np.sin(s * [0.35, 0.2, 0.1]) * [0.2, 0.2, 1.0])
    return poses


def jumped(poses, after, shift, turn=0.0):
    by = np.eye(4)
    by[:3, 3], by[:3, :3] = shift, se3.exp_so3(np.array([0.0, 0.0, turn]))
    return np.where(after[:, None, None], by @ poses, poses)


def sampled(rate, gap=0.0, shift=(0.0, 0.0, 0.0), turn=0.0):
    """A minute and a half at a rate, jumped after 60 s, the ``gap`` before it without samples."""
    rng = np.random.default_rng(SEED)
    times = np.arange(0.0, 90.0, 1.0 / rate)
    times = times[(times < 60.0 - gap) | (times >= 60.0)]
    poses = noisy(rng, flight(times), 2e-3, 2e-3)
    return at(times, jumped(poses, times >= 60.0, shift, turn))


@pytest.mark.parametrize(
    ("rate", "gap"), [(20, 0), (10, 0), (5, 0), (4, 0), (100, 0.2), (100, 0.5), (20, 0.5)]
)
@pytest.mark.parametrize("turn", [0.0, 0.15])
def test_a_jump_is_named_with_its_size_and_undone(rate, gap, turn):
    if turn and (rate, gap) == (100, 0.5):
        pytest.skip("over half a second neither the turn nor, turned, the step is far from motion")
    samples = sampled(rate, gap, (0.3, 0.2, 0.1), turn)
    passed, cuts, (fault,) = screened(samples)
    times = (passed.stamps - START) * 1e-9
    assert fault.count == 1
    assert cuts == [fault.begin] == [int(START + 60e9)]
    off = np.linalg.norm(passed.poses[:, :3, 3] - flight(times)[:, :3, 3], axis=1)
    # A turn is known to a few milliradians: as much further away, and the jump is where it was.
    assert off.max() < (0.05 if not turn else 0.15)
    if not turn:
        assert abs(float(fault.detail.split()[0]) - 0.374) < 0.03


@pytest.mark.parametrize(("rate", "gap"), [(0.5, 0), (100, 3.0)])
def test_where_the_body_could_have_gone_it_is_not_named(rate, gap):
    assert screened(sampled(rate, gap, (0.3, 0.2, 0.1)))[2] == []


def test_a_small_one_is_cut_and_left_where_it_is():
    samples = sampled(10, shift=(0.1, 0.1, 0.05))
    passed, cuts, (fault,) = screened(samples)
    assert (len(cuts), fault.detail[:4]) == (1, "0.14")
    assert np.array_equal(passed.poses, samples.poses)


def test_batches_do_not_matter():
    samples = sampled(100, 0.5, (0.3, 0.2, 0.1), 0.1)
    found = [screened(samples, batch) for batch in (3, 64, len(samples))]
    for passed, cuts, _ in found[1:]:
        np.testing.assert_allclose(passed.poses, found[0][0].poses, rtol=0, atol=1e-9)
        assert cuts == found[0][1]


def test_a_body_that_steps_between_samples_does_not_jump():
    """It stands, goes half a metre within a second now and then, and stands."""
    rng = np.random.default_rng(SEED)
    times = np.arange(0.0, 300.0)
    poses = flight(np.minimum(times, 100.0))
    for begin in (140.0, 180.0, 215.0, 260.0):
        poses[times >= begin, :3, 3] += [0.4, 0.3, 0.0]
    assert screened(at(times, noisy(rng, poses, 2e-3, 2e-3)))[2] == []


def test_a_body_set_down_elsewhere_does_not_jump():
    """All that it was seen to do before is to creep."""
    rng = np.random.default_rng(SEED)
    times = np.arange(0.0, 120.0)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, 0, 3] = 5e-3 * times + 0.5 * (times >= 100.0)
    assert screened(at(times, noisy(rng, poses, 1e-3, 1e-3)))[2] == []


def test_a_late_stamp_and_a_clock_that_jumps_are_no_jumps_of_the_origin():
    times = np.arange(0.0, 90.0, 0.1)
    poses = noisy(np.random.default_rng(SEED), flight(times), 1e-3, 1e-3)
    late = times.copy()
    late[600] += 0.08
    ahead = times + 0.7 * (times >= 60.0)
    for stamps in (late, ahead):
        assert screened(at(stamps, poses))[2] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_random_motion_has_none(seed):
    rng = np.random.default_rng(seed)
    phases = [(str(kind), rng.uniform(2.0, 20.0)) for kind in rng.choice(list(KINDS), 12)]
    profile = Profile(rng, *phases)
    for rate in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0):
        times = np.arange(0.0, profile.duration - 0.02, 1.0 / rate)
        poses = noisy(rng, profile.at(times), np.exp(rng.uniform(-9.0, -1.5)), 2e-3)
        assert screened(at(times, poses))[2] == [], rate
    times = np.arange(0.0, profile.duration - 0.02, 0.02)
    kept = np.ones(len(times), dtype=bool)
    for begin in rng.integers(0, len(times), 12):
        kept[begin : begin + rng.integers(3, 80)] = False
    poses = noisy(rng, profile.at(times[kept]), 2e-3, 2e-3)
    assert screened(at(times[kept], poses))[2] == []


@pytest.mark.parametrize(
    "name", sorted(path.parent.name for path in DATA.glob("*/groundtruth.txt"))
)
def test_a_recording_has_none_that_is_not_there(name):
    read = read_tum(DATA / name / "groundtruth.txt")
    poses = se3.from_position_quaternion(read.positions, read.quaternions)
    increasing = np.concatenate([[True], np.diff(read.stamps) > 0])
    samples = Samples(read.stamps[increasing], poses[increasing])
    for rate in RATES:
        kept, last = [], -(1 << 62)
        for index, stamp in enumerate(samples.stamps.tolist()):
            if stamp - last >= 0.999e9 / rate:
                kept.append(index)
                last = stamp
        thinned = Samples(samples.stamps[kept], samples.poses[kept])
        _, _, found = screened(thinned)
        # Its own, of 13 cm at 45 s.
        its_own = name == "euroc_mh04" and rate >= 10.0
        assert [(fault.count, fault.detail[:4]) for fault in found] == [(1, "0.13")] * its_own, rate


def test_errors_are_those_from_the_parabola_before():
    rng = np.random.default_rng(SEED)
    times = np.cumsum(rng.uniform(0.5, 1.5, 12))
    positions = rng.normal(size=(12, 3))
    expected = [
        np.linalg.norm(
            positions[k]
            - [
                np.polyval(np.polyfit(times[k - 3 : k], c, 2), times[k])
                for c in positions[k - 3 : k].T
            ]
        )
        for k in range(3, 12)
    ]
    np.testing.assert_allclose(errors(times, positions), expected, rtol=1e-9)
