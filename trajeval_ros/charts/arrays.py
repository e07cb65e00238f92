# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays as text that a page can hold, and fewer points that look the same."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


def numbers(values: npt.ArrayLike) -> str:
    """Values of any shape as little-endian float32 in base 64, for ``charts.floats``."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def extremes(columns: Sequence[npt.ArrayLike], most: int) -> Indices:
    """Indices of at most ``most`` rows that keep the extremes of every column.

    ``columns``: of (N,) or (N, k) each, the same N; ``most`` > 1 and twice the number of columns at
    the least. The rows are cut into as many stretches of equal length as may be; of each the rows
    with the smallest and the largest value of each column stay, and so do the first row and the
    last. NaN counts as nothing.
    """
    table = np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])
    count = len(table)
    if count <= most:
        return np.arange(count)
    nothing, stretches = np.isnan(table), most
    signed = [np.where(nothing, -np.inf, sign * table) for sign in (1.0, -1.0)]
    while True:
        kept = _extremes(signed, max(stretches, 1))
        if len(kept) <= most or stretches <= 1:
            return kept
        # A few tries: neighbours share rows, so that how many stay is only known by trying.
        stretches = min(stretches - 1, int(0.95 * stretches * most / len(kept)))


def _extremes(signed: Sequence[Array], stretches: int) -> Indices:
    count, width = signed[0].shape
    size = -(-count // stretches)
    whole = count - count % size
    kept = np.zeros(count, dtype=bool)
    kept[[0, -1]] = True
    for table in signed:
        places = np.argmax(table[:whole].reshape(-1, size, width), axis=1)
        kept[places + size * np.arange(len(places))[:, None]] = True
        if whole < count:
            kept[whole + np.argmax(table[whole:], axis=0)] = True
    return np.flatnonzero(kept)
