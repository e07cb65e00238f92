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
from performance.ground_truth import simulated
from performance.tables import SkippedError, Table, Target, at_most, targets
from trajeval_ros import se3

Array = npt.NDArray[np.float64]

PAIRS = (("kitti_00", "orb"), ("euroc_v102", "estimate"))
_SCRIPTS = Path(sysconfig.get_path("scripts"))
_ROOT = Path(__file__).resolve().parents[1]


def seconds(commands: Sequence[Sequence[str]]) -> Array:
    """Run commands one after the other; return wall and processor time (s), and peak memory (MB).

    Raises SkippedError where one fails.
    """
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "MPLBACKEND": "Agg"}
    processor, peak = 0.0, 0
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
        peak = max(peak, usage.ru_maxrss)
    return np.array([time.monotonic() - begin, processor, peak / 1e3])


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
    # By the processor: these wait for nothing, and the machine may have other work.
    ratios = np.median(times[:, :, 1] / times[:, 1:2, 1], axis=0)
    yield at_most(f"{sequence}/{estimate}: processor time over evo's", float(ratios[0]), 0.5)
    yield at_most("the same, report and table of poses written", float(ratios[2]), 0.65)


def long_run(folder: Path, seconds: int) -> list[str]:
    """Write the files of a run with 100 Hz of ground truth and 20 Hz of estimates; their names."""
    rng = np.random.default_rng(0)
    names = [str(folder / f"{name}.txt") for name in ("groundtruth", "estimate")]
    drift = np.zeros(6)
    with (
        open(names[0], "w", encoding="ascii") as truth,
        open(names[1], "w", encoding="ascii") as out,
    ):
        for second in range(0, seconds, 60):
            samples = simulated(100 * second, 100 * min(60, seconds - second), 100)
            truth.writelines(_rows(samples.stamps, samples.poses))
            steps = rng.normal(0.0, [5e-4] * 3 + [1e-4] * 3, (len(samples) // 5, 6))
            walk = drift + np.cumsum(steps, axis=0)
            drift = walk[-1]
            error = 0.05 * np.tanh(walk) + rng.normal(0.0, 1e-3, walk.shape)
            poses = se3.compose(samples.poses[::5], se3.exp(error))
            out.writelines(_rows(samples.stamps[::5] + 3_000_000, poses))
    return names


def _rows(stamps: npt.NDArray[np.int64], poses: Array) -> Iterator[str]:
    """The rows of a TUM file."""
    half = 0.5 * se3.log_so3(poses[:, :3, :3])
    angle = np.linalg.norm(half, axis=1, keepdims=True)
    quaternions = np.concatenate([half * np.sinc(angle / np.pi), np.cos(angle)], axis=1)
    values = np.concatenate([poses[:, :3, 3], quaternions], axis=1)
    for stamp, row in zip(stamps.tolist(), values.tolist(), strict=True):
        yield f"{stamp // 10**9}.{stamp % 10**9:09d} {' '.join(f'{v:.7f}' for v in row)}\n"


def long_targets(seconds_of_data: int = 7200) -> Iterator[Target]:
    """Time the commands once on a long run."""
    with tempfile.TemporaryDirectory() as folder:
        files = long_run(Path(folder), seconds_of_data)
        ours = seconds([[sys.executable, "-m", "trajeval_ros.commands.evaluate", "tum", *files]])
        theirs = seconds([[evo(name), "tum", *files, "-a"] for name in ("evo_ape", "evo_rpe")])
    what = f"{seconds_of_data / 3600:g} h of 100 Hz and 20 Hz"
    yield at_most(f"{what}: processor time over evo's", float(ours[1] / theirs[1]), 0.5)
    yield at_most(f"{what}: peak memory, MB", float(ours[2]), 250.0, ".0f")
    yield Target(f"{what}: evo's, MB", "", f"{theirs[2]:.0f}", None)


def import_targets(rounds: int = 5) -> Iterator[Target]:
    """Time what is loaded, beside a bare interpreter."""
    uses = {
        "`import trajeval_ros`": "import trajeval_ros",
        "all that `evaluate` loads": "import trajeval_ros.commands.scoring",
    }
    bare = [seconds([[sys.executable, "-c", ""]])[1] for _ in range(rounds + 1)][1:]
    for name, code in uses.items():
        taken = [seconds([[sys.executable, "-c", code]])[1] for _ in range(rounds + 1)][1:]
        yield at_most(f"{name}, processor time, s", float(np.median(taken) - np.median(bare)), 0.3)


def run() -> Iterator[Table]:
    """Measure on the longest pair, on the one with the most ground truth, and on a long run."""
    if not DATA.exists():
        raise SkippedError(f"the recordings are not there ({DATA.parent.name}/{DATA.name})")
    # As pip does with all that it installs, evo too.
    compileall.compile_dir(_ROOT / "trajeval_ros", quiet=1)
    found = [target for pair in PAIRS for target in pair_targets(*pair)]
    found += [*long_targets(), *import_targets()]
    yield targets("commands", "`evaluate tum` beside `evo_ape` plus `evo_rpe`", found)
