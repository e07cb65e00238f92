# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exit codes, progress, and the figures as text."""

import io
import subprocess
import sys
from pathlib import Path

import pytest

from trajeval_ros import se3
from trajeval_ros.commands import console, figures
from trajeval_ros.commands.figures import summary_lines
from trajeval_ros.commands.simulation import simulate
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.report.answers import first_lines
from trajeval_ros.report.numbers import compact, number


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


@pytest.mark.parametrize(("command", "code"), [("evaluate tum a b", 1), ("simulate out", 0)])
def test_streams_that_are_closed_are_none_s_loss(command: str, code: int, tmp_path: Path) -> None:
    """As of a process that something else started with neither stdout nor stderr."""
    name, *rest = command.split()
    module = f"trajeval_ros.commands.{name}"
    done = subprocess.run(
        ["sh", "-c", 'exec "$@" >&- 2>&-', "sh", sys.executable, "-m", module, *rest],
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == code
    assert (tmp_path / "out").exists() == (code == 0)


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
    assert number(value) == text


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


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (9222, "9,222"),
        (-2_953_458.4, "-2,953,458"),
        (-298_122_999.0, "-298.123 M"),
        (-92_547_400_000.0, "-92.5474 G"),
        (1.5e18, "1.500e+18"),
    ],
)
def test_a_large_figure_takes_little_room_and_reads_as_no_other(
    value: float | None, text: str
) -> None:
    assert compact(value) == text
    assert len(text) <= 11


def summary_of(gauge: str) -> list[str]:
    run = simulate(20.0, seed=1)
    engine = Engine({"gauge": gauge})
    samples = [
        PoseSamples(poses.stamps, *se3.to_position_quaternion(poses.poses))
        for poses in (run.ground_truth, run.estimate)
    ]
    for _ in feed(engine, *samples):
        pass
    summary = engine.summary()
    # As large as they come.
    for part in (summary["relative"], summary["absolute"]):
        assert isinstance(part, dict)
        part["chi2"] = 1.234567e14
        part["log_likelihood"] = -6.1e13
    parameters = complete({"gauge": gauge})
    return [*first_lines(summary, parameters), *summary_lines(summary, parameters)]


@pytest.mark.parametrize("gauge", ["se3", "sim3", "yaw_translation"])
def test_the_summary_fits_a_terminal_of_80_columns_and_names_each_row_once(gauge: str) -> None:
    lines = summary_of(gauge)
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("How good      ATE (")
    assert any(line.startswith("              over 100 % of 20 s, 100 % of ") for line in lines)
    names = [line.split("  ")[0] for line in lines if line.strip() and not line.startswith(" ")]
    assert len(set(names)) == len(names)
    assert ("Scale correction" in "\n".join(lines)) == (gauge == "sim3")
    assert not any(name.startswith(("RE, last", "AE")) for name in names)


def test_long_lines_are_wrapped_for_a_terminal_and_for_nothing_else() -> None:
    line = "Error         jitter 1.07 ± 0.17 mm, 0.0439 ± 0.0062 deg; wander " + 8 * "8.34 mm "
    pieces = console.wrapped([line, "", "short"], 14, 80)
    assert max(map(len, pieces)) <= 80
    assert pieces[0].startswith("Error         jitter")
    assert pieces[1].startswith(14 * " " + "8.34 mm")
    assert pieces[-2:] == ["", "short"]
    assert " ".join(" ".join(pieces).split()) == " ".join(f"{line} short".split())
    # A test's output is no terminal.
    assert console.wrapped([line], 14) == [line]
