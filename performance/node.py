# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node beside a bare subscriber on the same traffic, over DDS on this machine.

Processor time is what the process takes while the traffic lasts and two seconds longer: what it
takes to start, and to write the report when it ends, does not count.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from performance.ground_truth import LAG
from performance.tables import SkippedError, Table, Target, at_most, targets

Array = npt.NDArray[np.float64]

_ROOT = Path(__file__).resolve().parents[1]
_PATIENCE = 60.0
_AFTER = 2.0
_RATE, _EVERY = 1000, 5


@dataclass(frozen=True, slots=True)
class Passed:
    """What a process has made of the traffic: processor time (s), and what of it arrived.

    ``rejected``: estimates that were not evaluated, by reason.
    """

    processor: float
    ground_truth: int
    estimates: int
    rejected: Mapping[str, int]


class Child:
    """A process that does not outlive its block."""

    def __init__(self, *arguments: str) -> None:
        """Start ``python -m arguments...``."""
        domain = 1 + os.getpid() % 100
        environment = {
            **os.environ,
            "PYTHONPATH": str(_ROOT),
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
        # Type checks, which tests switch on, are not what is measured.
        environment.pop("ROS_PYTHON_CHECK_FIELDS", None)
        self._child = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def __enter__(self) -> Child:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill it where it still runs."""
        if self._child.poll() is None:
            self._child.kill()
        self._child.communicate()

    def line(self) -> str:
        """Wait for a line of its output.

        Raises SkippedError where it ends instead.
        """
        assert self._child.stdout is not None
        line = self._child.stdout.readline()
        if not line:
            raise SkippedError("a process of the benchmark has failed")
        return line.strip()

    def end(self) -> str:
        """Tell it to end, and return the line it ends with."""
        assert self._child.stdin is not None
        self._child.stdin.write("\n")
        self._child.stdin.flush()
        said = self.line()
        self._child.wait(_PATIENCE)
        return said

    def interrupt(self) -> None:
        """Tell it to end by SIGINT, and wait."""
        self._child.send_signal(signal.SIGINT)
        self._child.wait(_PATIENCE)

    def processor(self) -> float:
        """Return the processor time it has taken so far (s)."""
        text = Path(f"/proc/{self._child.pid}/stat").read_text(encoding="ascii")
        user, system = text.rsplit(")", 1)[1].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def traffic(subject: Child, seconds: int, path: Path) -> float:
    """Send the traffic; return what the subject took for it (s)."""
    with Child("performance.traffic", "publish", str(seconds), str(path)) as publisher:
        publisher.line()
        before = subject.processor()
        publisher.line()
        time.sleep(_AFTER)
        return subject.processor() - before


def bare(seconds: int, folder: Path) -> Passed:
    """Let a bare node have the traffic."""
    with Child("performance.traffic", "subscribe") as subject:
        taken = traffic(subject, seconds, folder / "sent.npz")
        ground_truth, estimates = map(int, subject.end().split())
    return Passed(taken, ground_truth, estimates, {})


def evaluator(seconds: int, folder: Path) -> Passed:
    """Let the evaluator have the traffic."""
    output = folder / "output"
    arguments = ("--ros-args", "-p", f"output.directory:={output}")
    with Child("trajeval_ros.node.main", *arguments) as subject:
        taken = traffic(subject, seconds, folder / "sent.npz")
        subject.interrupt()
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    truth, estimate = summary["ground_truth"], summary["estimate"]
    return Passed(taken, truth["received"], estimate["received"], estimate["rejected"])


def delays(seconds: int, folder: Path) -> tuple[Passed, Array]:
    """Return what the evaluator took with a listener, and each metric's delay (s).

    From when the first sample at or after t + lag went out, to when the error of the estimate at t
    came in at another process.
    """
    with Child("performance.traffic", "listen", str(folder / "heard.npz")) as listener:
        passed = evaluator(seconds, folder)
        time.sleep(0.5)
        listener.end()
    with np.load(folder / "sent.npz") as sent, np.load(folder / "heard.npz") as heard:
        completing = np.searchsorted(sent["stamps"], heard["stamps"] + LAG)
        live = completing < len(sent["stamps"])
        delay = heard["times"][live] - sent["sent"][completing[live]]
    # Those of the first seconds wait for the hyperparameters.
    return passed, np.asarray(delay[len(delay) // 2 :] * 1e-9)


def load_targets(seconds: int = 20, rounds: int = 2) -> Iterator[Target]:
    """Compare in turn."""
    ours: list[Passed] = []
    theirs: list[Passed] = []
    with tempfile.TemporaryDirectory() as name:
        for _ in range(rounds):
            theirs.append(bare(seconds, Path(name)))
            ours.append(evaluator(seconds, Path(name)))
        heard, delay = delays(seconds, Path(name))
    sent = seconds * _RATE * (_EVERY + 1) // _EVERY
    taken = np.median(
        [
            [a.processor / b.processor, a.processor, b.processor]
            for a, b in zip(ours, theirs, strict=True)
        ],
        axis=0,
    )
    yield at_most("processor time a message, over the bare subscriber's", float(taken[0]), 1.0)
    yield Target("that of the evaluator, µs", "", f"{taken[1] / sent * 1e6:.0f}", None)
    yield Target("of the bare subscriber, µs", "", f"{taken[2] / sent * 1e6:.0f}", None)
    both = [*ours, heard]
    yield at_most("messages lost by the evaluator", _lost(both, sent), 0, ".0f")
    yield at_most("messages lost by the bare subscriber", _lost(theirs, sent), 0, ".0f")
    rejected = sum((Counter(each.rejected) for each in both), Counter[str]())
    why = "".join(f", {count} {reason}" for reason, count in rejected.items())
    yield at_most(f"estimates not evaluated{why}", rejected.total(), 0, ".0f")
    yield Target("delay of a metric, median, ms", "", f"{1e3 * np.median(delay):.0f}", None)
    yield Target("its 99th percentile, ms", "", f"{1e3 * np.quantile(delay, 0.99):.0f}", None)
    yield Target(
        "processor time with a listener, µs", "", f"{heard.processor / sent * 1e6:.0f}", None
    )


def _lost(passed: Sequence[Passed], sent: int) -> int:
    return max(sent - each.ground_truth - each.estimates for each in passed)


def run() -> Iterator[Table]:
    """Measure with 1 kHz of ground truth and 200 Hz of estimates."""
    if importlib.util.find_spec("rclpy") is None:
        raise SkippedError("ROS 2 is missing: source it, or make install")
    if not Path("/proc/self/stat").exists():
        raise SkippedError("processor times of other processes are read from /proc")
    title = "The node: 1 kHz of ground truth and 200 Hz of estimates for 20 s"
    yield targets("node", title, list(load_targets()))
