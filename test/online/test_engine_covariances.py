# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Covariances that cannot be computed with cost their own poses and nothing else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.runs import FIXED, Run, assert_same_summary, balance, leaves, simulated

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.samples import PoseSamples

GOOD = np.diag([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])
# A covariance, but so large about an oblique axis that nothing is left of what is added to it.
AXIS = np.array([1.0, 2.0, 3.0, 1.0, 2.0, 1.0])
SINGULAR = 1e14 * np.outer(AXIS, AXIS)


def given_covariances(topic, covariances):
    return PoseSamples(topic.stamps, topic.positions, topic.quaternions, covariances)


def without(topic, mask):
    return PoseSamples(
        topic.stamps[~mask],
        topic.positions[~mask],
        topic.quaternions[~mask],
        topic.covariances[~mask],
    )


@pytest.mark.parametrize("which", ["some", "first", "in a row", "last"])
@pytest.mark.parametrize("covariance", ["independent", "joint"])
def test_the_others_are_scored_as_if_it_had_never_come(covariance, which):
    parameters = {
        **FIXED,
        "estimate.use_covariance": True,
        "likelihood.covariance": covariance,
    }
    run = simulated(3, 10.0, rates=(20.0, 10.0))
    bad = np.zeros(len(run.estimate), dtype=bool)
    bad[
        {"some": [13, 14, 31, 50], "first": [0], "in a row": range(20, 60), "last": [-1]}[which]
    ] = 1
    covariances = np.where(bad[:, None, None], SINGULAR, GOOD)
    estimate = given_covariances(run.estimate, covariances)
    spoilt, clean = Run(run.ground_truth, estimate), Run(run.ground_truth, without(estimate, bad))
    expected = Engine(parameters)
    list(feed(expected, clean.ground_truth, clean.estimate))
    for chunk in (50_000_000, 1_000_000_000, 100_000_000_000):
        engine = Engine(parameters)
        notices = [
            notice.code
            for results in feed(engine, spoilt.ground_truth, spoilt.estimate, chunk)
            for notice in results.notices
        ]
        counts = balance(engine)
        assert counts.rejected == {"singular_covariance": bad.sum()}
        assert counts.received == counts.used + bad.sum()
        assert notices.count("singular_covariance") == 1
        mine, theirs = engine.summary(), expected.summary()
        # A pose that came covers its time, scored or not.
        but = {"estimate": {}, "coverage": {}}
        assert_same_summary({**mine, **but}, {**theirs, **but})


@pytest.mark.parametrize(
    ("covariance", "code"),
    [(GOOD, "estimate_covariance_constant"), (0.0 * GOOD, "estimate_covariance_zero")],
)
def test_a_doubt_is_announced_once_and_holds_until_it_is_refuted(covariance, code):
    run = simulated(3, 10.0, rates=(20.0, 10.0))
    count = len(run.estimate)
    estimate = given_covariances(run.estimate, np.broadcast_to(covariance, (count, 6, 6)))
    engine = Engine({**FIXED, "estimate.use_covariance": True})
    announced = []
    for samples in (estimate[:30], estimate[30:60]):
        engine.add_estimate(samples)
        announced += engine.advance().notices
    assert [notice.code for notice in announced] == [code]
    assert engine.notices() == tuple(announced)
    engine.add_estimate(given_covariances(estimate[60:], 2.0 * GOOD + estimate.covariances[60:]))
    assert engine.advance().notices == engine.notices() == ()


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**32 - 1),
    exponents=st.tuples(st.floats(-20, 300), st.floats(-20, 300)).map(sorted),
    joint=st.booleans(),
    on_ground_truth=st.booleans(),
)
def test_any_covariance_that_is_let_in_leaves_an_account(seed, exponents, joint, on_ground_truth):
    run = simulated(1, 6.0, rates=(20.0, 10.0))
    rng = np.random.default_rng(seed)

    def covariances(count, share):
        axes, _ = np.linalg.qr(rng.normal(size=(count, 6, 6)))
        variances = 10.0 ** rng.uniform(*exponents, size=(count, 6))
        wild = (axes * variances[:, None]) @ axes.swapaxes(-1, -2)
        return np.where(rng.random(count)[:, None, None] < share, wild, GOOD)

    engine = Engine(
        {
            **FIXED,
            "estimate.use_covariance": True,
            "ground_truth.use_covariance": on_ground_truth,
            "likelihood.covariance": "joint" if joint else "independent",
        }
    )
    estimate = given_covariances(run.estimate, covariances(len(run.estimate), 0.3))
    truth = given_covariances(run.ground_truth, covariances(len(run.ground_truth), 0.1))
    list(feed(engine, truth, estimate))
    assert balance(engine).pending == 0
    assert all(
        np.isfinite(value)
        for value in leaves(engine.summary()).values()
        if isinstance(value, float)
    )
