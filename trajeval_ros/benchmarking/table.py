# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of each system, on each sequence and over all; which is best, beyond noise."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from trajeval_ros.benchmarking.figures import (
    FIGURES,
    Figure,
    Runs,
    costs,
    over_sequences,
    quartiles,
    values,
)
from trajeval_ros.benchmarking.noise import holm, least_p, p_smaller
from trajeval_ros.benchmarking.ranks import LEVEL, Ranks, friedman_nemenyi
from trajeval_ros.benchmarking.work import FAILED, LOST, OK, Row


@dataclasses.dataclass(frozen=True)
class Cell:
    """Of a system's runs: the median with its quartiles, in the figure's own SI unit.

    ``median`` is infinite where half of the runs failed, and None where there is no figure.
    ``whole``: every evaluated run on every sequence has the figure; else it is compared with none.
    ``best``: lowest (or highest), by more than noise.
    """

    median: float | None
    lower: float | None = None
    upper: float | None = None
    whole: bool = True
    best: bool = False


@dataclasses.dataclass(frozen=True)
class Counts:
    """How many of a system's runs were evaluated, failed, or were lost with their worker."""

    evaluated: int
    failed: int
    lost: int


@dataclasses.dataclass(frozen=True)
class Ranking:
    """Ranks by a figure: of ``systems`` (places in the comparison's), on ``sequences``.

    ``best``: the place of the one that is better than all others beyond noise. ``p_value``: Holm's,
    over the figures.
    """

    figure: Figure
    systems: tuple[int, ...]
    ranks: Ranks
    p_value: float
    best: int | None


@dataclasses.dataclass(frozen=True)
class Table:
    """All systems on one sequence, or over several: for each figure a cell of each system.

    ``least_p``: the smallest p-value that so many runs allow, with the correction for the figures.
    """

    title: str
    sequences: tuple[str, ...]
    figures: tuple[Figure, ...]
    counts: tuple[Counts, ...]
    cells: tuple[tuple[Cell, ...], ...]
    most_runs: int
    least_p: float

    def of(self, figure: Figure) -> tuple[Cell, ...]:
        """The cells of a figure, one of each system; without a median where it has none."""
        if figure in self.figures:
            return self.cells[self.figures.index(figure)]
        return tuple(Cell(None) for _ in self.counts)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A benchmark's tables: ``over_all`` sequences, of ``each``, and the ranks.

    With one sequence ``over_all`` is that one's, and there are no ranks.
    """

    systems: tuple[str, ...]
    over_all: Table
    each: tuple[Table, ...]
    rankings: tuple[Ranking, ...]


def compare(rows: Sequence[Row]) -> Comparison:
    """Compare the systems; Holm's correction is over the figures of a table."""
    systems = tuple(sorted({str(row["system"]) for row in rows}))
    sequences = tuple(sorted({str(row["sequence"]) for row in rows}))
    groups: Groups = {}
    for row in rows:
        groups.setdefault((str(row["system"]), str(row["sequence"])), []).append(row)
    each = tuple(_table(name, groups, systems, (name,)) for name in sequences)
    if len(sequences) == 1:
        return Comparison(systems, each[0], each, ())
    over_all = _table(f"All {len(sequences)} sequences", groups, systems, sequences)
    return Comparison(systems, over_all, each, _rankings(over_all, each))


Groups = dict[tuple[str, str], list[Row]]


def _table(title: str, groups: Groups, systems: Sequence[str], sequences: tuple[str, ...]) -> Table:
    of_systems = [
        {name: groups[system, name] for name in sequences if (system, name) in groups}
        for system in systems
    ]
    rows = [row for system in of_systems for group in system.values() for row in group]
    figures = tuple(f for f in FIGURES if any(isinstance(row.get(f.column), float) for row in rows))
    columns = [_column(figure, of_systems, len(sequences)) for figure in figures]
    sure = holm([p for _, _, p, _ in columns])
    cells = tuple(
        tuple(
            dataclasses.replace(cell, best=place == best and p < LEVEL)
            for place, cell in enumerate(column)
        )
        for (column, best, _, _), p in zip(columns, sure, strict=True)
    )
    counts = tuple(
        _counts([r for group in system.values() for r in group]) for system in of_systems
    )
    most = max(len(group) for system in of_systems for group in system.values())
    least = min((p for *_, p in columns), default=1.0) * len(columns)
    return Table(title, sequences, figures, counts, cells, most, min(least, 1.0))


def _counts(rows: Sequence[Row]) -> Counts:
    own = [row["status"] for row in rows]
    return Counts(own.count(OK), own.count(FAILED), own.count(LOST))


def _column(
    figure: Figure, of_systems: Sequence[dict[str, list[Row]]], sequences: int
) -> tuple[list[Cell], int | None, float, float]:
    """The cells; the place of the best system, if there is one; p of its being the second's equal.

    And the smallest p that these runs allow. A system that lacks the figure on a sequence, or in a
    run that was evaluated, is not compared: what it lacks may be what is hard.
    """
    runs = [
        {name: found for name, rows in system.items() if len(found := values(rows, figure))}
        for system in of_systems
    ]
    cells = []
    for system, by_sequence in zip(of_systems, runs, strict=True):
        wanted = sum(row["status"] in (OK, FAILED) for rows in system.values() for row in rows)
        have = sum(len(each) for each in by_sequence.values())
        whole = len(by_sequence) == sequences and have == wanted
        cells.append(_cell(list(by_sequence.values()), figure, whole))
    of_costs = [
        {name: costs(each, figure) for name, each in by_sequence.items()} for by_sequence in runs
    ]
    order = sorted(
        (-cell.median if figure.larger_is_better else cell.median, place)
        for place, cell in enumerate(cells)
        if cell.median is not None and cell.whole
    )
    if len(order) < 2:
        return cells, None, 1.0, 1.0
    first, second = of_costs[order[0][1]], of_costs[order[1][1]]
    least = least_p(first, second)
    if not np.isfinite(order[0][0]):
        return cells, None, 1.0, least
    return cells, order[0][1], p_smaller(first, second, two_sided=True), least


def _cell(runs: Sequence[Runs], figure: Figure, whole: bool) -> Cell:
    """Of one sequence, its runs' quartiles; of several, their means over sequences."""
    if not runs:
        return Cell(None, whole=whole)
    of_each = np.array([quartiles(of_one) for of_one in runs])
    of_all = of_each[0] if len(runs) == 1 else over_sequences(of_each, figure)
    lower, median, upper = (float(value) for value in of_all)
    return Cell(median, lower, upper, whole)


def _rankings(over_all: Table, each: Sequence[Table]) -> tuple[Ranking, ...]:
    """The ranks by each figure of the systems that are compared by it: of medians over runs."""
    made = [found for figure in over_all.figures if (found := _ranking(figure, over_all, each))]
    sure = holm([one.p_value for one in made])
    return tuple(
        dataclasses.replace(one, p_value=p, best=one.best if p < LEVEL else None)
        for one, p in zip(made, sure, strict=True)
    )


def _ranking(figure: Figure, over_all: Table, each: Sequence[Table]) -> Ranking | None:
    cells = over_all.of(figure)
    places = [place for place, cell in enumerate(cells) if cell.median is not None and cell.whole]
    if len(places) < 2:
        return None
    medians = np.array([[table.of(figure)[place].median for place in places] for table in each])
    ranks = friedman_nemenyi(costs(medians.astype(np.float64), figure))
    first, second = np.argsort(ranks.mean, kind="stable")[:2]
    ahead = ranks.mean[second] - ranks.mean[first] > ranks.critical_difference
    return Ranking(figure, tuple(places), ranks, ranks.p_value, places[first] if ahead else None)
