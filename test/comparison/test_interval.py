# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The interval of one RMSE holds it as often as it says, or is not given."""

import numpy as np
import numpy.typing as npt
import pytest

from trajeval_ros.comparison import interval
from trajeval_ros.comparison.interval import interval_of
from trajeval_ros.comparison.ratio import BLOCKS, Reason
from trajeval_ros.likelihood.tails import student_quantile

Array = npt.NDArray[np.float64]


def remembered(rng: np.random.Generator, count: int, memory: float) -> Array:
    """Distances of a point whose three coordinates have variance 1; (count,)."""
    noise = np.sqrt(1.0 - memory**2) * rng.normal(size=(count, 3))
    noise[0] /= np.sqrt(1.0 - memory**2)
    for i in range(1, count):
        noise[i] += memory * noise[i - 1]
    return np.asarray(np.linalg.norm(noise, axis=1))


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.98])
def test_it_covers_the_truth_in_95_of_100(memory: float) -> None:
    rng = np.random.default_rng(4)
    held = []
    for _ in range(200):
        errors = remembered(rng, 2000, memory)
        interval = interval_of(errors).of(float(np.sqrt(np.mean(errors**2))))
        if interval is not None:
            held.append(interval[0] <= np.sqrt(3.0) <= interval[1])
    assert len(held) > 180
    assert 0.92 <= np.mean(held) <= 0.99


def test_it_is_narrow_where_errors_are_new_and_does_not_know_the_unit() -> None:
    errors = remembered(np.random.default_rng(0), 5000, 0.0)
    narrow = interval_of(errors)
    assert narrow.factors is not None
    assert narrow.factors[1] < 1.03
    for unit in (1e-200, 1e200):
        assert interval_of(unit * errors).factors == pytest.approx(narrow.factors)


def test_students_quantile_is_that_of_the_blocks() -> None:
    assert pytest.approx(student_quantile(0.025, BLOCKS - 1), rel=1e-9) == interval._STUDENT


def test_a_walk_has_none() -> None:
    walk = np.cumsum(np.random.default_rng(2).normal(size=3000))
    found = interval_of(np.abs(walk))
    assert found.factors is None
    assert found.reason is Reason.ONE_WALK
    assert found.of(1.0) is None


@pytest.mark.parametrize(
    ("errors", "reason"),
    [(np.ones(19), Reason.TOO_FEW), (np.empty(0), Reason.TOO_FEW), (np.zeros(100), Reason.ZERO)],
)
def test_what_says_nothing_has_none(errors: Array, reason: Reason) -> None:
    assert interval_of(errors).reason is reason


def test_errors_that_never_change_are_known() -> None:
    assert interval_of(np.full(100, 0.3)).factors == (1.0, 1.0)


@pytest.mark.parametrize("errors", [np.full(30, np.nan), np.ones((30, 2))])
def test_what_is_no_series_is_refused(errors: Array) -> None:
    with pytest.raises(ValueError, match="errors must be"):
        interval_of(errors)
