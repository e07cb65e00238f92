# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The lag rule: with which samples an estimate is scored, and when."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.runs import FIXED, SECOND, Run, balance, handed_over, poses_of, simulated

from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.intake import LEAP

LAG = 3 * SECOND // 10


@functools.cache
def scenario():
    run = simulated(21, 8.0, dropouts=((3.0, 3.9),))
    return run, handed_over(FIXED, run)[1]


def completing(run, stamp, lag=LAG):
    """Index of the first sample at or after ``stamp + lag``."""
    return int(np.argmax(run.ground_truth.stamps >= stamp + lag))


def answer_from(run, count, stamp, parameters=FIXED):
    """The answer of a ground truth that has only ever seen the first ``count`` samples."""
    truth = Engine(parameters)._reference.ground_truth
    seen = run.ground_truth[:count]
    truth.append(Samples(seen.stamps, poses_of(seen)))
    return truth.posterior(np.array([stamp]), seen.stamps[-1:])


def test_an_estimate_is_scored_with_the_samples_up_to_the_completing_one_and_no_others():
    run, evaluations = scenario()
    compared = 0
    for i, stamp in enumerate(evaluations["stamps"]):
        if stamp + LAG > run.ground_truth.stamps[-1]:
            continue
        last = completing(run, stamp)
        exact = answer_from(run, last + 1, stamp)
        np.testing.assert_allclose(
            evaluations["ground_truth"][i], exact.poses[0], rtol=0, atol=1e-13
        )
        np.testing.assert_allclose(
            evaluations["covariance"][i], exact.covariances[0], rtol=0, atol=1e-16
        )
        compared += 1
    assert compared > 70


def test_one_sample_less_or_more_is_another_answer():
    # So that the test above can fail.
    run, evaluations = scenario()
    sizes = []
    for i in range(10, 70, 10):
        stamp = evaluations["stamps"][i]
        last = completing(run, stamp)
        for count in (last, last + 2):
            other = answer_from(run, count, stamp)
            sizes.append(np.abs(other.covariances[0] - evaluations["covariance"][i]).max())
    assert min(sizes) > 1e-15


@given(index=st.integers(5, 60), more=st.integers(0, 150))
@settings(max_examples=25)
def test_samples_that_come_before_it_is_evaluated_change_nothing(index, more):
    run, evaluations = scenario()
    i = int(np.searchsorted(evaluations["stamps"], run.estimate.stamps[index]))
    if i >= len(evaluations["stamps"]) or evaluations["stamps"][i] != run.estimate.stamps[index]:
        return  # in the gap
    last = completing(run, run.estimate.stamps[index]) + more
    last = min(last, len(run.ground_truth.stamps) - 1)
    if run.ground_truth.stamps[last] - run.ground_truth.stamps[last - 1] > LEAP:
        return  # that sample is held back, until the next one tells that time went on
    engine = Engine(FIXED)
    engine.add_estimate(run.estimate[index - 1 : index + 1])
    engine.add_ground_truth(
        run.ground_truth[: completing(run, run.estimate.stamps[index]) + 1 + more]
    )
    found = engine.advance().evaluations
    given = run.ground_truth.stamps[: last + 1]
    (gap,) = np.flatnonzero(np.diff(run.ground_truth.stamps) > LEAP)
    before, after = run.ground_truth.stamps[[gap, gap + 1]]
    if found.stamps.max(initial=0) < evaluations["stamps"][i]:
        # Those after a gap are held back, until it is told whether the origin has jumped.
        assert before < given[-1] < after + 0.75 * (after - before) + SECOND // 10
        return
    assert found.stamps[-1] == evaluations["stamps"][i]
    np.testing.assert_allclose(
        found.ground_truth[-1], evaluations["ground_truth"][i], rtol=0, atol=1e-13
    )
    np.testing.assert_allclose(
        found.covariance[-1], evaluations["covariance"][i], rtol=0, atol=1e-16
    )


def test_an_estimate_waits_for_the_completing_sample_and_not_longer():
    run, _ = scenario()
    engine = Engine(FIXED)
    engine.add_estimate(run.estimate)
    evaluated = 0
    for i in range(120):
        engine.add_ground_truth(run.ground_truth[i : i + 1])
        # Before the leap is told from a wrong stamp, nothing is let in of either topic.
        newest = engine.health().ground_truth.latest_stamp
        evaluated += len(engine.advance().evaluations)
        before = -SECOND if newest is None else newest
        due = np.count_nonzero(run.estimate.stamps + LAG <= before)
        assert balance(engine).used == evaluated == due


def test_a_sample_exactly_at_the_lag_completes():
    run, _ = scenario()
    truth = run.ground_truth
    stamps = truth.stamps.copy()
    stamp = int(run.estimate.stamps[20])
    last = completing(run, stamp)
    for shift, due in ((0, True), (-1, False)):
        stamps[last] = stamp + LAG + shift
        moved = type(truth)(
            stamps[: last + 1], truth.positions[: last + 1], truth.quaternions[: last + 1]
        )
        engine = Engine(FIXED)
        engine.add_estimate(run.estimate[19:21])
        engine.add_ground_truth(moved)
        assert (engine.advance().evaluations.stamps[-1] == stamp) == due


def test_without_lag_the_next_sample_is_the_last_one():
    run, _ = scenario()
    parameters = {**FIXED, "ground_truth.lag": 0.0}
    _, evaluations = handed_over(parameters, run)
    for i in range(0, len(evaluations["stamps"]), 7):
        stamp = evaluations["stamps"][i]
        exact = answer_from(run, completing(run, stamp, 0) + 1, stamp, parameters)
        np.testing.assert_allclose(
            evaluations["covariance"][i], exact.covariances[0], rtol=0, atol=1e-16
        )


@pytest.mark.parametrize("seconds", [0.0, 0.1, 0.3, 2.0])
def test_more_lag_is_less_uncertainty(seconds):
    run, _ = scenario()
    _, less = handed_over({**FIXED, "ground_truth.lag": seconds}, run)
    _, more = handed_over({**FIXED, "ground_truth.lag": seconds + 0.5}, run)
    traces = [np.trace(e["covariance"], axis1=1, axis2=2) for e in (less, more)]
    assert len(traces[0]) == len(traces[1])
    assert traces[1].sum() < traces[0].sum()


def test_at_the_end_what_is_there_is_used():
    run, evaluations = scenario()
    end = run.ground_truth.stamps[-1]
    tail = np.flatnonzero(evaluations["stamps"] + LAG > end)
    assert len(tail) >= 2
    for i in tail:
        exact = answer_from(run, len(run.ground_truth), evaluations["stamps"][i])
        np.testing.assert_allclose(
            evaluations["covariance"][i], exact.covariances[0], rtol=0, atol=1e-16
        )


def test_an_answer_does_not_depend_on_the_other_estimates():
    run, evaluations = scenario()
    few = Run(run.ground_truth, run.estimate[3:60:9])
    _, alone = handed_over(FIXED, few)
    index = np.isin(evaluations["stamps"], alone["stamps"])
    np.testing.assert_allclose(
        alone["ground_truth"], evaluations["ground_truth"][index], rtol=0, atol=1e-13
    )
    np.testing.assert_allclose(
        alone["covariance"], evaluations["covariance"][index], rtol=0, atol=1e-16
    )
