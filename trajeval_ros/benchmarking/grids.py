# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the tables say, whatever they are printed as. Every grid has a system in each column."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trajeval_ros.benchmarking.figures import Figure
from trajeval_ros.benchmarking.ranks import LEVEL
from trajeval_ros.benchmarking.table import Cell, Comparison, Counts, Table

_MEANS = "over several sequences the means of these (of errors geometric means)"
_BOLD = (
    "Bold: better than the second by more than noise (rank tests over runs, within sequences; 5 %,"
    " Holm's correction over the figures)."
)
_RANKS = (
    "Mean ranks of the medians, 1 is best. Two systems differ at 5 % where their ranks do by more"
    " than the critical difference (CD, Nemenyi) and p (Friedman, Holm's correction over the"
    " figures) is below 0.05; bold is what is so ahead of every other."
)
_NOT_WHOLE = "† Not every sequence, or not every evaluated run, has it: compared with no other."
_NONE = "–"


@dataclass(frozen=True)
class Entry:
    """A cell's text: the value, what stands in brackets, and whether it is bold."""

    text: str
    spread: str = ""
    bold: bool = False


@dataclass(frozen=True)
class Grid:
    """A table as text. ``corner``: what the first column names."""

    title: str
    corner: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Entry, ...]], ...]
    notes: tuple[str, ...]


def grids(comparison: Comparison) -> list[Grid]:
    """All tables: over all sequences, ranks, and of each figure every sequence."""
    made = summary(comparison)
    if len(comparison.each) > 1:
        made.append(_runs(comparison))
        made += [of_figure(comparison, figure) for figure in comparison.over_all.figures]
    return made


def summary(comparison: Comparison) -> list[Grid]:
    """The table over all sequences, and the ranks where there are several."""
    made = [_whole(comparison)]
    if comparison.rankings:
        made.append(_ranks(comparison))
    return made


def of_figure(comparison: Comparison, figure: Figure) -> Grid:
    """Return a figure's table: a row a sequence, and the last over all."""
    tables = (*comparison.each, comparison.over_all)
    cells = [table.of(figure) for table in tables]
    rows = [
        (table.title, tuple(_entry(figure, cell) for cell in row))
        for table, row in zip(tables, cells, strict=True)
    ]
    marked = any(cell.median is not None and not cell.whole for row in cells for cell in row)
    notes = (_NOT_WHOLE,) if marked else ()
    return Grid(heading(figure), "Sequence", comparison.systems, tuple(rows), notes)


def heading(figure: Figure) -> str:
    """A figure's title with its unit."""
    return f"{figure.title} ({figure.unit})"


def number(value: float, like: float | None = None) -> str:
    """Three digits, or the decimals that ``like`` has so; an infinite error is a failed run's."""
    if not np.isfinite(value):
        return "failed"
    like = value if like is None or not np.isfinite(like) else like
    magnitude = int(np.floor(np.log10(abs(like)))) if like else 0
    if magnitude < -5:
        return f"{value:.2e}"
    return f"{value:.{max(2 - magnitude, 0)}f}"


def counted(counts: Counts) -> str:
    """How many of how many runs were evaluated."""
    lost = f" (+{counts.lost} lost)" if counts.lost else ""
    return f"{counts.evaluated}/{counts.evaluated + counts.failed}{lost}"


def _whole(comparison: Comparison) -> Grid:
    table = comparison.over_all
    rows = [("Runs evaluated", tuple(Entry(counted(each)) for each in table.counts))]
    rows += [
        (heading(figure), tuple(_entry(figure, cell) for cell in cells))
        for figure, cells in zip(table.figures, table.cells, strict=True)
    ]
    return Grid(table.title, "", comparison.systems, tuple(rows), tuple(_notes(table)))


def _notes(table: Table) -> Iterator[str]:
    if not any(each.evaluated for each in table.counts):
        yield "No run could be evaluated."
        return
    if caption := _caption(table):
        yield caption
    if any(cell.median is not None and not cell.whole for row in table.cells for cell in row):
        yield _NOT_WHOLE
    if any(not np.isfinite(cell.median or 0.0) for row in table.cells for cell in row):
        where = " on one of the sequences" if len(table.sequences) > 1 else ""
        yield f"failed: at least half of the runs did{where}."
    if table.most_runs == 1:
        yield "One run of each: how much runs differ is not known."
    if len(table.counts) > 1 and not any(cell.best for row in table.cells for cell in row):
        if table.least_p >= LEVEL:
            yield (
                "Nothing can be bold: with so few runs the smallest p-value possible is"
                f" {table.least_p:.2g}, corrected for the number of figures."
            )
        else:
            yield "Nothing is bold: no difference is beyond noise."


def _caption(table: Table) -> str:
    """How the cells are to be read, of what there is in this table."""
    several = len(table.sequences) > 1
    if table.most_runs > 1:
        runs = "Median over runs, with the first and third quartile in brackets"
        parts = [f"{runs}; {_MEANS}." if several else f"{runs}."]
    else:
        parts = ["Means over the sequences (of errors geometric means)."] if several else []
    if any(each.failed for each in table.counts):
        parts.append("A failed run is worse than any other.")
    if any(cell.best for row in table.cells for cell in row):
        parts.append(_BOLD)
    return " ".join(parts)


def _ranks(comparison: Comparison) -> Grid:
    rows = []
    for ranking in comparison.rankings:
        ranks = dict(zip(ranking.systems, ranking.ranks.mean.tolist(), strict=True))
        entries = [
            Entry(f"{ranks[place]:.2f}", bold=place == ranking.best)
            if place in ranks
            else Entry(_NONE)
            for place in range(len(comparison.systems))
        ]
        entries.append(Entry(f"{ranking.ranks.critical_difference:.2f}"))
        entries.append(Entry(f"{ranking.p_value:.2g}"))
        rows.append((ranking.figure.title, tuple(entries)))
    title = f"Ranks over {len(comparison.each)} sequences"
    return Grid(title, "", (*comparison.systems, "CD", "p"), tuple(rows), (_RANKS,))


def _runs(comparison: Comparison) -> Grid:
    rows = [
        (table.title, tuple(Entry(counted(each)) for each in table.counts))
        for table in (*comparison.each, comparison.over_all)
    ]
    return Grid("Runs evaluated", "Sequence", comparison.systems, tuple(rows), ())


def _entry(figure: Figure, cell: Cell) -> Entry:
    if cell.median is None or cell.lower is None or cell.upper is None:
        return Entry(_NONE)
    median, lower, upper = (figure.factor * v for v in (cell.median, cell.lower, cell.upper))
    spread = "" if lower == upper else f"{number(lower, median)}, {number(upper, median)}"
    return Entry(number(median) + ("" if cell.whole else "†"), spread, cell.best)
