# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gaps of the ground truth, lateness, and what is given up when."""

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
    motion,
    nanoseconds,
    played,
    samples,
    simulated,
    where,
)

from trajeval_ros.ground_truth import jumps
from trajeval_ros.online import settings as settings_module
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed


def clean(truth_times, estimate_times):
    """A run without noise at given times (s)."""
    return Run(
        *(samples(nanoseconds(t), motion(np.asarray(t))) for t in (truth_times, estimate_times))
    )


def seconds(stamps):
    return (np.asarray(stamps) - START) / SECOND


def rejected(engine):
    return balance(engine).rejected


@given(
    gap=st.integers(1, 80),
    max_gap=st.sampled_from([0.35, 1.0, 2.5]),
    phase=st.integers(1, 9),
    live=st.booleans(),
)
@settings(max_examples=15)
def test_an_estimate_is_scored_where_a_sample_lies_within_max_gap(gap, max_gap, phase, live):
    begin, end = 3.0, 3.0 + 0.1 * gap
    truth = np.arange(0, 151) * 0.1
    truth = truth[(truth < begin + 0.05) | (truth > end - 0.05)]
    estimate = 0.5 + 0.01 * phase + np.arange(0, 140) * 0.1
    run = clean(truth, estimate)
    parameters = {**FIXED, "ground_truth.max_gap": max_gap}
    engine, found = (played if live else handed_over)(parameters, run)
    distance = np.abs(truth[:, None] - estimate).min(axis=0)
    scored = (distance <= max_gap) & (estimate < truth[-1])
    assert np.array_equal(found["stamps"], run.estimate.stamps[scored])
    far = int(np.count_nonzero(distance > max_gap))
    assert rejected(engine).get("no_ground_truth", 0) == far
    assert far == 0 or far < len(estimate)


def test_max_gap_itself_is_within():
    run = clean([0.0, 0.1, 0.2, 3.2, 3.3, 3.4], [0.1, 1.2, 2.2])
    _, found = handed_over(FIXED, run)
    np.testing.assert_allclose(seconds(found["stamps"]), [0.1, 1.2, 2.2], atol=1e-9)
    moved = samples(run.estimate.stamps + np.array([0, 1, -1]), motion([0.1, 1.2, 2.2]))
    engine, found = handed_over(FIXED, Run(run.ground_truth, moved))
    assert len(found["stamps"]) == 1
    assert rejected(engine) == {"no_ground_truth": 2}


def test_before_the_first_and_after_the_last_sample():
    times = np.arange(5.0, 8.0, 0.1)
    run = clean(times, [3.0, 3.5, 4.5, 4.99, 5.0, 6.05, times[-1], 7.95, 8.8, 9.0, 9.5])
    engine, found = handed_over(FIXED, run)
    assert rejected(engine) == {"no_ground_truth": 4, "outside_ground_truth": 4}
    np.testing.assert_allclose(seconds(found["stamps"]), [5.0, 6.05, times[-1]])


@pytest.mark.parametrize("delays", [(0, 0), (SECOND, 0), (0, SECOND)])
@pytest.mark.parametrize("length", [0.9, 1.9, 4.0, 8.0])
def test_a_dropout_is_the_same_live_and_from_files(length, delays):
    run = simulated(5, 14.0, dropouts=((4.0, 4.0 + length),))
    expected, _ = handed_over(FIXED, run)
    engine, _ = played(FIXED, run, 0.2, delays)
    assert_same_summary(engine.summary(), expected.summary())
    engine = Engine(FIXED)
    list(feed(engine, run.ground_truth, run.estimate))
    assert_same_summary(engine.summary(), expected.summary())
    assert (length > 2.0) == bool(rejected(engine))


def test_estimates_at_the_edge_of_a_gap_are_scored_after_its_end():
    # The completing sample lies behind the gap, so they wait for it: with the ground truth on both
    # sides, in spite of the clock.
    run = simulated(5, 12.0, dropouts=((4.0, 8.0),))
    engine = Engine(FIXED)
    edge, found = seconds(run.estimate.stamps), {}
    for now in np.arange(0.0, 12.4, 0.2):
        at = START + round(now * SECOND)
        for add, topic in (
            (engine.add_ground_truth, run.ground_truth),
            (engine.add_estimate, run.estimate),
        ):
            chosen = (topic.stamps <= at) & (topic.stamps > at - SECOND // 5)
            if chosen.any():
                first = int(np.argmax(chosen))
                add(topic[first : first + int(chosen.sum())])
        for stamp in engine.advance(at).evaluations.stamps:
            found[float(seconds(stamp))] = now
    waiting = [t for t in edge if 3.8 < t < 5.0]
    assert len(waiting) >= 10
    assert all(8.0 < found[float(t)] < 8.7 for t in waiting)
    assert all(found[float(t)] < t + 0.7 for t in edge if 0.5 < t < 3.5)


def test_uncertainty_grows_in_a_gap_and_the_conventional_figures_leave_it_out():
    parameters = {**FIXED, "ground_truth.max_gap": 20.0}
    run = simulated(5, 14.0, dropouts=((4.0, 9.0),))
    engine, found = handed_over(parameters, run)
    std = np.sqrt(np.diagonal(found["covariance"], axis1=1, axis2=2))[:, :3].max(axis=1)
    times = seconds(found["stamps"])
    usual = std[(times > 1) & (times < 3.5)].max()
    assert std[(times > 6) & (times < 7)].min() > 30 * usual
    assert len(times) == balance(engine).used
    inside = (times > 4.0) & (times < 9.0)
    assert engine.summary()["conventional"]["poses"] == np.count_nonzero(~inside)


def test_nothing_is_given_up_without_a_clock():
    run = clean([0.0, 0.1, 0.2, 0.3, 0.4], np.arange(0.05, 100.0, 1.0))
    engine = Engine(FIXED)
    engine.add_ground_truth(run.ground_truth)
    engine.add_estimate(run.estimate)
    engine.advance()
    assert balance(engine).pending == len(run.estimate) - 1
    assert rejected(engine) == {}


@given(max_wait=st.sampled_from([0.0, 0.5, 3.0]), max_gap=st.sampled_from([0.5, 1.0, 4.0]))
@settings(max_examples=9)
def test_without_ground_truth_an_estimate_is_given_up_max_gap_and_max_wait_after_its_stamp(
    max_wait, max_gap
):
    engine = Engine({**FIXED, "max_wait": max_wait, "ground_truth.max_gap": max_gap})
    engine.add_estimate(clean([0.0], [9.9, 10.0]).estimate)
    limit = START + round((10.0 + max_gap + max_wait) * SECOND)
    engine.advance(limit)
    assert balance(engine).pending == 1
    engine.advance(limit + 1)
    assert balance(engine).pending == 0
    assert rejected(engine) == {"no_ground_truth": 2}


def test_ground_truth_that_comes_just_in_time():
    # The only sample near is max_gap after the estimate and max_wait late.
    run = clean([11.0, 11.1, 11.2, 11.3], [10.0, 10.5])
    engine = Engine(FIXED)
    engine.add_estimate(run.estimate)
    now = int(run.estimate.stamps[0]) + 2 * SECOND
    engine.advance(now)
    assert balance(engine).pending == 2
    engine.add_ground_truth(run.ground_truth)
    engine.advance(now)
    assert rejected(engine) == {"outside_ground_truth": 2}


def test_a_longer_wait_set_while_it_runs_takes_effect():
    engine = Engine(FIXED)
    engine.add_estimate(clean([0.0], [10.0, 10.1]).estimate)
    engine.set("max_wait", 20.0)
    engine.advance(START + 30 * SECOND)
    assert balance(engine).pending == 2
    engine.set("max_wait", 1.0)
    engine.advance(START + 30 * SECOND)
    assert balance(engine).pending == 0


def test_a_clock_of_another_epoch_gives_up_and_does_no_other_harm():
    run = simulated(5, 6.0)
    engine = Engine(FIXED)
    engine.add_estimate(run.estimate[:20])
    engine.advance(2 * START)
    assert rejected(engine) == {"no_ground_truth": 20}
    engine.add_ground_truth(run.ground_truth)
    engine.add_estimate(run.estimate[20:])
    engine.advance(0)
    engine.finish()
    assert balance(engine).used == len(run.estimate) - 20


def test_ground_truth_lost_for_a_minute():
    run = simulated(6, 90.0, rates=(20.0, 5.0), dropouts=((10.0, 70.0),))
    expected, _ = handed_over(FIXED, run)
    engine, found = played(FIXED, run, 0.5)
    assert_same_summary(engine.summary(), expected.summary())
    times = seconds(found["stamps"])
    assert np.count_nonzero(times > 70.0) > 95
    # Up to the last sample before.
    assert np.count_nonzero(times < 69.0) == np.count_nonzero(seconds(run.estimate.stamps) < 9.95)
    assert balance(engine).pending == 0
    assert set(rejected(engine)) == {"no_ground_truth", "outside_ground_truth"}


def test_the_windows_length_decides_nothing():
    run = simulated(5, 14.0, dropouts=((4.0, 9.0),))
    expected, _ = handed_over(FIXED, run)
    engine = Engine({**FIXED, "window.duration": 20.0})
    for results in feed(engine, run.ground_truth, run.estimate):
        engine.set("window.duration", 1.0 if len(results.evaluations) % 2 else 30.0)
    engine.set("window.duration", 30.0)
    assert rejected(engine) == rejected(expected)
    assert_same_summary(engine.figures(), expected.figures())


@pytest.fixture
def impatient(monkeypatch):
    """A patience of a second, or of max_gap and lag, so that a run need not be longer."""
    monkeypatch.setattr(settings_module, "PATIENCE", SECOND)
    # Samples after a gap are held back for three quarters of it, 3 s at most: less than 30 s.
    monkeypatch.setattr(jumps, "LONGEST", SECOND // 2)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("delay", [0.5, 1.0, 1.75, 2.25, 2.5, 2.75, 3.0, 4.0])
def test_an_estimate_later_than_the_patience_is_too_late_or_exact(delay):
    run = simulated(1, 12.0)
    _, exact = handed_over(FIXED, run)
    engine, found = played(FIXED, run, 0.1, (0, round(delay * SECOND)))
    index = np.isin(exact["stamps"], found["stamps"])
    np.testing.assert_allclose(
        found["ground_truth"], exact["ground_truth"][index], rtol=0, atol=1e-13
    )
    np.testing.assert_allclose(found["covariance"], exact["covariance"][index], rtol=0, atol=1e-16)
    assert set(balance(engine).rejected) <= {"too_late"}


def test_an_estimate_later_than_what_is_kept_is_too_late(monkeypatch):
    monkeypatch.setattr(settings_module, "PATIENCE", 5 * SECOND)
    run = simulated(5, 60.0, rates=(20.0, 2.0))
    engine = Engine(FIXED)
    engine.add_estimate(run.estimate[:4])
    for begin in range(0, len(run.ground_truth), 50):
        engine.add_ground_truth(run.ground_truth[begin : begin + 50])
        engine.advance()
    engine.add_estimate(run.estimate[4:])
    engine.finish()
    counts = balance(engine)
    assert set(counts.rejected) == {"too_late"}
    # What is not older than that is there.
    recent = np.count_nonzero(run.estimate.stamps > run.ground_truth.stamps[-1] - 5 * SECOND)
    assert counts.used >= 4 + recent
    assert counts.rejected["too_late"] > 60


@pytest.mark.usefixtures("impatient")
def test_a_pause_of_both_topics():
    run = simulated(2, 14.0)
    run = Run(
        *(
            where(t, (t.stamps < START + 5 * SECOND) | (t.stamps > START + 9 * SECOND))
            for t in (run.ground_truth, run.estimate)
        )
    )
    expected, _ = handed_over(FIXED, run)
    live, _ = played(FIXED, run, 0.1)
    file = Engine(FIXED)
    list(feed(file, run.ground_truth, run.estimate))
    assert_same_summary(live.summary(), expected.summary())
    assert_same_summary(file.summary(), expected.summary())
    assert balance(live).used == len(run.estimate)


@pytest.mark.usefixtures("impatient")
def test_idling_after_the_end():
    run = simulated(2, 8.0)
    expected, _ = handed_over(FIXED, run)
    engine = Engine(FIXED)
    engine.add_ground_truth(run.ground_truth)
    engine.add_estimate(run.estimate)
    engine.advance(int(run.estimate.stamps[-1]))
    engine.advance(int(run.estimate.stamps[-1]) + 1000 * SECOND)
    engine.finish()
    assert_same_summary(engine.summary(), expected.summary())


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("delay", [0.0, 0.9])
def test_the_completing_sample_just_beyond_patience(delay):
    run = simulated(2, 9.0)
    gone = (run.ground_truth.stamps > START + 5.23 * SECOND) & (
        run.ground_truth.stamps < START + 6.45 * SECOND
    )
    run = Run(where(run.ground_truth, ~gone), run.estimate)
    expected, _ = handed_over(FIXED, run)
    live, _ = played(FIXED, run, 0.02, (round(delay * SECOND), 0))
    assert_same_summary(live.summary(), expected.summary())


@pytest.mark.parametrize("apart", [9, 12, 40])
def test_sparse_estimates_are_all_evaluated(apart):
    run = simulated(3, 200.0, rates=(20.0, 1.0))
    sparse = Run(run.ground_truth, where(run.estimate, np.arange(len(run.estimate)) % apart == 5))
    engine, _ = played(FIXED, sparse)
    assert balance(engine).used == len(sparse.estimate)


@pytest.mark.usefixtures("impatient")
def test_max_wait_longer_than_the_patience():
    parameters = {**FIXED, "max_wait": 5.0}
    run = simulated(1, 8.0)
    expected, _ = handed_over(parameters, run)
    for delays in ((0, 4 * SECOND), (4 * SECOND, 0)):
        engine, _ = played(parameters, run, 0.25, delays)
        assert_same_summary(engine.summary(), expected.summary())
