# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows on disk: each is there as it was, whatever happens to the writer."""

from __future__ import annotations

from pathlib import Path

import pytest

from trajeval_ros.benchmarking.figures import FIGURES
from trajeval_ros.benchmarking.results import (
    Results,
    ResultsError,
    read_brief,
    read_csv,
    read_results,
)
from trajeval_ros.benchmarking.work import FAILED, LOST, OK, Row
from trajeval_ros.online.parameters import PARAMETERS


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


def test_only_rows_of_these_contents_are_kept_each_once(tmp_path: Path) -> None:
    rows = [row("0", a=1.0), row("1", FAILED), row("2", LOST), row("3"), row("0", a=2.0)]
    Results(tmp_path, rows)
    resumed = Results.resumed(tmp_path, ["1e0", "1e1", "1e2"])
    kept = [("1", None), ("0", 2.0)]
    assert [one["run"] for one in resumed.rows] == ["1", "0"]
    resumed.add([row("4", b="more")])
    again = read_csv(resumed.path)
    assert [(one["run"], one["a"]) for one in again] == [*kept, ("4", None)]
    assert [one["b"] for one in again] == [None, None, "more"]


def test_a_broken_line_is_said_and_nothing_is_written_over(tmp_path: Path) -> None:
    path = Results(tmp_path, [row("0", a=1.0)]).path
    whole = path.read_text() + '"s","q"\n'
    path.write_text(whole)
    with pytest.raises(ResultsError, match=r"results\.csv"):
        Results.resumed(tmp_path, ["1e0"])
    assert path.read_text() == whole


def test_what_tables_are_made_of_is_a_small_part_of_a_row(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    whole = row("0", gauge="se3", version="1") | {f"window.figure_{k}": 1.0 for k in range(200)}
    whole |= {
        "parameters.gauge": "sim3",
        "parameters.relative.delta": PARAMETERS["relative.delta"].default,
    }
    whole |= {FIGURES[0].column: 0.5, FIGURES[1].column: None}
    results = Results(tmp_path)
    results.add([whole])
    (kept,) = results.rows
    assert len(kept) == 6 + 3
    assert (kept[FIGURES[0].column], kept["parameters.gauge"], kept["version"]) == (
        0.5,
        "sim3",
        "1",
    )
    assert read_brief(tmp_path) == [kept]
    results.finish()
    assert read_brief(tmp_path) == [kept]


def test_what_is_no_results_is_said(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(ResultsError, match=r"results\.csv"):
        read_csv(path)
    with pytest.raises(ResultsError, match=r"results\.csv"):
        read_results(tmp_path / "absent.csv")
