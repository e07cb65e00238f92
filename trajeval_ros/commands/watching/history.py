# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run's curves in bounded memory, and rows whose columns arrive one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

Row = tuple[float | None, ...]
"""Seconds, and a value for each curve; None where there is none."""

Merge = Callable[[Row, Row], Row]


def worst(first: Row, second: Row) -> Row:
    """The one with the larger value of the first curve, so that no peak is lost."""
    return second if _size(second) >= _size(first) else first


def latest(first: Row, second: Row) -> Row:
    """The later one."""
    return second


def _moved(row: Row, seconds: float) -> Row:
    return ((row[0] or 0.0) + seconds, *row[1:])


def _size(row: Row) -> float:
    return -math.inf if row[1] is None else row[1]


class Curves:
    """Curves over one time axis: each ``stride`` rows are merged into one.

    When there are ``2 * capacity`` rows, neighbours are merged and the stride doubles:
    ``generation`` counts how often. Rows that were there before may be others then; until then they
    stay as they are, and only ``tail`` changes, the row that is not full yet.
    """

    def __init__(self, names: Sequence[str], merge: Merge, capacity: int = 1024) -> None:
        """Start empty; ``names`` of the curves."""
        self.names = tuple(names)
        self._merge = merge
        self._capacity = capacity
        self.rows: list[Row] = []
        self.tail: Row | None = None
        self.generation = 0
        self.version = 0
        """Grows with every change."""
        self._stride = 1
        self._in_tail = 0

    def move(self, seconds: float) -> None:
        """Every row is so much later."""
        self.rows = [_moved(row, seconds) for row in self.rows]
        self.tail = None if self.tail is None else _moved(self.tail, seconds)
        self.generation += 1
        self.version += 1

    def add(self, row: Row) -> None:
        """Take in a row, later than all before it."""
        self.version += 1
        self.tail = row if self.tail is None else self._merge(self.tail, row)
        self._in_tail += 1
        if self._in_tail < self._stride:
            return
        self.rows.append(self.tail)
        self.tail, self._in_tail = None, 0
        if len(self.rows) == 2 * self._capacity:
            pairs = zip(self.rows[::2], self.rows[1::2], strict=True)
            self.rows = [self._merge(*pair) for pair in pairs]
            self._stride *= 2
            self.generation += 1


class Gathered:
    """Values of several columns, each in the order of its stamps, gathered into rows.

    A column's values arrive in order, so that what is not there when a later one is will not come
    any more. A column of which there has been none yet may be one that there is not.
    """

    def __init__(self, columns: int, most: int = 5000) -> None:
        """Start empty; ``most`` rows wait."""
        self._columns = columns
        self._most = most
        self._rows: dict[int, list[float | None]] = {}
        self._newest: list[int | None] = [None] * columns
        self._taken: int | None = None

    @property
    def has_begun(self) -> bool:
        """Whether there has been a value of any column."""
        return any(stamp is not None for stamp in self._newest)

    def put(self, stamp: int, column: int, value: float) -> None:
        """Take in a value, under its stamp in ns; what comes after its row is gone is left out."""
        if self._taken is not None and stamp <= self._taken:
            return
        row = self._rows.setdefault(stamp, [None] * self._columns)
        row[column] = value if math.isfinite(value) else None
        self._newest[column] = stamp

    def ready(
        self, *, all_of_them: bool = False, of_all_columns: bool = False
    ) -> list[tuple[int, list[float | None]]]:
        """Take out the rows that are complete, in the order of their stamps, or all there are.

        ``of_all_columns``: a column of which there has been none yet is waited for, too.
        """
        heard = [stamp for stamp in self._newest if stamp is not None]
        if not heard or not self._rows:
            return []
        if of_all_columns and len(heard) < self._columns:
            heard.append(min(self._rows) - 1)
        stamps = sorted(self._rows)
        until = stamps[-1] if all_of_them or len(stamps) > self._most else min(heard)
        found = [(stamp, self._rows.pop(stamp)) for stamp in stamps if stamp <= until]
        if found:
            self._taken = found[-1][0]
        return found
