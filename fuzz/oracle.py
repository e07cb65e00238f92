# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What must hold of every run of ``evaluate``, whatever it was given."""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
import signal
import traceback
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from trajeval_ros.commands import evaluate

SECONDS = 120
"""What a case may take."""

_PROGRESS = re.compile(r"(reading|evaluating): [\d,]+ of ")
_NO_NUMBER = re.compile(r"(?<![\w./])[+-]?(nan|inf|infinity)(?![\w./])", re.IGNORECASE)


class Failure(AssertionError):
    """What does not hold, in one line."""


def require(holds: bool, reason: str) -> None:
    """Raise :class:`Failure` unless it holds."""
    if not holds:
        raise Failure(reason)


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Turn a warning, an exception and a case without end into a failure."""

    def late(signum: int, frame: object) -> NoReturn:
        raise Failure(f"not done after {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            yield
    except Failure:
        raise
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        reason = f"{type(error).__name__} in {Path(frame.filename).name}:{frame.lineno}: {error}"
        raise Failure(" ".join(reason.split())) from error
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    for each in warned:
        where = f"{Path(each.filename).name}:{each.lineno}"
        raise Failure(f"{each.category.__name__} in {where}: {each.message}")


def evaluate_and_check(argv: Sequence[str], folder: Path) -> str:
    """Run ``evaluate`` in this process, its output in ``folder``; return what became of it.

    The arguments are left in the folder for whoever wants to repeat it by hand.

    Raises
    ------
    Failure
        If anything does not hold.
    """
    output = folder / "output"
    argv = [*argv, "--output", str(output)]
    (folder / "arguments.json").write_text(json.dumps(argv), encoding="utf-8")
    stdout, stderr = io.StringIO(), io.StringIO()
    with guarded(), contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
        try:
            code: object = evaluate.main(argv)
        except SystemExit as end:
            code = end.code
    said = [line for line in stderr.getvalue().splitlines() if not _PROGRESS.match(line)]
    require(code in (0, 1, 2), f"exit code {code!r}")
    require("Traceback" not in stderr.getvalue(), "a traceback")
    if code:
        _check_error(said, code == 2)
        return f"refused: {said[-1]}"
    require(not said, f"stderr with exit code 0: {said[:1]}")
    number = _NO_NUMBER.search(stdout.getvalue())
    require(number is None, f"{number and number[0]!r} among the figures")
    _check_output(output)
    return "evaluated"


def _check_error(said: list[str], usage: bool) -> None:
    """One line, under argparse's usage if it was wrong usage."""
    require(bool(said) and "error: " in said[-1], f"no error: {said[-1:]}")
    above = said[:-1]
    if usage and above and above[0].startswith("usage: "):
        above = [line for line in above[1:] if not line.startswith(" ")]
    require(not above, f"more than one line: {said[:2]}")


def _check_output(output: Path) -> None:
    def refuse(name: str) -> NoReturn:
        raise Failure(f"{name} in summary.json")

    text = (output / "summary.json").read_text(encoding="utf-8")
    summary = json.loads(text, parse_constant=refuse)
    check_accounts(summary)
    require(summary["ground_truth"]["pending"] == 0, "ground truth pending at the end")
    with (output / "poses.csv").open(encoding="utf-8") as file:
        rows = sum(1 for _ in file) - 1
    evaluated = summary["estimate"]["evaluated"]
    require(rows == evaluated, f"{rows} rows, {evaluated} evaluated")
    require((output / "report.html").stat().st_size > 0, "an empty report")
    _check_likelihood(summary["relative"])


def check_accounts(summary: Any) -> None:
    """Every message is in exactly one place of its account."""
    for topic, used in (("estimate", "evaluated"), ("ground_truth", "used")):
        account = summary[topic]
        found = account[used] + account["pending"] + sum(account["rejected"].values())
        require(found == account["received"], f"{topic}: {found} of {account['received']}")


def _check_likelihood(relative: Any) -> None:
    if relative["log_likelihood"] is None:
        return
    parts = (relative["chi2"], relative["log_det"], relative["dof"] * math.log(2 * math.pi))
    bound = 1e-9 * sum(map(abs, parts))
    error = abs(relative["log_likelihood"] + 0.5 * sum(parts))
    require(error <= bound, f"log-likelihood and its parts differ by {error:g}")
