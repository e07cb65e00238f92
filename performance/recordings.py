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
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from performance.calibration import (
    KERNELS,
    LAG,
    ON_THE_WAY,
    Array,
    Cell,
    Known,
    Measured,
    beside_spline,
    cells_of,
    conditioned,
    figure,
    fitted,
    learned,
    read,
    score,
    score_interpolation,
    typical_factor,
    with_all_data,
    with_lag,
)
from performance.tables import SkippedError, Table
from trajeval_ros import se3
from trajeval_ros.ground_truth.process import Process
from trajeval_ros.ground_truth.segment import Samples

SOURCES = Path(__file__).with_name("recordings.csv")
RATES = (20, 10, 5, 2)
OWN = 0
"""Stands for the rate of every second sample."""
CURVE = "splines"
"""In the kind of a recording whose samples were read off a fitted curve, and not measured."""
HALVES = ("held out", "chosen on")
WAYS = {KERNELS[0]: "learned first", ON_THE_WAY: "learned on the way"}
_PAGE = "calibration.md"
_LEAST_HELD_OUT = 20
_MOST_HELD_OUT = 1500
_MOST_DRAWN = 1000
_ROUND_OFF = 1e-12


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
        for cell in _cells(row["name"], read(folder / f"{row['name']}.txt"))
        if len(cell.held_out) >= _LEAST_HELD_OUT
    ]
    yield overview(measured)
    yield kinds(measured)
    yield single_cells(measured)
    yield own_world(there, folder)


def _cells(name: str, samples: Samples) -> Iterator[Cell]:
    yield halved(name, samples)
    yield from cells_of(name, samples, RATES)


def halved(name: str, samples: Samples) -> Cell:
    """Keep every second sample, as the recording has them: what smoothed ones are known to."""
    kept, held = samples[::2], samples[1:-1:2]
    return Cell(name, OWN, kept, held[:: max(1, len(held) // _MOST_HELD_OUT)])


def sources() -> list[dict[str, str]]:
    """Return the rows of ``recordings.csv``."""
    with SOURCES.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def overview(measured: list[Measured]) -> Table:
    """Return the default's figures over each half; with all samples they are only printed."""
    rows = {known: _overview(measured, known) for known in (with_lag, with_all_data)}
    header = (
        "half",
        "samples kept",
        "`matern52`",
        "knows",
        "cells",
        "typical ANEES factor",
        "likewise, of measurements",
        "ANEES",
        "95 % holds",
        "position RMSE / spline's",
    )
    title = "All cells of the recordings"
    return Table("recordings overview", title, header, rows[with_lag], _PAGE, rows[with_all_data])


def _overview(measured: list[Measured], known: Known) -> tuple[tuple[str, ...], ...]:
    rows = []
    measurements = {row["name"] for row in sources() if CURVE not in row["kind"]}
    for half, thinned, process in product(HALVES, (True, False), WAYS):
        cells = [cell for cell in _of_half(measured, half) if (cell.rate != OWN) is thinned]
        if not cells:
            continue
        anees = figure(cells, known, process, "anees")
        true = [a for a, cell in zip(anees, cells, strict=True) if cell.sequence in measurements]
        rows.append(
            (
                half,
                "20 to 2 Hz" if thinned else "every second",
                WAYS[process],
                "all samples" if known is with_all_data else "lag",
                str(len(cells)),
                f"{typical_factor(list(anees)):.2f}",
                f"{typical_factor(true):.2f}",
                f"{anees.min():.3f} to {anees.max():.1f}",
                f"{100 * figure(cells, known, process, 'coverage').mean():.1f} %",
                f"{beside_spline(cells, known, process, 'position_rmse'):.2f}",
            )
        )
    return tuple(rows)


def kinds(measured: list[Measured]) -> Table:
    """Return ANEES by kind of recording and rate, as a node has it: on the way, with the lag."""
    rows = []
    for kind, half in product(dict.fromkeys(row["kind"] for row in sources()), HALVES):
        names = {row["name"] for row in sources() if (row["kind"], row["half"]) == (kind, half)}
        cells = [cell for cell in measured if cell.sequence in names]
        if not cells:
            continue
        found = []
        for rate in (OWN, *RATES):
            here = [cell for cell in cells if cell.rate == rate]
            anees = figure(here, with_lag, ON_THE_WAY, "anees")
            found.append(f"{np.exp(np.log(anees).mean()):.2f}" if here else "")
        rows.append((kind, half, str(len({cell.sequence for cell in cells})), *found))
    header = ("kind", "half", "recordings", "every second", *(f"{rate} Hz" for rate in RATES))
    title = "ANEES, learned on the way, with the samples up to 0.3 s later; geometric means"
    return Table("recordings kinds", title, header, tuple(rows), _PAGE)


def single_cells(measured: list[Measured]) -> Table:
    """Return the ANEES of each cell, with the lag, which is printed and on no page."""
    rows = []
    for name in dict.fromkeys(cell.sequence for cell in measured):
        cells = {cell.rate: cell for cell in measured if cell.sequence == name}
        found = [
            f"{cells[rate].live[process].anees:.2f}" if rate in cells else ""
            for process, rate in product(WAYS, (OWN, *RATES))
        ]
        rows.append((name, *found))
    ways = product(WAYS.values(), (OWN, *RATES))
    header = ("recording", *(f"{rate or 'own'} Hz, {way}" for way, rate in ways))
    title = "ANEES, with the samples up to 0.3 s later"
    return Table("recordings anees", title, header, tuple(rows), None)


def own_world(rows: list[dict[str, str]], folder: Path) -> Table:
    """Return ANEES where each cell's motion and noise are drawn from what it has learned.

    Of measurements: what its scatter is at best, the process being known or learned anew.
    """
    anees: dict[str, list[float]] = {}
    for row in rows:
        if CURVE in row["kind"]:
            continue
        for cell in cells_of(row["name"], read(folder / f"{row['name']}.txt"), RATES):
            if len(cell.held_out) >= _LEAST_HELD_OUT:
                for way, value in in_own_world(cell).items():
                    anees.setdefault(way, []).append(value)
    found = tuple(
        (
            way,
            str(len(values)),
            f"{typical_factor(values):.2f}",
            f"{min(values):.2f} to {max(values):.2f}",
        )
        for way, values in anees.items()
    )
    header = ("process", "cells", "typical ANEES factor", "ANEES")
    title = "Motion and noise drawn from what each cell has learned, the samples kept likewise"
    return Table("recordings own world", title, header, found, _PAGE)


def in_own_world(cell: Cell, seed: int = 0) -> dict[str, float]:
    """ANEES of the process that is known, learned first and learned on the way, in its world."""
    step = max(1, len(cell.held_out) // _MOST_DRAWN)
    stamps = np.union1d(cell.kept.stamps, cell.held_out.stamps[::step])
    process = learned(cell.kept, KERNELS[0])
    if process is None:
        raise ValueError(f"{cell.sequence} at {cell.rate} Hz teaches nothing")
    process = replace(process, stamp_std=0.0, stamp_shared=0.0, _known={}, _parts={})
    poses = drawn(process, stamps, np.random.default_rng(seed))
    kept = np.isin(stamps, cell.kept.stamps)
    world = replace(
        cell,
        kept=Samples(stamps[kept], poses[kept]),
        held_out=Samples(stamps[~kept], poses[~kept]),
    )
    ways = {"known": conditioned(world.kept, process)}
    ways |= {way: fitted(world.kept, name) for name, way in WAYS.items()}
    return {way: float(score(world, each, LAG).anees or 0.0) for way, each in ways.items()}


def drawn(process: Process, stamps: npt.NDArray[np.int64], rng: np.random.Generator) -> Array:
    """Samples (n, 4, 4) of motion and noise of the process, at ``stamps`` (n,), ns."""
    times = (stamps - stamps[0]) * 1e-9
    motions, noises = [], []
    for group in process.groups:
        parts = {True: np.zeros((len(times), 3)), False: np.zeros((len(times), 3))}
        for moves in parts:
            covariance = np.zeros((len(times), len(times)))
            for kernel, part in zip(process.kernels, group.components, strict=True):
                if (kernel.curvature > 0.0) is moves:
                    apart = np.abs(times[:, None] - times) / part.length_scale
                    covariance += part.std**2 * kernel.correlation(apart)
            white = _ROUND_OFF * covariance[0, 0] if moves else group.noise_std**2
            covariance[np.diag_indices(len(times))] += white
            parts[moves] = np.linalg.cholesky(covariance) @ rng.normal(size=(len(times), 3))
        motions.append(parts[True])
        noises.append(parts[False])
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    # Turned step by step: the process is one of small rotations about those of its segments.
    turns = se3.exp_so3(np.diff(motions[1], axis=0))
    for i, turn in enumerate(turns):
        poses[i + 1, :3, :3] = poses[i, :3, :3] @ turn
    poses[:, :3, 3] = motions[0]
    error = np.tile(np.eye(4), (len(times), 1, 1))
    error[:, :3, :3], error[:, :3, 3] = se3.exp_so3(noises[1]), noises[0]
    return se3.compose(poses, error)


def _of_half(measured: list[Measured], half: str) -> list[Measured]:
    names = {row["name"] for row in sources() if row["half"] == half}
    return [cell for cell in measured if cell.sequence in names]
