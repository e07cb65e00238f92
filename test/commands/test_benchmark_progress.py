# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Progress says rates and times that are right, also after what was done before."""

from __future__ import annotations

import io

import pytest

from trajeval_ros.commands import benchmark_progress
from trajeval_ros.commands.benchmark_progress import BenchmarkProgress, lines


def test_rates_and_time_left_are_of_what_was_done_since() -> None:
    shown = lines({"orb": 10}, {"orb": 30, "vins": 5}, {"orb": 50, "vins": 50}, 10.0)
    assert shown == [
        "evaluating: 35 of 100 runs (35 %), 2.5 runs/s, 26 s left",
        "  orb   30 of 50 runs (60 %), 2 runs/s, 10 s left",
        "  vins  5 of 50 runs (10 %), 0.5 runs/s, 1 min 30 s left",
    ]


def test_a_large_rate_is_a_plain_number() -> None:
    (shown,) = lines({}, {"orb": 1_300}, {"orb": 9_100}, 10.0)
    assert shown == "evaluating: 1,300 of 9,100 runs (14 %), 130 runs/s, 1 min 00 s left"


def test_nothing_is_foretold_of_what_has_not_begun_or_is_done() -> None:
    assert lines({}, {}, {"orb": 5}, 0.0) == ["evaluating: 0 of 5 runs (0 %)"]
    assert lines({}, {"orb": 5}, {"orb": 5}, 2.0) == ["evaluating: 5 of 5 runs (100 %)"]


def test_many_systems_are_counted() -> None:
    total = {f"s{k:02}": 1 for k in range(20)}
    shown = lines({}, {}, total, 1.0)
    assert len(shown) == 14
    assert shown[-1] == "  and 8 systems more"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        return 0


def test_on_a_terminal_it_is_drawn_anew_and_goes_away(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(benchmark_progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(benchmark_progress.os, "get_terminal_size", lambda _: _Size(columns=40))
    stream = Terminal()
    with BenchmarkProgress(stream) as progress:
        progress.update({"a": 0, "b": 0}, {"a": 9, "b": 9})
        assert stream.getvalue() == ""
        now[0] = 5.0
        progress.update({"a": 1, "b": 0}, {"a": 9, "b": 9})
        assert stream.getvalue().count("\n") == 3
        assert max(map(len, stream.getvalue().splitlines())) < 40
    assert stream.getvalue().endswith("\x1b[1A\x1b[2K" * 3)


class _Size:
    def __init__(self, columns: int) -> None:
        self.columns = columns
