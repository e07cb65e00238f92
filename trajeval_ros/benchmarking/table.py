# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of each system, on each sequence and over all; which is best, beyond noise."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from trajeval_ros.benchmarking.noise import FIGURES, LEVEL, Figure, Runs, holm, p_smaller, values
from trajeval_ros.benchmarking.work import FAILED, LOST, OK, Row


@dataclasses.dataclass(frozen=True)
class Cell:
    """Of a system's runs: the median with its quartiles, in the figure's own SI unit.

    ``median`` is infinite where half of the runs failed, and None where there is no figure.
    ``best``: lowest (or highest), by more than noise.
    """

    median: float | None
    lower: float | None = None
    upper: float | None = None
    best: bool = False


@dataclasses.dataclass(frozen=True)
class Line:
    """A system in a table: how many of its runs were evaluated, of how many; the figures' cells."""

    system: str
    evaluated: int
    runs: int
    lost: int
    cells: tuple[Cell, ...]


@dataclasses.dataclass(frozen=True)
class Table:
    """The systems on one sequence, or over ``sequences`` of them."""

    title: str
    figures: tuple[Figure, ...]
    lines: tuple[Line, ...]
    sequences: int = 1


def tables(rows: Sequence[Row]) -> list[Table]:
    """The table over all sequences, where there are several, and one for each.

    Holm's correction is over the figures of a table.
    """
    sequences = sorted({str(row["sequence"]) for row in rows})
    made = [_table(name, [row for row in rows if row["sequence"] == name]) for name in sequences]
    if len(sequences) > 1:
        made.insert(0, _table(f"All {len(sequences)} sequences", rows))
    return made


def _table(title: str, rows: Sequence[Row]) -> Table:
    systems = sorted({str(row["system"]) for row in rows})
    sequences = sorted({str(row["sequence"]) for row in rows})
    figures = tuple(f for f in FIGURES if any(isinstance(row.get(f.column), float) for row in rows))
    columns = [_column(figure, rows, systems, sequences) for figure in figures]
    sure = holm([p for _, _, p in columns])
    lines = []
    for place, system in enumerate(systems):
        cells = tuple(
            dataclasses.replace(column[place], best=best == place and p < LEVEL)
            for (column, best, _), p in zip(columns, sure, strict=True)
        )
        own = [row["status"] for row in rows if row["system"] == system]
        counts = own.count(OK), own.count(OK) + own.count(FAILED), own.count(LOST)
        lines.append(Line(system, *counts, cells))
    return Table(title, figures, tuple(lines), len(sequences))


def _column(
    figure: Figure, rows: Sequence[Row], systems: Sequence[str], sequences: Sequence[str]
) -> tuple[list[Cell], int | None, float]:
    """The cells; the place of the best system, if there is one; p of its being the second's equal.

    A system can be best of all sequences only if it has the figure on each.
    """
    runs = [_runs(figure, rows, system, sequences) for system in systems]
    cells = [_cell(list(of_system.values())) for of_system in runs]
    sign = -1.0 if figure.larger_is_better else 1.0
    order = sorted(
        (sign * cell.median, place)
        for place, cell in enumerate(cells)
        if cell.median is not None and len(runs[place]) == len(sequences)
    )
    if len(order) < 2 or not np.isfinite(order[0][0]):
        return cells, None, 1.0
    first, second = order[0][1], order[1][1]
    signed = [{name: sign * v for name, v in runs[place].items()} for place in (first, second)]
    return cells, first, p_smaller(*signed, two_sided=True)


def _runs(
    figure: Figure, rows: Sequence[Row], system: str, sequences: Sequence[str]
) -> dict[str, Runs]:
    """The values by sequence, of those that there are."""
    found = {}
    for name in sequences:
        own = [row for row in rows if row["system"] == system and row["sequence"] == name]
        if len(of_runs := values(own, figure)):
            found[name] = of_runs
    return found


def _cell(runs: Sequence[Runs]) -> Cell:
    """Of one sequence, its runs' quartiles; of several, their geometric means over sequences.

    The mean is geometric so that no sequence counts more because its errors are larger.
    """
    if not runs:
        return Cell(None)
    quartiles = np.array([_quartiles(of_one) for of_one in runs])
    if len(runs) == 1:
        lower, median, upper = quartiles[0]
    else:
        with np.errstate(divide="ignore"):
            lower, median, upper = np.exp(np.log(quartiles).mean(axis=0))
    return Cell(float(median), float(lower), float(upper))


def _quartiles(runs: Runs) -> Runs:
    """First quartile, median and third, without arithmetic on infinite values."""
    shares = [0.25, 0.5, 0.75]
    if np.isfinite(runs).all():
        return np.asarray(np.quantile(runs, shares))
    return np.asarray(np.quantile(runs, shares, method="inverted_cdf"))
