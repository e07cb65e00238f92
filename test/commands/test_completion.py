# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a shell is told when it asks how a command line may go on."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def completions(line: str, answer: Path) -> list[str]:
    """Ask as the shell does, with the cursor at the end of ``line``."""
    pytest.importorskip("argcomplete", reason="the extra completion")
    command = line.split(" ", 1)[0]
    subprocess.run(
        [sys.executable, "-m", f"trajeval_ros.commands.{command}"],
        check=False,
        timeout=240,
        stdout=subprocess.DEVNULL,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "_ARGCOMPLETE": "1",
            "_ARGCOMPLETE_IFS": "\n",
            "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
            "COMP_LINE": line,
            "COMP_POINT": str(len(line)),
        },
    )
    return [word.strip() for word in answer.read_text().split("\n")]


@pytest.mark.parametrize(
    ("line", "among"),
    [
        ("evaluate ", ["tum", "euroc", "kitti", "bag"]),
        ("evaluate ki", ["kitti"]),
        ("evaluate tum gt.txt est.txt --req", ["--require"]),
        # No format: that of the content.
        ("evaluate gt.txt est.txt --ba", ["--baseline"]),
        ("evaluate gt.csv --tim", ["--times"]),
        ("evaluate gt.txt est.txt --set gau", ["gauge="]),
        ("replay gt.txt est.txt --type Odo", ["Odometry"]),
        ("simulate run --du", ["--duration"]),
        ("demo --rat", ["--rate"]),
    ],
)
def test_completions(line: str, among: list[str], tmp_path: Path) -> None:
    found = completions(line, tmp_path / "answer")
    assert set(among) <= set(found)


def test_the_choices_of_a_parameter(tmp_path: Path) -> None:
    # A shell breaks words at the sign, so what follows it is what is asked for.
    found = completions("evaluate tum a b --set gauge=si", tmp_path / "answer")
    assert any(word.endswith("sim3") for word in found)


def test_nobody_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    from trajeval_ros.commands import completion, evaluate

    monkeypatch.delenv("_ARGCOMPLETE", raising=False)
    completion.complete(evaluate.make_parser())
