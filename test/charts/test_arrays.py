# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers as text, and fewer points."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.charts import numbers
from trajeval_ros.charts.arrays import extremes


def test_numbers_are_little_endian_float32() -> None:
    values = np.array([[0.1, -2.0], [np.nan, 3e38]])
    read = np.frombuffer(base64.b64decode(numbers(values)), dtype="<f4")
    np.testing.assert_array_equal(read, values.ravel().astype(np.float32))


@given(
    count=st.integers(0, 3000),
    most=st.integers(8, 200),
    seed=st.integers(0, 1000),
    holes=st.booleans(),
)
def test_extremes_of_every_column_stay(count: int, most: int, seed: int, holes: bool) -> None:
    generator = np.random.default_rng(seed)
    first, second = np.cumsum(generator.normal(size=(2, count)), axis=1)
    if holes:
        second[generator.random(count) < 0.3] = np.nan
    kept = extremes([first, second], most)
    assert len(kept) <= max(most, 6)
    assert np.all(np.diff(kept) > 0)
    if count == 0:
        return
    assert kept[0] == 0
    assert kept[-1] == count - 1
    for column in (first, second):
        known = column[~np.isnan(column)]
        if len(known):
            assert np.nanmin(column[kept]) == known.min()
            assert np.nanmax(column[kept]) == known.max()


def test_a_peak_of_one_point_stays() -> None:
    values = np.sin(np.arange(100_000) / 3000)
    values[61_234] = 40.0
    kept = extremes([values], 500)
    assert 61_234 in kept
    assert len(kept) > 250
    shown = np.interp(np.arange(100_000), kept, values[kept])
    assert np.abs(np.delete(shown - values, np.s_[60_500:62_000])).max() < 0.1


def test_a_column_may_have_several_parts() -> None:
    parts = np.zeros((1000, 3))
    parts[[100, 555, 801], [0, 1, 2]] = 1.0
    assert {100, 555, 801} <= set(extremes([parts, np.arange(1000.0)], 100).tolist())


@pytest.mark.parametrize("most", [4, 7, 50])
def test_few_rows_are_all_kept(most: int) -> None:
    assert extremes([np.arange(4.0)], most).tolist() == [0, 1, 2, 3]
