# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``--start`` and ``--end``: what is left is evaluated as a file that was cut by hand is."""

import json
from pathlib import Path
from typing import Any

import pytest
from twins.runs import assert_same_summary

import trajeval_ros as te
from trajeval_ros.commands import evaluate, inputs, replay
from trajeval_ros.commands.simulate import write_files


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Ground truth, estimate, and every second pose of it."""
    truth, estimate = write_files(tmp_path_factory.mktemp("run"), 20.0, 3)
    sparse = estimate.with_name("sparse.txt")
    sparse.write_text("".join(estimate.read_text().splitlines(keepends=True)[::2]))
    return [truth, estimate, sparse]


def stamps_of(path: Path) -> list[float]:
    return [float(line.split()[0]) for line in path.read_text().splitlines() if line[0] != "#"]


def cut_by_hand(path: Path, target: Path, begin: float, end: float) -> Path:
    lines = [line for line in path.read_text().splitlines() if line[0] != "#"]
    kept = [line for line in lines if begin <= float(line.split()[0]) <= end]
    target.write_text("\n".join(kept) + "\n")
    return target


def summary_of(folder: Path) -> Any:
    """Without the files that it is of: those differ."""
    found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    found.pop("inputs", None)
    return found


def test_it_is_the_file_cut_by_hand(
    run: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, estimate = run[:2]
    known = stamps_of(truth)
    first = known[0]
    begin, end = first + 5.0, first + 12.5
    output = tmp_path / "cut"
    files = [str(truth), str(estimate), "--output", str(output)]
    assert evaluate.main(["tum", *files, "--start", "5", "--end", "12.5"]) == 0
    said = capsys.readouterr().out
    found = summary_of(output)
    hand = cut_by_hand(estimate, tmp_path / "est.txt", begin, end)
    left = len(stamps_of(hand))
    total = len(stamps_of(estimate))
    assert found["estimate"]["received"] == left
    assert found["estimate"]["cut"] == total - left
    assert found["ground_truth"]["cut"] == len(known) - found["ground_truth"]["received"]
    assert f"{total - left:,} cut away" in said
    line = said.splitlines()[0]
    assert line.startswith("info: from 5 s to 12.5 s after the ground truth begins; left out: ")
    assert f"{total - left:,} of {total:,} poses of {estimate}" in line

    lower = max(stamp for stamp in known if stamp <= begin)
    upper = min(stamp for stamp in known if stamp >= end)
    truth_hand = cut_by_hand(truth, tmp_path / "gt.txt", lower, upper)
    by_hand = tmp_path / "hand"
    assert evaluate.main(["tum", str(truth_hand), str(hand), "--output", str(by_hand)]) == 0
    expected = summary_of(by_hand)
    for counts in (found["estimate"], found["ground_truth"]):
        del counts["cut"]
    assert_same_summary(found, expected)

    # The same as stamps.
    stamps = ["--start", f"{begin:.9f}", "--end", str(round(end * 1e9))]
    assert evaluate.main(["tum", *files, *stamps]) == 0
    assert "info: from the stamp " in capsys.readouterr().out
    again = summary_of(output)
    for counts in (again["estimate"], again["ground_truth"]):
        del counts["cut"]
    assert_same_summary(again, expected)

    # And in Python.
    read = te.read_tum(truth), te.read_tum(estimate)
    result = te.evaluate(*read, start=5, end=12.5)
    assert result.summary["estimate"]["cut"] == total - left
    ate = result.summary["conventional"]["ate_translation_rmse"]
    assert ate == pytest.approx(expected["conventional"]["ate_translation_rmse"], rel=1e-9)
    with pytest.raises(ValueError, match="no pose of it lies from 500 s"):
        te.evaluate(*read, start=500)


def test_several_are_cut_alike(run: list[Path], tmp_path: Path) -> None:
    files = [*map(str, run), "--output", str(tmp_path), "--set", "sparse.time_offset=0.01"]
    assert evaluate.main(["tum", *files, "--start", "5"]) == 0
    found = summary_of(tmp_path)["estimates"]
    for path, offset in zip(run[1:], (0.0, 0.01), strict=True):
        counts = found[path.stem]["estimate"]
        kept = [s for s in stamps_of(path) if s + offset >= stamps_of(run[0])[0] + 5.0 - 1e-7]
        assert counts["received"] == len(kept)
        assert counts["cut"] == len(stamps_of(path)) - len(kept)


def test_uncut_runs_do_not_speak_of_it(
    run: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(run[0]), str(run[1]), "--output", str(tmp_path)]
    assert evaluate.main(["tum", *files]) == 0
    assert "cut" not in summary_of(tmp_path)["estimate"]
    assert "cut away" not in capsys.readouterr().out


def test_what_is_refused(run: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    files = ["tum", str(run[0]), str(run[1])]
    assert evaluate.main([*files, "--start", "900"]) == 1
    assert "no pose of it lies from 900 s" in capsys.readouterr().err
    assert evaluate.main([*files, "--start", "9", "--end", "8"]) == 2
    assert "is not after the start" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        evaluate.main([*files, "--start", "-3"])
    assert "must be finite and not negative: -3" in capsys.readouterr().err


def test_replay_publishes_the_part(run: list[Path]) -> None:
    arguments = replay.make_parser().parse_args(["tum", str(run[0]), str(run[1]), "--end", "4"])
    data = inputs.cut(arguments, inputs.read(arguments), [0.0])
    assert data.estimate.cut > 0
    assert data.remarks[0].startswith("to 4 s after the ground truth begins")
