# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth stamped late, or in coarse ticks: named, mended where that is asked for."""

import numpy as np
import pytest
from twins.profiles import Profile, noisy, samples
from twins.real_pairs import DATA
from twins.runs import SECOND, START, assert_same_summary, joined, poses_of, where
from twins.runs import samples as topic

from trajeval_ros import se3
from trajeval_ros.files.tum import read_tum
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.stamping import Stamping
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed

REGULARIZE = {"ground_truth.stamps": "regularize"}


def scored(ground_truth, profile, asked, lag=0.0, chunk=SECOND, **parameters):
    """The engine, and the errors (n, 6) and ANEES of a perfect estimate, by a clock with a lag."""
    engine, errors, covariances = Engine(parameters), [], []
    for results in feed(engine, ground_truth, samples(asked + lag, profile.at(asked)), chunk):
        found = results.evaluations
        truth = profile.at((found.stamps - START) / SECOND - lag)
        errors.append(se3.log(se3.compose(se3.inverse(found.ground_truth), truth)))
        covariances.append(found.covariance)
        account = engine.health().ground_truth
        rejected = sum(account.rejected.values())
        assert account.received == account.used + account.pending + rejected
    error, covariance = np.concatenate(errors), np.concatenate(covariances)
    whitened = np.linalg.solve(covariance, error[..., None])[..., 0]
    return engine, error, float((error * whitened).sum(axis=1).mean()) / 6.0


def codes(engine):
    return [fault["code"] for fault in engine.summary()["ground_truth"]["faults"]]


def late(kind="hand", seconds=60, rate=50, delay=0.006, seed=1):
    """A motion, when it was sampled, samples stamped on arrival, and when it is asked for, s."""
    rng = np.random.default_rng(seed)
    profile = Profile(rng, (kind, seconds))
    times = np.arange(0.5, seconds - 0.5, 1.0 / rate)
    stamps = np.maximum.accumulate(times + rng.exponential(delay, len(times)))
    stamps += 1e-6 * np.arange(len(times))
    data = samples(stamps, noisy(rng, profile.at(times), 1e-3, 1.7e-3))
    return profile, times, data, np.arange(2.0, seconds - 2.0, 0.0637)


def test_late_stamps_are_named_and_the_clock_is_better_than_they_are():
    profile, times, data, asked = late()
    measured, before, _ = scored(data, profile, asked, 0.006)
    stamping = Stamping(regularize=True)
    given = stamping.accept(Samples(data.stamps, poses_of(data))).stamps
    lag = np.median((given - START) / SECOND - times[: len(given)])
    assert 0.0 < lag < 0.002
    regular, after, anees = scored(data, profile, asked, lag, **REGULARIZE)
    for engine in (measured, regular):
        (fault,) = (
            f for f in engine.summary()["ground_truth"]["faults"] if f["code"] == "stamps_late"
        )
        assert "one in 20 ms, 6" in fault["text"]
        assert fault["count"] > 2900
        notice = next(n for n in engine.notices() if n.code == "ground_truth_stamps_late")
        assert ("regularize" in notice.text) == (engine is measured)
    rms = [np.sqrt(np.mean(e[:, :3] ** 2)) for e in (before, after)]
    assert rms[1] < 0.6 * rms[0]
    assert 0.3 < anees < 2.0


@pytest.mark.parametrize("chunk", [SECOND // 50, 7 * SECOND])
def test_batches_do_not_matter(chunk):
    profile, _, data, asked = late(seconds=20)
    first, error, _ = scored(data, profile, asked, **REGULARIZE)
    second, again, _ = scored(data, profile, asked, chunk=chunk, **REGULARIZE)
    np.testing.assert_allclose(again, error, rtol=0.0, atol=1e-9)
    assert_same_summary(first.summary()["ground_truth"], second.summary()["ground_truth"])


def test_samples_taken_late_are_stamped_right():
    # A loop that wakes up late samples late: its stamps hold.
    rng = np.random.default_rng(2)
    profile = Profile(rng, ("hand", 60))
    times = np.arange(0.5, 59.0, 0.02) + rng.exponential(0.006, 2925)
    times = np.maximum.accumulate(times) + 1e-6 * np.arange(len(times))
    data = samples(times, noisy(rng, profile.at(times), 1e-3, 1.7e-3))
    asked = np.arange(2.0, 58.0, 0.0637)
    engine, error, _ = scored(data, profile, asked, **REGULARIZE)
    assert codes(engine) == []
    assert np.sqrt(np.mean(error[asked > 6.0, :3] ** 2)) < 1e-3


@pytest.mark.parametrize("kind", ["rest", "hand"])
def test_a_gap_costs_no_more_than_itself(kind):
    profile, _, data, asked = late(kind)
    stamped = (data.stamps - START) / SECOND
    gone = where(data, (stamped < 30.0) | (stamped > 33.0))
    for chunk in (SECOND // 10, 40 * SECOND):
        engine, error, _ = scored(gone, profile, asked, chunk=chunk, **REGULARIZE)
        outside = engine.summary()["estimate"]["rejected"].get("no_ground_truth", 0)
        assert 10 < outside < 30
        assert len(error) + sum(engine.summary()["estimate"]["rejected"].values()) == len(asked)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kaist_vio_circle_fast", "kaist_vio_rotation"])
def test_half_of_a_recording_stamped_on_arrival_against_the_other(name):
    path = DATA / name / "groundtruth.txt"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    read = read_tum(path)
    kept = slice(*np.searchsorted(read.stamps, read.stamps[0] + np.array([70, 110]) * SECOND))
    stamps, poses = read.stamps[kept], poses_of(read)[kept]
    stamping = Stamping(regularize=True)
    regular = stamping.accept(Samples(stamps, poses)).stamps
    regular = np.concatenate([regular, stamping.conclude().stamps])
    (fault,) = stamping.faults(0.0, 0.0)
    assert fault.code == "stamps_late"
    errors = []
    for each in (stamps, regular):
        data = topic(each, poses)
        found = joined(
            [
                r.evaluations
                for r in feed(
                    Engine({}), where(data, slice(0, None, 2)), where(data, slice(1, None, 2))
                )
            ]
        )
        off = found["ground_truth"][:, :3, 3] - found["estimate"][:, :3, 3]
        errors.append(np.percentile(np.linalg.norm(off, axis=1), 90))
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize(
    ("rate", "tick", "named"),
    [
        (0.7, 1.0, "whole seconds"),
        (10.0, 1.0, "whole seconds"),
        (30.0, 0.01, "ticks of 10 ms"),
        (1.0, 1.0, None),
    ],
)
def test_rounded_stamps_are_named(rate, tick, named):
    rng = np.random.default_rng(3)
    profile = Profile(rng, ("drive", 200 if rate < 20.0 else 40))
    times = np.arange(0.3, profile.duration - 1.0, 1.0 / rate)
    stamps = np.floor(times / tick) * tick
    data = samples(stamps, noisy(rng, profile.at(times), 2e-3, 1e-3))
    asked = np.arange(5.0, profile.duration - 6.0, 0.5)
    engine, _, _ = scored(data, profile, asked, **{"ground_truth.max_gap": 2.0})
    found = [f["text"] for f in engine.summary()["ground_truth"]["faults"]]
    assert any(f"rounded ({named})" in text for text in found) == (named is not None)
    notices = [notice.code for notice in engine.notices()]
    # At even intervals nothing tells, but that no clock shows whole seconds by chance.
    assert ("ground_truth_whole_seconds" in notices) == (named is None)
    if rate < 1.0:
        assert engine.summary()["ground_truth"]["fit"]["stamp_std"] > 0.25


@pytest.mark.parametrize("rate", [0.45, 0.7, 0.9])
def test_whole_seconds_are_as_uncertain_as_they_are(rate):
    rng = np.random.default_rng(0)
    profile = Profile(rng, ("drive", 200))
    times = np.arange(0.3, profile.duration - 1.0, 1.0 / rate)
    data = samples(np.floor(times), noisy(rng, profile.at(times), 2e-3, 1e-3))
    # What is asked before it could be told is left out.
    asked = np.arange(100.0, profile.duration - 8.0, 0.5)
    engine, error, anees = scored(data, profile, asked, **{"ground_truth.max_gap": 4.0})
    assert np.sqrt(np.mean(error[:, :3] ** 2)) > 0.1
    assert 0.4 < anees < 2.5
    assert engine.summary()["ground_truth"]["fit"]["stamp_std"] == pytest.approx(3.0**-0.5, 1e-4)


def test_missing_samples_are_no_rounding():
    # One in a whole second, by a clock that is right, and some of them missing.
    rng = np.random.default_rng(5)
    profile = Profile(rng, ("drive", 200))
    times = np.arange(1.0, profile.duration - 1.0)[rng.random(int(profile.duration) - 2) > 0.3]
    data = samples(times, noisy(rng, profile.at(times), 2e-3, 1e-3))
    engine, _, _ = scored(data, profile, np.arange(100.0, 190.0, 0.5))
    assert engine.summary()["ground_truth"]["fit"]["stamp_std"] == 0.0


def test_samples_taken_on_ticks_are_not_rounded():
    rng = np.random.default_rng(4)
    profile = Profile(rng, ("hand", 60))
    times = np.floor(np.arange(0.5, 59.0, 1.0 / 30.0) / 0.01) * 0.01
    data = samples(times, noisy(rng, profile.at(times), 1e-3, 1e-3))
    engine, _, _ = scored(data, profile, np.arange(2.0, 57.0, 0.1))
    assert codes(engine) == []
