# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exit codes, progress, and the figures as text."""

import io
import subprocess
import sys
from pathlib import Path

import pytest

from trajeval_ros.commands import console, figures


def test_errors_become_one_line_and_a_code(capsys: pytest.CaptureFixture[str]) -> None:
    def failing(error: BaseException) -> int:
        def command() -> int:
            raise error

        return console.run(command, "tool")

    assert failing(console.CommandError("bad data")) == 1
    assert failing(console.UsageError("bad usage")) == 2
    assert failing(console.CommandError("a\nfile\x1b[2J ü")) == 1
    assert failing(KeyboardInterrupt()) == 130
    assert capsys.readouterr().err.splitlines() == [
        "tool: error: bad data",
        "tool: error: bad usage",
        "tool: error: a\\nfile\\x1b[2J ü",
        "tool: error: interrupted",
    ]


def test_a_defect_is_not_hidden() -> None:
    def broken() -> int:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        console.run(broken, "tool")


@pytest.mark.parametrize("flush", [False, True])
def test_output_that_cannot_be_written_is_one_line(flush: bool) -> None:
    code = (
        "import sys; from trajeval_ros.commands import console\n"
        f"sys.exit(console.run(lambda: print('figures', flush={flush}) or 0, 'tool'))"
    )
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr == "tool: error: cannot write the output: No space left on device\n"


def test_another_error_of_the_system_is_not_hidden() -> None:
    with pytest.raises(FileNotFoundError):
        console.run(lambda: len(Path("/no/such/file").read_bytes()), "tool")


def test_progress_is_silent_for_short_work() -> None:
    stream = io.StringIO()
    with console.Progress("reading", 10, "rows", stream) as progress:
        for done in range(10):
            progress.update(done)
    assert stream.getvalue() == ""


def test_progress_of_long_work_has_rate_and_remaining_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    stream = io.StringIO()
    with console.Progress("reading", 1000, "rows", stream) as progress:
        for done in range(0, 1000, 100):
            now += 1.0
            progress.update(done)
    assert stream.getvalue().splitlines() == [
        "reading: 100 of 1,000 rows (10 %), 50 rows/s, 18 s left"
    ]


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (59.4, "59 s"), (125, "2 min 05 s"), (4200, "1 h 10 min")]
)
def test_duration(seconds: float, text: str) -> None:
    assert console.duration(seconds) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (0.0, "0"),
        (0.0123456, "0.01235"),
        (-999.96, "-1000"),
        (12345.6, "12,346"),
        (-3213501.4, "-3,213,501"),
        (-6.3175e10, "-6.318e+10"),
        (4722, "4,722"),
    ],
)
def test_number(value: float | None, text: str) -> None:
    assert figures.number(value) == text


def test_account_adds_up_in_words() -> None:
    counts = {
        "received": 1588,
        "evaluated": 1530,
        "pending": 8,
        "rejected": {"non_finite": 0, "no_ground_truth": 50},
    }
    assert figures.account(counts, "evaluated") == (
        "1,588 received, 1,530 evaluated, 8 pending, 50 rejected (50 no_ground_truth)"
    )
