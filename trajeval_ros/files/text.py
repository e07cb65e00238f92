# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers in text files, with exact stamps and errors that name the row."""

import dataclasses
import decimal
import os
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.trajectory import TrajectoryFileError

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
PathLike = str | os.PathLike[str]

# Enough digits for any stamp in a file, so that decimal arithmetic on it is exact.
_CONTEXT = decimal.Context(prec=400)


@dataclasses.dataclass(frozen=True)
class Table:
    """The numbers of a text file.

    Attributes:
        source: the file as the user named it.
        values: (N, columns).
        first: the N texts of the first column.
        rows: (N,) the lines in the file, from 1.
    """

    source: str
    values: Array
    first: Sequence[str]
    rows: Integers


def read_table(path: PathLike, columns: Mapping[int, str]) -> Table:
    """Read a table of numbers separated by white space or commas; ``#`` begins a comment.

    Args:
        path: the file.
        columns: the numbers of columns that are right, each with what they are, for the error.

    Raises:
        TrajectoryFileError: the file cannot be read, is not text, holds no row, a row of
            another number of columns or something that is not a number.
    """
    source = os.fspath(path)
    text = _read_text(source)
    lines = [line.partition("#")[0] for line in text.split("\n")]
    filled = [row for row, line in enumerate(lines, start=1) if line and not line.isspace()]
    if not filled:
        reason = "nothing but comments" if text.strip() else "nothing"
        raise TrajectoryFileError(source, f"there is {reason} in it")
    lines = [lines[row - 1] for row in filled]
    try:
        values = np.loadtxt(lines, comments=None, ndmin=2)
    except ValueError as error:
        raise _first_bad_row(source, lines, filled, columns, str(error)) from None
    if values.shape[1] not in columns:
        raise _first_bad_row(source, lines, filled, columns, "wrong number of columns")
    first = [line.split(None, 1)[0] for line in lines]
    return Table(source, values, first, np.array(filled, dtype=np.int64))


def _read_text(source: str) -> str:
    """The text, commas turned into blanks."""
    try:
        with open(source, "rb") as file:
            text = file.read().decode("utf-8-sig")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TrajectoryFileError(source, f"it cannot be read: {reason}") from None
    except UnicodeDecodeError:
        raise TrajectoryFileError(source, "it is not a text file") from None
    return text.replace("\r\n", "\n").replace(",", " ")


def _first_bad_row(
    source: str, lines: list[str], rows: list[int], columns: Mapping[int, str], other: str
) -> TrajectoryFileError:
    """What to say of the first bad row; slow, for there is one only once it has come to that."""
    # What the rest of the file has, one row of another length is measured by.
    allowed = {len(lines[0].split())} & set(columns) or set(columns)
    for row, line in zip(rows, lines, strict=True):
        words = line.split()
        for word in words:
            if not _is_number(word):
                return TrajectoryFileError(source, f"{_shown(word)} is not a number", row)
        if len(words) not in allowed:
            expected = " or ".join(f"{count} ({columns[count]})" for count in sorted(allowed))
            plural = "column" if len(words) == 1 else "columns"
            return TrajectoryFileError(
                source, f"{len(words)} {plural} where there should be {expected}", row
            )
    return TrajectoryFileError(source, other)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    # Python's digit groups, which np.loadtxt does not take for a number.
    return "_" not in word


def stamps_from_seconds(table: Table) -> tuple[Integers, npt.NDArray[np.bool_]]:
    """The first column, seconds, in exact nanoseconds.

    A double since 1970 resolves 0.24 us, so the text is read, not the number. Digits beyond the
    nanosecond are rounded, half to even.

    Returns:
        Stamps (N,) ns, and which of them are finite, (N,); the stamp of the others is 0.

    Raises:
        TrajectoryFileError: a stamp that int64 nanoseconds cannot hold.
    """
    stamps = np.zeros(len(table.first), dtype=np.int64)
    finite = np.isfinite(table.values[:, 0])
    parsed = [_plain_nanoseconds(word) for word in table.first]
    for index, value in enumerate(parsed):
        if value is None and finite[index]:
            parsed[index] = _decimal_nanoseconds(table, index)
    stamps[finite] = _checked(table, parsed, finite, "seconds; is it in nanoseconds?")
    return stamps, finite


def stamps_from_nanoseconds(table: Table) -> tuple[Integers, npt.NDArray[np.bool_]]:
    """The first column, whole nanoseconds; as `stamps_from_seconds`.

    Raises:
        TrajectoryFileError: a stamp that is no whole number or that int64 cannot hold.
    """
    stamps = np.zeros(len(table.first), dtype=np.int64)
    finite = np.isfinite(table.values[:, 0])
    parsed: list[int | None] = []
    for index, word in enumerate(table.first):
        if word.isdecimal():
            parsed.append(int(word))
        elif finite[index]:
            value = _decimal(table, index)
            if value != value.to_integral_value(context=_CONTEXT):
                raise TrajectoryFileError(
                    table.source,
                    f"the stamp {_shown(word)} is not a whole number of nanoseconds",
                    int(table.rows[index]),
                )
            parsed.append(int(value))
        else:
            parsed.append(None)
    stamps[finite] = _checked(table, parsed, finite, "nanoseconds")
    return stamps, finite


def _plain_nanoseconds(word: str) -> int | None:
    """Of digits, a point, up to nine digits; None for any other way to write a number."""
    whole, _, fraction = word.partition(".")
    if whole.isdecimal() and len(fraction) <= 9 and (fraction.isdecimal() or not fraction):
        return int(whole + fraction.ljust(9, "0"))
    return None


def _decimal_nanoseconds(table: Table, index: int) -> int:
    nanoseconds = _decimal(table, index).scaleb(9, context=_CONTEXT)
    return int(nanoseconds.to_integral_value(decimal.ROUND_HALF_EVEN, context=_CONTEXT))


def _decimal(table: Table, index: int) -> decimal.Decimal:
    """The finite stamp of a row, exactly."""
    word, row = table.first[index], int(table.rows[index])
    try:
        value = decimal.Decimal(word)
    except decimal.InvalidOperation:
        raise TrajectoryFileError(table.source, f"{_shown(word)} is not a number", row) from None
    # An int of it would have as many digits as the exponent says.
    if value.adjusted() > 30:
        raise _out_of_range(table, index, "nanoseconds")
    return value


def _checked(
    table: Table, parsed: list[int | None], finite: npt.NDArray[np.bool_], unit: str
) -> Integers:
    """The finite ones as int64."""
    kept = [value for value, keep in zip(parsed, finite, strict=True) if keep and value is not None]
    try:
        return np.array(kept, dtype=np.int64)
    except OverflowError:
        too_large = next(
            index
            for index, value in enumerate(parsed)
            if value is not None and not -(2**63) <= value < 2**63
        )
        raise _out_of_range(table, too_large, unit) from None


def _out_of_range(table: Table, index: int, unit: str) -> TrajectoryFileError:
    return TrajectoryFileError(
        table.source,
        f"the stamp {_shown(table.first[index])} is out of the range of {unit}",
        int(table.rows[index]),
    )


def _shown(word: str) -> str:
    """The word in quotes, cut where it is long, on one line whatever is in it."""
    return repr(word if len(word) <= 40 else word[:37] + "...")
