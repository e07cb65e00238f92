# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors over time are ATE's, and what is read is what was written."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from benchmarking.conftest import make_runs

from trajeval_ros.benchmarking.errors import Errors, ErrorsFile, StoredErrors, band, read_errors
from trajeval_ros.benchmarking.manifest import read_manifest
from trajeval_ros.benchmarking.plan import plan, tasks
from trajeval_ros.benchmarking.work import outcomes_of


def errors(key: str, value: float) -> Errors:
    return Errors(key, 0.25, np.full(200, value))


def test_they_are_those_of_ate(tmp_path: Path) -> None:
    manifest = read_manifest(make_runs(tmp_path, runs=1))
    for task in tasks(manifest, plan(manifest), 1):
        for outcome in outcomes_of(task):
            assert outcome.errors is not None
            found = outcome.errors
            there = np.isfinite(found.values)
            # Ten poses a second in 200 bins of 9 seconds: one in most of those that have any.
            ate = outcome.row["conventional.ate_translation_rmse"]
            assert math.sqrt(np.mean(found.values[there] ** 2)) == pytest.approx(ate, rel=0.05)
            assert 60 < np.count_nonzero(there) <= 91
            assert found.step == pytest.approx(9.0 / 200, rel=0.01)


def test_they_are_read_as_they_were_written(tmp_path: Path) -> None:
    file = ErrorsFile(tmp_path, [errors("a", 0.125)])
    holes = errors("b", 1.5)
    holes.values[3:9] = math.nan
    file.add([holes, errors("c", 2.0)])
    found = {one.key: one for one in read_errors(tmp_path, "ab")}
    assert sorted(found) == ["a", "b"]
    assert found["a"].step == 0.25
    np.testing.assert_array_equal(found["b"].values, holes.values)


def test_those_that_are_asked_for_are_read_alone(tmp_path: Path) -> None:
    assert StoredErrors(tmp_path).of(["a"]) == []
    file = ErrorsFile(tmp_path, [errors("a", 1.0), errors("b", 2.0), errors("c", 3.0)])
    path = tmp_path / "errors.csv"
    path.write_bytes(path.read_bytes() + "d,é,ü\nb,1\n".encode())
    file.add([errors("a", 4.0), errors("d", 5.0)])
    path.write_bytes(path.read_bytes()[:-1])
    found = StoredErrors(tmp_path).of(["c", "d", "a", "x"])
    assert [(one.key, one.values[0]) for one in found] == [("c", 3.0), ("a", 4.0)]


def test_what_cannot_be_read_costs_itself_alone(tmp_path: Path) -> None:
    assert list(read_errors(tmp_path, "ab")) == []
    ErrorsFile(tmp_path, [errors("a", 1.0), errors("b", 1.0)])
    path = tmp_path / "errors.csv"
    path.write_text(path.read_text()[:-1])
    assert [one.key for one in read_errors(tmp_path, "ab")] == ["a"]
    path.write_text("b,x\n" + path.read_text() + "\nc,1.0,2.0\n")
    assert [one.key for one in read_errors(tmp_path, "abc")] == ["a", "b"]


def test_a_band_is_the_quartiles_where_half_of_the_runs_are() -> None:
    runs = [errors(str(value), float(value)) for value in range(5)]
    for one in runs[:3]:
        one.values[10:] = math.nan
    found = band(runs, 5)
    assert found is not None
    assert found.quartiles[0] == pytest.approx([1.0, 2.0, 3.0])
    assert np.isnan(found.quartiles[10:]).all()
    assert found.seconds[:2] == pytest.approx([0.125, 0.375])
    # Those that failed have no errors, and count.
    assert np.isnan(band(runs, 11).quartiles).all()  # type: ignore[union-attr]
    assert band([], 3) is None
