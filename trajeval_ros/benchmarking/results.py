# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``results.csv``, to which rows are added as they come, and ``results.parquet`` at the end.

In the csv text is in quotes and numbers are not, so that what is read is what was written.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from trajeval_ros.benchmarking.work import LOST, Row

CSV, PARQUET = "results.csv", "results.parquet"


class ResultsError(ValueError):
    """The results cannot be read; the message is one line."""


class Results:
    """The rows of a benchmark, each on disk before the next is waited for."""

    def __init__(self, folder: Path, rows: Iterable[Row] = ()) -> None:
        """``rows``: those to begin with; the file is written anew with them."""
        self.path = folder / CSV
        self.rows = list(rows)
        self._columns = _columns(self.rows)
        folder.mkdir(parents=True, exist_ok=True)
        self._write_anew()

    def add(self, rows: Sequence[Row]) -> None:
        """Append rows and wait until they are on disk."""
        self.rows += rows
        if set(_columns(rows)) <= set(self._columns):
            with self.path.open("a", encoding="utf-8", newline="") as file:
                file.write(_lines(rows, self._columns))
                file.flush()
                os.fsync(file.fileno())
        else:
            # The first row that has figures, or one of another error model.
            self._columns = _columns(self.rows)
            self._write_anew()

    def _write_anew(self) -> None:
        """In place of the old file all at once: one that is cut off has every earlier row."""
        new = self.path.with_suffix(".csv.new")
        with new.open("w", encoding="utf-8", newline="") as file:
            if self._columns:
                file.write(
                    _lines([dict(zip(self._columns, self._columns, strict=True))], self._columns)
                )
            file.write(_lines(self.rows, self._columns))
            file.flush()
            os.fsync(file.fileno())
        new.replace(self.path)

    def finish(self) -> None:
        """Write ``results.parquet``, the rows in the order of their names."""
        import pyarrow as pa
        from pyarrow import parquet

        ordered = in_order(self.rows)
        columns = {name: [row.get(name) for row in ordered] for name in _columns(ordered)}
        text = {n: any(isinstance(v, str) for v in values) for n, values in columns.items()}
        arrays = {
            name: pa.array(
                values if not text[name] else [None if v is None else str(v) for v in values],
                pa.string() if text[name] or name == "error" else pa.float64(),
            )
            for name, values in columns.items()
        }
        place = self.path.with_name(PARQUET)
        new = place.with_suffix(".parquet.new")
        parquet.write_table(pa.table(arrays), new)
        new.replace(place)


def in_order(rows: Iterable[Row]) -> list[Row]:
    """By system, sequence and run."""
    return sorted(rows, key=lambda row: (row["system"], row["sequence"], row["run"]))


def _columns(rows: Iterable[Row]) -> list[str]:
    found: dict[str, None] = {}
    for row in rows:
        found |= dict.fromkeys(row)
    return list(found)


def _lines(rows: Iterable[Row], columns: Sequence[str]) -> str:
    text = StringIO()
    writer = csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerows([row.get(name) for name in columns] for row in rows)
    return text.getvalue()


def read_csv(path: Path) -> list[Row]:
    """Read the rows of an unfinished benchmark; a last line that is cut off does not count."""
    try:
        whole = path.read_text(encoding="utf-8", errors="replace")
        whole = whole[: whole.rfind("\n") + 1]
        lines = list(csv.reader(StringIO(whole), quoting=csv.QUOTE_NONNUMERIC))
        header, *rest = lines or [[]]
        rows = [dict(zip(map(str, header), line, strict=True)) for line in rest]
    except (OSError, ValueError, csv.Error) as error:
        raise ResultsError(f"{path}: it is no results.csv: {error}") from error
    return _checked(path, [{k: None if v == "" else v for k, v in row.items()} for row in rows])


def read_results(path: Path) -> list[Row]:
    """Read ``results.parquet`` or ``results.csv``, or what of them lies in a folder."""
    if path.is_dir():
        path = path / PARQUET if (path / PARQUET).is_file() else path / CSV
    if path.suffix == ".csv":
        return read_csv(path)
    import pyarrow as pa
    from pyarrow import parquet

    try:
        rows: list[Row] = parquet.read_table(path).to_pylist()
    except (OSError, pa.ArrowException) as error:
        reason = next(iter(str(error).splitlines()), "")
        raise ResultsError(f"{path}: it is no results.parquet: {reason}") from error
    return _checked(path, rows)


def _checked(path: Path, rows: list[Row]) -> list[Row]:
    for row in rows:
        if not all(isinstance(row.get(name), str) for name in ("system", "sequence", "run", "key")):
            raise ResultsError(f"{path}: it is not of a benchmark: a row without a name")
    return rows


def still_good(rows: Iterable[Row], keys: Iterable[str]) -> list[Row]:
    """The rows that need not be made again: of these contents, each once, and not lost."""
    wanted = set(keys)
    found = {row["key"]: row for row in rows if row["key"] in wanted and row["status"] != LOST}
    return list(found.values())


def frame(rows: Iterable[Row]) -> Any:
    """Return the rows as a ``pandas.DataFrame``, in the order of their names."""
    import pandas as pd

    return pd.DataFrame(in_order(rows))
