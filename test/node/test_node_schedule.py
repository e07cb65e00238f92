# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Periodic work, on a clock that the test turns."""

from __future__ import annotations

import pytest

from trajeval_ros.node import schedule


def test_each_in_its_period_and_nothing_made_up_for(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(schedule.time, "monotonic", lambda: now[0])
    calls: list[str] = []
    made = schedule.Schedule([(0.25, lambda: calls.append("a")), (1.0, lambda: calls.append("b"))])
    assert made.run() == 0.25
    assert calls == ["a", "b"]
    now[0] = 100.125
    assert made.run() == 0.125
    assert calls == ["a", "b"]
    for quarter in range(1, 5):
        now[0] = 100.0 + quarter / 4
        made.run()
    assert calls == ["a", "b", "a", "a", "a", "a", "b"]
    # A long batch: one call each, not the many that were missed.
    now[0] = 110.0
    made.run()
    made.run()
    assert calls[7:] in (["a", "b"], ["a", "b", "a", "b"])


def test_one_says_when_it_is_due_again(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(schedule.time, "monotonic", lambda: now[0])
    waits = iter([0.5, 0.125, None])
    made = schedule.Schedule([(0.25, lambda: next(waits))])
    for until, rest in ((0.0, 0.5), (0.5, 0.125), (0.625, 0.25)):
        now[0] = 100.0 + until
        assert made.run() == rest
