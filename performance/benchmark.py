# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command ``benchmark`` on two cores: beside evo, over thousands of runs, and what Dask costs.

All runs of the first ratio are measured: a few would pay for the start of workers, and for the
models of a ground truth, as all do together. evo's commands cost the same each time, so five are.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from performance.commands import evo, long_run, seconds
from performance.tables import SkippedError, Table, Target, at_most, targets
from trajeval_ros.benchmarking import cluster
from trajeval_ros.benchmarking.manifest import Run, Source
from trajeval_ros.benchmarking.plan import Planned, Task
from trajeval_ros.benchmarking.work import Outcome, failed, outcomes_of
from trajeval_ros.online.parameters import complete

_ROOT = Path(__file__).resolve().parents[1]
_WORKERS = 2
_RUNS = 200


def run() -> Iterator[Table]:
    """Measure all; some minutes."""
    try:
        import distributed  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise SkippedError("Dask and pyarrow are missing: the extra benchmark") from error
    # The workers are processes of their own, which have to find this package.
    os.environ["PYTHONPATH"] = str(_ROOT)
    found = [*throughput_targets(), *memory_targets(), *overhead_targets()]
    yield targets("benchmark", "`benchmark` on two cores", found)


def noisy_copies(folder: Path, estimate: Path, count: int) -> None:
    """Write runs of one system: the estimate with a millimetre of other noise in each."""
    rows = np.loadtxt(estimate)
    (folder / "results/system/sequence").mkdir(parents=True)
    for number in range(count):
        noisy = rows.copy()
        noisy[:, 1:4] += np.random.default_rng(number).normal(0.0, 1e-3, (len(rows), 3))
        np.savetxt(folder / f"results/system/sequence/{number}.txt", noisy, fmt="%.9f")


def throughput_targets(runs: int = _RUNS, span: int = 180) -> Iterator[Target]:
    """Time ``runs`` of a sequence beside as many times evo's two commands."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth, estimate = long_run(folder, span)
        noisy_copies(folder, Path(estimate), runs)
        manifest = folder / "manifest.yaml"
        manifest.write_text(
            "estimates: 'results/{system}/{sequence}/{run}.txt'\n"
            f"sequences: {{sequence: {{ground_truth: {truth}}}}}\n"
        )
        command = [sys.executable, "-m", "trajeval_ros", "benchmark", str(manifest)]
        command += ["--workers", str(_WORKERS), "--output"]
        whole = seconds([[*command, str(folder / "out")]])[:2]
        # With nothing left to do: what starting costs, and the files at the end.
        start = seconds([[*command, str(folder / "out"), "--resume"]])[:2]
        files = sorted((folder / "results/system/sequence").iterdir())[: min(5, runs)]
        theirs = [
            [evo(name), "tum", truth, str(file), "-a"]
            for file in files
            for name in ("evo_ape", "evo_rpe")
        ]
        each = seconds(theirs)[:2] / len(files)
    what = f"{runs} runs of {span} s of 100 and 20 Hz"
    wall, processor = (whole / (runs * each)).tolist()
    yield at_most(f"{what}: time over a loop of `evo_ape` and `evo_rpe`", wall, 0.15)
    yield at_most("the same, processor time", processor, 0.15)
    yield Target("a run, processor time, s", "", f"{(whole - start)[1] / runs:.2f}", None)
    yield Target("evo's two commands, processor time, s", "", f"{each[1]:.2f}", None)
    yield Target("starting, planning, tables and report, s", "", f"{start[0]:.1f}", None)


def small_task(folder: Path, runs: int) -> Task:
    """Runs of a sequence of a second, all of one file."""
    truth, estimate = long_run(folder, 10)
    # A second of it, twenty poses: what stays in memory does not hang on how long a run is.
    Path(estimate).write_text("".join(Path(estimate).read_text().splitlines(True)[50:70]))
    planned = tuple(
        Planned(Run("system", "sequence", str(k), Source(estimate)), "", "", "", str(k))
        for k in range(runs)
    )
    return Task(Source(truth), complete({}), planned)


def memory_targets(runs: int = 2_000) -> Iterator[Target]:
    """Evaluate many runs in one process, and see what it holds afterwards."""
    with tempfile.TemporaryDirectory() as name:
        task = small_task(Path(name), 20)
        tasks = max(runs // len(task.runs), 4)
        held = []
        begin = time.monotonic()
        for _ in range(tasks):
            outcomes_of(task)
            held.append(_resident())
        each = (time.monotonic() - begin) / tasks / len(task.runs)
    # Not from the first: caches fill, and memory that is free is kept.
    growth = held[-1] - held[len(held) // 4]
    count = tasks * len(task.runs)
    yield at_most(
        f"a worker's memory from run {count // 4:,} to run {count:,}, MB more", growth, 5.0
    )
    yield Target(f"a worker's memory after {count:,} runs, MB", "", f"{held[-1]:.0f}", None)
    yield Target("a run of a second, s", "", f"{each:.3f}", None)


def _resident() -> float:
    """This process's memory, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def nothing(task: Task) -> list[Outcome]:
    """In place of the work."""
    return [Outcome(failed(one, "not evaluated here")) for one in task.runs]


def overhead_targets(runs: int = 10_000) -> Iterator[Target]:
    """Send tasks of one run that do nothing through the scheduler and back."""
    with tempfile.TemporaryDirectory() as name, cluster.cluster(workers=_WORKERS) as client:
        whole = small_task(Path(name), runs)
        tasks = [Task(whole.ground_truth, whole.parameters, (one,)) for one in whole.runs]
        begin = time.monotonic()
        done = sum(len(each) for each in cluster.evaluate(client, tasks, nothing))
        taken = time.monotonic() - begin
    if done != runs:
        raise SkippedError(f"of {runs:,} runs {done:,} came back")
    yield Target(
        f"{runs:,} tasks of nothing: the scheduler's share, ms a task",
        "",
        f"{1e3 * taken / runs:.1f}",
        None,
    )
