# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ranks over sequences, and how far apart they must be (Demsar, JMLR 7, 2006)."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

LEVEL = 0.05
_PERMUTATIONS = 20_000

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Ranks:
    """Mean ranks (k,) of k systems over ``sequences`` of them; 1 is best, equals share theirs.

    ``p_value``: Friedman's, of the systems being equal. ``critical_difference``: Nemenyi's, by
    which the mean ranks of two must differ to be told apart at 5 %, all pairs together.
    """

    mean: Array
    sequences: int
    p_value: float
    critical_difference: float


def friedman_nemenyi(costs: Array) -> Ranks:
    """Rank the systems on each sequence; lower costs (n sequences, k systems) are better.

    Friedman's p-value is by permutation within sequences, so that it holds for few of them, for two
    systems and for ties as well.

    Raises :class:`ValueError` for fewer than two sequences or two systems, or a NaN.
    """
    if costs.ndim != 2 or min(costs.shape) < 2 or np.isnan(costs).any():
        raise ValueError("ranks are of two sequences and two systems or more, each with a figure")
    count, systems = costs.shape
    ranks = stats.rankdata(costs, axis=1)
    return Ranks(ranks.mean(axis=0), count, _friedman(ranks), nemenyi(count, systems))


def nemenyi(sequences: int, systems: int) -> float:
    """The critical difference of mean ranks: ``q sqrt(k (k + 1) / (6 n))``."""
    q = _studentized_range(systems) / np.sqrt(2.0)
    return float(q * np.sqrt(systems * (systems + 1) / (6.0 * sequences)))


@functools.lru_cache(maxsize=64)
def _studentized_range(systems: int) -> float:
    return float(stats.studentized_range.ppf(1.0 - LEVEL, systems, np.inf))


def _friedman(ranks: Array) -> float:
    centred = ranks - ranks.mean(axis=1, keepdims=True)
    observed = np.sum(centred.sum(axis=0) ** 2)
    permuted = _permuted(tuple(map(tuple, np.sort(centred, axis=1).tolist())))
    # Sums of the same terms in another order differ in the last digits.
    extreme = np.count_nonzero(permuted >= observed - 1e-9)
    return float((1 + extreme) / (1 + _PERMUTATIONS))


@functools.lru_cache(maxsize=32)
def _permuted(rows: tuple[tuple[float, ...], ...]) -> Array:
    """Friedman's sum of squares (20,000,) where the ranks of each sequence are drawn by lot."""
    # The same numbers whatever else is compared: a table is a function of its rows.
    generator = np.random.default_rng(0)
    sums = np.zeros((_PERMUTATIONS, len(rows[0])))
    for row in rows:
        sums += generator.permuted(np.tile(row, (_PERMUTATIONS, 1)), axis=1)
    return np.asarray(np.sum(sums**2, axis=1))
