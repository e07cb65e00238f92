# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration on recordings that no constant was chosen with.

``recordings.csv`` says where they are from. They are read from the folder that the environment
variable ``TRAJEVAL_RECORDINGS`` names: ``<name>.txt`` in TUM's format, the first eight columns of
the path given there.
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
    with SOURCES.open(encoding="utf-8") as file:
        kinds = {row["name"]: row["kind"] for row in csv.DictReader(file)}
    there = [name for name in kinds if (folder / f"{name}.txt").exists()]
    if not there:
        raise SkippedError("the recordings are not there (TRAJEVAL_RECORDINGS)")
    measured = [
        measure(cell)
        for name in there
        for cell in cells_of(name, read(folder / f"{name}.txt"), RATES)
        if len(cell.held_out) >= _LEAST_HELD_OUT
    ]
    yield _overview(measured)
    rows = []
    for name in there:
        here = {cell.rate: cell for cell in measured if cell.sequence == name}
        found = [
            f"{here[rate].live[process].anees:.2f}" if rate in here else ""
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
    title = "ANEES, with the samples up to 0.3 s later"
    yield Table("recordings anees", title, header, tuple(rows), "calibration.md")


def _overview(measured: list[Measured]) -> Table:
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
    title = f"{len(measured)} cells of recordings that no constant was chosen with"
    return Table("recordings overview", title, header, tuple(rows), "calibration.md")
