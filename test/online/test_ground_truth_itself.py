# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simplest check there is: a trajectory against itself errs by less than its noise."""

import numpy as np
import pytest
from twins.profiles import Profile, noisy, samples
from twins.runs import SECOND, START, assert_same_summary, joined, where

from trajeval_ros import se3
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed

pytestmark = pytest.mark.slow  # together

DEGREE = np.pi / 180.0


def run(ground_truth, estimate, **parameters):
    """The summary, and the ground truth's poses where it was asked."""
    engine = Engine(parameters)
    found = joined([results.evaluations for results in feed(engine, ground_truth, estimate)])
    return engine.summary(), found["stamps"], found["ground_truth"]


def times_of(profile, rate):
    return np.arange(0.0, profile.duration - 0.01, 1.0 / rate)


# Each error with three axes; what was there before is in the comment, m and deg.
@pytest.mark.parametrize(
    ("phases", "rate", "translation", "rotation"),
    [
        ((("rest", 100), ("drive", 200)), 1, 8e-3, 0.2),  # 0.65, 7.1
        ((("drive", 200),), 1, 8e-3, 0.2),
        ((("rest", 120), ("drive", 60)), 10, 10e-3, 0.2),  # 0.11, 2.0
        ((("rest", 40), ("aggressive", 30)), 100, 3e-3, 0.1),  # 0.018, 2.3
        ((("rest", 40), ("aggressive", 30)), 100, 1.2e-3, 0.1),  # 0.011, 0.8
        ((("rest", 30), ("drive", 20), ("rest", 40), ("hand", 20)), 20, 4e-3, 0.1),  # 0.014, 0.6
        ((("creep", 60), ("spin", 30), ("creep", 30), ("drive", 30)), 5, 5e-3, 0.1),
    ],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_errs_by_less_than_the_noise(phases, rate, translation, rotation, seed):
    rng = np.random.default_rng(seed)
    profile = Profile(rng, *phases)
    times = times_of(profile, rate)
    data = samples(times, noisy(rng, profile.at(times), translation, rotation * DEGREE))
    summary, _, _ = run(data, data)
    conventional = summary["conventional"]
    assert conventional["ate_translation_rmse"] < np.sqrt(3.0) * translation
    assert conventional["ate_rotation_rmse"] < np.sqrt(3.0) * rotation * DEGREE
    for figures in (summary["relative"], summary["absolute"], summary["window"]["relative"]):
        assert figures["chi2_per_dof"] < 2.0
    assert max(summary["ground_truth"]["fit"][f"{g}_mean_square"] for g in _GROUPS) < 2.0


_GROUPS = ("translation", "rotation")


@pytest.mark.parametrize(("rest", "rate"), [(20, 25), (60, 100)])
def test_half_of_the_samples_against_the_other(rest, rate):
    rng = np.random.default_rng(4)
    profile = Profile(rng, ("rest", rest), ("hand", 40))
    times = times_of(profile, rate)
    data = samples(times, noisy(rng, profile.at(times), 2e-3, 0.1 * DEGREE))
    even, odd = (where(data, slice(k, None, 2)) for k in (0, 1))
    summary, stamps, poses = run(even, odd)
    truth = profile.at((stamps - START) / SECOND)
    error = np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)
    assert np.sqrt(np.mean(error**2)) < 3e-3  # 24 mm and 9 mm before
    assert summary["conventional"]["ate_translation_rmse"] < 1.5 * np.sqrt(3.0) * 2e-3


def faulty(fault, seed=3, seconds=60, rate=100):
    """Ground truth with a fault, and a perfect estimate at 20 Hz; the truth as a function."""
    rng = np.random.default_rng(seed)
    profile = Profile(rng, ("hand", seconds))
    times = times_of(profile, rate)
    poses = noisy(rng, profile.at(times), 2e-3, 0.1 * DEGREE)
    asked = np.arange(1.0, seconds - 1.0, 0.05) + 0.0013
    return profile, samples(times, fault(rng, times, poses)), samples(asked, profile.at(asked))


def errors(profile, stamps, poses):
    truth = profile.at((stamps - START) / SECOND)
    moved = np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)
    between = np.swapaxes(truth[:, :3, :3], 1, 2) @ poses[:, :3, :3]
    turned = np.arccos(np.clip(0.5 * (np.trace(between, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    return np.sqrt(np.mean(moved**2)), np.sqrt(np.mean(turned**2))


def outliers(rng, times, poses):
    poses = poses.copy()
    wrong = rng.random(len(times)) < 0.01
    direction = rng.normal(size=(len(times), 3))
    poses[wrong, :3, 3] += (direction / np.linalg.norm(direction, axis=1)[:, None])[wrong]
    return poses


def frozen(rng, times, poses):
    poses = poses.copy()
    for begin in np.arange(10.0, times[-1] - 3.0, 20.0):
        still = np.flatnonzero((times >= begin) & (times < begin + 2.0))
        poses[still] = poses[still[0]]
    return poses


def flipped_once(rng, times, poses):
    poses = poses.copy()
    poses[len(times) // 2, :3, :3] = poses[len(times) // 2, :3, :3] @ np.diag([-1.0, -1.0, 1.0])
    return poses


def flipped(rng, times, poses):
    poses = poses.copy()
    while_flipped = (times > 30.0) & (times < 31.5)
    poses[while_flipped, :3, :3] = poses[while_flipped, :3, :3] @ np.diag([-1.0, -1.0, 1.0])
    return poses


@pytest.mark.parametrize(
    ("fault", "code", "reason", "begin", "end"),
    [
        (outliers, "outliers", "outlier", 0.0, 60.0),
        (flipped_once, "flip", "flip", 29.9, 30.1),
        (flipped, "flip", None, 30.0, 31.6),
        (frozen, "frozen", "frozen", 10.0, 52.1),
    ],
)
def test_a_fault_is_named_and_does_not_rule(fault, code, reason, begin, end):
    profile, ground_truth, estimate = faulty(fault)
    summary, stamps, poses = run(ground_truth, estimate)
    (found,) = summary["ground_truth"]["faults"]
    assert found["code"] == code
    assert begin <= (found["begin"] - START) / SECOND <= (found["end"] - START) / SECOND <= end
    account = summary["ground_truth"]
    assert (reason in account["rejected"]) == (reason is not None)
    assert account["received"] == account["used"] + sum(account["rejected"].values())
    moved, turned = errors(profile, stamps, poses)
    if fault is not frozen:  # where there is nothing to know
        assert moved < 3e-3
        assert turned < 0.2 * DEGREE
        assert summary["relative"]["chi2_per_dof"] < 2.0
    assert summary["absolute"]["chi2_per_dof"] < 3.0


def moved_from(begin, shift, turn=0.0):
    """The origin moves and turns (rad, about the vertical) at a time."""
    by = np.eye(4)
    by[:3, 3], by[:3, :3] = shift, se3.exp_so3(np.array([0.0, 0.0, turn]))
    return lambda rng, times, poses: np.where((times > begin)[:, None, None], by @ poses, poses)


@pytest.mark.parametrize(
    ("shift", "turn", "size"),
    [
        ([0.3, 0.2, 0.1], 0.0, "(0.37"),
        ([0.3, 0.2, 0.1], 0.1, " and 5."),
        ([-6e5, 300.0, 2.0], 0.0, "(6e+05 m)"),
    ],
)
def test_a_moved_origin_is_named_and_does_not_rule(shift, turn, size):
    profile, ground_truth, estimate = faulty(moved_from(30.0, shift, turn), seconds=40)
    summary, stamps, poses = run(ground_truth, estimate)
    (found,) = summary["ground_truth"]["faults"]
    assert (found["code"], found["count"]) == ("origin_jump", 1)
    assert abs((found["begin"] - START) / SECOND - 30.01) < 1e-6
    assert size in found["text"]
    # What lies between the last sample before and the first one after is not judged.
    assert summary["estimate"]["rejected"] == {"outside_ground_truth": 1}
    off, turned = errors(profile, stamps, poses)
    assert off < 0.02
    assert turned < 0.3 * DEGREE
    assert summary["relative"]["chi2_per_dof"] < 10.0


def put_back(rng, times, poses):
    """As a simulation is reset: every fifteen seconds the body is where it began."""
    episode = (times // 15.0).astype(int)
    first = np.searchsorted(times, 15.0 * episode)
    return poses[0] @ se3.inverse(poses[first]) @ poses


@pytest.mark.parametrize("rate", [5, 50])
def test_a_body_that_is_put_back_where_it_began_is_left_there(rate):
    rng = np.random.default_rng(3)
    profile = Profile(rng, ("drive", 60))
    times = times_of(profile, rate)
    poses = noisy(rng, put_back(rng, times, profile.at(times)), 2e-3, 0.1 * DEGREE)
    summary, _, _ = run(samples(times, poses), samples(times, poses))
    (found,) = summary["ground_truth"]["faults"]
    assert (found["code"], found["count"]) == ("put_back", 3)
    assert [round((stamp - START) / SECOND) for stamp in found["stamps"]] == [15, 30, 45]
    assert summary["conventional"]["ate_translation_rmse"] < np.sqrt(3.0) * 2e-3
    assert summary["relative"]["chi2_per_dof"] < 2.0


def test_an_origin_that_moves_away_and_back_is_where_it_was():
    away = moved_from(20.0, [0.5, 0.3, 0.0], 0.3)

    def fault(rng, times, poses):
        return np.where((times > 30.0)[:, None, None], poses, away(rng, times, poses))

    rng = np.random.default_rng(5)
    profile = Profile(rng, ("rest", 60), ("drive", 20))
    times = times_of(profile, 20)
    poses = fault(rng, times, noisy(rng, profile.at(times), 2e-3, 0.1 * DEGREE))
    asked = np.arange(1.0, 79.0, 0.05) + 0.0013
    summary, stamps, found = run(samples(times, poses), samples(asked, profile.at(asked)))
    faults = summary["ground_truth"]["faults"]
    assert [(fault["code"], fault["count"]) for fault in faults] == [
        ("origin_jump", 1),
        ("put_back", 1),
    ]
    late = stamps > START + 31 * SECOND
    assert errors(profile, stamps[late], found[late])[0] < 5e-3


def test_of_a_fast_body_a_jump_is_less_than_a_step():
    rng = np.random.default_rng(3)
    profile = Profile(rng, ("drive", 60))
    times = times_of(profile, 20)
    poses = noisy(rng, profile.at(times), 2e-3, 0.1 * DEGREE)
    poses = moved_from(30.0, [0.3, 0.2, 0.1])(rng, times, poses)
    asked = np.arange(1.0, 59.0, 0.05) + 0.0013
    summary, stamps, poses = run(samples(times, poses), samples(asked, profile.at(asked)))
    assert [fault["code"] for fault in summary["ground_truth"]["faults"]] == ["origin_jump"]
    assert errors(profile, stamps, poses)[0] < 0.02


def test_growing_noise_is_named():
    rng = np.random.default_rng(2)
    profile = Profile(rng, ("hand", 100))
    times = times_of(profile, 50)
    std = np.where(times < 50.0, 2e-3, 30e-3)
    data = samples(times, noisy(rng, profile.at(times), std, 0.1 * DEGREE))
    summary, _, _ = run(data, data)
    (found,) = summary["ground_truth"]["faults"]
    assert found["code"] == "noise_grows"
    assert 45.0 < (found["begin"] - START) / SECOND < 70.0
    assert found["count"] > 25
    assert summary["ground_truth"]["fit"]["translation_noise_std"] > 15e-3
    assert summary["relative"]["chi2_per_dof"] < 2.0


@pytest.mark.parametrize("kind", ["rest", "drive", "aggressive"])
@pytest.mark.parametrize("rate", [1, 20])
def test_clean_data_have_no_faults(kind, rate):
    rng = np.random.default_rng(5)
    profile = Profile(rng, ("rest", 20), (kind, 60), ("rest", 20), ("drive", 20))
    times = times_of(profile, rate)
    data = samples(times, noisy(rng, profile.at(times), 3e-3, 0.1 * DEGREE))
    summary, _, _ = run(data, data)
    assert summary["ground_truth"]["faults"] == []
    assert summary["ground_truth"]["rejected"] == {}


@pytest.mark.parametrize(
    "fault", [outliers, frozen, flipped, put_back, moved_from(20.0, [0.3, 0.2, 0.1], 0.1)]
)
def test_batches_do_not_matter(fault):
    _, ground_truth, estimate = faulty(fault, seconds=40)
    found = []
    for chunk in (SECOND // 50, 7 * SECOND):
        engine = Engine({})
        for _ in feed(engine, ground_truth, estimate, chunk):
            pass
        found.append(engine.summary())
    first, second = found
    for part in ("ground_truth", "estimate"):
        assert_same_summary(first[part], second[part])
    for name in ("relative", "absolute"):
        expected = pytest.approx(second[name]["log_likelihood"], rel=1e-9)
        assert first[name]["log_likelihood"] == expected


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_of_a_body_that_is_told_badly_while_it_is_another_what_follows_is_right(seed):
    """As where it has fallen: it turns, tumbles in the markers' minds, and is itself again."""

    def fallen(rng, times, poses):
        poses, another = poses.copy(), (times > 30.0) & (times < 30.4)
        poses[another, :3, :3] = poses[another, :3, :3] @ np.diag([-1.0, -1.0, 1.0])
        at_last = np.flatnonzero(another & (times > 30.3))
        tumbled = se3.exp_so3(rng.normal(size=(len(at_last), 3)))
        poses[at_last, :3, :3] = poses[at_last, :3, :3] @ tumbled
        return poses

    profile, ground_truth, estimate = faulty(fallen, seed=seed)
    summary, stamps, poses = run(ground_truth, estimate)
    flips = [each for each in summary["ground_truth"]["faults"] if each["code"] == "flip"]
    assert len(flips) == 1
    after = stamps > START + 32 * SECOND
    moved, turned = errors(profile, stamps[after], poses[after])
    assert moved < 3e-3
    assert turned < 0.2 * DEGREE


@pytest.mark.parametrize("seed", [0, 2, 7])
def test_a_body_that_turns_while_its_samples_are_late_and_lost_is_no_other_body(seed):
    """Stamped on arrival, of a queue that stalls: where the motion led to is anywhere.

    What followed was turned back by as much as that was off, 40 to 130 degrees.
    """
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 60.0, 0.02)
    turned = 0.2 * np.sin(np.outer(times, [3.0, 2.6, 5.0]) + rng.uniform(0.0, 6.0, 3))
    turned[:, 2] = 2.0 * turned[:, 2] + 1.5 * np.sin(2.4 * times + rng.uniform(0.0, 6.0))
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3] = se3.exp_so3(turned)
    poses[:, :3, 3] = np.sin(np.outer(times, [0.5, 0.4, 0.7])) * [1.0, 1.0, 0.3]
    poses = noisy(rng, poses, 2e-4, 0.02 * DEGREE)
    arrival, kept = times + 1e-3 * rng.exponential(size=len(times)), np.ones(len(times), bool)
    begin = 0
    while (begin := begin + int(rng.integers(4, 25))) < len(times):
        late = times[begin] + rng.uniform(0.1, 0.35)
        stalled = np.flatnonzero((times >= times[begin]) & (times < late))
        arrival[stalled] = late + np.cumsum(rng.uniform(1e-5, 8e-4, len(stalled)))
        kept[stalled[rng.uniform(size=len(stalled)) < 0.6]] = False
    arrival = np.maximum.accumulate(arrival) + 1e-9 * np.arange(len(times))
    data = samples(arrival[kept], poses[kept])
    summary, _, _ = run(data, data)
    faults = summary["ground_truth"]["faults"]
    assert "flip" not in [fault["code"] for fault in faults]
    assert "stamp_bursts" in [fault["code"] for fault in faults]
    assert summary["conventional"]["ate_rotation_rmse"] < 0.1


def test_a_small_jump_of_the_origin_is_cut_and_left_where_it_is():
    """So that figures are of the samples as they are; against themselves there is no error."""
    rng = np.random.default_rng(5)
    profile = Profile(rng, ("drive", 40))
    times = times_of(profile, 100)
    poses = noisy(rng, profile.at(times), 5e-4, 0.02 * DEGREE)
    poses = moved_from(20.0, [0.1, 0.0, 0.1])(rng, times, poses)
    summary, _, _ = run(samples(times, poses), samples(times, poses))
    (found,) = summary["ground_truth"]["faults"]
    assert (found["code"], found["count"]) == ("origin_jump", 1)
    assert "(0.14" in found["text"]
    assert summary["conventional"]["ate_translation_rmse"] < 2e-3
