# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Progress of a benchmark on stderr: of all runs and of each system, with rates and time left."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from types import TracebackType
from typing import Self, TextIO

from trajeval_ros.commands.console import duration

# So many systems have a line of their own.
_MOST_SYSTEMS = 12


class BenchmarkProgress:
    """Drawn anew on a terminal; elsewhere lines now and then, and none for what is done at once."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._every = 0.2 if self._terminal else 10.0
        self._start = time.monotonic()
        self._next = self._start + (0.3 if self._terminal else 2.0)
        self._before: dict[str, int] | None = None
        self._drawn = 0
        self.done: dict[str, int] = {}
        self.total: dict[str, int] = {}

    def update(self, done: Mapping[str, int], total: Mapping[str, int]) -> None:
        """Draw, if it is time to: the runs of each system that are done, of how many.

        The first time it is told what was done before: to the rates that does not count.
        """
        now = time.monotonic()
        self.done, self.total = dict(done), dict(total)
        if self._before is None:
            self._before, self._start = dict(done), now
        if now >= self._next:
            self._next = now + self._every
            self._draw(lines(self._before, done, total, now - self._start))

    def _draw(self, shown: list[str]) -> None:
        if self._terminal:
            self._clear()
            width = os.get_terminal_size(self._stream.fileno()).columns
            shown = [line[: max(width - 1, 20)] for line in shown]
            self._drawn = len(shown)
        self._stream.write("".join(f"{line}\n" for line in shown))
        self._stream.flush()

    def _clear(self) -> None:
        self._stream.write("\x1b[1A\x1b[2K" * self._drawn)
        self._drawn = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._terminal:
            self._clear()
            self._stream.flush()


def lines(
    before: Mapping[str, int], done: Mapping[str, int], total: Mapping[str, int], elapsed: float
) -> list[str]:
    """A line of all runs, and one of each system, ``elapsed`` seconds after ``before`` was done."""
    whole = _line(sum(before.values()), sum(done.values()), sum(total.values()), elapsed)
    found = [f"evaluating: {whole}"]
    if len(total) > 1:
        width = max(map(len, total))
        found += [
            f"  {name:{width}}  {_line(before.get(name, 0), done.get(name, 0), count, elapsed)}"
            for name, count in list(total.items())[:_MOST_SYSTEMS]
        ]
    if len(total) > _MOST_SYSTEMS:
        found.append(f"  and {len(total) - _MOST_SYSTEMS} systems more")
    return found


def _line(before: int, done: int, total: int, elapsed: float) -> str:
    text = f"{done:,} of {total:,} runs ({100 * done / max(total, 1):.0f} %)"
    rate = (done - before) / elapsed if elapsed > 0.0 else 0.0
    if rate and done < total:
        shown = f"{rate:,.0f}" if rate >= 10.0 else f"{rate:.2g}"
        text += f", {shown} runs/s, {duration((total - done) / rate)} left"
    return text
