# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether one set of runs is better than another, or whether it is noise."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from trajeval_ros.benchmarking.figures import Runs

_PERMUTATIONS = 20_000
# Sequences with a run each on which Wilcoxon's test can say anything at all at 5 %, two-sided.
_LEAST_PAIRS = 6
# Costs are logarithms, shares or nats: none is as large, but those of failures, which are infinite.
_BEYOND_ALL = 1e9


def p_smaller(first: Mapping[str, Runs], second: Mapping[str, Runs], *, two_sided: bool) -> float:
    """The p-value of "the ``first`` are as large as the ``second``" against "smaller", or "other".

    Both have their runs' costs by sequence, and are compared within each sequence both have. On one
    sequence it is Mann and Whitney's test; on six or more with a run each Wilcoxon's, of the
    differences; else it is van Elteren's (1960), the rank sums of all sequences together, by
    permutation within each. 1 where there is nothing to compare.
    """
    pairs = _pairs(first, second)
    if not pairs:
        return 1.0
    if len(pairs) == 1:
        alternative = "two-sided" if two_sided else "less"
        return float(stats.mannwhitneyu(*pairs[0], alternative=alternative).pvalue)
    if _one_each(pairs):
        single = np.array([[a[0], b[0]] for a, b in pairs])
        differences = -np.diff(np.clip(single, -_BEYOND_ALL, _BEYOND_ALL), axis=1)[:, 0]
        if not np.any(differences):
            return 1.0
        alternative = "two-sided" if two_sided else "less"
        return float(stats.wilcoxon(differences, alternative=alternative).pvalue)
    return _van_elteren(pairs, two_sided)


def least_p(first: Mapping[str, Runs], second: Mapping[str, Runs]) -> float:
    """The smallest two-sided p-value that so many runs of each can have, whatever they say."""
    pairs = _pairs(first, second)
    if _one_each(pairs):
        return float(2.0 ** (1 - len(pairs)))
    ways = math.prod(math.comb(len(a) + len(b), len(a)) for a, b in pairs)
    # Of hundreds of runs there are more ways than a float holds.
    return min(1.0, 2.0 / min(ways, 10**300)) if pairs else 1.0


def _pairs(first: Mapping[str, Runs], second: Mapping[str, Runs]) -> list[tuple[Runs, Runs]]:
    return [
        (first[name], second[name])
        for name in first
        if name in second and len(first[name]) and len(second[name])
    ]


def _one_each(pairs: Sequence[tuple[Runs, Runs]]) -> bool:
    return len(pairs) >= _LEAST_PAIRS and all(len(a) == len(b) == 1 for a, b in pairs)


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
