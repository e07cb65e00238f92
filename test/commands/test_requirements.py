# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``--require``, ``--json`` and ``--quiet``: what a CI job sees of an evaluation."""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_evaluate import evaluate

from trajeval_ros.commands import evaluate as command
from trajeval_ros.commands.console import UsageError
from trajeval_ros.commands.requirements import Requirement, check, judge
from trajeval_ros.commands.simulate import write_files
from trajeval_ros.commands.summary_paths import why_unknown

SUMMARY: dict[str, Any] = {
    "estimate": {"received": 12, "evaluated": 10, "rejected": {"out_of_order": 2}},
    "gauge": "se3",
    "conventional": {"ate_translation_rmse": 0.04, "ate_rotation_rmse": None, "poses": 10},
    "error_model": {
        "model": "wander",
        "translation": {"jitter_std": {"value": 0.001, "std": 0.0001}},
        "jumps": [{"translation": 0.5}],
    },
}


def verdict(text: str, summary: dict[str, Any] = SUMMARY) -> tuple[bool, str]:
    (found,) = judge([Requirement.of(text)], summary, ["estimate"])
    return found.holds, found.line


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("conventional.ate_translation_rmse < 0.05", True),
        ("conventional.ate_translation_rmse<0.04", False),
        ("conventional.ate_translation_rmse <= 0.04", True),
        ("conventional.ate_translation_rmse > 4e-2", False),
        ("conventional.ate_translation_rmse >= 0.04", True),
        ("conventional.poses == 10", True),
        ("conventional.poses != 10", False),
        ("gauge == se3", True),
        ("gauge == 'se3'", True),
        ("gauge != sim3", True),
        ("error_model.translation.jitter_std.value < 0.01", True),
        ("error_model.jumps.0.translation < 0.6", True),
        # What is not there is neither small nor large.
        ("conventional.ate_rotation_rmse < 100", False),
        ("conventional.ate_rotation_rmse > 0", False),
        ("conventional.ate_rotation_rmse == null", True),
        ("error_model.translation.drift_std.value < 1", False),
        # A reason that no pose was rejected for is not listed.
        ("estimate.rejected.out_of_order < 3", True),
        ("estimate.rejected.no_ground_truth == 0", True),
        ("estimate.cut == 0", True),
    ],
)
def test_what_holds(text: str, holds: bool) -> None:
    assert verdict(text)[0] == holds


def test_the_line_has_the_value() -> None:
    assert verdict("conventional.ate_translation_rmse<0.01")[1] == (
        "conventional.ate_translation_rmse < 0.01: it is 0.04"
    )
    assert verdict("conventional.ate_rotation_rmse<1")[1].endswith("it is absent")
    few = {key: value for key, value in SUMMARY.items() if key != "error_model"}
    assert verdict("error_model.scale.value < 1", few) == (
        False,
        "error_model.scale.value < 1: it is absent",
    )


@pytest.mark.parametrize(
    ("path", "near"),
    [
        ("conventional.ate_translation_rsme", "conventional.ate_translation_rmse"),
        ("ate_translation_rmse", "conventional.ate_translation_rmse"),
        ("conventional.ate", "conventional.ate_translation_rmse"),
        ("estimate.rejected.lost", "estimate.rejected."),
        ("error_model.translation.jitter_std", "error_model.translation.jitter_std.value"),
        # Also where this summary has no error model, or not this one.
        ("error_model.translation.jiter_std.value", "error_model.translation.jitter_std.value"),
        ("error_model.translation.wonder_std.value", "error_model.translation.wander_std.value"),
        ("window.error_modell.poses", "window.error_model.poses"),
        ("error_model.jumps", "error_model.jumps.0.stamp"),
        ("estimate", "estimate.received"),
    ],
)
def test_an_unknown_path_names_those_near_it(path: str, near: str) -> None:
    with pytest.raises(UsageError, match=f"no summary has a figure {path}; near it: .*{near}"):
        check([Requirement.of(f"{path} < 1")], ["estimate"])


def test_a_group_is_there_or_is_not() -> None:
    for text, holds in (("error_model != null", True), ("window == null", True)):
        check([Requirement.of(text)], ["estimate"])
        assert verdict(text)[0] == holds


def leaves(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, below in items:
            yield from leaves(below, (*path, str(key)))
    else:
        yield path


def test_every_figure_can_be_asked_for(run: tuple[str, str], tmp_path: Path) -> None:
    """Of one, of several: what a summary has is what `check` knows."""
    assert command.main(["tum", *run, "--output", str(tmp_path / "one"), "--quiet"]) == 0
    assert command.main(["tum", *run, run[1], "--output", str(tmp_path / "two"), "--quiet"]) == 0
    for folder, names in (("one", ["estimate"]), ("two", ["estimate", "estimate_2"])):
        summary = json.loads((tmp_path / folder / "summary.json").read_text(encoding="utf-8"))
        estimates = summary.pop("estimates", {})
        for path in (*leaves(summary), *leaves(next(iter(estimates.values()), {}))):
            # A parameter's dots are no way down.
            if path[0] not in ("parameters", "likely_causes") or "." not in path[1]:
                assert why_unknown(path, names, group=True) is None


@pytest.mark.parametrize(
    ("asked", "near"),
    [
        ("ate", "conventional.ate_translation_rmse"),
        ("jitter", "error_model.translation.jitter_std"),
        ("chi2", "relative.chi2"),
        ("longest_loss", "coverage.longest_loss"),
    ],
)
def test_a_word_of_a_figure_leads_to_it(asked: str, near: str) -> None:
    said = why_unknown((asked,), ["estimate"])
    assert said is not None
    assert f"near it: {near}" in said


@pytest.mark.parametrize(
    "text", ["", "ate", "ate <", "< 3", "a.b < c", "a.b < nan", "a..b < 1", "a =< 1", "a < 1 m"]
)
def test_what_is_no_condition(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        Requirement.of(text)


def test_of_several_each_or_one() -> None:
    several = {
        "ground_truth": {"used": 7},
        "estimates": {"a": SUMMARY, "b": {**SUMMARY, "conventional": {"poses": 3}}},
        "comparison": [{"p_value": 0.5}],
    }

    def said(text: str) -> list[tuple[bool, str]]:
        found = judge([Requirement.of(text)], several, ["a", "b"])
        return [(each.holds, each.line) for each in found]

    assert said("conventional.poses > 5") == [
        (True, "a: conventional.poses > 5: it is 10"),
        (False, "b: conventional.poses > 5: it is 3"),
    ]
    assert said("a.conventional.poses > 5") == [(True, "a.conventional.poses > 5: it is 10")]
    assert said("ground_truth.used > 5") == [(True, "ground_truth.used > 5: it is 7")]
    assert said("comparison.0.p_value > 0.05")[0][0]
    with pytest.raises(UsageError, match=r"near it: a\.conventional\.poses"):
        check([Requirement.of("a.conventional.pose > 5")], ["a", "b"])
    for text in ("comparison.0.re_translation.p_value > 0.05", "b.coverage.time > 0.9"):
        check([Requirement.of(text)], ["a", "b"])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    truth, estimate = write_files(tmp_path_factory.mktemp("run"), 20.0, 3)
    return str(truth), str(estimate)


def test_exit_codes_of_a_process(run: tuple[str, str], tmp_path: Path) -> None:
    met = ["--require", "conventional.ate_translation_rmse < 10"]
    failed = ["--require", "conventional.poses > 1e9", "--require", "gauge == sim3"]
    result = evaluate("tum", *run, *met)
    assert (result.returncode, result.stderr) == (0, "")
    assert "Required      conventional.ate_translation_rmse < 10: it is 0." in result.stdout
    result = evaluate("tum", *run, *met, *failed, "--output", tmp_path)
    assert result.returncode == 3
    lines = result.stderr.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("evaluate: error: required: conventional.poses > 1e9: it is ")
    assert lines[1] == "evaluate: error: required: gauge == sim3: it is se3"
    # What failed is there to be looked at.
    assert (tmp_path / "report.html").is_file()
    # Before the run, which may take long.
    result = evaluate("tum", "none.txt", "none.txt", "--require", "conventional.ate < 1")
    assert result.returncode == 2
    assert "--require: no summary has a figure conventional.ate; near it: " in result.stderr
    assert result.stdout == ""
    result = evaluate("tum", *run, "--require", "conventional.ate_translation_rmse = 1")
    assert result.returncode == 2
    assert result.stdout == ""


def test_json_has_stdout_alone(run: tuple[str, str], tmp_path: Path) -> None:
    result = evaluate(*run, "--json", "--output", tmp_path, "--require", "gauge == sim3")
    assert result.returncode == 3
    assert json.loads(result.stdout) == json.loads((tmp_path / "summary.json").read_text())
    assert "ATE" in result.stderr
    assert "info: read as tum" in result.stderr
    assert "required: gauge == sim3: it is se3" in result.stderr
    quiet = evaluate(*run, "--json", "--quiet")
    assert (quiet.returncode, quiet.stderr) == (0, "")
    assert json.loads(quiet.stdout)["gauge"] == "se3"


def test_json_of_several(run: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["tum", *run, run[1], "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert sorted(found) == ["comparison", "estimates", "ground_truth", "likely_causes"]


def test_quiet_prints_errors_alone(run: tuple[str, str]) -> None:
    result = evaluate("tum", *run, "--quiet", "--require", "gauge == se3")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    result = evaluate("tum", *run, "--quiet", "--require", "gauge == sim3")
    assert (result.returncode, result.stdout) == (3, "")
    assert result.stderr == "evaluate: error: required: gauge == sim3: it is se3\n"
    result = evaluate("tum", run[0], "absent.txt", "--quiet")
    assert (result.returncode, result.stdout) == (1, "")
    assert "absent.txt" in result.stderr


def test_what_could_not_be_evaluated_comes_before_what_is_required(
    run: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dead = tmp_path / "dead.txt"
    rows = [line.split() for line in Path(run[1]).read_text().splitlines() if line[0] != "#"]
    dead.write_text("".join(f"{row[0]} nan 0 0 0 0 0 1\n" for row in rows))
    files = [run[0], str(dead), run[1]]
    assert command.main([*files, "--require", "estimate.conventional.poses > 1e9"]) == 1
    said = capsys.readouterr().err
    assert "none of its" in said
    assert "required: estimate.conventional.poses > 1e9" in said
