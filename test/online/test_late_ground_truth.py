# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground-truth samples that come after later ones: in their place, as long as it is undecided."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_late_poses import reordered
from twins.runs import FIXED, SECOND, assert_same_summary, balance, joined, simulated, where

from trajeval_ros.online.engine import Engine

RUN = simulated(11, 6.0, dropouts=((2.0, 3.4),))


def cut(topic, sizes):
    """The topic in batches of so many messages."""
    begin, batches = 0, []
    while begin < len(topic):
        size = next(sizes)
        batches.append(topic[begin : begin + size])
        begin += size
    return batches


def played(parameters, truth, estimate, sizes):
    """Estimates as their stamps say, the ground truth in batches; the engine, finished."""
    engine, found, taken = Engine(parameters), [], 0
    for batch in cut(truth, sizes):
        until = int(np.searchsorted(estimate.stamps, batch.stamps.max(), side="right"))
        until = max(until, taken)
        engine.add_estimate(estimate[taken:until])
        engine.add_ground_truth(batch)
        taken = until
        found.append(engine.advance().evaluations)
        balance(engine)
    engine.add_estimate(estimate[taken:])
    found.append(engine.finish().evaluations)
    return engine, joined(found)


def rejected(engine):
    return engine.health().ground_truth.rejected


def without(topic, engine, truth_stamps):
    """The samples that the engine has taken, by stamp: those of a file."""
    order = np.argsort(topic.stamps, kind="stable")
    kept = np.isin(topic.stamps[order], truth_stamps)
    return where(topic, order[kept])


@given(
    seed=st.integers(0, 2**16),
    lateness=st.sampled_from([0.05, 0.3, 0.9]),
    size=st.sampled_from([7, 40]),
)
@settings(max_examples=4)
def test_samples_that_overtake_each_other(seed, lateness, size):
    """Of a topic in disorder a few are counted; with the others it is as in a file."""
    shuffled, _ = reordered(RUN.ground_truth, lateness, seed)
    engine, found = played(FIXED, shuffled, RUN.estimate, iter(lambda: size, 0))
    lost = rejected(engine).get("out_of_order", 0)
    # What was on its way when the first came late, and not again.
    assert lost <= 2 + 50.0 * lateness
    assert rejected(engine).keys() <= {"out_of_order"}
    arrived = _taken(shuffled)
    assert len(arrived) == len(shuffled) - lost
    file = Engine(FIXED)
    file.add_ground_truth(arrived)
    file.add_estimate(RUN.estimate)
    expected = joined([file.advance().evaluations, file.finish().evaluations])
    # What was decided before the first sample came late had the samples before it.
    assert np.array_equal(found["stamps"], expected["stamps"])
    assert found["ground_truth"] == pytest.approx(expected["ground_truth"], abs=1e-9)
    assert_same_summary(
        {k: v for k, v in engine.summary().items() if k != "ground_truth"},
        {k: v for k, v in file.summary().items() if k != "ground_truth"},
    )


def _taken(shuffled):
    """What becomes of each sample by the rule as it is written: sorted, but for the lost."""
    taken, newest, decided, delay = [], None, None, 0
    for n, stamp in enumerate(shuffled.stamps.tolist()):
        if newest is None or stamp > newest:
            newest = stamp
        elif stamp <= (decided or 0):
            delay = min(max(delay, 2 * (newest - stamp)), SECOND)
            continue
        taken.append(n)
        decided = max(decided or 0, newest - delay)
    order = np.array(taken)[np.argsort(shuffled.stamps[taken])]
    return where(shuffled, order)


@given(seed=st.integers(0, 2**16), sizes=st.lists(st.integers(1, 60), min_size=1, max_size=30))
@settings(max_examples=3)
def test_what_is_taken_does_not_depend_on_the_batches(seed, sizes):
    shuffled, _ = reordered(RUN.ground_truth, 0.2, seed)
    one_by_one, first = played(FIXED, shuffled, RUN.estimate, iter(lambda: 2, 0))
    cut_up, second = played(FIXED, shuffled, RUN.estimate, iter([*sizes, *[50] * 100]))
    assert rejected(one_by_one) == rejected(cut_up)
    assert np.array_equal(first["stamps"], second["stamps"])
    assert_same_summary(one_by_one.summary(), cut_up.summary())


def test_a_topic_in_order_waits_for_nothing():
    engine = Engine(FIXED)
    stamps = RUN.ground_truth.stamps
    gap = int(np.argmax(np.diff(stamps)))
    told = stamps[gap + 1] + 0.75 * (stamps[gap + 1] - stamps[gap])
    for n, stamp in enumerate(stamps):
        engine.add_ground_truth(RUN.ground_truth[n : n + 1])
        # The screen's: some, and of those after a gap three quarters of it.
        if not stamps[gap] < stamp < told:
            assert engine.health().ground_truth.pending <= 10


def test_later_than_max_wait_is_counted_and_delays_nothing():
    order = np.arange(len(RUN.ground_truth))
    late = np.insert(np.delete(order, 20), 90, 20)  # 1.4 s late
    engine = Engine(FIXED)
    engine.add_ground_truth(where(RUN.ground_truth, late))
    assert rejected(engine) == {"out_of_order": 1}
    engine.add_ground_truth(where(RUN.ground_truth, order[:0]))
    engine.finish()
    assert engine.health().ground_truth.used == len(order) - 1


def test_what_is_held_back_goes_on_with_the_clock():
    """A topic that ends, or pauses, keeps nothing back for longer than max_wait."""
    order = np.arange(len(RUN.ground_truth))
    order[[100, 101]] = order[[101, 100]]
    order[[130, 135]] = order[[135, 130]]
    engine = Engine(FIXED)
    truth = where(RUN.ground_truth, order)
    engine.add_ground_truth(truth)
    engine.add_estimate(RUN.estimate[:30])
    before = engine.health().ground_truth
    engine.advance(int(truth.stamps.max()) + 2 * SECOND)
    assert engine.health().ground_truth.pending < before.pending
    assert engine.health().ground_truth.pending == 0
