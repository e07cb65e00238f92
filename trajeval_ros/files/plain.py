# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plain tables of numbers, a block of the text at a time: a long file takes as much as its numbers.

Plain is a file of whole lines of ASCII, with as many numbers in each, apart by blanks, tabs and
commas, where ``#`` begins a comment. All else is for `text` to judge, in whose words.
"""

from __future__ import annotations

import decimal
import os
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple, overload

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.trajectory import TrajectoryFileError

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# Bytes.
_BLOCK, _HEAD = 1 << 18, 1 << 16
# So many digits are always held by 64 bits; one more are told by their sign.
_DIGITS = 18
_PLAIN = b"\t\n\r" + bytes(range(ord(" "), ord("~") + 1))


def as_digits(words: Sequence[str]) -> tuple[Integers, Integers, Mask]:
    """Words as ``digits * 10**-decimals``, and which are digits, maybe with a point; (N,) each.

    Of lines it is their first words. All at once those that are as long and have the point at the
    same place.
    """
    digits, decimals = np.zeros((2, len(words)), dtype=np.int64)
    known = np.zeros(len(words), dtype=np.bool_)
    width = _DIGITS + 3  # with one more, a point, and one to tell that there are more
    letters = np.array(words, dtype=f"S{width}").view(np.uint8).reshape(-1, width)
    blanks = _first((letters == ord(" ")) | (letters == ord("\t")))
    sizes = np.minimum(blanks, np.count_nonzero(letters, axis=1))
    points = np.minimum(_first(letters == ord(".")), sizes)
    # NumPy's unique brings in its masked arrays, a hundredth of a short run.
    for kind in np.flatnonzero(np.bincount(width * sizes + points)).tolist():
        size, point = divmod(kind, width)
        count = size - (point < size)
        if not 0 < count <= _DIGITS + 1:
            continue
        alike = np.flatnonzero((sizes == size) & (points == point))
        figures = letters[alike, :size].astype(np.int64) - ord("0")
        figures = np.delete(figures, slice(point, point + 1), axis=1)
        numbers = figures @ 10 ** np.arange(count - 1, -1, -1, dtype=np.int64)
        digits[alike], decimals[alike] = numbers, count - point
        # Too large a one for 64 bits is negative.
        known[alike] = ((figures >= 0) & (figures <= 9)).all(axis=1) & (numbers >= 0)
    return digits, decimals, known


def _first(found: Mask) -> Integers:
    """In each row (N, M) the place of the first that is found; M where none is. (N,)."""
    places = found.argmax(axis=1)
    return np.asarray(np.where(found[np.arange(len(found)), places], places, found.shape[1]))


def scaled(digits: Integers, decimals: Integers, exponent: int) -> tuple[Integers, Mask]:
    """``digits * 10**(exponent - decimals)``, half to even, where 64 bits hold it; and where.

    All (N,). With the exponent 0 nothing is rounded: what is no whole number is none.
    """
    found, known = np.zeros_like(digits), np.zeros(len(digits), dtype=np.bool_)
    for power in sorted(set((exponent - decimals).tolist())):
        alike = decimals == exponent - power
        some = digits[alike]
        if 0 <= power <= _DIGITS:
            found[alike] = some * 10**power
            most = (2**63 - 1) // 10**power
            known[alike] = (-most <= some) & (some <= most)
        elif -_DIGITS <= power < 0:
            whole, rest = np.divmod(some, 10**-power)
            over = rest - 10**-power // 2
            found[alike] = whole + ((over > 0) | ((over == 0) & (whole % 2 == 1)))
            known[alike] = (rest == 0) | (exponent > 0)
    return found, known


class Written(Sequence[str]):
    """The first column as it is written: ``digits * 10**-decimals``, where it is finite.

    As words it is read anew from the file, if ever they are asked for.
    """

    def __init__(self, source: str, rows: Integers, digits: Integers, decimals: Integers) -> None:
        """Of ``source``, in these ``rows``, from 1; all (N,)."""
        self._source, self._rows = source, rows
        self._digits, self._decimals = digits, decimals

    def scaled(self, exponent: int) -> tuple[Integers, Mask]:
        """As the function `scaled`."""
        return scaled(self._digits, self._decimals, exponent)

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


class Plain(NamedTuple):
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
    try:
        # Counted first, so that at no time anything is there twice.
        most = sum(text.count(b"\n") for text in _texts(source))
        values, rows = np.empty((most, columns)), np.empty(most, dtype=np.int64)
        digits, decimals = np.empty((2, most), dtype=np.int64)
        line = count = 0
        for text in _texts(source):
            lines = _lines(text)
            filled = [row for row, each in enumerate(lines) if each]
            read = _read([lines[row] for row in filled], columns) if filled else None
            if read is not None:
                here = slice(count, count + len(filled))
                values[here], digits[here], decimals[here] = read
                rows[here] = np.array(filled) + (line + 1)
            line += len(lines)
            count += len(filled)
    except (OSError, ValueError, OverflowError):
        # Not plain, or changed meanwhile.
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


def _lines(text: bytes) -> list[str]:
    """Whole lines, without comments and the blanks at their ends. ValueError: not plain ones."""
    alone = b"\r" in text and text.count(b"\r") != text.count(b"\r\n")
    if alone or text.translate(None, _PLAIN) or not text.endswith(b"\n"):
        raise ValueError("not plain")
    lines = text[:-1].decode("ascii").replace(",", " ").split("\n")
    if b"#" in text:
        lines = [line.partition("#")[0] for line in lines]
    return [line.strip() for line in lines]


def _read(lines: list[str], columns: int) -> tuple[Array, Integers, Integers]:
    """Numbers (N, columns), and of the first column digits and decimals (N,).

    ValueError, OverflowError: not so many numbers; more digits than 64 bits hold.
    """
    values = np.loadtxt(lines, comments=None, ndmin=2)
    if values.shape[1] != columns:
        raise ValueError("other columns")
    digits, decimals, known = as_digits(lines)
    for place in np.flatnonzero(~known).tolist():
        word = lines[place].split(None, 1)[0]
        sign, figures, exponent = decimal.Decimal(word).as_tuple()
        if isinstance(exponent, int):
            number = int("".join(map(str, figures)))
            digits[place], decimals[place] = -number if sign else number, -exponent
        else:
            # Not finite.
            digits[place] = decimals[place] = 0
    return values, digits, decimals
