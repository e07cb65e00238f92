# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The gate is silent on noise and finds what is worse; its JUnit is what CI servers read."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from benchmarking.conftest import made_rows

from trajeval_ros.benchmarking.gate import GateError, judge, write_junit
from trajeval_ros.benchmarking.work import FAILED


def test_the_gate_is_silent_on_fresh_noise() -> None:
    alarms = sum(judge(made_rows(2 * i), made_rows(2 * i + 1)).regressed for i in range(200))
    # Expected 5 % at most, 10 of 200; 18 or more would come by chance once in 100 times.
    assert alarms <= 17


def test_the_gate_finds_a_regression_of_ten_per_cent(tmp_path: Path) -> None:
    verdict = judge(made_rows(1, larger=1.1), made_rows(2))
    worse = [change for change in verdict.changes if change.worse]
    # The other system is as it was: what is said of it may be wrong in 5 % of the cases.
    titles = {change.figure.title for change in worse if change.system == "vins"}
    # Each of the eight is found in 95 of 100 cases.
    assert len(titles) >= 6
    assert "Coverage" not in titles
    assert "times" in worse[0].line
    write_junit(tmp_path / "junit.xml", verdict)
    root = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert root.get("failures") == str(len(worse)) == str(len(root.findall(".//failure")))
    assert root.get("tests") == str(len(root.findall(".//testcase")))


# Jenkins' junit-10.xsd: of each element the children, the attributes it must have and may have.
_COUNTS = {"tests", "failures", "errors"}
_JUNIT: dict[str, tuple[set[str], set[str], set[str]]] = {
    "testsuites": ({"testsuite"}, set(), {"name", "time", "disabled", *_COUNTS}),
    "testsuite": (
        {"testcase", "properties", "system-out", "system-err"},
        {"name", *_COUNTS},
        {"name", "time", "skipped", "hostname", "id", "package", "timestamp", *_COUNTS},
    ),
    "testcase": (
        {"skipped", "error", "failure", "system-out", "system-err"},
        {"name", "classname"},
        {"name", "classname", "time", "status", "assertions"},
    ),
    "failure": (set(), set(), {"type", "message"}),
}


def test_junit_has_the_schema_s_shape(tmp_path: Path) -> None:
    rows = [{**row, "system": f"<{row['system']}>\x07&"} for row in made_rows(1, larger=1.2)]
    before = [{**row, "system": f"<{row['system']}>\x07&"} for row in made_rows(2)]
    gone = [row for row in rows if row["system"] != "<vins>\x07&" or row["sequence"] != "hall"]
    write_junit(tmp_path / "junit.xml", judge(gone, before))
    root = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert root.tag == "testsuites"
    for element in root.iter():
        children, needed, allowed = _JUNIT[element.tag]
        assert {child.tag for child in element} <= children
        assert needed <= set(element.attrib) <= allowed
        for name in {*_COUNTS, "time", "skipped"} & set(element.attrib):
            assert float(element.attrib[name]) >= 0.0
    failures = root.findall(".//failure")
    assert any("has no run on hall" in failure.attrib["message"] for failure in failures)


def test_an_improvement_is_none() -> None:
    changes = judge(made_rows(1, larger=0.8), made_rows(2)).changes
    assert {change.p_value for change in changes if change.system == "vins"} == {1.0}


def test_runs_that_fail_are_a_regression() -> None:
    now = [
        {**row, "status": FAILED} if row["system"] == "vins" and row["run"] < "5" else row  # type: ignore[operator]
        for row in made_rows(1)
    ]
    worse = {c.figure.title for c in judge(now, made_rows(2)).changes if c.worse}
    assert {"ATE", "Coverage"} <= worse


def test_a_sequence_that_is_not_run_any_more_is_a_regression() -> None:
    now = [r for r in made_rows(1) if (r["system"], r["sequence"]) != ("vins", "yard")]
    verdict = judge(now, made_rows(1))
    assert verdict.missing == (("vins", "yard"),)
    assert verdict.regressed


def test_another_ground_truth_is_another_question() -> None:
    before = [{**row, "ground_truth_sha256": "a"} for row in made_rows(1)]
    with pytest.raises(GateError, match="ground truth in the baseline is another"):
        judge([{**row, "ground_truth_sha256": "b"} for row in made_rows(1)], before)
    with pytest.raises(GateError, match="no figure"):
        judge(made_rows(1), [{**row, "system": "other"} for row in made_rows(1)])
