# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is let in, what is refused and why, and that every message is accounted for."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.runs import (
    FIXED,
    SECOND,
    START,
    Run,
    assert_same_summary,
    balance,
    handed_over,
    poses_of,
    simulated,
)

from trajeval_ros import loops
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.intake import Intake
from trajeval_ros.online.samples import PoseSamples

WRONG_NUMBERS = [np.nan, np.inf, -np.inf]


def good(stamps):
    """Poses that nothing is wrong with but perhaps their stamps (ns)."""
    n = len(stamps)
    quaternions = np.tile([0.5, -0.5, 0.5, 0.5], (n, 1))
    positions = np.arange(3.0 * n).reshape(n, 3)
    return PoseSamples(np.asarray(stamps, dtype=np.int64), positions, quaternions)


def taken(intake, *batches):
    """Stamps let in of some batches, at the end too."""
    found = [intake.accept(batch).stamps for batch in batches]
    return np.concatenate([*found, intake.conclude().stamps])


def regular(count, begin=START):
    return begin + np.arange(count, dtype=np.int64) * SECOND // 10


def one_by_one(samples):
    return [samples[i : i + 1] for i in range(len(samples))]


@given(
    row=st.integers(0, 19),
    column=st.integers(0, 6),
    value=st.sampled_from(WRONG_NUMBERS),
)
def test_a_number_that_is_none(row, column, value):
    samples = good(regular(20))
    values = np.concatenate([samples.positions, samples.quaternions], axis=1)
    values[row, column] = value
    intake = Intake(use_covariance=False)
    found = taken(intake, PoseSamples(samples.stamps, values[:, :3], values[:, 3:]))
    assert np.array_equal(found, np.delete(samples.stamps, row))
    assert intake.account.rejected == {"non_finite": 1}
    assert intake.account.received == 20


@given(
    norm=st.one_of(
        st.floats(0.0, 2.0), st.sampled_from([0.0, 1e-200, 0.5, 0.995, 1.005, 1.1, 1e200])
    ),
    row=st.integers(0, 19),
)
def test_a_quaternion_that_is_no_rotation(norm, row):
    if min(abs(norm - 1e-6), abs(abs(norm - 1.0) - 0.01)) < 1e-9:
        return
    samples = good(regular(20))
    quaternions = samples.quaternions.copy()
    quaternions[row] *= norm
    intake = Intake(use_covariance=False)
    with np.errstate(all="ignore"):
        found = taken(intake, PoseSamples(samples.stamps, samples.positions, quaternions))
    if norm < 1e-6:
        assert intake.account.rejected == {"zero_quaternion": 1}
    elif abs(norm - 1.0) > 0.01:
        assert intake.account.rejected == {"unnormalized_quaternion": 1}
    else:
        assert intake.account.rejected == {}
    assert len(found) == 20 - intake.account.rejected_total


def test_a_quaternion_a_little_off_one_is_normalised():
    samples = good(regular(5))
    off = PoseSamples(samples.stamps, samples.positions, samples.quaternions * 1.009)
    poses = Intake(use_covariance=False).accept(off).poses
    np.testing.assert_allclose(poses, poses_of(samples)[: len(poses)], rtol=0, atol=1e-15)


@pytest.mark.parametrize("value", [1.1e9, -1e12, 1e308])
def test_a_position_that_cannot_be(value):
    samples = good(regular(5))
    samples.positions[3, 2] = value
    intake = Intake(use_covariance=False)
    assert len(taken(intake, samples)) == 4
    assert intake.account.rejected == {"implausible_position": 1}


@pytest.mark.parametrize(
    "spoil",
    [
        lambda c: c.__setitem__((3, 0, 0), np.nan),
        lambda c: c.__setitem__((3, 0, 1), 0.5),
        lambda c: c.__setitem__((3, 2, 2), -1.0),
        lambda c: c.__setitem__((3, 5, 5), np.inf),
        lambda c: c.__setitem__(3, c[3] - 2.0),
    ],
    ids=["nan", "not symmetric", "unknown, by ROS's -1", "inf", "indefinite"],
)
def test_a_covariance_that_is_none(spoil):
    samples = good(regular(5))
    covariances = np.tile(np.eye(6), (5, 1, 1))
    spoil(covariances)
    spoilt = PoseSamples(samples.stamps, samples.positions, samples.quaternions, covariances)
    intake = Intake(use_covariance=True)
    assert len(taken(intake, spoilt)) == 4
    assert intake.account.rejected == {"invalid_covariance": 1}
    # Where it is not asked for, it does not matter.
    assert len(taken(Intake(use_covariance=False), spoilt)) == 5


def test_a_zero_covariance_is_one():
    samples = good(regular(5))
    zeros = PoseSamples(samples.stamps, samples.positions, samples.quaternions, np.zeros((5, 6, 6)))
    assert len(taken(Intake(use_covariance=True), zeros)) == 5


STAMP_CASES = {
    "repeated": ([0, 1, 1, 2], [0, 1, 2], {"duplicate_stamp": 1}),
    "repeated later": ([0, 1, 2, 1, 3], [0, 1, 2, 3], {"out_of_order": 1}),
    "the first repeated": ([0, 0, 1], [0, 1], {"duplicate_stamp": 1}),
    "backwards": ([0, 5, 4, 3, 6], [0, 5, 6], {"out_of_order": 2}),
    "ahead": ([0, 1, 999, 2, 3], [0, 1, 2, 3], {"stamp_jump": 1}),
    "ahead twice": ([0, 1, 999, 2, 999, 3], [0, 1, 2, 3], {"stamp_jump": 2}),
    "the first ahead": ([999, 1, 2], [1, 2], {"stamp_jump": 1}),
    "the second ahead": ([0, 999, 1, 2], [0, 1, 2], {"stamp_jump": 1}),
    "really on": ([0, 1, 999, 1000, 1001], [0, 1, 999, 1000, 1001], {}),
    "really on, repeated": ([0, 1, 999, 999, 1000], [0, 1, 999, 1000], {"duplicate_stamp": 1}),
    "the last ahead, within an hour": ([0, 1, 999], [0, 1, 999], {}),
    "the last ahead by more": ([0, 1, 1_000_000], [0, 1], {"stamp_jump": 1}),
    "sparse": ([0, 400, 800, 1200], [0, 400, 800, 1200], {}),
    "the only one": ([7], [7], {}),
}


@pytest.mark.parametrize("case", STAMP_CASES)
@pytest.mark.parametrize("single", [False, True], ids=["one batch", "one by one"])
def test_stamps(case, single):
    tenths, kept, rejected = STAMP_CASES[case]
    samples = good(START + np.array(tenths, dtype=np.int64) * SECOND // 10)
    intake = Intake(use_covariance=False)
    found = taken(intake, *(one_by_one(samples) if single else [samples]))
    assert ((found - START) * 10 // SECOND).tolist() == kept
    assert intake.account.rejected == rejected
    assert intake.first == found[0]
    assert intake.last == found[-1]


def test_a_leap_is_held_until_it_is_told_from_a_wrong_stamp():
    intake = Intake(use_covariance=False)
    leap = regular(5)[-1] + 20 * SECOND
    # So is the first pose, as nothing tells when the run is.
    assert len(intake.accept(good(regular(1))).stamps) == 0
    assert intake.held == 1
    assert len(intake.accept(good(regular(5)[1:])).stamps) == 5
    assert len(intake.accept(good([leap])).stamps) == 0
    assert (intake.held, intake.account.rejected) == (1, {})
    assert intake.accept(good([leap + 1, leap + 2])).stamps.tolist() == [leap, leap + 1, leap + 2]
    assert (intake.held, intake.account.rejected) == (0, {})


def test_zero_and_negative_stamps():
    intake = Intake(use_covariance=False)
    stamps = np.concatenate([[0, 0, -1, -(2**62)], regular(4), [0, -1]])
    assert np.array_equal(taken(intake, good(stamps)), regular(4))
    assert intake.account.rejected == {
        "negative_stamp": 3,
        "zero_stamp": 1,
        "duplicate_stamp": 1,
        "out_of_order": 1,
    }


def test_simulated_time_starts_at_zero():
    intake = Intake(use_covariance=False)
    assert np.array_equal(taken(intake, good(regular(5, begin=0))), regular(5, begin=0))


def test_relative_time_at_one_hertz_starts_at_zero():
    intake = Intake(use_covariance=False)
    stamps = np.arange(5) * 1_000_000_000
    assert np.array_equal(taken(intake, good(stamps)), stamps)
    assert intake.account.rejected == {}


def test_the_largest_stamps():
    intake = Intake(use_covariance=False)
    top = 2**63 - 1
    found = taken(intake, good([*regular(3), top, *(regular(6)[3:])]))
    assert np.array_equal(found, regular(6))
    assert intake.account.rejected == {"stamp_jump": 1}


@given(
    leads=st.lists(
        st.tuples(st.integers(1, 28), st.sampled_from([11, 3600, 86_400, 31_536_000])),
        min_size=1,
        max_size=5,
        unique_by=lambda lead: lead[0] // 3,
    ),
    single=st.booleans(),
)
def test_single_wrong_stamps_ahead_cost_nothing_else(leads, single):
    stamps = regular(30)
    # One in three: between any two there are right ones.
    where = sorted(index // 3 * 3 + 1 for index, _ in leads)
    for index, (_, lead) in zip(where, leads, strict=True):
        stamps[index] += lead * SECOND
    intake = Intake(use_covariance=False)
    samples = good(stamps)
    found = taken(intake, *(one_by_one(samples) if single else [samples]))
    assert np.array_equal(found, np.delete(regular(30), where))
    assert intake.account.rejected == {"stamp_jump": len(where)}


@given(data=st.data())
@settings(max_examples=150)
def test_any_stamps_in_any_batches(data):
    gaps = st.one_of(
        st.integers(-30, 30),
        st.sampled_from([101, -101, 5000, -5000, 10**6, -(10**6)]),
    )
    tenths = np.cumsum(data.draw(st.lists(gaps, min_size=1, max_size=30)))
    stamps = START + tenths * (SECOND // 10)
    stamps[data.draw(st.lists(st.integers(0, len(stamps) - 1), max_size=2))] = 0
    samples = good(stamps)
    whole, parts = Intake(use_covariance=False), Intake(use_covariance=False)
    expected = taken(whole, samples)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stamps)), max_size=6)))
    edges = [0, *cuts, len(stamps)]
    found = []
    for begin, end in itertools.pairwise(edges):
        found.append(parts.accept(samples[begin:end]).stamps)
        account = parts.account
        assert account.received == end
        assert account.received == sum(map(len, found)) + parts.held + account.rejected_total
    found.append(parts.conclude().stamps)
    assert np.array_equal(np.concatenate(found), expected)
    assert parts.account.rejected == whole.account.rejected
    assert parts.account.first_rejected == whole.account.first_rejected
    assert whole.account.first_rejected.keys() == whole.account.rejected.keys()
    assert (np.diff(expected) > 0).all()
    assert np.isin(expected, stamps).all()
    assert whole.account.received == len(expected) + whole.account.rejected_total == len(stamps)


@given(data=st.data())
@settings(max_examples=150)
def test_by_one_look_in_c_and_pose_by_pose(data):
    gaps = st.lists(st.sampled_from([1, 1, 1, 1, 5, 6, 0, -1]), min_size=4, max_size=12)
    samples = good(START + np.cumsum(data.draw(gaps)) * (SECOND // 10))
    row = st.integers(0, len(samples) - 1)
    for values, spoilt in (
        (samples.positions, [np.nan, np.inf, 1e9, -1.1e9, 1e308]),
        (samples.quaternions, [np.nan, -np.inf, 0.0, 0.52, 0.5199, 0.4794, 0.48, 1e200]),
    ):
        for _ in range(data.draw(st.integers(0, 2))):
            values[data.draw(row), data.draw(st.integers(0, 2))] = data.draw(
                st.sampled_from(spoilt)
            )
    cut = data.draw(row)
    batches = samples[:cut], samples[cut:]
    intakes = Intake(use_covariance=False), Intake(use_covariance=False)
    found = [intakes[0].accept(batch) for batch in batches]
    with loops.left_out():
        expected = [intakes[1].accept(batch) for batch in batches]
    for ours, theirs in zip(found, expected, strict=True):
        assert np.array_equal(ours.stamps, theirs.stamps)
        np.testing.assert_allclose(ours.poses, theirs.poses, atol=1e-12)
    accounts = [vars(intake.account) for intake in intakes]
    assert accounts[0] == accounts[1]
    assert (intakes[0].first, intakes[0].last) == (intakes[1].first, intakes[1].last)
    assert intakes[0].held_stamp == intakes[1].held_stamp


def test_the_poses_go_with_their_stamps():
    tenths = [0, 1, 3, 2, 999, 4, 4, 5]
    samples = good(START + np.array(tenths, dtype=np.int64) * SECOND // 10)
    intake = Intake(use_covariance=False)
    first, last = intake.accept(samples[:5]), intake.accept(samples[5:])
    poses = np.concatenate([first.poses, last.poses])
    assert poses[:, 0, 3].tolist() == [0.0, 3.0, 6.0, 15.0, 21.0]
    np.testing.assert_allclose(poses, poses_of(samples)[[0, 1, 2, 5, 7]])


def test_every_reason_has_words():
    for reason in Reason:
        assert reason.explanation
        assert "\n" not in reason.explanation


def test_the_reasons_of_an_engine_that_sees_everything():
    # Every reason but those of lateness, at once, and the figures of what is good are unharmed.
    run = simulated(31, 6.0)
    expected, _ = handed_over(FIXED, run)
    position, quaternion = run.estimate.positions, run.estimate.quaternions
    rows = []  # (before which pose, stamp, position, quaternion)
    stamps = run.estimate.stamps
    nan, one = np.full(3, np.nan), quaternion[0]
    rows += [(10, stamps[10] - 1, nan, one), (20, stamps[20] - 1, position[0], 0 * one)]
    rows += [(30, stamps[30] - 1, position[0], 2 * one), (5, -5, position[0], one)]
    rows += [(6, stamps[5], position[0], one), (7, stamps[3], position[0], one)]
    rows += [(8, stamps[8] + 3600 * SECOND, position[0], one), (9, stamps[9] - 1, nan + 1e10, one)]
    rows += [(0, 0, position[0], one), (12, stamps[12] - 1, position[0] + 1e10, one)]
    rows.sort(key=lambda row: row[0])
    before = [row[0] for row in rows]
    spoilt = PoseSamples(
        np.insert(stamps, before, [row[1] for row in rows]),
        np.insert(position, before, [row[2] for row in rows], axis=0),
        np.insert(quaternion, before, [row[3] for row in rows], axis=0),
    )
    engine, _ = handed_over(FIXED, Run(run.ground_truth, spoilt))
    counts = balance(engine)
    assert counts.rejected == {
        "non_finite": 2,
        "implausible_position": 1,
        "zero_quaternion": 1,
        "unnormalized_quaternion": 1,
        "negative_stamp": 1,
        "zero_stamp": 1,
        "duplicate_stamp": 1,
        "out_of_order": 1,
        "stamp_jump": 1,
    }
    assert counts.first_rejected == {
        "zero_stamp": 0,
        "negative_stamp": 6,
        "duplicate_stamp": 8,
        "out_of_order": 10,
        "stamp_jump": 12,
        "non_finite": 14,
        "implausible_position": 19,
        "zero_quaternion": 28,
        "unnormalized_quaternion": 39,
    }
    assert counts.received == len(stamps) + 10
    for part in ("relative", "window"):
        assert_same_summary(engine.summary()[part], expected.summary()[part])


def test_the_same_of_the_ground_truth():
    run = simulated(32, 6.0)
    expected, _ = handed_over(FIXED, run)
    truth = run.ground_truth
    index = np.sort(np.concatenate([np.arange(len(truth)), [50, 100, 150, 200]]))
    stamps, position, quaternion = (
        a[index].copy() for a in (truth.stamps, truth.positions, truth.quaternions)
    )
    position[50], quaternion[101], stamps[152] = np.nan, 0.0, stamps[152] + 100 * SECOND
    spoilt = PoseSamples(stamps, position, quaternion)
    engine, _ = handed_over(FIXED, Run(spoilt, run.estimate))
    counts = engine.health().ground_truth
    assert counts.rejected == {
        "non_finite": 1,
        "zero_quaternion": 1,
        "stamp_jump": 1,
        "duplicate_stamp": 1,
    }
    assert_same_summary(engine.summary()["relative"], expected.summary()["relative"])


def test_arrays_that_do_not_fit_are_refused():
    samples = good(regular(4))
    for wrong in (
        (samples.stamps[:3], samples.positions, samples.quaternions),
        (samples.stamps, samples.positions[:, :2], samples.quaternions),
        (samples.stamps, samples.positions, samples.quaternions[:, :3]),
        (samples.stamps, samples.positions, samples.quaternions, np.eye(6)),
    ):
        with pytest.raises(ValueError, match="shape"):
            PoseSamples(*wrong)


def test_a_burst_of_ten_thousand_messages():
    stamps = START + np.arange(10_000, dtype=np.int64) * 1_000_000
    burst = good(stamps)
    engine = Engine(FIXED)
    engine.add_ground_truth(burst)
    engine.add_estimate(burst)
    engine.advance(int(stamps[-1]))
    engine.finish()
    assert balance(engine).used == 10_000
