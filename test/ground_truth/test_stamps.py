# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of the stamps: found where it is, and only there."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins.profiles import Profile, noisy, samples
from twins.runs import START, motion

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth.faults import Faults
from trajeval_ros.ground_truth.screen import Screen
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.stamps import HISTORY, neighbours, slopes, stamp_noise
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed

ACCURACY = (5e-4, 9e-4)


def test_the_slope_of_a_straight_line_is_its_own_and_the_first_row_has_none():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.001, 0.3, 300))
    line = times[:, None] * np.arange(-3.0, 3.0)
    found = slopes(times, line, 0)
    np.testing.assert_array_equal(found[0], 0.0)
    np.testing.assert_allclose(found[1:], np.tile(np.arange(-3.0, 3.0), (299, 1)), atol=1e-9)


@pytest.mark.parametrize("step", [0.001, 0.01, 0.3])
def test_a_slope_depends_on_the_rows_up_to_it_and_not_on_how_they_are_cut(step):
    rng = np.random.default_rng(1)
    times, x = step * np.arange(400.0), rng.normal(size=(400, 6))
    whole = slopes(times, x, 0)
    for row in (130, 250, 399):
        begin = max(row - HISTORY, 0)
        part = slopes(times[begin : row + 1], x[begin : row + 1], row - begin)
        np.testing.assert_allclose(part[0], whole[row], rtol=0, atol=1e-9 * np.abs(whole).max())


def jittering(kind, rate, jitter, noise=1e-3, seed=1):
    """Times, stamps, samples' poses: each stamped on arrival, after a delay, in their order."""
    rng = np.random.default_rng(seed)
    profile = Profile(rng, ("rest", 5), (kind, 40))
    times = np.arange(0.5, profile.duration - 0.6, 1.0 / rate)
    delays = rng.exponential(jitter, len(times)) if jitter else np.zeros(len(times))
    stamps = np.maximum.accumulate(times + delays) + 1e-7 * np.arange(len(times))
    return profile, times, stamps, noisy(rng, profile.at(times), noise, 1.7e-3)


def scored(profile, stamps, poses, delay, **parameters):
    """The summary and the standardised errors of a perfect estimate, translation and rotation."""
    times = np.arange(2.0, profile.duration - 2.0, 0.0637)
    engine, errors, covariances = Engine(parameters), [], []
    # The delay's mean is an offset, no noise.
    estimate = samples(times + delay, profile.at(times))
    for results in feed(engine, samples(stamps, poses), estimate):
        found = results.evaluations
        errors.append(se3.log(se3.compose(se3.inverse(found.ground_truth), found.estimate)))
        covariances.append(found.covariance)
    error, covariance = np.concatenate(errors), np.concatenate(covariances)
    anees = []
    for group in (slice(0, 3), slice(3, 6)):
        whitened = np.linalg.solve(covariance[:, group, group], error[:, group, None])[..., 0]
        anees.append(float((error[:, group] * whitened).sum(axis=1).mean()) / 3.0)
    return engine.summary(), anees


@pytest.mark.parametrize(
    ("kind", "rate", "jitter"),
    [("hand", 100, 0.003), ("hand", 50, 0.005), ("hand", 50, 0.02), ("fast", 200, 0.005)],
)
def test_stamps_on_arrival_are_told_and_accounted_for(kind, rate, jitter):
    profile, times, stamps, poses = jittering(kind, rate, jitter)
    summary, anees = scored(profile, stamps, poses, jitter)
    found = summary["ground_truth"]["fit"]["stamp_std"]
    # What does not stay in order waits for the one before, which makes the noise less than white.
    actual = float(np.std(stamps - times - np.convolve(stamps - times, np.ones(9) / 9, "same")))
    assert 0.3 * actual < found < 1.5 * actual
    assert max(anees) < 2.5
    assert min(anees) > 0.3


def test_the_estimate_is_within_a_third_where_the_noise_is_white():
    rng = np.random.default_rng(3)
    profile = Profile(rng, ("hand", 60))
    times = np.arange(0.5, 59.0, 0.02)
    stamps = times + np.clip(rng.normal(0.0, 0.003, len(times)), -0.009, 0.009)
    poses = noisy(rng, profile.at(times), 1e-3, 1.7e-3)
    summary, anees = scored(profile, stamps, poses, 0.0)
    assert summary["ground_truth"]["fit"]["stamp_std"] == pytest.approx(0.003, rel=0.3)
    assert max(anees) < 2.0
    # Without it the process has to take it for rough motion or noise at rest as well.
    exact, _ = scored(profile, stamps, poses, 0.0, **{"ground_truth.stamps": "exact"})
    assert exact["ground_truth"]["fit"]["stamp_std"] == 0.0


@pytest.mark.parametrize(
    ("kind", "rate"),
    [
        ("hand", 100),
        ("drive", 10),
        ("drive", 1),
        ("aggressive", 100),
        ("aggressive", 20),
        ("fast", 5),
    ],
)
@pytest.mark.parametrize("noise", [1e-4, 5e-3])
def test_exact_stamps_have_no_noise_however_rare_the_samples(kind, rate, noise):
    profile, _, stamps, poses = jittering(kind, rate, 0.0, noise)
    summary, _ = scored(profile, stamps, poses, 0.0)
    assert summary["ground_truth"]["fit"]["stamp_std"] == 0.0


def test_a_body_at_rest_tells_nothing_of_its_stamps():
    profile, _, stamps, poses = jittering("rest", 50, 0.01)
    summary, anees = scored(profile, stamps, poses, 0.01)
    assert summary["ground_truth"]["fit"]["stamp_std"] == 0.0
    assert max(anees) < 1.5


def test_missing_samples_are_no_noise_of_the_stamps():
    profile, times, stamps, poses = jittering("aggressive", 20, 0.0)
    kept = np.random.default_rng(5).uniform(size=len(times)) > 0.3
    summary, _ = scored(profile, stamps[kept], poses[kept], 0.0)
    assert summary["ground_truth"]["fit"]["stamp_std"] == 0.0


def throttled(stamps, interval):
    """The rows that a throttle lets pass: the first, and each so much (s) after the last one."""
    rows = [0]
    for row, stamp in enumerate(stamps):
        if stamp - stamps[rows[-1]] >= interval:
            rows.append(row)
    return rows


@pytest.mark.parametrize("kind", ["hand", "fast"])
def test_a_throttle_does_not_hide_that_stamps_are_uncertain(kind):
    profile, times, stamps, poses = jittering(kind, 100, 0.003, 3e-4)
    rows = throttled(stamps, 0.045)
    # A long interval makes none short: the intervals' covariance has nothing of the noise.
    off = np.diff(stamps[rows]) - np.median(np.diff(stamps[rows]))
    late = stamps[rows] - times[rows]
    assert -np.mean(off[:-1] * off[1:]) < 0.1 * np.var(late)
    summary, anees = scored(profile, stamps[rows], poses[rows], late.mean())
    assert summary["ground_truth"]["fit"]["stamp_std"] == pytest.approx(np.std(late), rel=0.3)
    assert max(anees) < 2.0
    assert min(anees) > 0.3


@pytest.mark.parametrize("kind", ["drive", "hand", "fast", "aggressive"])
@pytest.mark.parametrize("interval", [0.045, 0.09])
def test_a_throttle_makes_right_stamps_no_less_certain(kind, interval):
    profile, _, stamps, poses = jittering(kind, 100, 0.0, 3e-4)
    there = np.random.default_rng(7).uniform(size=len(stamps)) > 0.3
    rows = throttled(stamps[there], interval)
    summary, _ = scored(profile, stamps[there][rows], poses[there][rows], 0.0)
    assert summary["ground_truth"]["fit"]["stamp_std"] == 0.0


@pytest.mark.parametrize(("turns", "found"), [(1.0, True), (-1.0, False)])
def test_positions_and_orientations_have_to_be_off_by_the_same_times(turns, found):
    """Each is late by as much as the other, or early by as much as the other is late."""
    rng = np.random.default_rng(8)
    segments = []
    for _ in range(12):
        # Intervals that scatter without a covariance, as a throttle makes them.
        times = np.cumsum(rng.uniform(0.035, 0.065, 40))
        late = rng.normal(0.0, 0.006, (40, 1)) * np.repeat([1.0, turns], 3)
        segments.append((times, 0.4 * (times[:, None] - late)))
    std = stamp_noise(segments, ACCURACY)
    assert std == pytest.approx(0.006, rel=0.3) if found else std < 0.003


def held_up(rng, count, interval):
    """Times and stamps: samples arrive together now and then, and a throttle passes the first."""
    times = 0.2 * interval * np.arange(5 * count)
    stamps = times + rng.exponential(1e-3, len(times))
    for begin in np.cumsum(rng.exponential(0.6, count)):
        end = begin + rng.exponential(0.06)
        stamps[(stamps > begin) & (stamps < end)] = end
    stamps = np.maximum.accumulate(stamps) + 1e-6 * np.arange(len(times))
    rows = throttled(stamps, 0.9 * interval)
    return times[rows], stamps[rows]


def cut(times, x, count=24):
    return [
        (times[i : i + count] - times[i], x[i : i + count])
        for i in range(0, len(times) - count, count)
    ]


@pytest.mark.parametrize(("interval", "seed"), [(0.05, 0), (0.05, 3), (0.1, 2), (0.1, 4)])
def test_a_few_late_stamps_show_on_a_body_that_does_not_turn(interval, seed):
    """By intervals: a throttle takes their covariance away, and there is nothing to agree with."""
    rng = np.random.default_rng(seed)
    times, stamps = held_up(rng, 1200, interval)
    assert np.median(stamps - times) < 0.01 < np.std(stamps - times)
    for taken, late in ((times, True), (stamps, False)):
        x = rng.normal(scale=3e-4, size=(len(times), 6))
        x[:, :2] += np.transpose([np.cos(0.6 * taken), np.sin(0.6 * taken)])
        std = stamp_noise(cut(stamps, x), ACCURACY)
        assert 0.1 * np.std(stamps - times) < std < np.std(stamps - times) if late else std == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_abrupt_motion_that_rare_samples_do_not_resolve_is_no_noise_of_the_stamps(seed):
    """It starts at once and slows down; the samples are taken when stamped, at uneven times."""
    rng = np.random.default_rng(seed)
    fine = 0.01 * np.arange(20000)
    velocity = np.zeros((len(fine), 2))
    for begin in np.cumsum(rng.uniform(1.5, 3.5, 100)):
        since = np.maximum(fine - begin, 0.0)
        pace = np.minimum(since / 0.2, 1.0) * np.exp(-since)
        velocity = np.where(since[:, None] > 0.0, np.outer(pace, [0.9, rng.normal()]), velocity)
    way = 0.01 * np.cumsum(velocity, axis=0)
    times = 0.1 + 0.2 * np.arange(900) + rng.uniform(-0.07, 0.07, 900)
    x = rng.normal(scale=3e-4, size=(900, 6))
    x[:, 0] += np.interp(times, fine, way[:, 0])
    x[:, 3] += np.interp(times, fine, way[:, 1])
    assert stamp_noise(cut(times, x), ACCURACY) == 0.0


def test_few_segments_do_not_tell():
    times = np.arange(0.0, 2.0, 0.02)
    x = np.outer(times, np.ones(6)) + np.random.default_rng(0).normal(size=(100, 6)) * 0.01
    assert stamp_noise([(times, x)] * 3, ACCURACY) == 0.0


def bursts(taken, batch=40):
    """What is named of samples whose intervals are a queue's, ``taken`` at so many (n,) s."""
    intervals = np.tile([0.04, 0.04, 0.04, 0.12, 2e-4, 2e-4], 20)
    stamps = START + np.cumsum(np.rint(1e9 * intervals)).astype(np.int64)
    times = (stamps - START) * 1e-9 if taken is None else taken(len(stamps))
    late = Samples(stamps, motion(times))
    faults = Faults()
    screen = Screen((5e-4, 1e-3), faults)
    for begin in range(0, len(late), batch):
        screen.accept(late[begin : begin + batch])
    screen.conclude()
    return faults.found


def evenly(count):
    return 0.04 * np.arange(count)


@pytest.mark.parametrize("batch", [1, 5, 120])
def test_bursts_are_the_same_in_any_batches(batch):
    (named,) = bursts(evenly, batch)
    assert named.code == "stamp_bursts"
    assert (named,) == bursts(evenly)


@pytest.mark.parametrize("taken", [None, np.zeros])
def test_bursts_are_named_where_the_poses_say_that_stamps_are_of_arrival(taken):
    """Not where samples were taken in bursts, nor of a robot that stands."""
    assert bursts(taken) == ()


@pytest.mark.parametrize("kind", ["drive", "spin", "hand", "aggressive"])
@pytest.mark.parametrize(("rate", "noise"), [(10, 3e-4), (50, 3e-3), (150, 1e-3)])
def test_right_stamps_at_random_times_are_no_fault(kind, rate, noise):
    rng = np.random.default_rng(rate)
    profile = Profile(rng, (kind, 45))
    times = 0.5 + np.cumsum(rng.exponential(1.0 / rate, 44 * rate) + 1e-4)
    times = times[times < 44.0]
    engine = Engine({})
    engine.add_ground_truth(samples(times, noisy(rng, profile.at(times), noise, 1.7 * noise)))
    engine.finish()
    found = engine.summary()["ground_truth"]
    assert [fault for fault in found["faults"] if fault["code"].startswith("stamp")] == []
    assert found["fit"]["stamp_std"] == 0.0


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@given(
    count=st.integers(5, 60),
    group=st.integers(0, 1),
    rest=st.sampled_from([0.0, 0.5, 1.0]),
    noise=st.sampled_from([0.0, 1e-3]),
    seed=st.integers(0, 999),
)
def test_the_loop_sums_what_numpy_sums(count, group, rest, noise, seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.2, 1.8, count)) * 0.01
    x = np.sin(times[:, None] * rng.uniform(1.0, 9.0, 6)) * (times > rest * times[-1])[:, None]
    x += noise * rng.standard_t(2, (count, 6))
    some = x[:, 3 * group : 3 * group + 3]
    found = neighbours(times, some, 0.01)
    with loops.left_out():
        expected = neighbours(times, some, 0.01)
    scale = max(map(abs, (expected[0], expected[3])))
    np.testing.assert_allclose(found[:2], expected[:2], rtol=1e-9, atol=1e-9 * scale)
    assert found[2] == expected[2]
    np.testing.assert_allclose(found[3], expected[3], rtol=1e-9, atol=1e-9 * scale)
    # Where a cubic fits to the last digit, what is due is that digit's.
    digit = 1e-12 * np.sqrt(expected.expected) * max(np.abs(x).max(), 1.0)
    np.testing.assert_allclose(found.due, expected.due, rtol=1e-9, atol=digit)
    scatter = np.sqrt([found.scattered, expected.scattered])
    np.testing.assert_allclose(*scatter, rtol=1e-9, atol=digit)
    np.testing.assert_allclose(found.expected, expected.expected, rtol=1e-9)
