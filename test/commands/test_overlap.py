# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps that have nothing, or little, in common: what ``evaluate`` says and advises."""

import re
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.commands import evaluate
from trajeval_ros.commands.simulate import write_files


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A short simulated run: ground truth and estimate."""
    return write_files(tmp_path_factory.mktemp("run"), 20.0, 3)


def restamped(path: Path, to: Path, change: object) -> Path:
    """The file with its stamps (s since the first, and the first) changed."""
    assert callable(change)
    rows = [line.split() for line in path.read_text().splitlines()[1:]]
    seconds = np.array([float(row[0]) for row in rows])
    new = change(seconds - 1.75e9)
    to.write_text("".join(f"{s:.6f} {' '.join(r[1:])}\n" for s, r in zip(new, rows, strict=True)))
    return to


def test_an_hour_and_the_motion_agree(
    run: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moved = restamped(run[1], tmp_path / "moved.txt", lambda s: s + 1.75e9 - 7200.0)
    assert evaluate.main(["tum", str(run[0]), str(moved)]) == 1
    line = capsys.readouterr().err
    assert "Likely reason: a time zone, 2 h" in line
    advised = re.search(r"set estimate\.time_offset=(\S+)$", line.strip())
    assert advised is not None
    assert float(advised.group(1)) == pytest.approx(7200.0, abs=0.1)


def test_a_start_at_zero_and_what_is_advised_works(
    run: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moved = restamped(run[1], tmp_path / "moved.txt", lambda s: s + 3.0)
    assert evaluate.main(["tum", str(run[0]), str(moved)]) == 1
    line = capsys.readouterr().err
    assert "the estimate's stamps count from a start" in line
    advice = re.search(r"(estimate\.time_offset=\S+)$", line.strip())
    assert advice is not None
    assert float(advice.group(1).partition("=")[2]) == pytest.approx(1.75e9 - 3.0, abs=0.1)
    assert evaluate.main(["tum", str(run[0]), str(moved), "--set", advice.group(1)]) == 0


def test_frame_numbers_lead_with_the_share(
    run: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = restamped(run[0], tmp_path / "truth.txt", lambda s: s)
    frames = restamped(run[1], tmp_path / "frames.txt", lambda s: np.arange(len(s)) * 1.0)
    assert evaluate.main(["tum", str(truth), str(frames)]) == 0
    out = capsys.readouterr().out
    warning = out.index("warning: only ")
    assert warning < out.index("ATE")
    assert "the estimate's stamps look like frame numbers (0, 1, ...)" in out


def test_milliseconds_of_which_none_is_evaluated(
    run: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = restamped(run[0], tmp_path / "truth.txt", lambda s: s)
    counted = restamped(run[1], tmp_path / "counted.txt", lambda s: 1e3 * (s - s[0]))
    assert evaluate.main(["tum", str(truth), str(counted)]) == 1
    line = capsys.readouterr().err
    assert "could be evaluated" in line
    assert "Likely reason: the estimate's stamps are milliseconds, by their size" in line


def test_whole_seconds_are_said(
    run: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    coarse = restamped(run[1], tmp_path / "coarse.txt", lambda s: np.floor(s + 1.75e9))
    assert evaluate.main(["tum", str(run[0]), str(coarse)]) == 0
    out = capsys.readouterr().out
    assert "coarse.txt: stamps resolve only 1 s, 20 different ones in" in out
    assert re.search(r"warning: only \d\d of \d+ poses \(\d(\.\d)? %\) are evaluated", out)


def test_where_all_of_the_ground_truth_is_rejected_it_is_named(
    run: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [line.split() for line in run[0].read_text().splitlines()[1:]]
    truth = tmp_path / "truth.txt"
    # Numbers of many sizes that are no quaternions.
    numbers = [f"0 0 0 {0.1 + 0.1 * (i % 7)}" for i in range(len(rows))]
    lines = [" ".join([*row[:4], q]) for row, q in zip(rows, numbers, strict=True)]
    truth.write_text("\n".join(lines) + "\n")
    assert evaluate.main(["tum", str(truth), str(run[1])]) == 1
    line = capsys.readouterr().err
    assert f"of the ground truth's {len(rows):,} none could be used" in line
    assert "unnormalized_quaternion" in line
