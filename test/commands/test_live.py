# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live view, without a node."""

import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trajeval_ros.commands.live import TRENDS, Health, PlainView, State, render, sparkline


def running() -> State:
    state = State(first=100.0, last=180.0, phase="replaying 2x", stamp=120.0, messages=400)
    state.metrics = {
        "relative": {"log_likelihood": -298_122_999.0, "chi2_per_dof": 12.5},
        "window": {
            "duration": 30.0,
            "absolute_noise_equivalent_translation_std": 0.00785,
            "relative_error_in_ground_truth_std": 119.11139025,
        },
        "conventional": {
            "ate_translation_rmse": 0.0213,
            "ate_rotation_rmse": 0.01,
            "re_delta": 1.0,
            "re_unit": "s",
        },
        "coverage": {"time": 0.5, "duration": 30.0},
    }
    state.answers = {"": [("Kind of error", "jitter 1.07 ± 0.17 mm"), ("Not its fault", "none")]}
    state.take_health("ground truth", Health(1, "dropout of 2.5 s"))
    for value in range(50):
        for status, key in TRENDS:
            state.remember(f"{status}/{key}", float(value))
    return state


@example([0.0, 2.3e-308], 2)
@given(st.lists(st.floats(-1e12, 1e12), min_size=1, max_size=300), st.integers(1, 60))
def test_sparkline_spans_its_bars(values: list[float], width: int) -> None:
    line = sparkline(values, width)
    assert 1 <= len(line) <= width
    assert set(line) <= set("▁▂▃▄▅▆▇█")


def test_sparkline_rises() -> None:
    assert sparkline([float(value) for value in range(80)], 8) == "▁▂▃▄▅▆▇█"
    assert sparkline([], 8) == ""


def test_progress_is_a_share() -> None:
    assert running().progress() == pytest.approx(0.25)
    assert State(first=0.0, last=0.0, stamp=3.0).progress() == 0.0


def test_what_is_not_finite_has_no_trend() -> None:
    state = State(first=0.0, last=1.0)
    state.remember("a", float("nan"))
    state.remember("a", None)
    assert state.trends == {}


def test_plain_view_prints_the_figures(capsys: pytest.CaptureFixture[str]) -> None:
    view = PlainView()
    state = running()
    view.show(state)
    view._next = 0.0
    view.show(state)
    event, *lines = capsys.readouterr().out.splitlines()
    assert event == "  20.0 s  WARN  ground truth: dropout of 2.5 s"
    assert lines[0] == "replaying 2x ..."
    for text in (
        " 25 %",
        "ATE 0.0213 m, 0.573 deg",
        "accuracy 0.00785 m",
        "WARN: dropout of 2.5 s",
    ):
        assert text in lines[1]
    assert "nats" not in lines[1]


def test_screen_shows_figures_trends_and_health() -> None:
    rich_console = pytest.importorskip("rich.console")
    console = rich_console.Console(width=110, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(render(running()))
    text = console.export_text()
    for expected in ("replaying 2x", "0.0213 m", "WARN", "dropout of 2.5 s", "20 s of"):
        assert expected in text
    # The answer first, as in the report.
    lines = [line.strip("│ ") for line in text.splitlines()]
    answers = [line for line in lines if line.startswith(("How good", "Kind of", "Not its"))]
    assert answers == [
        "How good      ATE 0.0213 m, 0.573 deg; over 50 % of 30 s",
        "Kind of error jitter 1.07 ± 0.17 mm",
        "Not its fault none",
    ]
    assert lines.index(answers[-1]) < next(n for n, line in enumerate(lines) if "trend" in line)
    assert "▁" in text
    assert "█" in text


def test_an_event_is_logged_once_and_so_is_its_end() -> None:
    state = State(first=100.0, last=180.0)
    for stamp, level, message in (
        (101.0, 0, "20.0 messages/s"),
        (110.0, 1, "/ground_truth: no message for 5 s"),
        (111.0, 1, "/ground_truth: no message for 6 s"),
        (112.0, 0, "19.0 messages/s"),
        (113.0, 0, "20.0 messages/s"),
    ):
        state.stamp = stamp
        state.take_health("ground truth", Health(level, message))
    assert [(event.seconds, event.level) for event in state.events] == [(10.0, 1), (12.0, 0)]
    assert state.health["ground truth"].message == "20.0 messages/s"


@pytest.mark.parametrize("width", [80, 120])
def test_no_figure_is_cut_off(width: int) -> None:
    rich_console = pytest.importorskip("rich.console")
    state = running()
    state.metrics["window"]["absolute_error_in_ground_truth_std"] = 298_122_999.9
    state.metrics["conventional"]["re_translation_rmse"] = 123_456.789
    console = rich_console.Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(render(state))
    text = console.export_text()
    assert "…" not in text
    for figure in ("298.123 M", "123,457 m", "0.573 deg", "119.1", "dropout of 2.5 s"):
        assert figure in text
    # No nine-digit numbers.
    assert not re.search(r"\d{9}|\d{3},\d{3},\d{3}", text)
    assert max(map(len, text.splitlines())) <= width


def test_screen_before_anything_is_known() -> None:
    rich_console = pytest.importorskip("rich.console")
    console = rich_console.Console(width=80, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(render(State(first=0.0, last=10.0)))
    assert "starting the node" in console.export_text()


def several() -> State:
    state = State(first=100.0, last=180.0, stamp=120.0, messages=400, names=("vins", "orb"))
    for name, ate in (("vins", 0.0213), ("orb", 0.0312)):
        state.metrics[f"{name}: conventional"] = {"ate_translation_rmse": ate}
    state.sentences = {"vins vs orb": "vins's translation ATE is 32 % smaller"}
    return state


def test_several_stand_side_by_side(capsys: pytest.CaptureFixture[str]) -> None:
    view = PlainView()
    for _ in range(2):
        view._next = 0.0
        view.show(several())
    out = capsys.readouterr().out
    assert "vins: ATE 0.0213 m" in out
    assert "orb: ATE 0.0312 m" in out
    console = pytest.importorskip("rich.console", reason="needs rich")
    screen = console.Console(width=80, record=True)
    screen.print(render(several()))
    shown = screen.export_text()
    (row,) = [line for line in shown.splitlines() if "0.0213" in line]
    assert "0.0312" in row
    assert "vins's translation ATE is 32 % smaller" in shown
