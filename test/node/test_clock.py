# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stamps' clock, and what is a jump back in time."""

from __future__ import annotations

import numpy as np
import pytest

from trajeval_ros.node.clock import JumpDetector, StampClock

SECOND = 1_000_000_000


def seconds(*values: float) -> np.ndarray:
    return np.round(np.array(values) * SECOND).astype(np.int64)


def test_the_stamp_clock_goes_on_between_stamps() -> None:
    clock = StampClock()
    assert clock.now(5) is None
    clock.note([100], now=5000)
    assert clock.now(5000) == 100
    assert clock.now(5030) == 130


def test_the_stamp_clock_never_goes_back() -> None:
    clock = StampClock()
    clock.note([100], now=5000)
    clock.note([90], now=5005)
    assert clock.now(5005) == 105
    assert clock.now(4000) == 100


def test_the_stamp_clock_without_a_clock_says_nothing() -> None:
    clock = StampClock()
    clock.note([100], now=None)
    assert clock.now(None) is None


def test_the_clock_jumps_by_more_than_a_second() -> None:
    jumps = JumpDetector()
    assert jumps.clock(10 * SECOND) is None
    assert jumps.clock(10 * SECOND - SECOND // 2) is None
    assert jumps.clock(20 * SECOND) is None
    assert jumps.clock(5 * SECOND) == 15 * SECOND
    assert jumps.clock(6 * SECOND) is None


def test_no_clock_is_no_jump() -> None:
    jumps = JumpDetector()
    jumps.clock(10 * SECOND)
    assert jumps.clock(None) is None
    assert jumps.clock(11 * SECOND) is None


def test_stamps_that_start_over_on_both_topics_are_a_jump() -> None:
    jumps = JumpDetector()
    run = seconds(*np.arange(0, 10, 0.1))
    for _ in range(2):
        jumps.stamps(0, run)
        jumps.stamps(1, run)
        jumped = jumps.stamps_jumped()
    assert jumped


def test_one_topic_that_starts_over_is_not_a_jump_of_time() -> None:
    jumps = JumpDetector()
    run = seconds(*np.arange(0, 10, 0.1))
    jumps.stamps(0, run)
    jumps.stamps(1, run)
    jumps.stamps(1, run)
    assert not jumps.stamps_jumped()


@pytest.mark.parametrize("late", [1, 5, 19])
def test_a_few_stamps_out_of_order_are_no_jump(late: int) -> None:
    jumps = JumpDetector()
    jumps.stamps(0, seconds(*np.arange(0, 10, 0.1)))
    jumps.stamps(0, seconds(*np.arange(3, 3 + late * 0.1, 0.1))[:late])
    jumps.stamps(0, seconds(10.1, 10.2))
    assert not jumps.stamps_jumped()
    jumps.stamps(0, seconds(*np.arange(3, 4, 0.1)))
    assert not jumps.stamps_jumped()


def test_one_wild_stamp_does_not_make_the_others_a_jump() -> None:
    jumps = JumpDetector()
    jumps.stamps(0, seconds(*np.arange(0, 5, 0.1), 1e6, *np.arange(5, 20, 0.1)))
    assert not jumps.stamps_jumped()


def test_of_several_estimates_a_silent_one_is_not_waited_for() -> None:
    run, more = seconds(*np.arange(0, 10, 0.1)), seconds(*np.arange(0, 6, 0.1))
    jumps = JumpDetector(2)
    for topic in (0, 1, 2):
        jumps.stamps(topic, run)
    jumps.stamps(0, more[:40])
    jumps.stamps(1, more[:40])
    # The second may yet go on where it was.
    assert not jumps.stamps_jumped()
    jumps.stamps(0, more[40:])
    assert jumps.stamps_jumped()
    # One that does go on where it was is heard: time has not jumped.
    jumps.stamps(2, seconds(10.1))
    assert not jumps.stamps_jumped()


def test_one_of_several_estimates_that_starts_over_is_not_a_jump_of_time() -> None:
    run = seconds(*np.arange(0, 10, 0.1))
    jumps = JumpDetector(2)
    for topic in (0, 1, 2, 2):
        jumps.stamps(topic, run)
    assert not jumps.stamps_jumped()
