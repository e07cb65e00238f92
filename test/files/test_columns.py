# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of ``poses.csv`` as text: the loop in C and Python's own repr write the same."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.files.columns import COLUMNS, as_text, filled

Array = npt.NDArray[np.float64]
T = TypeVar("T")

WIDTH = len(COLUMNS) - 4
SUMMARY = {
    "ate_translation_rmse": 1.0,
    "ate_rotation_rmse": 1.0,
    "alignment": {"pose": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "scale": 1.0},
}


def both(write: Callable[[], T]) -> tuple[T, T]:
    """With the loops, and without."""
    looped = write()
    with loops.left_out():
        return looped, write()


def text_of(values: Array) -> list[str]:
    """What the loop makes of ``values`` (n,)."""
    nothing = np.zeros(1, dtype=np.int64)
    row = as_text(nothing, values[None], np.zeros(1, dtype=bool)).decode("ascii")
    return row.split(",")[1:-3]


@given(st.lists(st.floats(), min_size=1, max_size=50))
def test_a_number_is_python_s_repr(values: list[float]) -> None:
    wanted = ["" if value != value else repr(value) for value in values]
    assert text_of(np.array(values)) == wanted


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(0).integers(0, 2**64, 50_000, dtype=np.uint64).view(np.float64),
        2.0 ** np.arange(-1074, 1024),
        np.nextafter(2.0 ** np.arange(-1073, 1024), 0.0),
        np.array([float(f"1e{power}") for power in range(-323, 309)]),
        np.nextafter([float(f"1e{power}") for power in range(-322, 309)], np.inf),
        np.round(np.random.default_rng(1).normal(size=5_000), 3),
        np.random.default_rng(2).integers(-(10**17), 10**17, 5_000).astype(float),
        np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e16, 9999999999999998.0, 1e-4, 9.9e-5]),
    ],
    ids=["bits", "powers of two", "below", "powers of ten", "above", "short", "whole", "edges"],
)
def test_every_kind_of_number(values: Array) -> None:
    wanted = ["" if value != value else repr(value) for value in values.tolist()]
    assert text_of(values) == wanted


@given(
    stamps=st.lists(st.integers(-(2**63), 2**63 - 1), max_size=5),
    seed=st.integers(0, 99),
)
def test_rows_are_those_of_python(stamps: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(len(stamps), 3))
    values[:1] = np.nan
    given = np.array(stamps, dtype=np.int64), values, rng.random(len(stamps)) < 0.5
    looped, plain = both(lambda: as_text(*given))
    assert looped == plain
    assert [int(row.split(b",")[0]) for row in looped.splitlines()] == stamps


def test_the_errors_of_what_ate_counts_are_filled_in() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(600, WIDTH))
    sampled = rng.random(600) < 0.5
    rows = as_text(np.arange(600) * 10**17, values, sampled)
    looped, plain = both(lambda: filled(rows, SUMMARY))
    assert len(looped) == len(plain) == len(rows)
    texts = (text.splitlines() for text in (rows, looped, plain))
    for known, before, *after in zip(sampled, *texts, strict=True):
        (*cells, _, translation, rotation), other = (row.split(b",") for row in after)
        assert cells == before.split(b",")[:-3] == other[:-3]
        assert int(other[-3]) == known
        assert [bool(translation), bool(rotation)] == [known, known]
        if known:
            # What the rows are filled with is computed by other loops.
            error = [float(translation), float(rotation)]
            assert error == pytest.approx([float(cell) for cell in other[-2:]], rel=1e-9)
            assert [repr(number).encode() for number in error] == [translation, rotation]


def test_a_last_row_without_an_end_is_filled_all_the_same() -> None:
    rng = np.random.default_rng(0)
    rows = as_text(np.arange(3), rng.normal(size=(3, WIDTH)), np.ones(3, dtype=bool))
    with loops.left_out():
        whole = filled(rows, SUMMARY)
    assert both(lambda: filled(rows[:-1], SUMMARY)) == (whole, whole)
