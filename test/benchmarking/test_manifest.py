# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The manifest: what is wrong with it is said with its line, before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from trajeval_ros.benchmarking.manifest import ManifestError, discover, read_manifest
from trajeval_ros.benchmarking.pattern import Pattern, PatternError
from trajeval_ros.commands import benchmark

TRUTH = "0.0 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n"
GOOD = "estimates: 'r/{system}/{sequence}/{run}.txt'\nsequences:\n  hall: {ground_truth: gt.txt}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "gt.txt").write_text(TRUTH)
    for system in ("a", "b"):
        path = tmp_path / "r" / system / "hall" / "1.txt"
        path.parent.mkdir(parents=True)
        path.write_text(TRUTH)
    return tmp_path


def problems(folder: Path, text: str) -> list[str]:
    path = folder / "m.yaml"
    path.write_text(text)
    with pytest.raises(ManifestError) as caught:
        read_manifest(path)
    return [problem.removeprefix(f"{path}:") for problem in caught.value.problems]


def test_a_good_one_names_every_run(folder: Path) -> None:
    path = folder / "m.yaml"
    path.write_text(GOOD + "parameters: {gauge: sim3, gp: {kernel: matern52}}\n")
    manifest = read_manifest(path)
    assert [(run.system, run.sequence, run.run) for run in manifest.runs] == [
        ("a", "hall", "1"),
        ("b", "hall", "1"),
    ]
    assert manifest.sequences[0].parameters["gauge"] == "sim3"
    assert manifest.sequences[0].ground_truth.path == str(folder / "gt.txt")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "1: it is empty"),
        ("a: [1\n", "2: no YAML"),
        ("- 1\n", "1: the manifest must be a mapping"),
        ("sequences:\n  hall: {ground_truth: gt.txt}\n", "1: estimates is missing"),
        (GOOD.replace("gt.txt", "absent.txt"), "3: sequence hall: ground_truth: there is no"),
        (
            GOOD.replace("gt.txt", "gt.txt, format: bag"),
            "3: sequence hall: ground_truth: a bag, but",
        ),
        (
            GOOD.replace(
                "'r/{system}/{sequence}/{run}.txt'",
                "{pattern: 'r/{system}/{sequence}/{run}.txt', format: bag}",
            ),
            "3: sequence hall: its estimates: a bag, but which topic of it? set topic",
        ),
        (GOOD + "sequencess: {}\n", "4: unknown key sequencess; did you mean sequences?"),
        (GOOD + "parameters: {gauge: sim4}\n", "4: gauge must be one of"),
        (GOOD + "parameters:\n  gp.kernal: matern52\n", "5: unknown parameter gp.kernal; did"),
        (GOOD + "  room: {ground_truth: gt.txt}\n", "4: sequence room: no file matches"),
        (GOOD.replace("{run}", "{rum}"), "1: estimates: {rum} is none of"),
        (GOOD.replace("{system}/", ""), "1: estimates: {system} is missing"),
        (GOOD.replace("gt.txt", "gt.txt, format: tam"), "3: format must be one of"),
        (GOOD + "estimates: x\n", "4: estimates is there twice"),
    ],
)
def test_mistakes_are_said_with_their_lines(folder: Path, text: str, said: str) -> None:
    assert any(problem.startswith(said) for problem in problems(folder, text)), said


def test_every_mistake_is_said_at_once(folder: Path) -> None:
    text = GOOD.replace("gt.txt", "absent.txt") + "parameters: {gauge: 3, max_wait: -1}\n"
    assert len(problems(folder, text)) == 3


def test_the_command_refuses_it_with_exit_code_2(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "m.yaml"
    path.write_text(GOOD + "parameters: {gauge: sim4}\n")
    assert benchmark.main([str(path), "--output", str(folder / "out")]) == 2
    assert f"{path}:4: gauge must be" in capsys.readouterr().err
    assert not (folder / "out").exists()


def test_a_pattern_may_do_without_runs_and_repeat_a_field(tmp_path: Path) -> None:
    for name in ("vins/vins_hall.txt", "vins/orb_hall.txt", "orb/orb_hall.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = Pattern.of("{system}/{system}_{sequence}.txt").files(tmp_path, "hall")
    assert [(system, run) for system, run, _ in found] == [("orb", "1"), ("vins", "1")]
    with pytest.raises(PatternError, match="brace"):
        Pattern.of("{system}/{sequence}/{")


def test_discovered_manifests_are_read(tmp_path: Path) -> None:
    for name in ("hall/groundtruth.txt", "results/vins/hall/1.txt", "results/vins/hall/2.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(TRUTH)
    assert len(read_manifest(discover(tmp_path)).runs) == 2
    with pytest.raises(ManifestError, match="already"):
        discover(tmp_path)


def test_nothing_to_discover_is_said(tmp_path: Path) -> None:
    with pytest.raises(ManifestError, match="no ground truth"):
        discover(tmp_path)
