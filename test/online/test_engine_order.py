# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The same data give the same numbers, in whatever order and batches they arrive."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.runs import (
    FIXED,
    SECOND,
    Run,
    assert_same_summary,
    balance,
    handed_over,
    joined,
    play,
    played,
    samples,
    simulated,
)

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.samples import PoseSamples

DROPOUTS = ((4.0, 6.5), (9.0, 9.4))


@functools.cache
def scenario(fixed=True):
    """A run with two gaps, and what the engine makes of it handed over at once."""
    run = simulated(11, 12.0, dropouts=DROPOUTS)
    parameters = FIXED if fixed else {}
    engine, evaluations = handed_over(parameters, run)
    return run, parameters, engine.summary(), evaluations


def assert_same(engine, evaluations, expected_summary, expected):
    assert_same_summary(engine.summary(), expected_summary)
    assert np.array_equal(evaluations["stamps"], expected["stamps"])
    assert np.array_equal(evaluations["estimate"], expected["estimate"])
    # Nearly the same digits: the arithmetic is laid out by positions in the data, not by batches.
    np.testing.assert_allclose(
        evaluations["ground_truth"], expected["ground_truth"], rtol=0, atol=1e-13
    )
    size = np.abs(expected["covariance"]).max()
    np.testing.assert_allclose(
        evaluations["covariance"], expected["covariance"], rtol=0, atol=1e-11 * size
    )
    for name in ("relative_error", "chi2", "log_det", "log_likelihood", "relative_log_likelihood"):
        size = np.nanmax(np.abs(expected[name]))
        np.testing.assert_allclose(
            evaluations[name], expected[name], rtol=0, atol=1e-9 * size, err_msg=name
        )


def test_the_scenario_has_evaluated_and_rejected_estimates():
    run, _, summary, _ = scenario()
    counts = summary["estimate"]
    assert counts["evaluated"] > 90
    # In the long gap 2.5 s - 2 * 1 s are further than a second from any sample.
    assert counts["rejected"] == {"no_ground_truth": 5}
    assert counts["received"] == len(run.estimate)


@given(data=st.data())
@settings(max_examples=10)
def test_interleaving_batch_cuts_delays_and_the_clock_do_not_matter(data):
    run, parameters, summary, evaluations = scenario()
    period = data.draw(st.sampled_from([0.1, 0.31, 1.0, 4.0]), "seconds between ticks")
    delays = tuple(
        data.draw(st.integers(0, SECOND), f"delay of the {name}")
        for name in ("ground truth", "estimate")
    )
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1), "seed of the cuts"))
    engine, found = played(
        parameters,
        run,
        period,
        delays,
        cuts=lambda count: np.sort(rng.integers(0, count + 1, rng.integers(0, 4))),
        order=lambda _: int(rng.integers(2)),
    )
    assert_same(engine, found, summary, evaluations)
    balance(engine)


def test_jitter_of_the_arrival_does_not_matter():
    run, parameters, summary, evaluations = scenario()
    rng = np.random.default_rng(3)
    delays = tuple(
        rng.integers(0, SECOND, len(topic)) for topic in (run.ground_truth, run.estimate)
    )
    engine, found = played(parameters, run, 0.02, delays)
    assert_same(engine, found, summary, evaluations)


def test_one_message_at_a_time_in_the_order_of_their_stamps():
    run, parameters, summary, evaluations = scenario()
    engine, found = Engine(parameters), []
    stamps = np.concatenate([run.ground_truth.stamps, run.estimate.stamps])
    for i in np.argsort(stamps, kind="stable"):
        n = int(i) - len(run.ground_truth)
        if n < 0:
            engine.add_ground_truth(run.ground_truth[int(i) : int(i) + 1])
        else:
            engine.add_estimate(run.estimate[n : n + 1])
        found.append(engine.advance(int(stamps[i])).evaluations)
        balance(engine)
    found.append(engine.finish().evaluations)
    assert_same(engine, joined(found), summary, evaluations)


@pytest.mark.parametrize("first", [0, 1], ids=["ground truth first", "estimates first"])
@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_one_topic_after_the_other(first, size):
    # Without a clock nothing is given up, and until an estimate comes only the ground truth older
    # than a window is dropped.
    run, parameters, summary, evaluations = scenario()
    engine, found = Engine(parameters), []
    topics = [(engine.add_ground_truth, run.ground_truth), (engine.add_estimate, run.estimate)]
    for add, topic in (topics[first], topics[1 - first]):
        for begin in range(0, len(topic), size):
            add(topic[begin : begin + size])
            found.append(engine.advance().evaluations)
    found.append(engine.finish().evaluations)
    assert_same(engine, joined(found), summary, evaluations)


@pytest.mark.parametrize("chunk", [SECOND // 20, SECOND, 3 * SECOND, 1000 * SECOND])
def test_feed_equals_live(chunk):
    run, parameters, summary, evaluations = scenario()
    engine = Engine(parameters)
    found = [r.evaluations for r in feed(engine, run.ground_truth, run.estimate, chunk)]
    assert_same(engine, joined(found), summary, evaluations)


def test_empty_batches_do_not_matter():
    run, parameters, summary, evaluations = scenario()
    engine, found = Engine(parameters), []
    for begin in range(0, len(run.ground_truth), 100):
        engine.add_ground_truth(run.ground_truth[:0])
        engine.add_ground_truth(run.ground_truth[begin : begin + 100])
        engine.add_estimate(run.estimate[:0])
        found.append(engine.advance().evaluations)
        assert len(engine.advance().evaluations) == 0
    engine.add_estimate(run.estimate)
    found.append(engine.finish().evaluations)
    assert_same(engine, joined(found), summary, evaluations)


@given(
    delay=st.tuples(st.integers(0, SECOND), st.integers(0, SECOND)),
    period=st.sampled_from([0.2, 0.77]),
)
@settings(max_examples=4)
def test_bad_messages_do_not_make_the_order_matter(delay, period):
    run, parameters, _, _ = scenario()
    truth, estimate = (
        _spoilt(topic, seed) for topic, seed in ((run.ground_truth, 5), (run.estimate, 6))
    )
    spoilt = Run(truth, estimate)
    expected, evaluations = handed_over(parameters, spoilt)
    # What a message is good for is told by its stamp; its arrival follows the true time.
    true_times = Run(run.ground_truth, run.estimate)
    delays = tuple(
        _arrivals(bad, good) - bad.stamps + d
        for bad, good, d in zip(
            (truth, estimate), (true_times.ground_truth, true_times.estimate), delay, strict=True
        )
    )
    engine = Engine(parameters)
    first, last = run.ground_truth.stamps[0], run.ground_truth.stamps[-1] + 3 * SECOND
    ticks = np.arange(first, last, round(period * SECOND))
    found = play(engine, spoilt, ticks, delays)
    assert sum(balance(engine).rejected.values()) >= 10
    assert_same(engine, found, expected.summary(), evaluations)


def _arrivals(bad, good):
    index = np.linspace(0, len(good) - 1, len(bad)).round().astype(int)
    return good.stamps[index]


def _spoilt(topic, seed):
    """The topic with some messages broken and some repeated."""
    rng = np.random.default_rng(seed)
    index = np.sort(np.concatenate([np.arange(len(topic)), rng.integers(10, len(topic), 4)]))
    stamps, position, quaternion = (
        a[index].copy() for a in (topic.stamps, topic.positions, topic.quaternions)
    )
    where = rng.permutation(np.arange(10, len(index)))[:9]
    position[where[0]] = np.nan
    quaternion[where[1]] = 0.0
    quaternion[where[2]] *= 1.1
    position[where[3], 1] = -np.inf
    stamps[where[4]] = 0
    stamps[where[5]] = -1
    stamps[where[6]] -= 2 * SECOND
    stamps[where[7]] += 100 * SECOND
    position[where[8]] = 1e12
    return PoseSamples(stamps, position, quaternion)


def test_relearning_the_same_run_after_a_reset_gives_the_same_figures():
    run, parameters, summary, evaluations = scenario()
    engine = Engine(parameters)
    played_once = play(engine, run, [run.ground_truth.stamps[-1]])
    engine.reset()
    assert engine.health().estimate.received == 0
    assert engine.summary()["relative"]["log_likelihood"] is None
    again = play(engine, run, [run.ground_truth.stamps[-1]])
    assert_same(engine, again, summary, evaluations)
    np.testing.assert_allclose(again["chi2"], played_once["chi2"], rtol=1e-9)


def test_estimates_of_a_rigidly_displaced_clock_are_displaced_only():
    # The whole run moved in time by two days: stamps are compared exactly, so nothing changes.
    run, parameters, summary, evaluations = scenario()
    later = Run(
        *(
            PoseSamples(t.stamps + 172_800 * SECOND, t.positions, t.quaternions)
            for t in (run.ground_truth, run.estimate)
        )
    )
    engine, found = handed_over(parameters, later)
    found["stamps"] = found["stamps"] - 172_800 * SECOND
    assert_same(engine, found, summary, evaluations)
    np.testing.assert_allclose(found["chi2"], evaluations["chi2"], rtol=1e-9)


def test_samples_is_the_inverse_of_the_intake():
    # The helper itself: what the engine gets is what the scenario means.
    run, _, _, evaluations = scenario()
    again = samples(evaluations["stamps"], evaluations["estimate"])
    kept = np.isin(run.estimate.stamps, evaluations["stamps"])
    np.testing.assert_allclose(again.positions, run.estimate.positions[kept], atol=1e-14)


@pytest.mark.parametrize("period", [0.1, 0.5, 3.0])
def test_learning_does_not_depend_on_the_batches(period):
    run = simulated(11, 15.0, dropouts=((4.0, 6.5),))
    expected, _ = handed_over({}, run)
    engine, _ = played({}, run, period)
    assert_same_summary(engine.summary(), expected.summary())


@pytest.mark.parametrize("lead", [11, 100, 30_000_000])
@pytest.mark.parametrize("topic", [0, 1])
def test_a_wrong_stamp_costs_one_pose_by_file_too(lead, topic):
    run = simulated(2, 12.0)
    topics = [run.ground_truth, run.estimate]
    stamps = topics[topic].stamps.copy()
    stamps[len(stamps) // 3] += lead * SECOND
    topics[topic] = PoseSamples(stamps, topics[topic].positions, topics[topic].quaternions)
    expected, _ = handed_over(FIXED, Run(*topics))
    engine = Engine(FIXED)
    list(feed(engine, *topics))
    assert_same_summary(engine.summary(), expected.summary())
    assert balance(engine).used >= len(run.estimate) - 1


@pytest.mark.parametrize("lead", [1.0, 3.0, 9.0])
@pytest.mark.parametrize("topic", [0, 1])
def test_a_stamp_a_few_seconds_ahead_costs_one_pose(lead, topic):
    run = simulated(2, 12.0)
    topics = [run.ground_truth, run.estimate]
    stamps = topics[topic].stamps.copy()
    stamps[len(stamps) // 3] += round(lead * SECOND)
    topics[topic] = PoseSamples(stamps, topics[topic].positions, topics[topic].quaternions)
    engine, _ = handed_over(FIXED, Run(*topics))
    assert balance(engine).used >= len(run.estimate) - 1
