# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all commands share: exit codes, errors of one line, progress."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import signal
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType
from typing import Self, TextIO

from trajeval_ros import __version__

DONE = 0
NOT_EVALUATED = 1
WRONG_USAGE = 2
NOT_GOOD_ENOUGH = 3
INTERRUPTED = 128 + signal.SIGINT

_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)


class CommandError(Exception):
    """The data could not be evaluated; the message is one line."""


class UsageError(CommandError):
    """Called in a way that cannot work; the message is one line."""


class Answered(Exception):
    """What was asked for has been printed, and there is no more to do."""


def run(command: Callable[[], int], name: str) -> int:
    """Run ``command``; turn its errors into one line on stderr and an exit code."""
    _have_streams()
    try:
        code = command()
        # A closed pipe shows here rather than in the interpreter's shutdown.
        sys.stdout.flush()
        return code
    except Answered:
        sys.stdout.flush()
        return DONE
    except UsageError as error:
        return fail(name, str(error), WRONG_USAGE)
    except CommandError as error:
        return fail(name, str(error), NOT_EVALUATED)
    except KeyboardInterrupt:
        return fail(name, "interrupted", INTERRUPTED)
    except BrokenPipeError:
        # The reader of our output is gone (`evaluate ... | head`).
        _drop_output()
        return DONE
    except OSError as error:
        # A disk that is full, a terminal that is gone. An error with a file's name is not stdout's.
        if error.filename is not None or error.errno not in _UNWRITABLE:
            raise
        _drop_output()
        return fail(name, f"cannot write the output: {error.strerror}", NOT_EVALUATED)


@contextlib.contextmanager
def directed(*, quiet: bool, to_stderr: bool) -> Iterator[None]:
    """While it lasts, what is printed goes nowhere, progress neither; or to stderr."""
    if not (quiet or to_stderr):
        yield
        return
    Progress.shown = not quiet
    try:
        with open(os.devnull, "w", encoding="utf-8") as nowhere:
            target = nowhere if quiet else sys.stderr
            with contextlib.redirect_stdout(target):
                yield
    finally:
        Progress.shown = True


def _have_streams() -> None:
    """Where a stream was closed (`evaluate ... >&-`), what is said goes nowhere."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115


def _drop_output() -> None:
    """Python would flush stdout once more at exit and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def add_version(parser: argparse.ArgumentParser) -> None:
    """Declare ``--version``."""
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")


def fail(name: str, message: str, code: int) -> int:
    """Say what went wrong in one line, and return the exit code.

    File names may hold line breaks and what a terminal takes for commands: they are shown escaped.
    """
    shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
    print(f"{name}: error: {shown}", file=sys.stderr)
    return code


def number(lower: float, upper: float) -> Callable[[str], float]:
    """Return the type of an option that is a number in a range, for argparse."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"not a number: {text!r}") from None
        if not lower <= value <= upper:
            raise argparse.ArgumentTypeError(f"must lie between {lower:g} and {upper:g}: {text}")
        return value

    return parse


def integer(lower: int, upper: int) -> Callable[[str], int]:
    """Return the type of an option that is a whole number in a range, for argparse."""
    real = number(lower, upper)

    def parse(text: str) -> int:
        value = real(text)
        if value != int(value):
            raise argparse.ArgumentTypeError(f"not a whole number: {text!r}")
        return int(value)

    return parse


def duration(seconds: float) -> str:
    """Return a length of time as a person says it: ``4 s``, ``2 min 05 s``, ``1 h 10 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def wrapped(lines: Iterable[str], indent: int, width: int | None = None) -> list[str]:
    """Return lines as a terminal of ``width`` columns takes them, what goes on indented.

    Without a terminal they stay as they are: what reads them goes by lines.
    """
    if width is None:
        width = os.get_terminal_size(sys.stdout.fileno()).columns if sys.stdout.isatty() else 0
    if width < 2 * indent + 1:
        return list(lines)
    return [
        piece
        for line in lines
        for piece in textwrap.wrap(
            line,
            width,
            subsequent_indent=" " * indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        or [""]
    ]


def say(lines: Iterable[str], indent: int = 4) -> None:
    """Print lines as :func:`wrapped`."""
    print("\n".join(wrapped(lines, indent)))


class Progress:
    """Progress of long work on stderr, with its rate and the time that remains.

    On a terminal one line that is drawn anew; elsewhere a line now and then, and none at all for
    work that is done within two seconds.
    """

    shown = True
    """Whether any is to be shown at all."""

    def __init__(self, label: str, total: int, unit: str, stream: TextIO | None = None) -> None:
        self._label = label
        self._total = total
        self._unit = unit
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._start = time.monotonic()
        self._every = 0.1 if self._terminal else 10.0
        self._next = self._start + (0.3 if self._terminal else 2.0)
        self._drawn = False

    def update(self, done: int, total: int | None = None) -> None:
        """Draw, if it is time to; ``total`` where it was not known before."""
        self._total = self._total if total is None else total
        now = time.monotonic()
        if now < self._next or not self.shown:
            return
        self._next = now + self._every
        elapsed = now - self._start
        rate = done / elapsed
        line = f"{self._label}: {done:,} of {self._total:,} {self._unit}"
        if self._total:
            line += f" ({100 * min(done / self._total, 1):.0f} %)"
        line += f", {rate:,.0f} {self._unit}/s"
        if done:
            line += f", {duration(max(self._total - done, 0) / rate)} left"
        if self._terminal:
            width = os.get_terminal_size(self._stream.fileno()).columns
            self._stream.write("\r\x1b[K" + line[: max(width - 1, 20)])
        else:
            self._stream.write(line + "\n")
        self._stream.flush()
        self._drawn = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._drawn and self._terminal:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
