# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stamps of a table, exact to the nanosecond, in whatever unit they are."""

import decimal

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.plain import Written, as_digits, scaled
from trajeval_ros.files.text import Table, shown
from trajeval_ros.files.trajectory import TrajectoryFileError
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

SECONDS, NANOSECONDS = 9, 0
"""Units, as powers of ten in nanoseconds."""

_UNITS = {9: "seconds", 6: "milliseconds", 3: "microseconds", 0: "nanoseconds"}

# Enough digits for any stamp in a file, so that decimal arithmetic on it is exact.
_CONTEXT = decimal.Context(prec=400)

# s since 1970, from the year 2000 to 2100: no count since a start comes near.
_EPOCH = (946_684_800.0, 4_102_444_800.0)
_LARGEST_SECONDS = 2**63 / 1e9
# s between rows, as far as they can be those of a trajectory.
_SHORTEST_STEP, _LONGEST_STEP = 1e-4, 3600.0


def read_stamps(table: Table, exponent: int) -> tuple[Integers, Mask, tuple[str, ...]]:
    """The first column in exact nanoseconds.

    A double since 1970 resolves 0.24 us, so the text is read, not the number. Digits beyond the
    nanosecond are rounded, half to even. Where the stamps cannot be in the format's unit, and
    count from 1970 in another one, they are read in that.

    Args:
        table: with stamps in its first column; its names may say their unit.
        exponent: of ten, the format's unit in nanoseconds.

    Returns:
        Stamps (N,) ns; which of them are finite, (N,), the stamp of the others is 0; remarks.

    Raises:
        TrajectoryFileError: a stamp that int64 nanoseconds cannot hold, or that is no whole number
            of nanoseconds where it is in these.
    """
    finite = np.isfinite(table.values[:, 0])
    said = None if table.named is None else table.named.exponent
    unit = _unit(table.values[finite, 0], exponent) if said is None else said
    remarks = () if unit == exponent else (f"stamps in {_UNITS[unit]}",)
    column = table.first
    if isinstance(column, Written):
        stamps, known = column.scaled(unit)
    else:
        digits, decimals, plain = as_digits(column)
        stamps, known = scaled(digits, decimals, unit)
        known &= plain
    stamps[~finite] = 0
    for index in np.flatnonzero(finite & ~known).tolist():
        stamp = _decimal_nanoseconds(table, index, unit)
        if not -(2**63) <= stamp < 2**63:
            hint = "; is it in nanoseconds?" if unit == SECONDS else ""
            raise _out_of_range(table, index, _UNITS[unit] + hint)
        stamps[index] = stamp
    return stamps, finite, remarks


def _unit(values: Array, exponent: int) -> int:
    """The unit by size, where it cannot be the format's."""
    if len(values) == 0:
        return exponent
    # Of stamps that are none it may be beyond a double.
    with np.errstate(over="ignore"):
        usual = median(values)
    if not _impossible(values, usual, exponent):
        return exponent
    for unit in _UNITS:
        seconds = 10.0 ** (unit - 9)
        if _EPOCH[0] <= usual * seconds <= _EPOCH[1] and _is_step(values, seconds):
            return unit
    return exponent


def _impossible(values: Array, usual: float, exponent: int) -> bool:
    """Whether stamps cannot be in that unit."""
    if exponent == SECONDS:
        return usual >= _LARGEST_SECONDS
    # Whole numbers that are no count since 1970 may be one since a start.
    parts = bool((values != np.rint(values)).any())
    return (parts and usual < 1e11) or not _is_step(values, 10.0 ** (exponent - 9))


def _is_step(values: Array, seconds: float) -> bool:
    """Whether rows this unit (s) apart can be those of a trajectory."""
    with np.errstate(over="ignore"):
        steps = np.abs(np.diff(values))
    steps = steps[steps > 0]
    return len(steps) == 0 or _SHORTEST_STEP <= median(steps) * seconds <= _LONGEST_STEP


def _decimal_nanoseconds(table: Table, index: int, exponent: int) -> int:
    """The finite stamp of a row, however it is written."""
    word, row = table.first[index], int(table.rows[index])
    try:
        value = decimal.Decimal(word)
    except decimal.InvalidOperation:
        raise TrajectoryFileError(table.source, f"{shown(word)} is not a number", row) from None
    # An int of it would have as many digits as the exponent says.
    if value.adjusted() > 30:
        raise _out_of_range(table, index, "nanoseconds")
    whole = value.scaleb(exponent, context=_CONTEXT)
    rounded = whole.to_integral_value(decimal.ROUND_HALF_EVEN, context=_CONTEXT)
    if exponent == NANOSECONDS and rounded != whole:
        reason = f"the stamp {shown(word)} is not a whole number of nanoseconds"
        raise TrajectoryFileError(table.source, reason, row)
    return int(rounded)


def _out_of_range(table: Table, index: int, unit: str) -> TrajectoryFileError:
    return TrajectoryFileError(
        table.source,
        f"the stamp {shown(table.first[index])} is out of the range of {unit}",
        int(table.rows[index]),
    )
