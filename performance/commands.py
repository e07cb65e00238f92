# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command ``evaluate`` as a process, beside evo's two commands on the same files."""

from __future__ import annotations

import compileall
import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from performance.calibration import DATA
from performance.tables import SkippedError, Table, Target, at_most, targets

Array = npt.NDArray[np.float64]

PAIRS = (("kitti_00", "orb"), ("euroc_v102", "estimate"))
_SCRIPTS = Path(sysconfig.get_path("scripts"))
_ROOT = Path(__file__).resolve().parents[1]


def seconds(commands: Sequence[Sequence[str]]) -> Array:
    """Run commands one after the other; return wall and processor time (s); (2,).

    Raises SkippedError where one fails.
    """
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "MPLBACKEND": "Agg"}
    processor = 0.0
    begin = time.monotonic()
    for command in commands:
        with tempfile.TemporaryFile() as output:
            child = subprocess.Popen(command, env=environment, stdout=output, stderr=output)
            _, status, usage = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            if child.returncode:
                output.seek(0)
                said = output.read().decode(errors="replace").strip().splitlines()[-1:]
                raise SkippedError(f"{' '.join(command)} failed: {''.join(said)}")
        processor += usage.ru_utime + usage.ru_stime
    return np.array([time.monotonic() - begin, processor])


def evo(command: str) -> str:
    """Return the path of one of evo's commands, or say that it is missing."""
    path = _SCRIPTS / command
    if not path.exists():
        raise SkippedError("evo is missing: pip install evo")
    return str(path)


def pair_targets(sequence: str, estimate: str, rounds: int = 4) -> Iterator[Target]:
    """Time the commands in turn."""
    files = [str(DATA / sequence / f"{name}.txt") for name in ("groundtruth", estimate)]
    ours = [[sys.executable, "-m", "trajeval_ros.commands.evaluate", "tum", *files]]
    theirs = [[evo("evo_ape"), "tum", *files, "-a"], [evo("evo_rpe"), "tum", *files, "-a"]]
    with tempfile.TemporaryDirectory() as folder:
        written = [[*ours[0], "--output", folder]]
        works = (ours, theirs, written)
        times = np.array([[seconds(work) for work in works] for _ in range(rounds + 1)][1:])
    for column, name in enumerate(("wall", "processor")):
        ratios = np.median(times[:, :, column] / times[:, 1:2, column], axis=0)
        yield at_most(f"{sequence}/{estimate}: {name} time over evo's", float(ratios[0]), 1.0)
        yield Target(
            f"the same, report and table of poses written, {name} time",
            "",
            f"{ratios[2]:.2f}",
            None,
        )


def run() -> Iterator[Table]:
    """Measure on the longest pair and on the one with the most ground truth."""
    if not DATA.exists():
        raise SkippedError(f"the recordings are not there ({DATA.parent.name}/{DATA.name})")
    # As pip does with all that it installs, evo too.
    compileall.compile_dir(_ROOT / "trajeval_ros", quiet=1)
    found = [target for pair in PAIRS for target in pair_targets(*pair)]
    yield targets("commands", "`evaluate tum` beside `evo_ape` plus `evo_rpe`", found)
