# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration on recordings of two halves: that constants were chosen on, and that none were.

``recordings.csv`` says which is which, and where they are from. They are read from the folder that
the environment variable ``TRAJEVAL_RECORDINGS`` names: ``<name>.txt`` in TUM's format, made of the
path given there: its first eight columns but for the trolley's, whose date is to be put in seconds.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from pathlib import Path

from performance import calibration
from performance.calibration import (
    KERNELS,
    LAG,
    ON_THE_WAY,
    Cell,
    Measured,
    beside_spline,
    cells_of,
    figure,
    fitted,
    read,
    score,
    score_interpolation,
    typical_factor,
    with_lag,
)
from performance.tables import SkippedError, Table

SOURCES = Path(__file__).with_name("recordings.csv")
RATES = (20, 10, 5, 2)
HALVES = ("chosen on", "held out")
_LEAST_HELD_OUT = 20


def measure(cell: Cell) -> Measured:
    """Score the default, learned first and learned on the way."""
    ways = {process: fitted(cell.kept, process) for process in (KERNELS[0], ON_THE_WAY)}
    return Measured(
        cell.sequence,
        cell.rate,
        {"spline": score_interpolation(cell, "spline")},
        {process: score(cell, ground_truth, None) for process, ground_truth in ways.items()},
        {process: score(cell, ground_truth, LAG) for process, ground_truth in ways.items()},
    )


def run() -> Iterator[Table]:
    """Measure all cells of the recordings that are there."""
    folder = Path(os.environ.get("TRAJEVAL_RECORDINGS", "none"))
    there = [row for row in sources() if (folder / f"{row['name']}.txt").exists()]
    if not there:
        raise SkippedError("the recordings are not there (TRAJEVAL_RECORDINGS)")
    measured = [
        measure(cell)
        for row in there
        for cell in cells_of(row["name"], read(folder / f"{row['name']}.txt"), RATES)
        if len(cell.held_out) >= _LEAST_HELD_OUT
    ]
    for half in HALVES:
        yield from tables_of(half, measured)


def sources() -> list[dict[str, str]]:
    """Return the rows of ``recordings.csv``."""
    with SOURCES.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def tables_of(half: str, measured: list[Measured]) -> Iterator[Table]:
    """Return the tables of the recordings of one half."""
    kinds = {row["name"]: row["kind"] for row in sources() if row["half"] == half}
    here = [cell for cell in measured if cell.sequence in kinds]
    if not here:
        return
    yield _overview(half, here)
    rows = []
    for name in dict.fromkeys(cell.sequence for cell in here):
        cells = {cell.rate: cell for cell in here if cell.sequence == name}
        found = [
            f"{cells[rate].live[process].anees:.2f}" if rate in cells else ""
            for process in (KERNELS[0], ON_THE_WAY)
            for rate in RATES
        ]
        rows.append((name, kinds[name], *found))
    header = (
        "recording",
        "kind",
        *(f"{rate} Hz" for rate in RATES),
        *(f"{rate} Hz, on the way" for rate in RATES),
    )
    title = f"ANEES, with the samples up to 0.3 s later: {half}"
    yield Table(f"recordings anees {half}", title, header, tuple(rows), "calibration.md")


def _overview(half: str, measured: list[Measured]) -> Table:
    rows = []
    for known, words in ((calibration.with_all_data, "all samples"), (with_lag, "lag")):
        for process in (KERNELS[0], ON_THE_WAY):
            anees = figure(measured, known, process, "anees")
            coverage = figure(measured, known, process, "coverage")
            ratio = beside_spline(measured, known, process, "position_rmse")
            rows.append(
                (
                    f"`{process}`" if process in KERNELS else process,
                    words,
                    f"{typical_factor(list(anees)):.2f}",
                    f"{anees.min():.3f} to {anees.max():.1f}",
                    f"{coverage.mean():.3f}",
                    f"{ratio:.2f}",
                )
            )
    header = (
        "process",
        "knows",
        "typical ANEES factor",
        "ANEES",
        "coverage",
        "position RMSE / spline's",
    )
    title = f"{len(measured)} cells of recordings: {half}"
    return Table(f"recordings overview {half}", title, header, tuple(rows), "calibration.md")
