# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth that is fed ahead of the estimates changes no answer."""

import pytest
from twins.runs import SECOND, assert_same_summary, balance, joined, simulated

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed_all
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.settings import PATIENCE


def fed(run, ahead, whole):
    engine = Engine(complete({}), ("estimate",), whole=whole)
    every = feed_all(engine, run.ground_truth, {"estimate": run.estimate}, SECOND, ahead)
    return engine, joined([results["estimate"].evaluations for results in every])


@pytest.mark.parametrize("whole", [True, False])
def test_answers_do_not_depend_on_it(whole):
    run = simulated(4, 60.0, rates=(20.0, 4.0), dropouts=((20.0, 23.0), (40.0, 45.0)))
    engine, expected = fed(run, 0, whole)
    found_by, found = fed(run, PATIENCE // 2, whole)
    assert balance(found_by) == balance(engine)
    assert "too_late" not in balance(found_by).rejected
    assert found["stamps"].tolist() == expected["stamps"].tolist()
    for name in ("ground_truth", "covariance", "relative_error"):
        same = pytest.approx(expected[name], rel=1e-9, abs=1e-12, nan_ok=True)
        assert found[name] == same, name
    assert_same_summary(found_by.summary("estimate"), engine.summary("estimate"))
