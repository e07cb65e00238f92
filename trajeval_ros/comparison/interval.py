# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How well the RMSE of one run is known.

Errors last: the next one is like this one. So the run is cut into ten stretches of equal length,
whose mean squares scatter as independent ones (Ibragimov and Müller); and the memory of the squares
is estimated as that of an autoregression of first order, with its bias in a short series taken out
(Kendall). The larger of the two scatters, with Student's t of nine degrees of freedom, gives the
interval of the RMSE's logarithm. It says what another stretch of such motion would give, not
another run. Where the errors drift through the whole run, there is none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.comparison.ratio import BINS, FEWEST, Reason, block_t, may_be_a_walk

Array = npt.NDArray[np.float64]

# Beyond it, the test for a walk decides.
_LONGEST_MEMORY = 0.98
# The quantile at 97.5 % of Student's t with the nine degrees of freedom of `block_t`.
_STUDENT = 2.2621571627982053


class Interval(NamedTuple):
    """95 % interval of an RMSE over the RMSE; without one, the reason."""

    factors: tuple[float, float] | None
    reason: Reason | None = None

    def of(self, rmse: float) -> list[float] | None:
        """The interval of such an RMSE, in its unit."""
        return None if self.factors is None else [rmse * factor for factor in self.factors]


def interval_of(errors: Array) -> Interval:
    """The interval of the RMSE of errors (N,), in the order of time and in any unit.

    Raises:
        ValueError: errors that are not finite, or not (N,).
    """
    if errors.ndim != 1 or not np.isfinite(errors).all():
        raise ValueError(f"errors must be (N,) and finite, got {errors.shape}")
    if len(errors) < FEWEST:
        return Interval(None, Reason.TOO_FEW)
    largest = float(np.abs(errors).max())
    if largest == 0.0:
        return Interval(None, Reason.ZERO)
    squares = (errors / largest) ** 2
    edges = np.linspace(0, len(errors), min(BINS, len(errors)) + 1).astype(int)
    means = np.add.reduceat(squares, edges[:-1]) / np.diff(edges)
    linear = 0.5 * means / means.mean()
    if may_be_a_walk(linear):
        return Interval(None, Reason.ONE_WALK)
    std, _ = block_t(linear)
    half = _STUDENT * max(std, _autoregressive(linear))
    return Interval((float(np.exp(-half)), float(np.exp(half))))


def _autoregressive(series: Array) -> float:
    """Standard deviation of the mean of a series (n,) with the memory of its neighbours."""
    count, rest = len(series), series - series.mean()
    square = float(rest @ rest)
    if square == 0.0:
        return 0.0
    memory = float(rest[1:] @ rest[:-1]) / square
    memory = min(memory + (1.0 + 3.0 * memory) / count, _LONGEST_MEMORY)
    return float((square / (count - 1) / count * (1.0 + memory) / (1.0 - memory)) ** 0.5)
