# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether one set of runs is better than another, or whether it is noise."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from trajeval_ros.benchmarking.work import FAILED, OK, Row

LEVEL = 0.05
_PERMUTATIONS = 20_000
# Sequences with a run each on which Wilcoxon's test can say anything at all at 5 %, two-sided.
_LEAST_PAIRS = 6

Runs = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Figure:
    """A figure of the tables: its column, title, unit, and the factor to that unit."""

    column: str
    title: str
    unit: str
    factor: float
    larger_is_better: bool = False


_DEGREES = 180.0 / np.pi
_MODEL = "error_model.{}.{}.value"
FIGURES = (
    Figure("conventional.ate_translation_rmse", "ATE", "m", 1.0),
    Figure("conventional.ate_rotation_rmse", "ATE, rotation", "deg", _DEGREES),
    Figure("conventional.re_translation_rmse", "RE", "m", 1.0),
    Figure("conventional.re_rotation_rmse", "RE, rotation", "deg", _DEGREES),
    Figure(_MODEL.format("translation", "jitter_std"), "Jitter", "mm", 1e3),
    Figure(_MODEL.format("rotation", "jitter_std"), "Jitter, rotation", "deg", _DEGREES),
    Figure(_MODEL.format("translation", "long_run_drift"), "Drift", "mm/sqrt(s)", 1e3),
    Figure(_MODEL.format("rotation", "long_run_drift"), "Drift, rotation", "deg/sqrt(s)", _DEGREES),
    Figure("coverage.time", "Coverage", "%", 100.0, larger_is_better=True),
)


def values(rows: Sequence[Row], figure: Figure) -> Runs:
    """The figure of each run (n,); a run that failed is worse than any: an infinite error.

    Runs that are evaluated and have no such figure are left out, and so are those whose worker
    died: of the system they say nothing.
    """
    worst = 0.0 if figure.larger_is_better else np.inf
    found: list[float] = []
    for row in rows:
        value = row.get(figure.column)
        if row["status"] == FAILED:
            found.append(worst)
        elif row["status"] == OK and isinstance(value, float):
            found.append(value)
    # One that nobody has (no orientations, say) is no figure, however many runs failed.
    if not any(row["status"] == OK and isinstance(row.get(figure.column), float) for row in rows):
        return np.full(0, np.nan) if any(row["status"] == OK for row in rows) else np.array(found)
    return np.array(found)


def p_smaller(first: Mapping[str, Runs], second: Mapping[str, Runs], *, two_sided: bool) -> float:
    """The p-value of "the ``first`` are as large as the ``second``" against "smaller", or "other".

    Both have runs by sequence, and are compared within each sequence both have. On one sequence it
    is Mann and Whitney's test; on six or more with a run each Wilcoxon's, of the logarithms'
    differences; else it is van Elteren's (1960), the rank sums of all sequences together, by
    permutation within each. 1 where there is nothing to compare.
    """
    pairs = [
        (first[name], second[name])
        for name in first
        if name in second and len(first[name]) and len(second[name])
    ]
    if not pairs:
        return 1.0
    if len(pairs) == 1:
        alternative = "two-sided" if two_sided else "less"
        return float(stats.mannwhitneyu(*pairs[0], alternative=alternative).pvalue)
    if len(pairs) >= _LEAST_PAIRS and all(len(a) == len(b) == 1 for a, b in pairs):
        differences = _log_differences(np.array([[a[0], b[0]] for a, b in pairs]))
        if not np.any(differences):
            return 1.0
        alternative = "two-sided" if two_sided else "less"
        return float(stats.wilcoxon(differences, alternative=alternative).pvalue)
    return _van_elteren(pairs, two_sided)


def _log_differences(pairs: Runs) -> Runs:
    """Differences of the logarithms (n,); those of infinite errors lie beyond all others."""
    floor = np.finfo(np.float64).tiny
    logarithms = np.log(np.clip(pairs, floor, 1.0 / floor))
    return np.asarray(logarithms[:, 0] - logarithms[:, 1])


def _van_elteren(pairs: Sequence[tuple[Runs, Runs]], two_sided: bool) -> float:
    observed, strata = 0.0, []
    for a, b in pairs:
        ranks = stats.rankdata(np.concatenate([a, b]))
        weighted = (ranks - ranks.mean()) / (len(ranks) + 1)
        observed += weighted[: len(a)].sum()
        strata.append((len(a), tuple(np.sort(weighted).tolist())))
    permuted = _permuted(tuple(strata))
    # Sums of the same terms in another order differ in the last digits.
    slack = 1e-9
    if two_sided:
        as_extreme = np.abs(permuted) >= abs(observed) - slack
    else:
        as_extreme = permuted <= observed + slack
    return float((1 + np.count_nonzero(as_extreme)) / (1 + _PERMUTATIONS))


@functools.lru_cache(maxsize=32)
def _permuted(strata: tuple[tuple[int, tuple[float, ...]], ...]) -> Runs:
    """The rank sums (20,000,) of the first, when who is first is drawn by lot in each stratum.

    Without ties they hang on the numbers of runs alone, so all figures of a table share them.
    """
    # The same numbers whatever else is compared: a table is a function of its rows.
    generator = np.random.default_rng(0)
    sums = np.zeros(_PERMUTATIONS)
    for count, weighted in strata:
        shuffled = generator.permuted(np.tile(weighted, (_PERMUTATIONS, 1)), axis=1)
        sums += shuffled[:, :count].sum(axis=1)
    return sums


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's (1979) adjusted p-values, in the order given: below 5 %, of all at most 5 % wrong."""
    adjusted = [1.0] * len(p_values)
    largest = 0.0
    for rank, place in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[place]))
        adjusted[place] = largest
    return adjusted
