# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A few cases of each family; that the oracle sees defects; a short soak."""

from __future__ import annotations

import copy
import json
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest

from fuzz import __main__ as entry
from fuzz import oracle, relations, soak
from trajeval_ros.commands import evaluate
from trajeval_ros.runs.session import Session

SEED = 1
NEEDS = {"bags": "rosbags", "cdr": "rclpy"}


@pytest.mark.parametrize("family", entry.FAMILIES)
def test_a_few_cases(family: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if family in NEEDS:
        pytest.importorskip(NEEDS[family])
    arguments = ["--seed", str(SEED), "--cases", "8", "--only", family]
    code = entry.main([*arguments, "--keep", str(tmp_path)])
    said = capsys.readouterr().out
    assert code == 0, said
    row = next(line.split() for line in said.splitlines() if line.startswith(family))
    assert int(row[1]) == 8
    assert int(row[2]) > 0, "not one of the cases was evaluated"


def test_a_case_is_a_function_of_seed_and_number(tmp_path: Path) -> None:
    inputs = []
    for name in ("first", "second"):
        folder = tmp_path / name
        folder.mkdir()
        entry.run_case(SEED, 8, folder)
        files = [path for path in folder.iterdir() if path.suffix in (".txt", ".csv")]
        inputs.append({path.name: path.read_bytes() for path in files})
    assert len(inputs[0]) >= 2
    assert inputs[0] == inputs[1]


def run_of(function: Any, monkeypatch: pytest.MonkeyPatch, folder: Path) -> str:
    monkeypatch.setattr(evaluate, "main", function)
    with pytest.raises(oracle.Failure) as caught:
        oracle.evaluate_and_check(["tum", "a", "b"], folder)
    return str(caught.value)


def test_the_oracle_sees_what_is_wrong(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def raises(argv: list[str]) -> int:
        raise ZeroDivisionError("division by zero")

    def warns(argv: list[str]) -> int:
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        return 1

    def talks(argv: list[str]) -> int:
        sys.stderr.write("evaluate: error: one\nevaluate: error: two\n")
        return 1

    assert "ZeroDivisionError in test_fuzz.py" in run_of(raises, monkeypatch, tmp_path)
    assert "RuntimeWarning in test_fuzz.py" in run_of(warns, monkeypatch, tmp_path)
    assert "more than one line" in run_of(talks, monkeypatch, tmp_path)
    assert run_of(lambda argv: 3, monkeypatch, tmp_path) == "exit code 3"
    assert "no error" in run_of(lambda argv: 1, monkeypatch, tmp_path)


def test_the_oracle_counts(tmp_path: Path) -> None:
    account = {"received": 3, "evaluated": 1, "used": 1, "pending": 0, "rejected": {"late": 2}}
    summary: Any = {
        "estimate": account,
        "ground_truth": dict(account),
        "relative": {"log_likelihood": None},
    }
    (tmp_path / "poses.csv").write_text("stamp\n1\n", encoding="utf-8")
    (tmp_path / "report.html").write_text("page", encoding="utf-8")

    def check(changed: Any) -> None:
        (tmp_path / "summary.json").write_text(json.dumps(changed), encoding="utf-8")
        oracle._check_output(tmp_path)

    check(summary)
    for topic, name in (("estimate", "received"), ("ground_truth", "used")):
        wrong = copy.deepcopy(summary)
        wrong[topic][name] += 1
        with pytest.raises(oracle.Failure, match=topic):
            check(wrong)
    with pytest.raises(oracle.Failure, match="NaN"):
        check({**summary, "gauge": float("nan")})
    likelihood = {"log_likelihood": 1.0, "chi2": 1.0, "log_det": 0.0, "dof": 6}
    with pytest.raises(oracle.Failure, match="parts"):
        check({**summary, "relative": likelihood})


def test_what_differs_is_named() -> None:
    first = {"a": {"b": [1.0, 2.0], "n": 3, "p_value": 0.0}, "consistency": 1e-16, "end": 5}
    second = {"a": {"b": [1.0, 2.0], "n": 3, "p_value": 1e-9}, "consistency": 0.0, "end": 7}
    assert list(relations.differences(first, second, ("end",), 1e-7)) == []
    assert list(relations.differences(first, second, (), 1e-7)) == ["end: 5 and 7"]
    second["a"] = {"b": [1.0, 2.000001], "n": 4, "more": None}
    found = list(relations.differences(first, second, ("end",), 1e-7))
    assert found[0] == "a.b[1]: 2 and 2.000001"
    assert found[1:] == ["a.n: 3 and 4", "a.p_value: 0.0 and None"]


def test_what_makes_a_difference_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Figures that depend on how they were fed are an engine's defect."""
    summary = relations._summary

    def hasty(settings: Any, pair: Any, chunk: int) -> Any:
        found = summary(settings, pair, chunk)
        found["coverage"]["time"] = 1e-9 * chunk
        return found

    monkeypatch.setattr(relations, "_summary", hasty)
    became = [entry.run_case(SEED, number, _folder(tmp_path, number)) for number in (4, 9, 14, 29)]
    assert any(found.failure and "coverage.time" in found.failure for found in became)


def _folder(parent: Path, number: int) -> Path:
    folder = parent / str(number)
    folder.mkdir()
    return folder


def test_ten_minutes_of_stamps(tmp_path: Path) -> None:
    tenths = soak.run(1 / 6, tmp_path)
    assert len(tenths) == 10
    # 600 s at 22 Hz, less what the silences hold back.
    assert 12_500 < sum(tenth.messages for tenth in tenths) < 13_200
    assert all(tenth.resident > 0 and tenth.state > 0 for tenth in tenths)


@pytest.mark.ros
@pytest.mark.slow
def test_a_few_minutes_of_stamps_over_dds(tmp_path: Path, domain: int) -> None:
    pytest.importorskip("rclpy")
    from fuzz import dds

    tenths = dds.run(0.1, 60.0, tmp_path, domain)
    assert sum(tenth.messages for tenth in tenths) == 8_800
    assert all(tenth.resident > 0 for tenth in tenths)


def test_what_grows_is_named() -> None:
    def tenths(**last: Any) -> list[soak.Tenth]:
        flat: dict[str, Any] = {"messages": 100, "cpu": 1.0, "resident": 200 << 20}
        flat["parts"] = {"engine.a": 1 << 20, "engine.b": 1 << 20}
        # The first one warms up.
        return [soak.Tenth(), *(soak.Tenth(**flat) for _ in range(8)), soak.Tenth(**flat | last)]

    assert soak.judge(tenths()) == []
    assert soak.judge(tenths(cpu=1.4, resident=202 << 20)) == []
    (cost,) = soak.judge(tenths(cpu=1.6))
    assert "1.60 times" in cost
    (memory,) = soak.judge(tenths(resident=204 << 20))
    assert memory == "resident memory grew from 200.0 to 204.0 MB"
    (state,) = soak.judge(tenths(parts={"engine.a": 1 << 20, "engine.b": 3 << 20}))
    assert state == "state memory grew from 2.0 to 4.0 MB, most of all engine.b"


def test_a_lost_message_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    feed = Session.feed
    monkeypatch.setattr(
        Session, "feed", lambda self, truth, estimate: feed(self, truth[1:], estimate)
    )
    with pytest.raises(oracle.Failure, match=r"received \[199, 20\] of \[200, 20\]"):
        soak.run(1 / 6, tmp_path)
