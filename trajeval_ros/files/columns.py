# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rows of ``poses.csv``.

ATE's alignment is not known before the end. So every row keeps room for the pose's two errors,
which are filled in, in place, as the folder is written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.online.ate import ate_errors
from trajeval_ros.online.results import Evaluations

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

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
    "sampled",
    "ate_translation",
    "ate_rotation",
)
"""The columns of ``poses.csv``."""

# Where a row has the two poses.
_POSES = tuple(COLUMNS.index(f"{whose}_{name}") for whose in ("gt", "est") for name in _POSE)

# The last three columns have this many characters: what the two errors do not need, and each may
# need 24, are blanks behind the first of them, a number to every reader of CSV.
_TAIL = 52
# What a number takes at the most, its comma included, and how many rows are made at a time.
_WIDEST = 25
_ROWS = 256
# Of which powers of ten the loop that writes a number takes the digits.
_LEAST_POWER, _LARGEST_POWER = -292, 324
_BITS = 128


def rows_as_text(evaluations: Evaluations) -> bytes:
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
    return as_text(evaluations.stamps, columns, evaluations.sampled)


def as_text(stamps: Stamps, columns: Array, sampled: Mask) -> bytes:
    """Rows of ``stamps`` (n,), ``columns`` (n, m), whether they are ``sampled`` (n,), two blanks.

    repr(float) is the shortest text that reads back as the same number; one that is none is empty.
    """
    if not loops.there():
        return _plain(stamps, columns, sampled)
    return b"".join(
        _looped(stamps[at : at + _ROWS], columns[at : at + _ROWS], sampled[at : at + _ROWS])
        for at in range(0, len(stamps), _ROWS)
    )


def _looped(stamps: Stamps, columns: Array, sampled: Mask) -> bytes:
    count, width = columns.shape
    text = np.empty(count * (_WIDEST * (width + 1) + _TAIL + 1), dtype=np.uint8)
    numbers, known = loops.doubles(columns), np.ascontiguousarray(sampled)
    given = np.ascontiguousarray(stamps), numbers, known, count, width
    length = loops.call("digits_rows", *given, _TAIL, _powers(), text)
    return _plain(stamps, columns, sampled) if length < 0 else text[:length].tobytes()


def _plain(stamps: Stamps, columns: Array, sampled: Mask) -> bytes:
    # NumPy has no batch form of repr.
    rows = zip(stamps.tolist(), columns.tolist(), sampled.tolist(), strict=True)
    return "".join(
        f"{stamp},{','.join(map(_number, row))}{_tail(known)}\n" for stamp, row, known in rows
    ).encode("ascii")


def _number(value: float) -> str:
    return "" if value != value else repr(value)


def _tail(sampled: bool, translation: str = "", rotation: str = "") -> str:
    """The last three columns."""
    return f",{int(sampled)}".ljust(_TAIL - 2 - len(translation + rotation)) + (
        f",{translation},{rotation}"
    )


def filled(rows: bytes, conventional: Mapping[str, Any]) -> bytes:
    """Whole ``rows`` with the errors of those that ATE counts; not a byte longer."""
    lines = rows.decode("ascii").splitlines()
    poses = np.loadtxt(lines, delimiter=",", usecols=_POSES, ndmin=2)
    truth, estimate = (
        se3.from_position_quaternion(part[:, :3], part[:, 3:])
        for part in (poses[:, :7], poses[:, 7:])
    )
    errors = np.stack(ate_errors(conventional, truth, estimate), axis=1)
    if loops.there():
        text = np.frombuffer(rows, dtype=np.uint8).copy()
        if not loops.call("digits_tails", text, len(text), errors, _TAIL, _powers()):
            return text.tobytes()
    return b"".join(_filled(lines, errors))


def _filled(lines: list[str], errors: Array) -> Iterator[bytes]:
    for line, pair in zip(lines, errors.tolist(), strict=True):
        if line[1 - _TAIL] == "1":
            line = line[:-_TAIL] + _tail(True, *map(_number, pair))
        yield f"{line}\n".encode("ascii")


@cache
def _powers() -> npt.NDArray[np.uint64]:
    """The first 128 bits of powers of ten, rounded up: (617, 2), high half first."""
    first = []
    for power in range(_LEAST_POWER, _LARGEST_POWER + 1):
        if power < 0:
            divisor = 10**-power
            bits = -(-(1 << (_BITS - 1 + divisor.bit_length())) // divisor)
        else:
            shift = _BITS - (10**power).bit_length()
            bits = -(-(10**power << max(shift, 0)) // (1 << max(-shift, 0)))
        first.append(divmod(bits, 1 << (_BITS // 2)))
    return np.array(first, dtype=np.uint64)
