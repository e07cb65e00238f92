# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A benchmark from its manifest to its files."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trajeval_ros.benchmarking import cluster, tables
from trajeval_ros.benchmarking.errors import ErrorsFile, StoredErrors, read_errors
from trajeval_ros.benchmarking.gate import Verdict
from trajeval_ros.benchmarking.grids import grids
from trajeval_ros.benchmarking.manifest import Manifest, read_manifest
from trajeval_ros.benchmarking.plan import plan, tasks
from trajeval_ros.benchmarking.report import REPORT, Benchmark, page
from trajeval_ros.benchmarking.results import CSV, Results, frame, in_order
from trajeval_ros.benchmarking.table import compare
from trajeval_ros.benchmarking.work import Row

Progress = Callable[[Mapping[str, int], Mapping[str, int]], None]
"""Told how many runs of each system are done, and how many there are."""


class OutputExistsError(ValueError):
    """There are results in the folder already."""


def run(
    manifest: Manifest,
    folder: Path,
    client: Any,
    *,
    resume: bool = False,
    progress: Progress = lambda done, total: None,
) -> list[Row]:
    """Evaluate every run of a manifest; write its rows, errors, tables and report.

    ``resume``: rows that are there of the same contents are kept. Returns the rows, in brief, in
    the order of their names; whole they are in the folder.

    Raises :class:`OutputExistsError` without ``resume`` where there are results already,
    :class:`~trajeval_ros.benchmarking.results.ResultsError` for those that cannot be read, and
    :class:`~trajeval_ros.benchmarking.cluster.ClusterError` where the scheduler is gone; what was
    done until then is in ``results.csv``.
    """
    there = (folder / CSV).is_file()
    if there and not resume:
        raise OutputExistsError(f"{folder / CSV} is there already: resume it, or name a new folder")
    planned = plan(manifest)
    keys = [one.key for runs in planned.values() for one in runs]
    results = Results.resumed(folder, keys) if there else Results(folder)
    done = {str(row["key"]) for row in results.rows}
    errors = ErrorsFile(folder, read_errors(folder, done))
    left = {name: [one for one in runs if one.key not in done] for name, runs in planned.items()}
    total = Counter(run.system for run in manifest.runs)
    counts = Counter(str(row["system"]) for row in results.rows)
    progress(counts, total)
    todo = tasks(manifest, left, cluster.workers_of(client))
    for outcomes in cluster.evaluate(client, todo):
        # The errors first: whatever has a row has them.
        errors.add(outcome.errors for outcome in outcomes if outcome.errors is not None)
        results.add([outcome.row for outcome in outcomes])
        counts.update(str(outcome.row["system"]) for outcome in outcomes)
        progress(counts, total)
    results.finish()
    rows = in_order(results.rows)
    publish(folder, rows)
    return rows


def publish(folder: Path, rows: Sequence[Row], verdict: Verdict | None = None) -> None:
    """Write the tables and the report of a benchmark that is done; with what the gate found."""
    comparison = compare(rows)
    tables.write(folder, grids(comparison))
    text = page(Benchmark(rows, comparison, StoredErrors(folder).of, verdict))
    (folder / REPORT).write_text(text, encoding="utf-8")


def benchmark(
    manifest: str | os.PathLike[str],
    output: str | os.PathLike[str],
    client: Any = None,
    *,
    resume: bool = False,
) -> Any:
    """Evaluate every run that a manifest names (``docs/benchmark.md``), on all cores.

    Returns a ``pandas.DataFrame``, a row a run, with every scalar of its ``summary.json`` under its
    dotted name; files of it and the tables are written to the folder ``output``. ``client``: a
    ``distributed.Client`` whose cluster is to do the work. Without one a cluster of processes is
    started, so a script needs ``if __name__ == "__main__":`` around the call. ``resume``: rows
    that are in ``output`` already, of the same contents, are kept. Needs the extra ``benchmark``.

    Raises :class:`ValueError` for a manifest with mistakes, which it lists by line, and where
    ``output`` has results and ``resume`` is not set.
    """
    read = read_manifest(os.fspath(manifest))
    folder = Path(output).expanduser()
    if client is not None:
        run(read, folder, client, resume=resume)
    else:
        with cluster.cluster() as own:
            run(read, folder, own, resume=resume)
    return frame(folder)
