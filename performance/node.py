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
from collections.abc import Iterable, Iterator, Mapping, Sequence
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


@dataclass(frozen=True, slots=True)
class Traffic:
    """``rate`` Hz of ground truth for some ``seconds``; an estimate with ``every`` so manieth."""

    seconds: int
    rate: int
    every: int

    @property
    def estimates(self) -> int:
        """How many are sent."""
        return self.seconds * self.rate // self.every

    @property
    def sent(self) -> int:
        """How many messages are sent."""
        return self.seconds * self.rate + self.estimates


USUAL = Traffic(20, 1000, 5)
SLOW = Traffic(30, 100, 5)
FAST = Traffic(60, 10_000, 10)


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


def send(traffic: Traffic, subject: Child, path: Path) -> float:
    """Send the traffic; return what the subject took for it (s)."""
    numbers = map(str, (traffic.seconds, traffic.rate, traffic.every))
    with Child("performance.traffic", "publish", *numbers, str(path)) as publisher:
        publisher.line()
        before = subject.processor()
        publisher.line()
        time.sleep(_AFTER)
        return subject.processor() - before


def bare(traffic: Traffic, folder: Path) -> Passed:
    """Let a bare node have the traffic."""
    with Child("performance.traffic", "subscribe") as subject:
        taken = send(traffic, subject, folder / "sent.npz")
        ground_truth, estimates = map(int, subject.end().split())
    return Passed(taken, ground_truth, estimates, {})


def evaluator(traffic: Traffic, folder: Path) -> Passed:
    """Let the evaluator have the traffic."""
    output = folder / "output"
    arguments = ("--ros-args", "-p", f"output.directory:={output}")
    with Child("trajeval_ros.node.main", *arguments) as subject:
        taken = send(traffic, subject, folder / "sent.npz")
        subject.interrupt()
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    truth, estimate = summary["ground_truth"], summary["estimate"]
    return Passed(taken, truth["received"], estimate["received"], estimate["rejected"])


def delays(traffic: Traffic, folder: Path) -> tuple[Passed, Array]:
    """Return what the evaluator took with a listener, and each metric's delay (s).

    From when the first sample at or after t + lag went out, to when the error of the estimate at t
    came in at another process.
    """
    with Child("performance.traffic", "listen", str(folder / "heard.npz")) as listener:
        passed = evaluator(traffic, folder)
        time.sleep(0.5)
        listener.end()
    with np.load(folder / "sent.npz") as sent, np.load(folder / "heard.npz") as heard:
        completing = np.searchsorted(sent["stamps"], heard["stamps"] + LAG)
        live = completing < len(sent["stamps"])
        delay = heard["times"][live] - sent["sent"][completing[live]]
    # Those of the first seconds wait for the hyperparameters.
    return passed, np.asarray(delay[len(delay) // 2 :] * 1e-9)


def readiness() -> float:
    """Return how long after its start the evaluator receives (s).

    Every other time discovery takes two seconds more, of any node.
    """
    with Child("performance.traffic", "meet") as publisher:
        publisher.line()
        time.sleep(1.0)
        begin = time.monotonic()
        with Child("trajeval_ros.node.main") as subject:
            publisher.line()
            taken = time.monotonic() - begin
            subject.interrupt()
    return taken


def load_targets(traffic: Traffic = USUAL, rounds: int = 2) -> Iterator[Target]:
    """Compare in turn."""
    with tempfile.TemporaryDirectory() as name:
        compared = list(_compared(traffic, rounds, Path(name)))
        heard, delay = delays(traffic, Path(name))
    yield from _costs("", traffic, compared, 0.25)
    both = [ours for ours, _ in compared] + [heard]
    yield at_most("messages lost by the evaluator", _lost(both, traffic), 0, ".0f")
    lost = _lost([theirs for _, theirs in compared], traffic)
    yield at_most("messages lost by the bare subscriber", lost, 0, ".0f")
    yield _rejected(both)
    yield at_most("delay of a metric, median, ms", 1e3 * float(np.median(delay)), 25.0, ".0f")
    yield at_most("its 99th percentile, ms", 1e3 * float(np.quantile(delay, 0.99)), 60.0, ".0f")
    theirs = float(np.median([theirs.processor for _, theirs in compared]))
    what = "processor time a message with a listener, over the bare subscriber's"
    yield at_most(what, heard.processor / theirs, 0.25)


def further_targets() -> Iterator[Target]:
    """What a message costs where they are few, and whether any is lost where they are many."""
    with tempfile.TemporaryDirectory() as name:
        yield from _costs("at 100 Hz and 20 Hz: ", SLOW, _compared(SLOW, 1, Path(name)), None)
        fast = [evaluator(FAST, Path(name))]
    yield at_most("ready to receive after, s", min(readiness() for _ in range(8)), 1.0, ".2f")
    title = "at 10 kHz and 1 kHz for 60 s: "
    yield at_most(f"{title}messages lost by the evaluator", _lost(fast, FAST), 0, ".0f")
    yield _rejected(fast, title)
    taken = fast[0].processor / FAST.sent * 1e6
    yield Target(f"{title}processor time a message, µs", "", f"{taken:.0f}", None)


def _compared(traffic: Traffic, rounds: int, folder: Path) -> Iterator[tuple[Passed, Passed]]:
    """The evaluator and the bare subscriber, in turn."""
    for _ in range(rounds):
        theirs = bare(traffic, folder)
        yield evaluator(traffic, folder), theirs


def _costs(
    title: str, traffic: Traffic, compared: Iterable[tuple[Passed, Passed]], aim: float | None
) -> Iterator[Target]:
    pairs = [(a.processor / b.processor, a.processor, b.processor) for a, b in compared]
    ratio, ours, theirs = np.median(pairs, axis=0).tolist()
    what = f"{title}processor time a message, over the bare subscriber's"
    if aim is None:
        yield Target(what, "", f"{ratio:.2f}", None)
    else:
        yield at_most(what, ratio, aim)
    for name, taken in (
        (f"{title}that of the evaluator", ours),
        ("of the bare subscriber", theirs),
    ):
        yield Target(f"{name}, µs", "", f"{taken / traffic.sent * 1e6:.0f}", None)


def _rejected(passed: Sequence[Passed], title: str = "") -> Target:
    rejected = sum((Counter(each.rejected) for each in passed), Counter[str]())
    why = "".join(f", {count} {reason}" for reason, count in rejected.items())
    return at_most(f"{title}estimates not evaluated{why}", rejected.total(), 0, ".0f")


def _lost(passed: Sequence[Passed], traffic: Traffic) -> int:
    return max(traffic.sent - each.ground_truth - each.estimates for each in passed)


def run() -> Iterator[Table]:
    """Measure with 1 kHz of ground truth and 200 Hz of estimates; and with fewer and more."""
    if importlib.util.find_spec("rclpy") is None:
        raise SkippedError("ROS 2 is missing: source it, or make install")
    if not Path("/proc/self/stat").exists():
        raise SkippedError("processor times of other processes are read from /proc")
    title = "The node: 1 kHz of ground truth and 200 Hz of estimates for 20 s"
    yield targets("node", title, [*load_targets(), *further_targets()])
