# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live view of a run in the terminal, from what the node publishes."""

from __future__ import annotations

import math
import re
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, Self

from trajeval_ros.commands.console import duration
from trajeval_ros.commands.figures import compact, degrees, metres
from trajeval_ros.report.answers import leading
from trajeval_ros.runs.statuses import error_models_of

Figures = Mapping[str, float]

_MOST_EVENTS = 200
_EVENTS_SHOWN = 4

_BARS = "▁▂▃▄▅▆▇█"
LEVELS = {0: "OK", 1: "WARN", 2: "ERROR", 3: "STALE"}


@dataclass(frozen=True)
class Health:
    """One entry of ``/diagnostics``."""

    level: int
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Event:
    """Something that the health said, and when: seconds of the run."""

    seconds: float
    level: int
    text: str

    @property
    def line(self) -> str:
        """The event in one line."""
        return f"{self.seconds:6.1f} s  {LEVELS.get(self.level, '?'):5} {self.text}"


@dataclass
class State:
    """What is known of the run at this moment. Times are the data's, in seconds.

    ``names`` of the estimates, where there are several: statuses of each begin with its name.
    ``answers``: of each estimate (of one, under an empty name), what kind of error it is and what
    is not its fault, in sentences with their titles. ``sentences``: of each pair, how they compare.
    ``events``: what the health said and says no more, too; the latest.
    """

    first: float
    last: float
    phase: str = "starting the node"
    stamp: float | None = None
    metrics: dict[str, dict[str, float | str]] = field(default_factory=dict)
    health: dict[str, Health] = field(default_factory=dict)
    trends: dict[str, deque[float]] = field(default_factory=dict)
    messages: int = 0
    names: tuple[str, ...] = ()
    answers: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    sentences: dict[str, str] = field(default_factory=dict)
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=_MOST_EVENTS))
    _said: dict[str, tuple[int, str]] = field(default_factory=dict)

    def take_metrics(self, stamp: float, statuses: Mapping[str, Mapping[str, str]]) -> None:
        """Take in a message of ``~/metrics``: the values of each status, under a stamp (s)."""
        self.messages += 1
        self.stamp = stamp
        for name, values in statuses.items():
            figures = {key: _read(value) for key, value in values.items()}
            owner, _, status = name.rpartition(": ")
            if status == "error_model":
                self.answers[owner] = _answer(figures)
            self.metrics[name] = figures

    def take_health(self, name: str, health: Health) -> None:
        """Keep what one entry of ``/diagnostics`` says, and log it where it is news.

        A count or a duration that goes on is none.
        """
        self.health[name] = health
        said = (health.level, re.sub(r"[\d.,]+", "#", health.message) if health.level else "")
        before = self._said.get(name, (0, ""))
        self._said[name] = said
        if said == before:
            return
        seconds = 0.0 if self.stamp is None else max(self.stamp - self.first, 0.0)
        text = f"{name}: {health.message}" if health.level else f"{name}: well again"
        self.events.append(Event(seconds, health.level, text))

    def progress(self) -> float:
        """Share of the run that has been evaluated, 0 to 1."""
        if self.stamp is None or self.last <= self.first:
            return 0.0
        return min(max((self.stamp - self.first) / (self.last - self.first), 0.0), 1.0)

    def figure(self, status: str, *keys: str, of: str = "") -> float | None:
        """Return the first of the figures that is there; ``of`` one of several estimates."""
        figures = self.metrics.get(f"{of}: {status}" if of else status, {})
        found = (figures.get(key) for key in keys)
        return next((value for value in found if isinstance(value, float)), None)

    def remember(self, name: str, value: float | None) -> None:
        """Append to a trend."""
        if value is not None and math.isfinite(value):
            self.trends.setdefault(name, deque(maxlen=2048)).append(value)


def _read(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _answer(figures: Mapping[str, float | str]) -> list[tuple[str, str]]:
    """The error model in sentences: the run's, or, while there is none yet, the window's."""
    models = error_models_of(figures)
    model = models.get("run") or models.get("window")
    if model is None:
        return []
    since = "" if "run" in models else ", window"
    return [(f"{title}{since}", text.replace("\n", " ")) for title, text in leading(model)]


def sparkline(values: Sequence[float], width: int) -> str:
    """Return the values as a row of bars, from the smallest to the largest of them."""
    if not values:
        return ""
    count = min(width, len(values))
    # From the first to the last of them.
    step = (len(values) - 1) / max(count - 1, 1)
    shown = [values[round(index * step)] for index in range(count)]
    shown[-1] = values[-1]
    low, high = min(shown), max(shown)
    # A share of the range, and not the range's reciprocal, which a tiny range makes infinite.
    shares = [(value - low) / (high - low) if high > low else 0.0 for value in shown]
    return "".join(_BARS[round(share * (len(_BARS) - 1))] for share in shares)


class View(Protocol):
    """Shows the state now and then."""

    def show(self, state: State) -> None:
        """Show the state, if it is time to."""

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End."""


class PlainView:
    """A line every two seconds: for logs, and where rich is not installed."""

    def __init__(self) -> None:
        self._next = 0.0
        self._phase = ""
        self._printed: Event | None = None

    def show(self, state: State) -> None:
        """Print a line, if it is time to; an event at once."""
        now = time.monotonic()
        events = list(state.events)
        # By what it is: the log is bounded.
        known = [number for number, event in enumerate(events) if event is self._printed]
        for event in events[known[0] + 1 if known else 0 :]:
            print(event.line, flush=True)
            self._printed = event
        if state.phase != self._phase:
            self._phase = state.phase
            print(f"{state.phase} ...", flush=True)
            self._next = now + 2.0
        if now < self._next or state.stamp is None:
            return
        self._next = now + 2.0
        truth = state.health.get("ground truth")
        words = [
            f"{100 * state.progress():3.0f} %",
            f"ATE {metres(state.figure('conventional', 'ate_translation_rmse'))}",
            f"relative {compact(state.figure('relative', 'log_likelihood'))} nats",
            f"chi2/dof {compact(state.figure('relative', 'chi2_per_dof'))}",
            f"absolute {compact(state.figure('absolute', 'log_likelihood'))} nats",
        ]
        if state.names:
            words = [words[0]]
            for name in state.names:
                ate = state.figure("conventional", "ate_translation_rmse", of=name)
                step = state.figure("conventional", "re_translation_rmse", of=name)
                words.append(f"{name}: ATE {metres(ate)}, RE {metres(step)}")
        if truth is not None:
            words.append(f"ground truth {LEVELS.get(truth.level, '?')}: {truth.message}")
        print("  ".join(words), flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        return None


class RichView:
    """One screen that is drawn anew eight times a second."""

    def __init__(self) -> None:
        from rich.live import Live

        self._live = Live(refresh_per_second=8, transient=True)
        self._next = 0.0

    def show(self, state: State) -> None:
        """Draw, if it is time to."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + 0.125
        self._live.update(render(state))

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._live.stop()


_HEALTH = ("ground truth", "estimate", "synchronization", "consistency", "performance", "clock")

_STYLES = {0: "green", 1: "yellow", 2: "bold red", 3: "magenta"}

_Where = tuple[str, str]
# Title, unit, where the figures of the whole run and of the window are.
_ROWS: tuple[tuple[str, Any, _Where | None, _Where | None], ...] = (
    ("ATE, translation", metres, ("conventional", "ate_translation_rmse"), None),
    ("ATE, rotation", degrees, ("conventional", "ate_rotation_rmse"), None),
    ("RE, translation", metres, ("conventional", "re_translation_rmse"), None),
    ("RE, rotation", degrees, ("conventional", "re_rotation_rmse"), None),
    (
        "noise-equivalent, m",
        metres,
        None,
        ("window", "absolute_noise_equivalent_translation_std"),
    ),
    (
        "noise-equivalent, deg",
        degrees,
        None,
        ("window", "absolute_noise_equivalent_rotation_std"),
    ),
    (
        "relative, nats",
        compact,
        ("relative", "log_likelihood"),
        ("window", "relative_log_likelihood"),
    ),
    (
        "relative chi2/dof",
        compact,
        ("relative", "chi2_per_dof"),
        ("window", "relative_chi2_per_dof"),
    ),
    (
        "absolute, nats",
        compact,
        ("absolute", "log_likelihood"),
        ("window", "absolute_log_likelihood"),
    ),
    (
        "absolute chi2/dof",
        compact,
        ("absolute", "chi2_per_dof"),
        ("window", "absolute_chi2_per_dof"),
    ),
)

TRENDS: tuple[tuple[str, str], ...] = tuple(
    where for _, _, running, windowed in _ROWS for where in (running, windowed) if where is not None
)
"""The figures whose trend is kept: status and key."""


def render(state: State) -> Any:
    """Return the screen."""
    from rich.console import Group
    from rich.panel import Panel
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    heading = Table.grid(expand=True, padding=(0, 1))
    heading.add_column(no_wrap=True)
    heading.add_column(ratio=1)
    heading.add_column(justify="right", no_wrap=True)
    done = state.progress()
    length = state.last - state.first
    heading.add_row(
        Text(state.phase, style="bold"),
        # Of one colour, whatever happens: a run that is over is no failure.
        ProgressBar(total=1.0, completed=done, complete_style="cyan", finished_style="green"),
        f"{duration(done * length)} of {duration(length)}",
    )

    table = _beside(state) if state.names else _alone(state)

    health = Table.grid(padding=(0, 1))
    health.add_column(no_wrap=True)
    health.add_column(no_wrap=True)
    health.add_column()
    known = [*_HEALTH[:1], *state.names, *_HEALTH[1:]]
    order = [name for name in known if name in state.health]
    order += sorted(set(state.health) - set(known))
    for name in order:
        entry = state.health[name]
        level = LEVELS.get(entry.level, "?")
        health.add_row(Text(level, style=_STYLES.get(entry.level, "")), name, entry.message)
    compared = [Text(text) for text in state.sentences.values()]
    return Panel(
        Group(heading, "", table, "", *compared, *[""][: len(compared)], health, *_log(state)),
        title="trajeval_ros: evaluator, live",
        title_align="left",
        border_style="blue",
    )


def _beside(state: State) -> Any:
    """Several estimates side by side, the whole run."""
    from rich.table import Table

    table = Table(expand=True, box=None, padding=(0, 1), header_style="dim")
    table.add_column("whole run", no_wrap=True, min_width=21)
    for name in state.names:
        table.add_column(name, justify="right", min_width=11)
    for title, show, running, _ in _ROWS:
        if running:
            shown = (show(state.figure(*running, of=name)) for name in state.names)
            table.add_row(title, *shown)
    after = [state.figure("latest_path", "ate_translation_rmse", of=n) for n in state.names]
    if any(value is not None for value in after):
        table.add_row("ATE, latest path", *map(metres, after))
    shares = [state.figure("coverage", "time", of=name) for name in state.names]
    table.add_row("coverage, time", *("-" if s is None else f"{100 * s:.1f} %" for s in shares))
    return table


def _alone(state: State) -> Any:
    """One estimate: the whole run, the window, and how it went."""
    from rich.table import Table
    from rich.text import Text

    table = Table(expand=True, box=None, padding=(0, 1), header_style="dim")
    table.add_column("", no_wrap=True, min_width=21)
    table.add_column("whole run", justify="right", no_wrap=True, min_width=11)
    table.add_column("window", justify="right", no_wrap=True, min_width=11)
    table.add_column("trend", no_wrap=True, ratio=1)
    for title, show, running, windowed in _ROWS:
        trend = next(
            (
                state.trends[key]
                for key in ("/".join(where) for where in (windowed, running) if where)
                if state.trends.get(key)
            ),
            (),
        )
        table.add_row(
            title,
            show(state.figure(*running)) if running else "",
            show(state.figure(*windowed)) if windowed else "",
            Text(sparkline(list(trend), 24), style="cyan"),
        )
    after = state.figure("latest_path", "ate_translation_rmse")
    if after is not None:
        table.add_row("ATE, latest path", metres(after), "", "")
    share = state.figure("coverage", "time")
    table.add_row("coverage, time", "-" if share is None else f"{100 * share:.1f} %", "", "")
    return table


def _log(state: State) -> list[Any]:
    """The latest events, which may be over before one has read them elsewhere."""
    from rich.text import Text

    latest = list(state.events)[-_EVENTS_SHOWN:]
    lines = [
        Text(event.line, style=_STYLES.get(event.level, ""), no_wrap=True, overflow="ellipsis")
        for event in latest
    ]
    return [Text(""), Text("events", style="dim"), *lines] if lines else []


def make_view() -> View:
    """Return the view that suits the terminal."""
    if sys.stdout.isatty():
        try:
            return RichView()
        except ImportError:
            print("(python3 -m pip install rich gives a live view)")
    return PlainView()
