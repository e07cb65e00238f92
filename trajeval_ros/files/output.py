# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The output folder: ``poses.csv``, ``summary.json`` and ``report.html``.

A run may last for days, so the rows of ``poses.csv`` go to a hidden stream file in the folder as
they come, and no row is kept in memory. Each of the three files appears whole, by a rename, or not
at all.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.online.results import Evaluations

Array = npt.NDArray[np.float64]
Summary = Mapping[str, Any]

_POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_UPPER = np.triu_indices(6)

COLUMNS: tuple[str, ...] = (
    "stamp_ns",
    *(f"gt_{name}" for name in _POSE),
    *(f"cov_{row}{column}" for row, column in zip(*_UPPER, strict=True)),
    *(f"est_{name}" for name in _POSE),
    *(f"e_{axis}" for axis in range(6)),
    "chi2",
    "log_det",
    "log_likelihood",
)
"""The columns of ``poses.csv``."""

_HEADER = ",".join(COLUMNS) + "\n"

# Ctrl-C this often while one file is being written, and it is given up.
_PATIENCE = 20


class OutputError(Exception):
    """The output folder cannot be written; the message, one line, names path and reason."""


def format_rows(evaluations: Evaluations) -> str:
    """Rows of ``poses.csv`` in full precision: ``float`` reads back what was computed."""
    columns = np.concatenate(
        [
            *se3.to_position_quaternion(evaluations.ground_truth),
            evaluations.covariance[:, _UPPER[0], _UPPER[1]],
            *se3.to_position_quaternion(evaluations.estimate),
            evaluations.relative_error,
            evaluations.chi2[:, None],
            evaluations.log_det[:, None],
            evaluations.log_likelihood[:, None],
        ],
        axis=1,
    )
    # repr(float) is the shortest text that reads back as the same number; NumPy has no batch form
    # of it.
    lines = [
        f"{stamp}," + ",".join(map(repr, row))
        for stamp, row in zip(evaluations.stamps.tolist(), columns.tolist(), strict=True)
    ]
    return "".join(line.replace("nan", "") + "\n" for line in lines)


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
        self.path = Path(path).expanduser().absolute()
        self._stream: IO[str] = self._open()

    def _open(self) -> IO[str]:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            stream = tempfile.NamedTemporaryFile(  # noqa: SIM115 (closed by close)
                "w+",
                encoding="utf-8",
                newline="",
                dir=self.path,
                prefix=".poses-",
                suffix=".csv.partial",
                delete=False,
            )
        except OSError as error:
            raise self._refused(error) from error
        stream.write(_HEADER)
        return stream

    def _refused(self, error: OSError) -> OutputError:
        where = error.filename or self.path
        return OutputError(f"cannot write the output folder: {where}: {error.strerror or error}")

    def add(self, evaluations: Evaluations) -> None:
        """Append one row an evaluated pose."""
        if len(evaluations.stamps) == 0:
            return
        rows = format_rows(evaluations)
        try:
            self._stream.write(rows)
        except OSError as error:
            raise self._refused(error) from error

    def clear(self) -> None:
        """Forget the rows so far. Files already written stay until the next :meth:`write`."""
        try:
            self._stream.seek(0)
            self._stream.truncate()
            self._stream.write(_HEADER)
        except OSError as error:
            raise self._refused(error) from error

    def write(self, summary: Summary, report: Callable[[Summary], str] | None = None) -> None:
        """Write ``poses.csv``, complete to this moment, ``summary.json`` and ``report.html``.

        ``report`` (without it there is no ``report.html``) is called with the summary, after the
        two other files are safe. May be called again and again. A KeyboardInterrupt restarts the
        file it fell into, and is raised once all files are written: ``ros2 launch`` sends SIGINT
        twice.
        """
        text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
        steps: list[Callable[[], None]] = [
            lambda: self._replace("poses.csv", self._copy_rows),
            lambda: self._replace("summary.json", lambda file: _put(file, text)),
        ]
        if report is not None:
            steps.append(
                lambda: self._replace("report.html", lambda file: _put(file, report(summary)))
            )
        interrupt: KeyboardInterrupt | None = None
        for step in steps:
            for attempt in range(_PATIENCE):
                try:
                    step()
                    break
                except KeyboardInterrupt as error:
                    if attempt == _PATIENCE - 1:
                        raise
                    interrupt = error
        if interrupt is not None:
            raise interrupt

    def _replace(self, name: str, fill: Callable[[IO[bytes]], None]) -> None:
        """Fill a temporary file and rename it: a reader sees the old file or the new one."""
        partial = self.path / f".{name}.{os.getpid()}.partial"
        try:
            # Somebody may have removed the folder since.
            self.path.mkdir(parents=True, exist_ok=True)
            with partial.open("wb") as file:
                fill(file)
            partial.replace(self.path / name)
        except OSError as error:
            raise self._refused(error) from error
        finally:
            partial.unlink(missing_ok=True)

    def _copy_rows(self, file: IO[bytes]) -> None:
        self._stream.flush()
        # pread leaves the position where the next row goes.
        descriptor, position = self._stream.fileno(), 0
        while block := os.pread(descriptor, 1 << 20, position):
            file.write(block)
            position += len(block)

    def move(self, path: str | os.PathLike[str]) -> OutputFolder:
        """Return a folder at ``path`` that has the rows so far, and close this one."""
        moved = OutputFolder(path)
        try:
            moved._stream.seek(0)
            moved._stream.truncate()
            self._copy_rows(moved._stream.buffer)  # type: ignore[attr-defined]
        except OSError as error:
            raise moved._refused(error) from error
        self.close()
        return moved

    def close(self) -> None:
        """Close and remove the stream file. Does not write; may be called twice."""
        self._stream.close()
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


def _put(file: IO[bytes], text: str) -> None:
    file.write(text.encode("utf-8"))
