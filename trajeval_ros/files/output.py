# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The output folder: ``poses.csv``, ``summary.json`` and ``report.html``.

A run may last for days, so the rows of ``poses.csv`` go to a hidden stream file in the folder as
they come, and no row is kept in memory. Each of the three files appears whole, by a rename, or not
at all.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from trajeval_ros.files.columns import COLUMNS, filled, rows_as_text
from trajeval_ros.files.partial import lock, remove_leftovers, replacing
from trajeval_ros.files.tum import tum_text
from trajeval_ros.online.results import Evaluations
from trajeval_ros.online.samples import PoseSamples

Summary = Mapping[str, Any]

_HEADER = ",".join(COLUMNS) + "\n"

# How much of the rows is in memory at a time, bytes.
_BLOCK = 1 << 20

# Ctrl-C this often while one file is being written, and it is given up.
_PATIENCE = 20

FILES = ("summary.json", "poses.csv", "report.html")
"""What is written, in this order."""
LATEST_PATH = "latest_path.txt"
"""And of an estimate that is published as whole trajectories, again and again, the latest."""

# More than a summary takes, bytes, and the pieces in which room for it is found.
_RESERVE, _PIECE = 1 << 16, 1 << 12
# Rows that a full disk does not take wait for it to have room again, bytes: some ten thousand.
_MOST_WAITING = 1 << 23
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_LEFTOVERS = (
    ".poses-*.csv.partial",
    *(f".{name}.*.partial" for name in (*FILES, LATEST_PATH)),
)


class OutputError(Exception):
    """The output folder cannot be written; the message, one line, names path and reason.

    ``failures``: a line for each file that could not be written (or not all of it); the others
    are. Empty if it is the folder. ``full``: whether it is only that the disk is.
    """

    def __init__(
        self, message: str, failures: Mapping[str, str] | None = None, full: bool = False
    ) -> None:
        super().__init__(message)
        self.failures = dict(failures or {})
        self.full = full

    @property
    def lines(self) -> tuple[str, ...]:
        """The message, a line for each file."""
        return tuple(self.failures.values()) or (str(self),)

    def below(self, name: str) -> OutputError:
        """The same, of a folder called ``name`` in another one."""
        failures = {f"{name}/{file}": line for file, line in self.failures.items()}
        return OutputError(str(self), failures or {name: str(self)}, self.full)


class OutputFolder:
    """The folder that a run's results go to.

    Construction creates the folder, its parents, and a hidden stream file in it, so that a folder
    which cannot be written is known at the start of a run rather than at its end.

    Raises
    ------
    OutputError
        From every method that touches the disk, when it cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        import tempfile

        self.path = Path(path).expanduser().absolute()
        # Rows that the stream has not got: those that wait, the number of those lost, and why.
        self._waiting = b""
        self._lost = 0
        self._why_lost = ""
        # Why the rows have not got their absolute errors.
        self._unfilled = ""
        self._size = 0
        self._handed_over = False
        self._stream: IO[bytes] = self._open()
        # An unlinked file that keeps room for the summary while the rows fill the disk.
        self._reserve: IO[bytes] | None = None
        with contextlib.suppress(OSError):
            self._reserve = tempfile.TemporaryFile(  # noqa: SIM115 (closed by close)
                buffering=0, dir=self.path
            )
        self._keep_room()

    def _open(self) -> IO[bytes]:
        import tempfile

        try:
            self.path.mkdir(parents=True, exist_ok=True)
            # Unbuffered: what a full disk does not take is known at once, and given up at once.
            stream = tempfile.NamedTemporaryFile(  # noqa: SIM115 (closed by close)
                "w+b",
                buffering=0,
                dir=self.path,
                prefix=".poses-",
                suffix=".csv.partial",
                delete=False,
            )
        except OSError as error:
            where = error.filename or self.path
            raise OutputError(_refused(where, error), full=error.errno in _FULL) from error
        lock(stream.fileno())
        remove_leftovers(self.path, *_LEFTOVERS)
        return stream

    def _keep_room(self) -> None:
        """Take what there is of the room for a summary, which is more than none."""
        if self._reserve is not None:
            with contextlib.suppress(OSError):
                for begin in range(os.fstat(self._reserve.fileno()).st_size, _RESERVE, _PIECE):
                    os.posix_fallocate(self._reserve.fileno(), begin, _PIECE)

    def _replace_summary(self, text: str, last: bool) -> None:
        """Write it in the room kept for it, which after the ``last`` time is for the rows."""
        if self._reserve is not None:
            with contextlib.suppress(OSError):
                os.ftruncate(self._reserve.fileno(), 0)
        try:
            self._replace("summary.json", lambda file: _put(file, text))
        finally:
            if last and self._reserve is not None:
                self._reserve.close()
                self._reserve = None
            self._keep_room()

    def add(self, evaluations: Evaluations) -> None:
        """Append one row an evaluated pose.

        Rows that the disk does not take wait until it does. So many that they cannot wait are lost,
        and :meth:`write` says so.
        """
        if len(evaluations.stamps) == 0:
            return
        try:
            self._append(self._waiting + rows_as_text(evaluations))
        except OSError as error:
            raise OutputError(
                _refused(self.path / "poses.csv", error), full=error.errno in _FULL
            ) from error

    def lack(self, count: int, why: str) -> None:
        """Note that so many rows came before there was a folder to put them in."""
        if count:
            self._lost, self._why_lost = self._lost + count, why

    def _append(self, rows: bytes) -> None:
        """Append to the stream the waiting ``rows``; of those that do not all fit those that do."""
        if self._reserve is not None and os.fstat(self._reserve.fileno()).st_size < _RESERVE:
            self._keep_room()
        header = _HEADER.encode("utf-8") if self._size == 0 else b""
        data = header + rows
        written = 0
        try:
            while written < len(data):
                position = self._size + written
                written += os.pwrite(self._stream.fileno(), data[written:], position)
            self._waiting = b""
        except OSError as error:
            written = data.rfind(b"\n", 0, written) + 1
            rest = data[max(written, len(header)) :]
            self._waiting = rest[: rest.rfind(b"\n", 0, _MOST_WAITING) + 1]
            self._lost += rest[len(self._waiting) :].count(b"\n")
            self._why_lost = error.strerror or str(error)
            with contextlib.suppress(OSError):
                os.ftruncate(self._stream.fileno(), self._size + written)
            raise
        finally:
            self._size += written

    def _append_waiting(self) -> None:
        with contextlib.suppress(OSError):
            if self._waiting or self._size == 0:
                self._append(self._waiting)

    @property
    def _lacking(self) -> int:
        """How many rows the stream has not got."""
        return self._lost + self._waiting.count(b"\n")

    def clear(self) -> None:
        """Forget the rows so far. Files already written stay until the next :meth:`write`."""
        self._lost = self._size = 0
        self._waiting = b""
        try:
            os.ftruncate(self._stream.fileno(), 0)
        except OSError as error:
            raise OutputError(_refused(self.path, error)) from error

    def write(
        self,
        summary: Summary,
        report: Callable[[Summary], str] | None = None,
        *,
        last: bool = False,
        latest_path: PoseSamples | None = None,
    ) -> None:
        """Write ``summary.json``, ``poses.csv``, complete to this moment, and ``report.html``.

        The rows get the errors that the ATE in ``summary`` is of.
        ``report`` (without it there is no ``report.html``) is called with the summary, after the
        two other files are safe; ``latest_path`` goes to ``latest_path.txt``, as TUM's. May be
        called again and again, but not after the ``last`` time, for which no copy of the rows is
        made. A file that cannot be written does not keep the next ones from it. A KeyboardInterrupt
        restarts the file it fell into, and is raised once all files are written: ``ros2 launch``
        sends SIGINT twice.
        """
        text = _as_json(summary)
        steps: dict[str, Callable[[], None]] = {
            "summary.json": lambda: self._replace_summary(text, last),
            "poses.csv": lambda: self._write_rows(last, summary.get("conventional", {})),
        }
        if report is not None:
            steps["report.html"] = lambda: self._replace(
                "report.html", lambda file: _put(file, report(summary))
            )
        if latest_path is not None:
            rows = tum_text(latest_path)
            steps[LATEST_PATH] = lambda: self._replace(LATEST_PATH, lambda file: _put(file, rows))
        else:
            # One of another run would be taken for this one's.
            with contextlib.suppress(OSError):
                (self.path / LATEST_PATH).unlink(missing_ok=True)
        failures: dict[str, str] = {}
        full = True
        interrupt: KeyboardInterrupt | None = None
        for name, step in steps.items():
            for attempt in range(_PATIENCE):
                try:
                    step()
                    break
                except OSError as error:
                    failures[name] = _refused(self.path / name, error)
                    full = full and error.errno in _FULL
                    break
                except KeyboardInterrupt as error:
                    if attempt == _PATIENCE - 1:
                        raise
                    interrupt = error
        if self._lacking and "poses.csv" not in failures:
            failures["poses.csv"] = (
                f"{self.path / 'poses.csv'} lacks {self._lacking:,} poses, which could not be"
                f" written: {self._why_lost}"
            )
        if self._unfilled and "poses.csv" not in failures:
            failures["poses.csv"] = (
                f"{self.path / 'poses.csv'} lacks the absolute errors of its poses, which could"
                f" not be written: {self._unfilled}"
            )
        if interrupt is not None:
            raise interrupt
        if failures:
            failures = {name: failures[name] for name in steps if name in failures}
            raise OutputError("; ".join(failures.values()), failures, full)

    def _replace(self, name: str, fill: Callable[[IO[bytes]], None]) -> None:
        # Somebody may have removed the folder since.
        self.path.mkdir(parents=True, exist_ok=True)
        _replace_file(self.path / name, fill)

    def _write_rows(self, last: bool, conventional: Summary) -> None:
        self._append_waiting()
        self._unfilled = ""
        try:
            if conventional.get("ate_translation_rmse") is not None:
                for position, rows in self._blocks():
                    _overwrite(self._stream.fileno(), filled(rows, conventional), position)
        except OSError as error:
            # Not worth the rows themselves.
            self._unfilled = error.strerror or str(error)
        if last:
            self._hand_over()
        else:
            self._replace("poses.csv", self._copy_rows)

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """The rows of the stream, many at a time, and where they stand in it."""
        position, end = len(_HEADER), self._size
        while position < end:
            block = os.pread(self._stream.fileno(), min(_BLOCK, end - position), position)
            rows = block[: block.rfind(b"\n") + 1]
            if not rows:
                return
            yield position, rows
            position += len(rows)

    def _copy_rows(self, file: IO[bytes]) -> None:
        if self._size == 0:
            _put(file, _HEADER)
        # pread leaves the position alone.
        position = 0
        while block := os.pread(self._stream.fileno(), _BLOCK, position):
            file.write(block)
            position += len(block)

    def _hand_over(self) -> None:
        """Make the stream file ``poses.csv``: needs no room, as a copy does."""
        if self._handed_over:
            return
        name = Path(self._stream.name)
        if not name.exists():
            # The folder was removed since: the rows are there as long as the stream is open.
            self._replace("poses.csv", self._copy_rows)
            return
        name.chmod(0o666 & ~_umask())
        name.replace(self.path / "poses.csv")
        self._handed_over = True

    def move(self, path: str | os.PathLike[str]) -> OutputFolder:
        """Return a folder at ``path`` that has the rows so far, and close this one."""
        moved = OutputFolder(path)
        try:
            if self._size:
                # Buffered, as a write to the bare file may stop halfway.
                with open(os.dup(moved._stream.fileno()), "wb") as file:
                    self._copy_rows(file)
        except OSError as error:
            moved.close()
            raise OutputError(_refused(moved.path, error), full=error.errno in _FULL) from error
        moved._size, moved._waiting = self._size, self._waiting
        moved._lost, moved._why_lost = self._lost, self._why_lost
        self.close()
        return moved

    def close(self) -> None:
        """Close and remove the stream file. Does not write; may be called twice."""
        self._stream.close()
        if self._reserve is not None:
            self._reserve.close()
        if not self._handed_over:
            with contextlib.suppress(OSError):
                Path(self._stream.name).unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def write_summary(folder: Path, summary: Summary) -> None:
    """Write a ``summary.json`` that has no rows of its own beside it: that of several estimates.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    _write(folder / "summary.json", _as_json(summary))


def write_report(folder: Path, page: str) -> None:
    """Write the ``report.html`` of several estimates.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    _write(folder / "report.html", page)


def _as_json(summary: Summary) -> str:
    import json

    return json.dumps(summary, indent=2, allow_nan=False) + "\n"


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _replace_file(path, lambda file: _put(file, text))
    except OSError as error:
        line = _refused(path, error)
        raise OutputError(line, {path.name: line}, error.errno in _FULL) from error


def _replace_file(path: Path, fill: Callable[[IO[bytes]], None]) -> None:
    """Fill a temporary file and rename it: a reader sees the old file or the new one."""
    with replacing(path) as file:
        fill(file)


def _put(file: IO[bytes], text: str) -> None:
    file.write(text.encode("utf-8"))


def _overwrite(descriptor: int, data: bytes, position: int) -> None:
    """Write in the place of as many bytes, which needs no room."""
    written = 0
    while written < len(data):
        written += os.pwrite(descriptor, data[written:], position + written)


def _refused(where: object, error: OSError) -> str:
    return f"cannot write the output folder: {where}: {error.strerror or error}"


def _umask() -> int:
    # There is no other way to read it.
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
