# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The order in which recorded messages are published."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.commands.schedule import arrival_times, merge

stamps = st.lists(st.integers(0, 2**62), max_size=40).map(lambda values: np.array(values, np.int64))


@given(first=stamps, second=stamps)
def test_every_message_once_in_its_topics_order(first: np.ndarray, second: np.ndarray) -> None:
    schedule = merge(first, second)
    assert len(schedule) == len(first) + len(second)
    assert np.all(np.diff(schedule.times) >= 0)
    for topic, values in enumerate((first, second)):
        rows = schedule.rows[schedule.topics == topic]
        np.testing.assert_array_equal(rows, np.arange(len(values)))


@given(first=stamps.map(np.sort), second=stamps.map(np.sort))
def test_ordered_stamps_are_followed(first: np.ndarray, second: np.ndarray) -> None:
    schedule = merge(first, second)
    both = np.concatenate([first, second])
    np.testing.assert_array_equal(schedule.times, np.sort(both))
    # at the same time the ground truth comes first
    same = np.diff(schedule.times) == 0
    assert np.all(np.diff(schedule.topics)[same] >= 0)


def test_a_wild_stamp_holds_up_nobody() -> None:
    values = np.arange(10, dtype=np.int64)
    values[5] = 10**18
    np.testing.assert_array_equal(arrival_times(values), [0, 1, 2, 3, 4, 6, 6, 7, 8, 9])
