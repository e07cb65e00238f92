# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A short evaluation takes as long as what it loads: what it has no use for is left out."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from trajeval_ros import loops
from trajeval_ros.commands.simulate import write_files

ROOT = Path(__file__).resolve().parents[2]


def loaded_by(*arguments: object) -> set[str]:
    """The modules that are there after ``evaluate`` with these arguments."""
    code = (
        "import contextlib, sys; from trajeval_ros.commands.evaluate import main\n"
        "with contextlib.redirect_stdout(sys.stderr), contextlib.suppress(SystemExit):\n"
        "    assert main(sys.argv[1:]) == 0\n"
        "print(*sys.modules, sep='\\n')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    return set(done.stdout.split())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_files(tmp_path_factory.mktemp("run"), 20.0, 3)


@pytest.fixture(scope="module")
def plain(run: tuple[Path, Path]) -> set[str]:
    """What an evaluation of two files loads."""
    return loaded_by("tum", *run)


def test_an_evaluation_takes_nothing_that_others_need(plain: set[str]) -> None:
    others = {
        "concurrent.futures",
        "email",
        "html",
        "importlib.metadata",
        "logging",
        "matplotlib",
        "rich",
        "rosbags",
        "statistics",
        "subprocess",
        "tempfile",
        "unittest",
        "yaml",
        "trajeval_ros.commands.baseline",
        "trajeval_ros.commands.exports",
        "trajeval_ros.commands.requirements",
        "trajeval_ros.comparison.compare",
        "trajeval_ros.error_model.positions",
        "trajeval_ros.files.bag",
        "trajeval_ros.files.recognise",
        "trajeval_ros.files.span",
        "trajeval_ros.report.page",
        "trajeval_ros.runs.latest_path",
        "trajeval_ros.runs.several",
    }
    assert "trajeval_ros.runs.offline" in plain
    assert others & plain == set()


@pytest.mark.skipif(not loops.there(), reason="without the loops in C, SciPy's LAPACK is needed")
def test_an_evaluation_takes_nothing_of_scipy(plain: set[str]) -> None:
    assert {name for name in plain if name.startswith("scipy")} == set()
