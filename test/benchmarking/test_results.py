# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows on disk: each is there as it was, whatever happens to the writer."""

from __future__ import annotations

from pathlib import Path

import pytest

from trajeval_ros.benchmarking.results import (
    Results,
    ResultsError,
    read_csv,
    read_results,
    still_good,
)
from trajeval_ros.benchmarking.work import FAILED, LOST, OK, Row


def row(name: str, status: str = OK, **figures: float | str | None) -> Row:
    key = f"1e{name}"  # what looks like a number stays text
    return {"system": "s", "sequence": "q", "run": name, "status": status, "error": None} | {
        "key": key,
        **figures,
    }


def test_rows_are_read_as_they_were_written(tmp_path: Path) -> None:
    results = Results(tmp_path)
    rows = [row("0", a=0.1 + 0.2), row("1", FAILED, a=None), row("2", a=1e-300, b='x, "y"')]
    for one in rows:
        results.add([one])
    assert read_csv(tmp_path / "results.csv") == [{"b": None, "a": None, **one} for one in rows]
    pytest.importorskip("pyarrow")
    results.finish()
    assert read_results(tmp_path) == read_csv(tmp_path / "results.csv")


def test_a_line_that_is_cut_off_costs_itself_alone(tmp_path: Path) -> None:
    results = Results(tmp_path)
    results.add([row("0", a=1.0), row("1", a=2.0)])
    whole = results.path.read_bytes()
    results.path.write_bytes(whole[:-5])
    assert [one["run"] for one in read_csv(results.path)] == ["0"]


def test_only_rows_of_these_contents_are_kept_each_once() -> None:
    rows = [row("0"), row("1", FAILED), row("2", LOST), row("3"), row("0")]
    assert [one["run"] for one in still_good(rows, ["1e0", "1e1", "1e2"])] == ["0", "1"]


def test_what_is_no_results_is_said(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(ResultsError, match=r"results\.csv"):
        read_csv(path)
    with pytest.raises(ResultsError, match=r"results\.csv"):
        read_results(tmp_path / "absent.csv")
