# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of an estimate that come after later ones: in their place, as long as it is undecided."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.runs import (
    FIXED,
    SECOND,
    assert_same_summary,
    balance,
    handed_over,
    joined,
    simulated,
    where,
)

from trajeval_ros.online.coverage import Presence
from trajeval_ros.online.engine import Engine

RUN = simulated(11, 12.0, dropouts=((4.0, 5.4),))


def reordered(topic, seconds, seed):
    """The topic in the order of an arrival that is late by up to so much; the first two as sent.

    The first message of a topic has nothing before it that would tell its stamp from a wrong one.
    """
    rng = np.random.default_rng(seed)
    arrival = topic.stamps + rng.integers(0, round(seconds * SECOND), len(topic))
    arrival[:2] = topic.stamps[:2]
    return where(topic, np.argsort(arrival, kind="stable")), np.sort(arrival)


@given(
    seed=st.integers(0, 2**16),
    lateness=st.sampled_from([0.12, 0.4]),
    period=st.sampled_from([0.02, 0.3, 2.0]),
)
@settings(max_examples=4)
def test_late_poses_whose_ground_truth_comes_later_still_are_as_in_a_file(seed, lateness, period):
    """Live = file: the file's rows are by stamp."""
    expected, evaluations = handed_over(FIXED, RUN)
    shuffled, arrival = reordered(RUN.estimate, lateness, seed)
    assert (np.diff(shuffled.stamps) < 0).any()
    engine, found, taken = Engine(FIXED), [], [0, 0]
    # Late enough that nothing that is still to come has been decided: the lag is 0.3 s.
    truth_arrival = RUN.ground_truth.stamps + round((lateness + 0.3) * SECOND)
    first, last = int(arrival[0]), int(truth_arrival[-1])
    for now in range(first, last + round(period * SECOND), round(period * SECOND)):
        until = [int(np.searchsorted(a, now, side="right")) for a in (truth_arrival, arrival)]
        engine.add_estimate(shuffled[taken[1] : until[1]])
        engine.add_ground_truth(RUN.ground_truth[taken[0] : until[0]])
        taken = until
        found.append(engine.advance().evaluations)
        balance(engine)
    found.append(engine.finish().evaluations)
    assert balance(engine).rejected == expected.health().estimate.rejected
    assert_same_summary(engine.summary(), expected.summary())
    assert np.array_equal(joined(found)["stamps"], evaluations["stamps"])


def test_what_has_been_decided_is_counted():
    """The pose before it has been scored: it would be scored with a step that is no step."""
    engine = Engine(FIXED)
    order = np.arange(len(RUN.estimate))
    order[20:22] = order[20:22][::-1]
    late = where(RUN.estimate, order)
    engine.add_ground_truth(RUN.ground_truth)
    for n in range(len(late)):
        engine.add_estimate(late[n : n + 1])
        engine.advance()
        balance(engine)
    engine.finish()
    assert balance(engine).rejected["out_of_order"] == 1


@pytest.mark.parametrize(("wait", "taken"), [(1.0, True), (0.05, False)])
def test_how_late_is_max_wait(wait, taken):
    engine = Engine({**FIXED, "max_wait": wait})
    order = np.arange(len(RUN.estimate))
    order[20:22] = order[20:22][::-1]
    engine.add_estimate(where(RUN.estimate, order))
    engine.add_ground_truth(RUN.ground_truth)
    engine.finish()
    assert ("out_of_order" in balance(engine).rejected) is not taken


@pytest.mark.parametrize("apart", [False, True], ids=["one batch", "several"])
def test_a_late_pose_that_is_there_already(apart):
    """Once, however the messages are cut."""
    engine = Engine(FIXED)
    order = [*range(22), 20, 19, *range(22, len(RUN.estimate))]
    repeated = where(RUN.estimate, np.array(order))
    for batch in [repeated[n : n + 1] for n in range(len(order))] if apart else [repeated]:
        engine.add_estimate(batch)
        engine.advance()
    engine.add_ground_truth(RUN.ground_truth)
    engine.finish()
    assert balance(engine).rejected["out_of_order"] == 2


def test_a_late_pose_covers_its_time():
    presence, whole = Presence(), Presence()
    stamps = np.arange(10) * SECOND // 10
    presence.add(np.delete(stamps, [3, 4]))
    presence.add(np.append(stamps[[4]], stamps[-1] + 5 * SECOND))
    presence.add(stamps[[3]])
    whole.add(np.append(stamps, stamps[-1] + 5 * SECOND))
    end = int(stamps[-1]) + 6 * SECOND
    assert np.array_equal(presence.losses(0, end), whole.losses(0, end))
    assert presence.losses(0, end).tolist()[0] == [int(stamps[-1]), int(stamps[-1]) + 5 * SECOND]


def test_late_poses_of_several_estimates_do_not_touch_each_other():
    shuffled, _ = reordered(RUN.estimate, 0.2, 3)
    engine = Engine({**FIXED, "estimates": ["a", "b"]}, ("a", "b"))
    engine.add_estimate(shuffled, "a")
    engine.add_estimate(RUN.estimate, "b")
    engine.add_ground_truth(RUN.ground_truth)
    engine.finish_all()
    a, b = (engine.summary(name) for name in ("a", "b"))
    assert_same_summary(a, b)
