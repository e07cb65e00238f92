# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers in text files, with errors that name the row."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.content import Content, read_content
from trajeval_ros.files.names import POSITION, QUATERNION, Columns, columns_of, split_names
from trajeval_ros.files.plain import head_of, read_plain
from trajeval_ros.files.trajectory import TrajectoryFileError

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
PathLike = str | os.PathLike[str]

# Rows whose last numbers tell how many digits one has.
_ALIKE = 100


@dataclasses.dataclass(frozen=True)
class Layout:
    """What the rows of a format are.

    Attributes:
        columns: the numbers of columns that are right, each with what they are, for the errors.
        also: others that are read, with what they are.
        at_least: from so many columns on any number is read; 0: none is.
        named: the columns as the format has them, if names in the file may say otherwise.
        index: whether a column of row numbers may stand before the first.
    """

    columns: Mapping[int, str]
    also: Mapping[int, str] = dataclasses.field(default_factory=dict)
    at_least: int = 0
    named: Columns | None = None
    index: bool = False

    def fits(self, count: int) -> bool:
        """Whether rows of so many columns are read."""
        return count in self.columns or count in self.also or 0 < self.at_least <= count


class Table(NamedTuple):
    """The numbers of a text file.

    Attributes:
        source: the file as the user named it.
        values: (N, columns).
        first: the N texts of the first column.
        rows: (N,) the lines in the file, from 1.
        named: where names in the file say what its columns are: stamp, x, y, z and maybe qx, qy,
            qz, qw are in this order in `values` then, whatever the format.
        remarks: what was read differently from the plain format, a clause each.
    """

    source: str
    values: Array
    first: Sequence[str]
    rows: Integers
    named: Columns | None = None
    remarks: tuple[str, ...] = ()


def read_table(path: PathLike, layout: Layout) -> Table:
    """Read a table of numbers separated by white space or commas; ``#`` begins a comment.

    Args:
        path: the file, or ``-``.
        layout: what its rows are.

    Raises:
        TrajectoryFileError: the file cannot be read, is not text, holds no row, a row of
            another number of columns or something that is not a number.
    """
    plain = _plain_table(os.fspath(path), layout)
    if plain is not None:
        return plain
    content = read_content(path)
    text = content.text.replace(",", " ")
    lines = text.split("\n")
    if "#" in text:
        lines = [line.partition("#")[0] for line in lines]
    filled = [row for row, line in enumerate(lines, start=1) if line and not line.isspace()]
    if not filled:
        reason = "nothing but comments" if text.strip() else "nothing"
        raise TrajectoryFileError(content.source, f"there is {reason} in it")
    lines = [lines[row - 1] for row in filled]
    remarks = [*content.remarks, *_without_cut_row(content.text, lines, filled)]
    named = _names(content, lines, filled, layout)
    if named is not None:
        lines = _chosen(content, filled, named)
        remarks.append(f"columns by their names, {_listed(named)}")
        layout = Layout({1 + len(named.position) + len(named.quaternion): "of those named"})
    values = _numbers(content.source, lines, filled, layout)
    if named is None and layout.index and layout.fits(values.shape[1] - 1):
        values, lines = _without_index(values, lines, remarks)
    if not layout.fits(values.shape[1]):
        raise _first_bad_row(content.source, lines, filled, layout, "wrong number of columns")
    first = [line.split(None, 1)[0] for line in lines]
    rows = np.array(filled, dtype=np.int64)
    return Table(content.source, values, first, rows, named, tuple(remarks))


def _plain_table(source: str, layout: Layout) -> Table | None:
    """The table of a file that is as its format has it; None where anything is to be said of it."""
    head = head_of(source)
    if head is None:
        return None
    first = head[-1].partition("#")[0].replace(",", " ").split()
    if not layout.fits(len(first)) or not all(map(_is_number, first)):
        return None
    content = Content(source, "\n".join(head), ())
    if _names(content, [" ".join(first)], [len(head)], layout) is not None:
        return None
    plain = read_plain(source, len(first))
    return None if plain is None else Table(source, plain.values, plain.first, plain.rows)


def _numbers(source: str, lines: list[str], rows: list[int], layout: Layout) -> Array:
    try:
        return np.loadtxt(lines, comments=None, ndmin=2)
    except ValueError as error:
        raise _first_bad_row(source, lines, rows, layout, str(error)) from None


def _without_cut_row(text: str, lines: list[str], rows: list[int]) -> list[str]:
    """Leave out a last row that a killed writer has cut off; the remark about it."""
    if text.endswith("\n") or len(lines) < 3:
        return []
    words, whole = lines[-1].split(), lines[-2].split()
    cut = len(words) < len(whole) or not _is_number(words[-1])
    if not cut and len(words) == len(whole):
        digits = {_digits(line.rpartition(" ")[2]) for line in lines[-_ALIKE:-1]}
        cut = len(digits) == 1 and len(lines) > _ALIKE and _digits(words[-1]) < digits.pop()
    if not cut:
        return []
    lines.pop()
    return [f"row {rows.pop()}, the last, is cut off: left out"]


def _digits(word: str) -> int:
    """Digits after the point."""
    return len(word.strip().partition(".")[2])


def _names(content: Content, lines: list[str], rows: list[int], layout: Layout) -> Columns | None:
    """The columns that names say, where they are other than the format's.

    The names stand in a row of their own, which is left out here, or in the last comment before
    the rows, which has to have one for every column.
    """
    if layout.named is None:
        return None
    before = content.text.split("\n", rows[0])[: rows[0]]
    if any(_is_number(word) for word in lines[0].split()):
        comments = [line for line in before[:-1] if line.lstrip().startswith("#")]
        names = split_names(comments[-1]) if comments else []
        found = columns_of(names)
        if len(names) != len(_cells(before[-1], "," in before[-1])):
            return None
    else:
        found = columns_of(split_names(before[-1]))
        if found is not None and len(rows) == 1:
            raise TrajectoryFileError(content.source, "there is nothing but names in it")
        if found is not None:
            del lines[0], rows[0]
    return None if found is None or _plain(found, layout) else found


def _plain(named: Columns, layout: Layout) -> bool:
    """Whether names say what the format says."""
    format_ = layout.named
    if format_ is None or named.exponent is not None:
        return named == format_
    return named == format_._replace(exponent=None)


def _chosen(content: Content, rows: list[int], named: Columns) -> list[str]:
    """Of each row what is named, in the order of `Table`."""
    raw = content.text.split("\n")
    commas = "," in raw[rows[0] - 1]
    last = max((*named.stamp, *named.position, *named.quaternion))
    lines = []
    for row in rows:
        cells = _cells(raw[row - 1].partition("#")[0], commas)
        if len(cells) <= last:
            raise TrajectoryFileError(
                content.source, f"{len(cells)} columns, but the names are of {last + 1}", row
            )
        stamp = cells[named.stamp[0]] or "nan"
        if len(named.stamp) > 1:
            stamp += f".{cells[named.stamp[1]]:0>9}"
        # A cell that is empty is no zero.
        chosen = [cells[column] or "nan" for column in (*named.position, *named.quaternion)]
        lines.append(" ".join([stamp, *chosen]))
    return lines


def _cells(line: str, commas: bool) -> list[str]:
    """The words of a row."""
    if not commas:
        return line.split()
    cells = [cell.strip().strip("\"'") for cell in line.split(",")]
    return cells[:-1] if cells[-1] == "" else cells


def _listed(named: Columns) -> str:
    """Which column is what, from 1."""
    columns = (*named.stamp[:1], *named.position, *named.quaternion)
    pairs = zip(("stamp", *POSITION, *QUATERNION), columns, strict=False)
    return ", ".join(f"{name} in {column + 1}" for name, column in pairs)


def _without_index(values: Array, lines: list[str], remarks: list[str]) -> tuple[Array, list[str]]:
    """Leave out a first column that numbers the rows."""
    if len(values) < 2 or not (np.diff(values[:, 0]) == 1.0).all():
        return values, lines
    remarks.append("the first column numbers the rows: left out")
    return values[:, 1:].copy(), [line.split(None, 1)[1] for line in lines]


def _first_bad_row(
    source: str, lines: list[str], rows: list[int], layout: Layout, other: str
) -> TrajectoryFileError:
    """What to say of the first bad row; slow, for there is one only once it has come to that."""
    # What the rest of the file has, one row of another length is measured by.
    known = {**layout.also, **layout.columns}
    count = len(lines[0].split())
    allowed = {count} if layout.fits(count) else set(layout.columns)
    for row, line in zip(rows, lines, strict=True):
        words = line.split()
        for word in words:
            if not _is_number(word):
                return TrajectoryFileError(source, f"{shown(word)} is not a number", row)
        if len(words) not in allowed:
            expected = " or ".join(
                f"{count} ({known[count]})" if count in known else f"{count}"
                for count in sorted(allowed)
            )
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


def shown(word: str) -> str:
    """The word in quotes, cut where it is long, on one line whatever is in it."""
    return repr(word if len(word) <= 40 else word[:37] + "...")
