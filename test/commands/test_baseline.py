# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``--baseline``: an estimate held to an earlier run of it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_evaluate import evaluate as process

from trajeval_ros import se3
from trajeval_ros.commands import evaluate

SECONDS = 60.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``gt.txt``, and estimates: ``before``, ``same`` of 1 cm of noise, ``worse`` of 3."""
    place = tmp_path_factory.mktemp("baseline")
    rng = np.random.default_rng(1)

    def poses(t: np.ndarray) -> np.ndarray:
        steps = (3 * np.sin(0.5 * t), 3 * np.cos(0.7 * t), np.sin(t), 0 * t, 0.1 * np.sin(t), t / 5)
        return np.asarray(se3.exp(np.stack(steps, axis=1)))

    def write(name: str, t: np.ndarray, stack: np.ndarray) -> None:
        rows = np.column_stack((t, *se3.to_position_quaternion(stack)))
        np.savetxt(place / f"{name}.txt", rows, fmt="%.17g")

    dense, sparse = np.arange(0, SECONDS, 0.01), np.arange(0.5, SECONDS - 0.5, 0.1)
    write("gt", dense, poses(dense))
    for name, scale in (("before", 1.0), ("same", 1.0), ("worse", 3.0)):
        noise = scale * rng.normal(size=(len(sparse), 6)) * np.repeat([0.01, 0.005], 3)
        write(name, sparse, se3.compose(poses(sparse), se3.exp(noise)))
    half = (place / "same.txt").read_text().splitlines(keepends=True)
    (place / "short.txt").write_text("".join(half[: len(half) // 2]))
    return place


@pytest.fixture(scope="module")
def baseline(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("output") / "base"
    files = [str(folder / "gt.txt"), str(folder / "before.txt")]
    assert evaluate.main(["tum", *files, "--output", str(output)]) == 0
    return output


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(folder: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: object) -> tuple[int, str, str]:
        names = [str(folder / f"{name}.txt") for name in ("gt", *str(arguments[0]).split())]
        capsys.readouterr()
        code = evaluate.main(["tum", *names, *map(str, arguments[1:])])
        said = capsys.readouterr()
        # On a busy machine there is progress, too.
        errors = [line for line in said.err.splitlines(True) if not line.startswith("evaluating: ")]
        return code, said.out, "".join(errors)

    return call


def test_paired_by_the_poses(run: Run, baseline: Path) -> None:
    for where in (baseline, baseline / "summary.json"):
        code, out, err = run("same", "--baseline", where)
        assert (code, err) == (0, "")
        assert f"Baseline      {baseline / 'summary.json'}, paired on 590 poses" in out
        assert "ate_translation" in out
    code, out, err = run("worse", "--baseline", baseline)
    assert code == 3
    lines = err.splitlines()
    assert len(lines) == 4
    assert lines[0].startswith("evaluate: error: worse than before: ate_translation is ")
    assert " times as large (95 %: " in lines[0]
    assert " m, and was 0.01" in lines[0]
    assert "deg" in lines[1]


def test_a_process(folder: Path, baseline: Path) -> None:
    result = process(folder / "gt.txt", folder / "worse.txt", "--baseline", baseline, "--quiet")
    assert (result.returncode, result.stdout) == (3, "")
    assert "worse than before: re_translation" in result.stderr


def test_the_figures_are_those_of_a_comparison(
    run: Run, folder: Path, baseline: Path, tmp_path: Path
) -> None:
    _, out, _ = run("worse", "--baseline", baseline)
    assert run("worse before", "--output", tmp_path)[0] == 0
    (pair,) = json.loads((tmp_path / "summary.json").read_text())["comparison"]
    (row,) = (line.split() for line in out.splitlines() if "re_translation" in line)
    low, high = pair["re_translation"]["interval"]
    ratio = pair["re_translation"]["ratio"]
    assert row[5:9] == [f"{ratio:.4g}", f"{low:.4g}", "to", f"{high:.4g}"]


def test_the_folder_may_be_written_anew(run: Run, baseline: Path, tmp_path: Path) -> None:
    own = shutil.copytree(baseline, tmp_path / "own")
    assert run("worse", "--baseline", own, "--output", own)[0] == 3
    assert run("same", "--baseline", own, "--output", own)[0] == 0


def test_without_poses_it_says_so(run: Run, baseline: Path, tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    shutil.copy(baseline / "summary.json", summary)
    code, out, _ = run("same", "--baseline", summary)
    assert code == 0
    assert "no poses.csv beside it: the error models' intervals are compared" in out
    assert "translation.jitter_std" in out
    code, _, err = run("worse", "--baseline", summary)
    assert code == 3
    assert "worse than before: translation.jitter_std is " in err
    without = json.loads(summary.read_text())
    del without["error_model"]
    summary.write_text(json.dumps(without))
    code, _, err = run("same", "--baseline", summary)
    assert code == 1
    assert "--baseline: there is no poses.csv beside it, and the error models" in err


def test_the_rows_of_the_baseline_have_its_own_clock(
    run: Run, folder: Path, tmp_path: Path
) -> None:
    """The baseline's stamps were late and were put right; those of now are right."""
    rows = np.loadtxt(folder / "before.txt")
    rows[:, 0] += 0.04
    np.savetxt(tmp_path / "late.txt", rows, fmt="%.17g")
    files = [str(folder / "gt.txt"), str(tmp_path / "late.txt")]
    late = [*files, "--set", "estimate.time_offset=-0.04", "--output", str(tmp_path / "out")]
    assert evaluate.main(["tum", *late]) == 0
    code, out, _ = run("before", "--baseline", tmp_path / "out")
    assert code == 0
    (row,) = (line.split() for line in out.splitlines() if "ate_translation" in line)
    # Of the same poses at the same times.
    assert float(row[5]) == pytest.approx(1.0, abs=1e-3)


def test_what_was_exact_is_said(run: Run, folder: Path, tmp_path: Path) -> None:
    truth = str(folder / "gt.txt")
    assert evaluate.main(["tum", truth, truth, "--output", str(tmp_path / "out")]) == 0
    poses = tmp_path / "out" / "poses.csv"
    header, *lines = poses.read_text().splitlines()
    names = header.split(",")
    known, est = names.index("gt_tx"), names.index("est_tx")
    cells = [line.split(",") for line in lines]
    for row in cells:
        row[est : est + 7] = row[known : known + 7]
    poses.write_text("\n".join([header, *(",".join(row) for row in cells)]) + "\n")
    code, _, err = run("before", "--baseline", tmp_path / "out")
    assert code == 3
    assert "ate_translation is " in err
    assert "and was exact" in err


def test_a_tracker_that_gives_up_is_worse(run: Run, baseline: Path) -> None:
    code, _, err = run("short", "--baseline", baseline)
    assert code == 3
    assert "worse than before: 29.5 s that were covered are not any more" in err


def test_several_each_with_its_own(run: Run, folder: Path, baseline: Path, tmp_path: Path) -> None:
    both = tmp_path / "both"
    assert run("before same", "--output", both)[0] == 0
    code, out, err = run("before same", "--baseline", both)
    assert (code, err) == (0, "")
    assert "before:\nBaseline" in out
    # All against one.
    code, _, err = run("same worse", "--baseline", baseline)
    assert code == 3
    assert all("worse than before: worse: " in line for line in err.splitlines())
    code, _, err = run("same worse", "--baseline", both)
    assert code == 2
    assert "is of before, same, not of worse" in err
    code, _, err = run("same", "--baseline", both)
    assert code == 2
    assert f"name {both / 'before' / 'summary.json'}" in err


def test_what_is_no_baseline(run: Run, folder: Path, baseline: Path, tmp_path: Path) -> None:
    for text, said in (("{", "it is not JSON"), ("[]", "no summary"), ('{"a": 1}', "no summary")):
        (tmp_path / "summary.json").write_text(text)
        code, out, err = run("same", "--baseline", tmp_path)
        assert (code, out) == (2, "")
        assert said in err
    code, _, err = run("same", "--baseline", tmp_path / "absent.json")
    assert code == 2
    assert "absent.json: it cannot be read: no such file" in err
    broken = shutil.copytree(baseline, tmp_path / "broken")
    text = (baseline / "poses.csv").read_text()
    lines = text.splitlines(keepends=True)
    for bad in ("", lines[0], "a,b\n1,2\n", text[: len(text) // 2], lines[0] + lines[2] + lines[1]):
        (broken / "poses.csv").write_text(bad)
        code, _, err = run("same", "--baseline", broken)
        assert code == 1
        assert "--baseline: " in err
        assert "poses.csv" in err
    # Another recording: no pose at the same time.
    (broken / "poses.csv").write_text(
        lines[0]
        + "".join(f"{10**18 + i},{line.partition(',')[2]}" for i, line in enumerate(lines[1:]))
    )
    code, _, err = run("same", "--baseline", broken)
    assert code == 1
    assert "no poses at the times of this run's" in err
