# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The whole engine on degenerate motions: every figure finite, every message accounted for."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.degenerate import poses, shapes
from twins.runs import nanoseconds, samples

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.parameters import complete
from trajeval_ros.report import Report

pytestmark = pytest.mark.filterwarnings("error")


@given(
    st.tuples(shapes(), shapes()),
    st.tuples(shapes(), shapes()),
    st.sampled_from(["se3", "sim3", "yaw_translation", "none"]),
    st.sampled_from([2, 3, 300]),
    st.booleans(),
)
@settings(max_examples=40)
def test_degenerate_motions(truth_shapes, estimate_shapes, gauge, count, joint):
    seconds = np.arange(count) * 0.05
    truth = poses(*truth_shapes, seconds)
    estimate = poses(*estimate_shapes, seconds + 0.01)
    parameters = complete(
        {"gauge": gauge, "likelihood.covariance": "joint" if joint else "independent"}
    )
    engine = Engine(parameters)
    report = Report(parameters, {"ground truth": "truth", "estimate": "estimate"})
    topics = [samples(nanoseconds(s), p) for s, p in ((seconds, truth), (seconds + 0.01, estimate))]
    for results in feed(engine, *topics):
        report.add(results)
        assert np.isfinite(results.evaluations.covariance).all()
        assert np.isfinite(results.evaluations.ground_truth).all()
    summary = engine.summary()
    json.dumps(summary, allow_nan=False)
    account = summary["estimate"]
    assert account["received"] == count
    rest = account["pending"] + sum(account["rejected"].values())
    assert account["received"] == account["evaluated"] + rest
    assert engine.figures() is not None
    report.causes()
    assert report.defects == ()
