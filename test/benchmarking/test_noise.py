# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""P-values are no smaller than they claim."""

from __future__ import annotations

import numpy as np
import pytest

from trajeval_ros.benchmarking.noise import holm, least_p, p_smaller


def test_holm_is_that_of_the_textbook() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []


@pytest.mark.parametrize(("sequences", "runs"), [(1, 5), (3, 4), (8, 1)])
def test_p_values_are_no_smaller_than_they_claim(sequences: int, runs: int) -> None:
    generator = np.random.default_rng(5)
    p_values = []
    for _ in range(120):
        first, second = (
            {str(s): generator.lognormal(s, 0.3, runs) for s in range(sequences)} for _ in range(2)
        )
        p_values.append(p_smaller(first, second, two_sided=True))
    # Binomial: more than 13 of 120 at 5 % once in 200 times.
    assert np.count_nonzero(np.array(p_values) < 0.05) <= 13


def test_nothing_in_common_tells_nothing() -> None:
    assert p_smaller({"a": np.ones(3)}, {"b": np.ones(3)}, two_sided=True) == 1.0


def test_of_thousands_of_runs_the_least_p_is_a_number() -> None:
    runs = np.linspace(1.0, 2.0, 2_000)
    many = {"hall": runs, "yard": runs}
    assert 0.0 <= least_p(many, many) < 1e-200
