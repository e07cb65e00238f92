# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the log says of likely causes that come and go."""

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.node.told import Told

CLOCK = Cause("clock_offset", "the estimate's clock is off", "set estimate.time_offset")
SCALE = Cause("scale", "the estimate is too small", "set gauge")


def test_each_change_is_told_once() -> None:
    told = Told()
    assert told.news((CLOCK, SCALE), 0.0) == ([CLOCK, SCALE], [])
    assert told.news((CLOCK, SCALE), 5.0) == ([], [])
    assert told.news((SCALE,), 10.0) == ([], [CLOCK])
    assert told.news((SCALE,), 15.0) == ([], [])


def test_what_comes_and_goes_is_told_again_after_a_while() -> None:
    told = Told()
    said = [told.news((CLOCK,) if k % 2 == 0 else (), 5.0 * k) for k in range(24)]
    assert sum(len(come) for come, _ in said) == 2
    assert sum(len(gone) for _, gone in said) == 2


def test_a_new_run_starts_over() -> None:
    told = Told()
    told.news((CLOCK,), 0.0)
    told.clear()
    assert told.news((), 1.0) == ([], [])
    assert told.news((CLOCK,), 2.0) == ([CLOCK], [])
