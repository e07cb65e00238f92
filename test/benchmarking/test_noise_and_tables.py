# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is called better or worse is so beyond noise; tables and JUnit are well formed."""

from __future__ import annotations

import html.parser
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.benchmarking import tables
from trajeval_ros.benchmarking.gate import GateError, judge, write_junit
from trajeval_ros.benchmarking.noise import FIGURES, holm, p_smaller
from trajeval_ros.benchmarking.table import tables as make_tables
from trajeval_ros.benchmarking.work import FAILED, OK, Row

SYSTEMS, SEQUENCES, RUNS = ("vins", "orb_slam"), ("hall", "stairs", "yard"), 10


def made(seed: int, larger: float = 1.0, spread: float = 0.08) -> list[Row]:
    """Runs that spread by 8 % about each sequence's own error; vins' errors are ``larger``."""
    generator = np.random.default_rng(seed)
    rows: list[Row] = []
    for system in SYSTEMS:
        for place, sequence in enumerate(SEQUENCES):
            for run in range(RUNS):
                factor = np.exp(generator.normal(0.0, spread, len(FIGURES)))
                factor *= larger if system == "vins" else 1.0
                row: Row = {"system": system, "sequence": sequence, "run": str(run), "status": OK}
                for figure, value in zip(FIGURES, factor, strict=True):
                    row[figure.column] = (
                        1.0 if figure.larger_is_better else float(value) * 0.02 * 10**place
                    )
                rows.append(row)
    return rows


def test_holm_is_that_of_the_textbook() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []


def test_the_gate_is_silent_on_fresh_noise() -> None:
    alarms = sum(judge(made(2 * i), made(2 * i + 1)).regressed for i in range(200))
    # Expected 5 % at most, 10 of 200; 18 or more would come by chance once in 100 times.
    assert alarms <= 17


def test_the_gate_finds_a_regression_of_ten_per_cent(tmp_path: Path) -> None:
    verdict = judge(made(1, larger=1.1), made(2))
    worse = [change for change in verdict.changes if change.worse]
    # The other system is as it was: what is said of it may be wrong in 5 % of the cases.
    titles = {change.figure.title for change in worse if change.system == "vins"}
    # Each of the eight is found in 95 of 100 cases.
    assert len(titles) >= 6
    assert "Coverage" not in titles
    assert "times" in worse[0].line
    write_junit(tmp_path / "junit.xml", verdict)
    suite = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert suite.get("failures") == str(len(worse)) == str(len(suite.findall("*/failure")))
    assert suite.get("tests") == str(len(suite.findall("testcase")))


def test_an_improvement_is_none() -> None:
    changes = judge(made(1, larger=0.8), made(2)).changes
    assert {change.p_value for change in changes if change.system == "vins"} == {1.0}


def test_runs_that_fail_are_a_regression() -> None:
    now = [
        {**row, "status": FAILED} if row["system"] == "vins" and row["run"] < "5" else row  # type: ignore[operator]
        for row in made(1)
    ]
    worse = {c.figure.title for c in judge(now, made(2)).changes if c.worse}
    assert {"ATE", "Coverage"} <= worse


def test_a_sequence_that_is_not_run_any_more_is_a_regression() -> None:
    now = [r for r in made(1) if (r["system"], r["sequence"]) != ("vins", "yard")]
    verdict = judge(now, made(1))
    assert verdict.missing == (("vins", "yard"),)
    assert verdict.regressed


def test_another_ground_truth_is_another_question() -> None:
    before = [{**row, "ground_truth_sha256": "a"} for row in made(1)]
    with pytest.raises(GateError, match="ground truth in the baseline is another"):
        judge([{**row, "ground_truth_sha256": "b"} for row in made(1)], before)
    with pytest.raises(GateError, match="no figure"):
        judge(made(1), [{**row, "system": "other"} for row in made(1)])


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


def test_best_is_bold_only_beyond_noise() -> None:
    def bold(rows: list[Row]) -> set[str]:
        lines = tables.markdown(make_tables(rows)).splitlines()
        return {line.split("|")[1].strip() for line in lines if "**" in line}

    assert bold(made(1, larger=1.3)) == {"orb\\_slam"}
    assert bold([row for row in made(1) if row["run"] in "012"]) == set()


def test_failures_are_counted_in() -> None:
    rows = [
        {**row, "status": FAILED} if row["system"] == "vins" and row["run"] != "0" else row
        for row in made(1)
    ]
    (line,) = [one for one in make_tables(rows)[0].lines if one.system == "vins"]
    assert (line.evaluated, line.runs) == (3, 30)
    assert line.cells[0].median == np.inf
    assert "| vins | 3/30 | failed" in tables.markdown(make_tables(rows))


class _Balance(html.parser.HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[int] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        del attrs
        if tag == "meta":
            return
        self.open.append(tag)
        if tag == "tr":
            self.cells.append(0)
        self.cells[-1:] = [n + (tag in ("td", "th")) for n in self.cells[-1:]]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_tables_are_well_formed(tmp_path: Path) -> None:
    made_tables = make_tables(made(3, larger=1.3))
    paths = {path.suffix: path.read_text() for path in tables.write(tmp_path, made_tables)}
    columns = len(FIGURES) + 2
    for block in re.findall(r"\\begin\{tabular\}.*?\\end\{tabular\}", paths[".tex"], re.S):
        rows = re.findall(r"^    (.*) \\\\$", block, re.M)
        assert len(rows) == 1 + len(SYSTEMS)
        assert {len(re.split(r"(?<!\\)&", row)) for row in rows} == {columns}
        assert all(rule in block for rule in (r"\toprule", r"\midrule", r"\bottomrule"))
        assert block.count("{") == block.count("}")
    unescaped = r"(?<!\\)[%_#]"
    assert re.findall(unescaped, paths[".tex"].split("\n", 1)[1]) == []
    parser = _Balance()
    parser.feed(paths[".html"])
    assert parser.open == []
    assert set(parser.cells) == {columns}
    shown = [line for line in paths[".md"].splitlines() if line.startswith("|")]
    assert {line.count("|") for line in shown} == {columns + 1}
