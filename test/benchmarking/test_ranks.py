# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Friedman's test and Nemenyi's critical difference are those of the textbook."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from trajeval_ros.benchmarking.ranks import friedman_nemenyi, nemenyi


@pytest.mark.parametrize(("systems", "q"), [(2, 1.960), (3, 2.343), (5, 2.728), (10, 3.164)])
def test_critical_differences_are_demsar_s(systems: int, q: float) -> None:
    expected = q * np.sqrt(systems * (systems + 1) / (6 * 14))
    assert nemenyi(14, systems) == pytest.approx(expected, rel=5e-4)


def test_the_p_value_is_friedman_s_where_sequences_are_many() -> None:
    generator = np.random.default_rng(2)
    costs = generator.normal(0.0, 1.0, (60, 4)) + np.array([0.0, 0.2, 0.4, 0.4])
    found = friedman_nemenyi(costs)
    expected = stats.friedmanchisquare(*costs.T).pvalue
    assert 0.001 < expected < 0.6
    assert found.p_value == pytest.approx(expected, abs=0.02)
    assert found.mean == pytest.approx(stats.rankdata(costs, axis=1).mean(axis=0))


@pytest.mark.parametrize(("sequences", "systems"), [(3, 3), (5, 2), (8, 4)])
def test_it_is_exact_for_few_sequences(sequences: int, systems: int) -> None:
    generator = np.random.default_rng(7)
    p_values = [
        friedman_nemenyi(generator.normal(0.0, 1.0, (sequences, systems))).p_value
        for _ in range(300)
    ]
    # Binomial: more than 26 of 300 at 5 % once in 200 times.
    assert np.count_nonzero(np.array(p_values) < 0.05) <= 26


def test_ties_and_failures_share_ranks() -> None:
    found = friedman_nemenyi(np.array([[1.0, 1.0, np.inf], [0.0, np.inf, np.inf]]))
    assert found.mean == pytest.approx([1.25, 2.0, 2.75])
    assert friedman_nemenyi(np.ones((5, 3))).p_value == 1.0


def test_a_system_that_wins_everywhere_is_found_with_enough_sequences() -> None:
    costs = np.arange(3.0) + np.zeros((11, 1))
    found = friedman_nemenyi(costs)
    assert found.p_value < 1e-3
    assert found.critical_difference == pytest.approx(2.343 * np.sqrt(12 / 66), rel=1e-3)


def test_what_cannot_be_ranked_is_refused() -> None:
    for costs in (np.ones((1, 3)), np.ones((3, 1)), np.array([[1.0, np.nan], [1.0, 2.0]])):
        with pytest.raises(ValueError, match="ranks are of"):
            friedman_nemenyi(costs)
