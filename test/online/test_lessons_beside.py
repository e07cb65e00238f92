# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lessons that are learned beside the run change nothing, however long each takes."""

import functools

import numpy as np
import pytest
from twins.runs import (
    SECOND,
    assert_same_summary,
    balance,
    handed_over,
    joined,
    nanoseconds,
    simulated,
)

from trajeval_ros.online.engine import Engine

DURATION = 50.0


@functools.cache
def scenario():
    run = simulated(5, DURATION, dropouts=((20.0, 22.5),))
    engine, evaluations = handed_over({}, run)
    return run, engine.summary(), evaluations


# The last is longer than what has been asked for is remembered otherwise.
@pytest.mark.parametrize("longest", [0.3, 2.0, 6.0, 60.0])
def test_figures_are_those_of_lessons_at_once(longest):
    run, expected, evaluations = scenario()
    rng = np.random.default_rng(round(longest))
    engine = Engine({}, beside=True)
    topics = (run.ground_truth, run.estimate)
    taken, found, lesson, ends, lessons, waited = [0, 0], [], None, 0.0, 0, 0
    now, behind = 0.0, False
    while now < DURATION + 1.0:
        now += rng.choice([0.02, 0.1, 0.7])
        until = [int(np.searchsorted(t.stamps, nanoseconds(now), side="right")) for t in topics]
        engine.add_ground_truth(topics[0][taken[0] : until[0]])
        engine.add_estimate(topics[1][taken[1] : until[1]])
        taken = until
        results = engine.advance_all(int(nanoseconds(now)), 20)["estimate"]
        assert len(results.evaluations) <= 20
        found.append(results.evaluations)
        behind |= engine.is_behind
        pending = balance(engine).pending
        if lesson is None and engine.lesson is not None:
            wait = longest * rng.uniform(0.5, 1.0) if lessons else 0.5
            lesson, ends, lessons = engine.lesson, now + wait, lessons + 1
        elif lesson is not None:
            waited = max(waited, pending)
            if now >= ends:
                engine.teach(lesson, lesson.learned())
                lesson = None
    found.append(engine.finish().evaluations)
    assert lessons >= 2
    assert waited > 5
    assert engine.lesson is None
    assert behind
    assert_same_summary(engine.summary(), expected)
    together = joined(found)
    assert np.array_equal(together["stamps"], evaluations["stamps"])
    for name in ("ground_truth", "covariance", "chi2", "log_likelihood"):
        size = np.nanmax(np.abs(evaluations[name]))
        np.testing.assert_allclose(
            together[name], evaluations[name], rtol=0, atol=1e-9 * size, err_msg=name
        )


def test_what_another_run_was_taught_is_not_taken():
    run, *_ = scenario()
    engine = Engine({}, beside=True)
    until = int(np.searchsorted(run.ground_truth.stamps, nanoseconds(10.0)))
    engine.add_ground_truth(run.ground_truth[:until])
    lesson = engine.lesson
    assert lesson is not None
    process = lesson.learned()
    engine.reset()
    engine.teach(lesson, process)
    assert engine.health().hyperparameters is None
    engine.add_ground_truth(run.ground_truth[:until])
    engine.teach(engine.lesson, process)
    assert engine.health().hyperparameters == process.hyperparameters


def test_poses_up_to_what_a_lesson_is_for_go_on():
    run, *_ = scenario()
    engine = Engine({}, beside=True)
    stamps = run.ground_truth.stamps
    evaluated = []
    for end in range(0, len(stamps), 10):
        engine.add_ground_truth(run.ground_truth[end : end + 10])
        inside = (run.estimate.stamps >= stamps[end]) & (
            run.estimate.stamps < stamps[min(end + 10, len(stamps) - 1)]
        )
        places = np.flatnonzero(inside)
        if len(places):
            engine.add_estimate(run.estimate[slice(places[0], places[-1] + 1)])
        if engine.lesson is not None and engine.health().hyperparameters is None:
            engine.teach(engine.lesson, engine.lesson.learned())
        evaluated.append(engine.advance().evaluations.stamps)
        if engine.lesson is not None:
            break
    closed_by = int(stamps[end])
    newest = max(int(each[-1]) for each in evaluated if len(each))
    assert newest > closed_by - 1.2 * SECOND
