# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plain tables of numbers, a block of the text at a time: a long file takes as much as its numbers.

Plain is a file of whole lines of ASCII, with as many numbers in each, apart by blanks, tabs and
commas, where ``#`` begins a comment. All else is for `text` to judge, in whose words.
"""

from __future__ import annotations

import dataclasses
import decimal
import os
import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import overload

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.files.trajectory import TrajectoryFileError

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# Bytes.
_BLOCK, _HEAD = 1 << 20, 1 << 16
# More digits than so many are never held by 64 bits.
_DIGITS = 18
_NOT_PLAIN = re.compile(rb"[^\t\n\r -~]|\r(?!\n)")


class Written(Sequence[str]):
    """Numbers as they are written: ``digits * 10**-decimals``, where they are finite.

    As words they are read anew from the file, if ever they are asked for.
    """

    def __init__(self, source: str, rows: Integers, digits: Integers, decimals: Integers) -> None:
        """Of the first column of ``source``, in these ``rows``, from 1; all (N,)."""
        self._source, self._rows = source, rows
        self._digits, self._decimals = digits, decimals

    def scaled(self, exponent: int) -> tuple[Integers, Mask]:
        """Times ten to the ``exponent``, half to even, as far as 64 bits hold it; and where, (N,).

        With the exponent 0 nothing is rounded: what is no whole number is none.
        """
        scaled, known = np.zeros_like(self._digits), np.zeros(len(self._digits), dtype=np.bool_)
        for power in np.unique(exponent - self._decimals).tolist():
            alike = self._decimals == exponent - power
            digits = self._digits[alike]
            if 0 <= power <= _DIGITS:
                scaled[alike] = digits * 10**power
                known[alike] = np.abs(digits) <= (2**63 - 1) // 10**power
            elif -_DIGITS <= power < 0:
                whole, rest = np.divmod(digits, 10**-power)
                over = rest - 10**-power // 2
                scaled[alike] = whole + ((over > 0) | ((over == 0) & (whole % 2 == 1)))
                known[alike] = (rest == 0) | (exponent > 0)
        return scaled, known

    @cached_property
    def _words(self) -> list[str]:
        try:
            with open(self._source, encoding="ascii") as file:
                lines = file.read().replace(",", " ").split("\n")
            return [lines[row - 1].split(None, 1)[0] for row in self._rows.tolist()]
        except (OSError, UnicodeDecodeError, IndexError):
            reason = "it has changed while it was read"
            raise TrajectoryFileError(self._source, reason) from None

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, place: int) -> str: ...

    @overload
    def __getitem__(self, place: slice) -> list[str]: ...

    def __getitem__(self, place: int | slice) -> str | list[str]:
        """The words, as in the file."""
        return self._words[place]


@dataclasses.dataclass(frozen=True, eq=False)
class Plain:
    """A plain table.

    Attributes:
        values: (N, columns).
        rows: (N,) the lines in the file, from 1.
        first: the first column as it is written.
    """

    values: Array
    rows: Integers
    first: Written


def head_of(source: str) -> list[str] | None:
    """The lines up to the first with a word outside comments; None where none is near."""
    # What is no file can be read once only.
    if not os.path.isfile(source):
        return None
    try:
        with open(source, "rb") as file:
            head = file.read(_HEAD).decode("ascii")
    except (OSError, UnicodeDecodeError):
        return None
    lines = head.replace("\r\n", "\n").split("\n")
    # The last may be cut.
    for place, line in enumerate(lines[:-1]):
        if line.partition("#")[0].replace(",", " ").strip():
            return lines[: place + 1]
    return None


def read_plain(source: str, columns: int) -> Plain | None:
    """Read a table of so many columns; None where the file is not plain."""
    read = _read_by_loops if loops.there() else _read_by_numpy
    try:
        # Counted first, so that at no time anything is there twice.
        most = sum(text.count(b"\n") for text in _texts(source))
        values, rows = np.empty((most, columns)), np.empty(most, dtype=np.int64)
        digits, decimals = np.empty((2, most), dtype=np.int64)
        line = count = 0
        for text in _texts(source):
            left = (array[count:] for array in (rows, digits, decimals))
            found = read(text, line, values[count:], *left)
            if found < 0:
                return None
            line += text.count(b"\n")
            count += found
    except OSError:
        return None
    rows = rows[:count]
    return Plain(values[:count], rows, Written(source, rows, digits[:count], decimals[:count]))


def _texts(source: str) -> Iterator[bytes]:
    """Whole lines, about a block at a time; where one is not whole, or endless, what there is."""
    left = b""
    with open(source, "rb") as file:
        while block := file.read(_BLOCK):
            end = block.rfind(b"\n") + 1
            yield left + (block[:end] if end else block)
            left = block[end:] if end else b""
    if left:
        yield left


def _read_by_loops(
    text: bytes, before: int, values: Array, rows: Integers, digits: Integers, decimals: Integers
) -> int:
    """Read whole lines that stand behind so many ``before``; how many rows, or -1: not plain.

    What is read is written to ``values`` (M, columns), ``rows``, ``digits`` and ``decimals`` (M,).
    """
    letters = np.frombuffer(text, dtype=np.uint8)
    most, columns = values.shape
    arrays = (values, rows, digits, decimals)
    return loops.call("rows", letters, len(text), before, columns, most, *arrays)


def _read_by_numpy(
    text: bytes, before: int, values: Array, rows: Integers, digits: Integers, decimals: Integers
) -> int:
    """The same without a compiler."""
    if _NOT_PLAIN.search(text) or not text.endswith(b"\n"):
        return -1
    lines = text.decode("ascii").replace(",", " ").split("\n")
    lines = [line.partition("#")[0].strip() for line in lines]
    filled = [row for row, line in enumerate(lines) if line]
    count = len(filled)
    if not filled or count > len(values):
        return -bool(filled)
    try:
        found = np.loadtxt([lines[row] for row in filled], comments=None, ndmin=2)
        if found.shape[1] != values.shape[1]:
            return -1
        values[:count] = found
        rows[:count] = np.array(filled) + (before + 1)
        for place, row in enumerate(filled):
            sign, letters, exponent = decimal.Decimal(lines[row].split(None, 1)[0]).as_tuple()
            if isinstance(exponent, int):
                number = int("".join(map(str, letters)))
                digits[place], decimals[place] = -number if sign else number, -exponent
            else:
                digits[place] = decimals[place] = 0
    except (ValueError, OverflowError):
        return -1
    return count
