# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m fuzz.soak --hours H``: that many hours of stamps through the node's session at speed.

Rest and motion in turn, silences, messages that cannot be read, a clock that jumps back, an output
folder that is gone and back, a disk that is full. Error models are fitted and likely causes looked
for as by the node. Memory and cost a message are held to be flat, accounts to be exact.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import os
import pickle
import resource
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fuzz.oracle import Failure, check_accounts, require
from trajeval_ros import se3
from trajeval_ros.commands.console import Progress
from trajeval_ros.files.output import OutputError
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.track import Track
from trajeval_ros.runs.session import Session

Array = npt.NDArray[np.float64]
SECOND = 1_000_000_000
START = 1_750_000_000 * SECOND
CHUNK = 10.0
"""Seconds of stamps that are fed at a time."""

_PERIOD = 120.0
_STDS = (2e-3, 1e-2)
# As shares of the run: what is left is long enough for what grows to be seen.
_JUMPS = (0.05, 0.10, 0.60)
_LOSSES = (0.12, 0.85)
_MB = 1 << 20
# Of the state, of which every byte is counted, no more is slack.
_KB = 1 << 10
# Every so many chunks: the node looks as often for causes, and fits its window less often.
_SEARCH, _WINDOW = 6, 30
_MEASURED = 30
"""How often a tenth's memory is measured."""


@dataclass
class Tenth:
    """What a tenth of the run took; memory in bytes, the largest seen in it.

    parts: of each part of the state. They grow and shrink each in its own time, so that what they
    have together is at its largest when chance has it; their largest sizes together are not.
    """

    messages: int = 0
    cpu: float = 0.0
    resident: int = 0
    parts: dict[str, int] = field(default_factory=dict)

    @property
    def state(self) -> int:
        """The largest sizes of all parts together."""
        return sum(self.parts.values())

    @property
    def cost(self) -> float:
        """Seconds of CPU time a message."""
        return self.cpu / max(self.messages, 1)


def motion(t: Array) -> Array:
    """Poses (n, 4, 4): a minute's rest, a minute's drive, and so on, smoothly."""
    half = 0.5 * _PERIOD
    driven = np.maximum(t % _PERIOD - half, 0.0)
    phase = t // _PERIOD * half + driven - half / (2 * np.pi) * np.sin(2 * np.pi * driven / half)
    poses = np.tile(np.eye(4), (len(t), 1, 1))
    poses[:, :3, 3] = np.stack([5 * np.sin(0.3 * phase), 4 * np.cos(0.2 * phase), 0 * t], axis=-1)
    turn = np.stack([0.1 * np.sin(0.5 * phase), 0.1 * np.cos(0.4 * phase), 0.2 * phase], axis=-1)
    poses[:, :3, :3] = se3.exp_so3(turn)
    return poses


def samples(rng: np.random.Generator, begin: float, rate: float, std: float) -> PoseSamples:
    """Return a chunk of samples at ``begin`` seconds; noise ``std`` in m and rad."""
    t = np.asarray(begin + (np.arange(round(CHUNK * rate)) + 0.5) / rate, dtype=np.float64)
    poses = motion(t) @ se3.exp(rng.normal(0.0, std, (len(t), 6)))
    stamps = START + np.rint(t * SECOND).astype(np.int64)
    return PoseSamples(stamps, *se3.to_position_quaternion(poses))


@dataclass
class Soak:
    """A session that is fed, and how much it was fed since it last started over."""

    folder: Path
    rates: tuple[float, float]
    rng: np.random.Generator
    fed: list[int] = field(default_factory=lambda: [0, 0])
    begin: float = 0.0

    def __post_init__(self) -> None:
        """Start the session."""
        values = complete({"output.directory": str(self.folder)})
        self.session = Session(values, {"ground truth": "/a", "estimate": "/b"})

    def chunk(self, number: int, tenth: Tenth) -> None:
        """Feed a chunk, some of them silent on one topic or the other."""
        made = [samples(self.rng, self.begin, r, s) for r, s in zip(self.rates, _STDS, strict=True)]
        silent = (number % 97 in (40, 41), number % 131 in (60, 61, 62))
        made = [each[:0] if quiet else each for each, quiet in zip(made, silent, strict=True)]
        self.begin += CHUNK
        counts = [len(each) + int(number % 29 == 7) for each in made]
        begin = time.process_time()
        self.session.feed(*made)
        if number % 29 == 7:
            self.session.note_undecodable(0, 1)
            self.session.note_undecodable(1, 1)
        self.session.advance(START + round(self.begin * SECOND))
        while (fit := self.session.fit_due(of_window=number % _WINDOW == 0)) is not None:
            fit.at_once()
        if number % _SEARCH == 0:
            self.session.look_for_causes()
        figures = self.session.figures()
        tenth.cpu += time.process_time() - begin
        tenth.messages += sum(counts)
        self.fed = [a + b for a, b in zip(self.fed, counts, strict=True)]
        self.check(figures)

    def check(self, figures: Any) -> None:
        """Every message that was fed is in the accounts."""
        check_accounts(figures)
        received = [figures[topic]["received"] for topic in ("ground_truth", "estimate")]
        require(received == self.fed, f"received {received} of {self.fed}")

    def save(self) -> None:
        """Save and compare the rows with the account."""
        path = self.session.save()
        assert path is not None
        with (path / "poses.csv").open(encoding="utf-8") as file:
            rows = sum(1 for _ in file) - 1
        summary: Any = self.session.summary()
        evaluated = summary["estimate"]["evaluated"]
        require(rows == evaluated, f"{rows} rows, {evaluated} evaluated")

    def lose_folder(self) -> None:
        """Put a link to nowhere in its place: nothing can be saved, and the session says so."""
        away = self.folder.with_name("away")
        self.folder.rename(away)
        self.folder.symlink_to(self.folder.with_name("nowhere"))
        try:
            self.session.save()
        except OutputError:
            require(self.session.error is not None, "no error of the folder that is gone")
        else:
            raise Failure("saved to a folder that is gone")
        self.chunk(0, Tenth())
        self.folder.unlink()
        away.rename(self.folder)
        self.save()
        require(self.session.error is None, "the error outlives the folder's return")

    def fill_disk(self) -> None:
        """No file may grow: nothing is saved, and the session says so; then there is room again."""
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 10, hard))
        try:
            self.session.save()
        except OutputError:
            require(self.session.error is not None, "no error of the disk that is full")
        else:
            raise Failure("saved to a disk that is full")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        self.save()
        require(self.session.error is None, "the error outlives the full disk")

    def jump_back(self) -> None:
        """End the run as the node does when the clock jumps back, and start over."""
        self.session.finish()
        self.check(self.session.figures())
        require(self.session.archive() is not None, "no copy of the run")
        self.session.reset()
        self.fed, self.begin = [0, 0], 0.0

    def measure(self, tenth: Tenth) -> None:
        """Note the memory at its largest."""
        gc.collect()
        if hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
            libc.malloc_trim(0)
        resident = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        tenth.resident = max(tenth.resident, resident * os.sysconf("SC_PAGE_SIZE"))
        for name, size in sizes(self.session):
            tenth.parts[name] = max(tenth.parts.get(name, 0), size)


def sizes(session: Session) -> Iterator[tuple[str, int]]:
    """What a session's parts hold, each with its name, pickled, in bytes."""
    for name, record in session._records.items():
        yield from _sizes(f"{name}.report", record.report)
        yield from _sizes(f"{name}.models", record.models)
    yield from _sizes("engine", session.engine)


def _sizes(name: str, thing: Any) -> Iterator[tuple[str, int]]:
    """Of what a thing of the package's owns, and of that; the estimates share a ground truth."""
    if isinstance(thing, dict) and any(map(_owns, thing.values())):
        parts = {f"{name}.{key}": each for key, each in thing.items()}
    elif _owns(thing):
        shared = ("_reference", "_ground_truth") if isinstance(thing, Track) else ()
        parts = {f"{name}.{key}": each for key, each in vars(thing).items() if key not in shared}
    else:
        yield name, len(pickle.dumps(thing))
        return
    for part, each in parts.items():
        yield from _sizes(part, each)


def _owns(thing: Any) -> bool:
    """Whether it is of the package's, and changes."""
    return type(thing).__module__.startswith("trajeval_ros.") and hasattr(thing, "__dict__")


def run(hours: float, folder: Path, rates: tuple[float, float] = (20.0, 2.0)) -> list[Tenth]:
    """Run, and return its tenths; raises :class:`~fuzz.oracle.Failure` where accounts are wrong."""
    count = max(round(hours * 3600 / CHUNK), 40)
    soak = Soak(folder / "output", rates, np.random.default_rng(1))
    tenths = [Tenth() for _ in range(10)]
    jumps, losses = ({round(share * count) for share in shares} for shares in (_JUMPS, _LOSSES))
    every = max(count // (10 * _MEASURED), 1)
    progress = Progress("soaking", count, "chunks")
    for number in range(count):
        tenth = tenths[10 * number // count]
        if number in jumps:
            soak.jump_back()
        soak.chunk(number, tenth)
        progress.update(number + 1)
        if number % every == every - 1:
            soak.measure(tenth)
        if number in losses:
            soak.lose_folder()
            soak.fill_disk()
    soak.session.finish()
    soak.check(soak.session.figures())
    soak.save()
    soak.session.close()
    require(len(list(soak.folder.glob("run_*"))) == len(jumps), "not a copy for each run")
    left = [path.name for path in soak.folder.glob(".*")]
    require(not left, f"left behind: {left}")
    return tenths


def judge(tenths: Sequence[Tenth], early_number: int = 1) -> list[str]:
    """Return what is not flat between an early tenth, the second by default, and the last."""
    early, late = tenths[early_number], tenths[-1]
    wrong = []
    for name, slack in (("resident", _MB), ("state", 64 * _KB)):
        before, after = getattr(early, name), getattr(late, name)
        if after > 1.01 * before + slack:
            wrong.append(f"{name} memory grew from {before / _MB:.1f} to {after / _MB:.1f} MB")
    if late.state > 1.01 * early.state + 64 * _KB:
        part = max(late.parts, key=lambda each: late.parts[each] - early.parts.get(each, 0))
        wrong[-1] += f", most of all {part}"
    if late.cost > 1.5 * early.cost:
        wrong.append(f"a message's cost grew {late.cost / early.cost:.2f} times")
    return wrong


def table(tenths: Sequence[Tenth]) -> str:
    """What each tenth took."""
    rows = [f"{'tenth':>6}{'messages':>11}{'us/message':>12}{'resident MB':>13}{'state kB':>11}"]
    for number, tenth in enumerate(tenths, start=1):
        figures = f"{1e6 * tenth.cost:12.1f}{tenth.resident / _MB:13.1f}{tenth.state / 1024:11.0f}"
        rows.append(f"{number:6}{tenth.messages:11,}{figures}")
    return "\n".join(rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Run, print a table; return 0, or 1 where something grew or was lost."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--ground-truth-rate", type=float, default=20.0, metavar="HZ")
    parser.add_argument("--estimate-rate", type=float, default=2.0, metavar="HZ")
    arguments = parser.parse_args(argv)
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="soak-") as name:
        try:
            rates = (arguments.ground_truth_rate, arguments.estimate_rate)
            tenths = run(arguments.hours, Path(name), rates)
        except Failure as failure:
            print(f"failed: {failure}")
            return 1
    wrong = judge(tenths)
    print(
        "\n".join(
            [table(tenths), *wrong, f"{arguments.hours:g} h in {time.monotonic() - begin:.0f} s"]
        )
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
