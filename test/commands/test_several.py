# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate`` of several estimates against one ground truth."""

import os
from pathlib import Path

import pytest
from test_evaluate import evaluate, summary_of
from twins.runs import assert_same_summary

from trajeval_ros.commands.inputs import names_of
from trajeval_ros.commands.simulate import write_files


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A ground truth, and two estimates of the same run: one has every second pose."""
    truth, estimate = write_files(tmp_path_factory.mktemp("run"), 20.0, 3)
    sparse = estimate.with_name("sparse.txt")
    lines = estimate.read_text(encoding="utf-8").splitlines()
    sparse.write_text("\n".join(lines[::2]) + "\n", encoding="utf-8")
    return [truth, estimate.rename(estimate.with_name("dense.txt")), sparse]


def test_each_has_what_it_has_alone(paths: list[Path], tmp_path: Path) -> None:
    result = evaluate("tum", *paths, "--output", tmp_path / "both")
    assert result.returncode == 0, result.stderr
    assert sorted(os.listdir(tmp_path / "both")) == [
        "dense",
        "report.html",
        "sparse",
        "summary.json",
    ]
    both = summary_of(tmp_path / "both")
    assert sorted(both) == ["comparison", "estimates", "ground_truth", "likely_causes"]
    for path in paths[1:]:
        name = path.stem
        alone = evaluate("tum", paths[0], path, "--output", tmp_path / name)
        assert alone.returncode == 0
        expected = summary_of(tmp_path / name)
        together = {**both["estimates"][name], "ground_truth": both["ground_truth"]}
        # A search ends where it ends: not to the last digits.
        for part in (together, together["window"]), (expected, expected["window"]):
            assert all("error_model" in each for each in part)
        ours, theirs = together.pop("error_model"), expected.pop("error_model")
        assert ours["model"] == theirs["model"]
        assert ours["log_likelihood"] == pytest.approx(theirs["log_likelihood"], rel=1e-6)
        together["window"].pop("error_model")
        expected["window"].pop("error_model")
        assert together["inputs"].pop("arguments") != expected["inputs"].pop("arguments")
        # The same order, for the comparison of the two.
        assert_same_summary({key: together[key] for key in expected}, expected)
        own = tmp_path / "both" / name
        assert sorted(os.listdir(own)) == ["poses.csv", "report.html", "summary.json"]
        assert len((own / "poses.csv").read_text().splitlines()) == len(
            (tmp_path / name / "poses.csv").read_text().splitlines()
        )
        assert f"{name}: {path}" in result.stdout


def test_each_pair_is_compared(paths: list[Path], tmp_path: Path) -> None:
    result = evaluate("tum", *paths, "--output", tmp_path)
    (pair,) = summary_of(tmp_path)["comparison"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<title>dense, sparse: trajectory evaluation</title>" in page
    assert page.index("<h2>Which is better</h2>") < page.index("<h2>Where</h2>")
    assert (pair["a"], pair["b"]) == ("dense", "sparse")
    # The same poses, where both have one: no error differs.
    sparse = summary_of(tmp_path)["estimates"]["sparse"]
    # Outside the gaps of the ground truth, which this run has.
    assert pair["common"]["poses"] == sparse["conventional"]["poses"]
    assert pair["common"]["poses"] < sparse["estimate"]["evaluated"]
    assert pair["ate_translation"]["ratio"] == pytest.approx(1.0, abs=1e-9)
    assert "both cover" in result.stdout
    # Side by side, before the sentence.
    end = result.stdout.partition("Compared, each with each")[2].splitlines()
    assert end[2].split() == ["coverage", "ATE", "RE"]
    assert [line.split()[0] for line in end[3:5]] == ["dense", "sparse"]
    assert all("100 %" in line for line in end[3:5])


def test_each_has_parameters_of_its_own(paths: list[Path], tmp_path: Path) -> None:
    output = ["--output", tmp_path]
    result = evaluate("tum", *paths, "--set", "sparse.time_offset=500", *output)
    assert result.returncode == 1
    assert "do not overlap" in result.stderr
    result = evaluate("tum", *paths, "--set", "estimate.time_offset=0.1")
    assert result.returncode == 2
    assert "unknown parameter estimate.time_offset" in result.stderr
    result = evaluate("tum", *paths, "--set", "sparse.extrinsic=0.5,0,0,0,0,0,1", *output)
    assert result.returncode == 0, result.stderr
    found = summary_of(tmp_path)["estimates"]
    alone = evaluate("tum", paths[0], paths[1], "--output", tmp_path / "alone")
    assert alone.returncode == 0
    ate = summary_of(tmp_path / "alone")["conventional"]["ate_translation_rmse"]
    assert found["dense"]["conventional"]["ate_translation_rmse"] == pytest.approx(ate, rel=1e-9)
    assert found["sparse"]["conventional"]["ate_translation_rmse"] > 1.5 * ate


def test_one_that_cannot_be_evaluated_costs_itself_alone(paths: list[Path], tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.txt"
    rows = [line.split() for line in paths[1].read_text(encoding="utf-8").splitlines()]
    nowhere = [" ".join([row[0], "nan", *row[2:]]) for row in rows if row[0] != "#"]
    wrong.write_text("\n".join(nowhere) + "\n", encoding="utf-8")
    result = evaluate("tum", paths[0], paths[1], wrong, "--output", tmp_path / "out")
    assert result.returncode == 1
    assert "wrong.txt: none of its" in result.stderr
    assert "Traceback" not in result.stderr
    found = summary_of(tmp_path / "out")["estimates"]
    assert found["dense"]["estimate"]["evaluated"] > 100
    assert found["wrong"]["estimate"]["evaluated"] == 0


@pytest.mark.parametrize(
    ("sources", "names"),
    [
        (["a.txt"], ("estimate",)),
        (["runs/VINS-Mono.txt", "runs/orb.tum"], ("vins_mono", "orb")),
        (["a/out.txt", "b/out.txt"], ("a_out", "b_out")),
        (["out.txt", "out.txt"], ("out", "out_2")),
        (["/vins/odom", "/orb/odom"], ("vins_odom", "orb_odom")),
        (
            ["2024.txt", "gp.txt", "ground_truth.txt"],
            ("estimate_2024", "estimate_gp", "estimate_ground_truth"),
        ),
    ],
)
def test_names(sources: list[str], names: tuple[str, ...]) -> None:
    assert names_of(sources) == names
