# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``results.csv``, to which rows are added as they come, and ``results.parquet`` at the end.

In the csv text is in quotes and numbers are not, so that what is read is what was written. Whole
rows are on disk alone: in memory there is of each what tables, report and gate are made of.
"""

from __future__ import annotations

import csv
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from trajeval_ros.benchmarking.figures import FIGURES
from trajeval_ros.benchmarking.work import LOST, Row, cell
from trajeval_ros.online.parameters import PARAMETERS

CSV, PARQUET = "results.csv", "results.parquet"

_ALWAYS = ("system", "sequence", "run", "status", "error", "key")
_WHERE_KNOWN = (
    *("ground_truth_sha256", "parameters_sha256", "version", "python", "numpy", "scipy"),
    *(figure.column for figure in FIGURES),
)
_DEFAULTS = {f"parameters.{name}": cell(one.default) for name, one in PARAMETERS.items()}


class ResultsError(ValueError):
    """The results cannot be read; the message is one line."""


def brief(row: Row) -> Row:
    """What tables, report and gate ask of a row: a tenth of it."""
    found = {name: row.get(name) for name in _ALWAYS}
    found |= {name: value for name in _WHERE_KNOWN if (value := row.get(name)) is not None}
    found |= {
        name: value
        for name, default in _DEFAULTS.items()
        if (value := row.get(name)) is not None and value != default
    }
    # Most texts are those of many rows.
    return {name: sys.intern(v) if isinstance(v, str) else v for name, v in found.items()}


class Results:
    """The rows of a benchmark, each on disk before the next is waited for.

    ``rows``: those so far, in `brief`.
    """

    def __init__(self, folder: Path, rows: Sequence[Row] = ()) -> None:
        """``rows``: those to begin with; the file is written anew with them."""
        self.path = folder / CSV
        self.rows: list[Row] = []
        self._columns: list[str] = []
        self._texts: set[str] = set()
        folder.mkdir(parents=True, exist_ok=True)
        self._begin(rows, _columns(rows))

    @classmethod
    def resumed(cls, folder: Path, keys: Iterable[str]) -> Results:
        """Go on with what is in a folder, if anything is.

        The rows that need not be made again stay: of these ``keys``, each once, and not lost.
        Raises :class:`ResultsError` where they cannot be read.
        """
        path, wanted = folder / CSV, set(keys)
        if not path.is_file():
            return cls(folder)
        last: dict[object, int] = {}
        columns: list[str] = []
        for place, row in enumerate(_checked(path, read_rows(path))):
            columns = columns or list(row)
            if row["key"] in wanted and row["status"] != LOST:
                last[row["key"]] = place
        kept = set(last.values())
        made = cls.__new__(cls)
        made.path, made.rows, made._columns, made._texts = path, [], [], set()
        made._begin((row for n, row in enumerate(read_rows(path)) if n in kept), columns)
        return made

    def add(self, rows: Sequence[Row]) -> None:
        """Append rows and wait until they are on disk."""
        more = [name for name in _columns(rows) if name not in self._columns]
        if more:
            # The first row that has figures, or one of another error model.
            columns = [*self._columns, *more]
            self._write_anew(read_rows(self.path) if self.rows else (), columns)
            self._columns = columns
        with self.path.open("a", encoding="utf-8", newline="") as file:
            for row in rows:
                file.write(_line(row, self._columns))
            file.flush()
            os.fsync(file.fileno())
        for row in rows:
            self._note(row)

    def _note(self, row: Row) -> None:
        self.rows.append(brief(row))
        self._texts.update(name for name, value in row.items() if isinstance(value, str))

    def _begin(self, rows: Iterable[Row], columns: list[str]) -> None:
        def noted() -> Iterator[Row]:
            for row in rows:
                self._note(row)
                yield row

        self._columns = columns
        self._write_anew(noted(), columns)

    def _write_anew(self, rows: Iterable[Row], columns: Sequence[str]) -> None:
        """In place of the old file all at once: one that is cut off has every earlier row."""
        new = self.path.with_suffix(".csv.new")
        with new.open("w", encoding="utf-8", newline="") as file:
            if columns:
                file.write(_line(dict(zip(columns, columns, strict=True)), columns))
            for row in rows:
                file.write(_line(row, columns))
            file.flush()
            os.fsync(file.fileno())
        new.replace(self.path)

    def finish(self) -> None:
        """Write ``results.parquet``, the rows in the order of their names."""
        import pyarrow as pa
        from pyarrow import parquet

        place = self.path.with_name(PARQUET)
        new = place.with_suffix(".parquet.new")
        parquet.write_table(self._table() if self._columns else pa.table({}), new)
        new.replace(place)

    def _table(self) -> Any:
        import pyarrow as pa
        from pyarrow import csv as arrow

        texts = {*self._texts, "error"}
        types = {n: pa.string() if n in texts else pa.float64() for n in self._columns}
        table = arrow.read_csv(
            self.path,
            parse_options=arrow.ParseOptions(newlines_in_values=True),
            convert_options=arrow.ConvertOptions(
                column_types=types, null_values=[""], strings_can_be_null=True
            ),
        )
        return table.sort_by([(name, "ascending") for name in ("system", "sequence", "run")])


def in_order(rows: Iterable[Row]) -> list[Row]:
    """By system, sequence and run."""
    return sorted(rows, key=lambda row: (row["system"], row["sequence"], row["run"]))


def _columns(rows: Iterable[Row]) -> list[str]:
    found: dict[str, None] = {}
    for row in rows:
        found |= dict.fromkeys(row)
    return list(found)


def _line(row: Row, columns: Sequence[str]) -> str:
    text = StringIO()
    writer = csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow([row.get(name) for name in columns])
    return text.getvalue()


def read_rows(path: Path) -> Iterator[Row]:
    """Read the rows of ``results.csv`` one by one; a last line that is cut off does not count.

    Raises :class:`ResultsError` at what is no row.
    """
    try:
        with path.open(encoding="utf-8", errors="replace", newline="") as file:
            whole = (line for line in file if line.endswith("\n"))
            lines = csv.reader(whole, quoting=csv.QUOTE_NONNUMERIC)
            header = [str(name) for name in next(lines, [])]
            for line in lines:
                row = zip(header, line, strict=True)
                yield {name: None if value == "" else value for name, value in row}
    except (OSError, ValueError, csv.Error) as error:
        raise ResultsError(f"{path}: it is no results.csv: {error}") from error


def read_csv(path: Path) -> list[Row]:
    """Read all rows of an unfinished benchmark, as `read_rows`."""
    return list(_checked(path, read_rows(path)))


def read_results(path: Path) -> list[Row]:
    """Read ``results.parquet`` or ``results.csv``, or what of them lies in a folder."""
    path = _of_folder(path)
    return read_csv(path) if path.suffix == ".csv" else list(_checked(path, _read_parquet(path)))


def read_brief(path: Path) -> list[Row]:
    """Read as `read_results`, but of each row what `brief` says."""
    path = _of_folder(path)
    rows = read_rows(path) if path.suffix == ".csv" else _read_parquet(path, only_brief=True)
    return [brief(row) for row in _checked(path, rows)]


def _of_folder(path: Path) -> Path:
    if path.is_dir():
        return path / PARQUET if (path / PARQUET).is_file() else path / CSV
    return path


def _read_parquet(path: Path, *, only_brief: bool = False) -> Iterator[Row]:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as file:
            names = file.schema_arrow.names
            if only_brief:
                wanted = {*_ALWAYS, *_WHERE_KNOWN, *_DEFAULTS}
                names = [name for name in names if name in wanted]
            for batch in file.iter_batches(1_000, columns=names):
                yield from batch.to_pylist()
    except (OSError, pa.ArrowException) as error:
        reason = next(iter(str(error).splitlines()), "")
        raise ResultsError(f"{path}: it is no results.parquet: {reason}") from error


def _checked(path: Path, rows: Iterable[Row]) -> Iterator[Row]:
    for row in rows:
        if not all(isinstance(row.get(name), str) for name in ("system", "sequence", "run", "key")):
            raise ResultsError(f"{path}: it is not of a benchmark: a row without a name")
        yield row


def frame(folder: Path) -> Any:
    """Return ``results.parquet`` as a ``pandas.DataFrame``, in the order of the rows' names."""
    from pyarrow import parquet

    return parquet.read_table(folder / PARQUET).to_pandas()
