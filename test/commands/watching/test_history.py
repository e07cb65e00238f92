# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Curves in bounded memory, and rows whose columns come one by one."""

import random

from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.commands.watching.history import Curves, Gathered, latest, worst

VALUES = st.lists(st.none() | st.floats(-1e6, 1e6), min_size=1, max_size=400)


@given(VALUES, st.integers(1, 8))
def test_no_peak_is_lost_and_memory_is_bounded(values: list[float | None], capacity: int) -> None:
    curves = Curves(("error",), worst, capacity)
    for second, value in enumerate(values):
        curves.add((float(second), value))
        assert len(curves.rows) < 2 * capacity
    rows = [*curves.rows, *([] if curves.tail is None else [curves.tail])]
    known = [value for value in values if value is not None]
    shown = [row[1] for row in rows if row[1] is not None]
    assert (max(shown) if shown else None) == (max(known) if known else None)
    # Each is a row as it came, in its order.
    seconds = [row[0] for row in rows]
    assert seconds == sorted(seconds)
    assert all(values[int(second)] == value for second, value in rows)


@given(VALUES, st.integers(1, 8))
def test_the_latest_is_the_last(values: list[float | None], capacity: int) -> None:
    curves = Curves(("figure",), latest, capacity)
    for second, value in enumerate(values):
        curves.add((float(second), value))
    last = curves.tail or curves.rows[-1]
    assert last == (len(values) - 1, values[-1])


@given(VALUES, st.integers(1, 8))
def test_rows_stay_as_they_are_within_a_generation(
    values: list[float | None], capacity: int
) -> None:
    curves = Curves(("error",), worst, capacity)
    generation, rows = 0, []
    for second, value in enumerate(values):
        curves.add((float(second), value))
        if curves.generation == generation:
            assert curves.rows[: len(rows)] == rows
        generation, rows = curves.generation, list(curves.rows)


@given(st.integers(1, 40), st.randoms(use_true_random=False), st.integers(0, 3))
def test_rows_are_gathered_however_the_columns_come(
    count: int, chance: random.Random, silent: int
) -> None:
    gathered = Gathered(4)
    # Each column in the order of its stamps, some of it lost, one of them never heard.
    columns = [
        [stamp for stamp in range(1, count + 1) if column != silent and chance.random() < 0.8]
        for column in range(4)
    ]
    expected = {
        stamp: [float(stamp) if stamp in column else None for column in columns]
        for stamp in range(1, count + 1)
        if any(stamp in column for column in columns)
    }
    # All columns up to a stamp, one after another, as the node publishes a batch.
    places = [0] * 4
    found = []
    until = 0
    while until < count:
        until = chance.randint(until + 1, count)
        for number, column in enumerate(columns):
            while places[number] < len(column) and column[places[number]] <= until:
                gathered.put(column[places[number]], number, float(column[places[number]]))
                places[number] += 1
        found += gathered.ready()
    found += gathered.ready(all_of_them=True)
    assert dict(found) == expected
    stamps = [stamp for stamp, _ in found]
    assert stamps == sorted(set(stamps))


def test_a_column_that_is_late_at_the_beginning_is_waited_for() -> None:
    gathered = Gathered(2)
    for stamp in (1, 2):
        gathered.put(stamp, 0, 1.0)
    assert gathered.ready(of_all_columns=True) == []
    gathered.put(1, 1, 2.0)
    assert gathered.ready(of_all_columns=True) == [(1, [1.0, 2.0])]
    gathered.put(3, 0, 1.0)
    assert gathered.ready() == []
    assert gathered.ready(all_of_them=True, of_all_columns=True) == [
        (2, [1.0, None]),
        (3, [1.0, None]),
    ]


def test_what_comes_after_its_row_is_gone_makes_no_second_row() -> None:
    gathered = Gathered(2)
    gathered.put(1, 0, 1.0)
    assert gathered.ready(all_of_them=True) == [(1, [1.0, None])]
    gathered.put(1, 1, 1.0)
    assert gathered.ready(all_of_them=True) == []


def test_rows_that_are_never_complete_do_not_pile_up() -> None:
    gathered = Gathered(2, most=10)
    gathered.put(0, 1, 1.0)
    for stamp in range(1, 12):
        gathered.put(stamp, 0, 1.0)
    assert [stamp for stamp, _ in gathered.ready()] == list(range(12))


def test_what_is_not_finite_is_nothing() -> None:
    gathered = Gathered(2)
    gathered.put(1, 0, float("nan"))
    gathered.put(1, 1, 2.0)
    assert gathered.ready() == [(1, [None, 2.0])]
