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
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any, Protocol, Self

from trajeval_ros.commands.console import duration
from trajeval_ros.commands.figures import degrees, metres
from trajeval_ros.report.answers import leading
from trajeval_ros.report.covered import percent
from trajeval_ros.report.numbers import compact
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
    ``page``: where the figures are shown in a browser.
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
    page: str = ""
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

    def move(self, seconds: float) -> None:
        """The run began so much earlier than it seemed: what happened in it was so much later."""
        self.stamp = None if self.stamp is None else self.stamp + seconds
        moved = [replace(event, seconds=event.seconds + seconds) for event in self.events]
        self.events = deque(moved, maxlen=_MOST_EVENTS)

    def progress(self) -> float:
        """Share of the run that has been evaluated, 0 to 1."""
        if self.stamp is None or self.last <= self.first:
            return 0.0
        return min(max((self.stamp - self.first) / (self.last - self.first), 0.0), 1.0)

    def figure(self, status: str, *keys: str, of: str = "") -> float | None:
        """Return the first of the figures that is there and finite; ``of`` one of several."""
        figures = self.metrics.get(f"{of}: {status}" if of else status, {})
        found = (figures.get(key) for key in keys)
        numbers = (value for value in found if isinstance(value, float))
        return next((value for value in numbers if math.isfinite(value)), None)

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
        self._page = ""

    def show(self, state: State) -> None:
        """Print a line, if it is time to; an event at once."""
        now = time.monotonic()
        events = list(state.events)
        # By what it is: the log is bounded.
        known = [number for number, event in enumerate(events) if event is self._printed]
        for event in events[known[0] + 1 if known else 0 :]:
            print(event.line, flush=True)
            self._printed = event
        if state.page != self._page:
            self._page = state.page
            print(f"In a browser: {state.page}", flush=True)
        if state.phase != self._phase:
            self._phase = state.phase
            print(f"{state.phase} ...", flush=True)
            self._next = now + 2.0
        if now < self._next or state.stamp is None:
            return
        self._next = now + 2.0
        truth = state.health.get("ground truth")
        words = [f"{100 * state.progress():3.0f} %"]
        for name in state.names or ("",):
            found = [(title, _pair(state, status, key, name)) for title, status, key in _ERRORS]
            shown = [f"{title} {text}" for title, text in found if text]
            words.append((f"{name}: " if name else "") + ("  ".join(shown) or "nothing yet"))
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

_PARTS = ("translation", "rotation")
# Title, status, and key of each part: what is looked at first.
_ERRORS = (
    ("ATE", "conventional", "ate_{}_rmse"),
    ("RE", "conventional", "re_{}_rmse"),
    ("accuracy", "window", "absolute_noise_equivalent_{}_std"),
)
# How large the errors are beside what the ground truth is known to.
_IN_STD = (
    ("steps", "window", "relative_error_in_ground_truth_std"),
    ("aligned", "window", "absolute_error_in_ground_truth_std"),
)

TRENDS: tuple[tuple[str, str], ...] = (
    *((status, key.format("translation")) for _, status, key in _ERRORS),
    *((status, key) for _, status, key in _IN_STD),
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
    return Panel(
        Group(
            heading,
            Text(f"in a browser: {state.page}" if state.page else "", style="dim"),
            *_leading(state),
            "",
            table,
            "",
            *_health(state),
            *_log(state),
        ),
        title="trajeval_ros: evaluator, live",
        title_align="left",
        border_style="blue",
    )


def _leading(state: State) -> list[Any]:
    """The answer: which is better, how good, what kind of error, and whose fault."""
    from rich.table import Table
    from rich.text import Text

    lines = Table.grid(padding=(0, 1))
    lines.add_column(no_wrap=True)
    lines.add_column()
    for pair, text in state.sentences.items():
        said = f"{pair}: {text}" if len(state.sentences) > 1 else text
        lines.add_row(Text("Compared", style="bold"), said)
    for name in state.names or ("",):
        if name:
            said = "; ".join(text for title, text in state.answers.get(name, []) if "Kind" in title)
            lines.add_row(Text(name, style="bold"), said or "not known yet")
            continue
        lines.add_row(Text("How good", style="bold"), _how_good(state))
        for title, text in state.answers.get(name, []):
            lines.add_row(Text(title, style="bold"), text)
    return [lines]


def _how_good(state: State) -> str:
    """The errors and how much of the run they are of."""
    parts = []
    for title, status, key in _ERRORS[:2]:
        shown = _pair(state, status, key)
        parts += [f"{title} {shown}"] if shown else []
    share = state.figure("coverage", "time")
    whole = state.figure("coverage", "duration")
    if share is not None and whole is not None:
        parts.append(f"over {percent(share)} of {duration(whole)}")
    return "; ".join(parts) or "not known yet"


def _pair(state: State, status: str, key: str, of: str = "") -> str:
    """Translation and rotation, as far as they are there."""
    translation, rotation = (state.figure(status, key.format(part), of=of) for part in _PARTS)
    parts = [] if translation is None else [metres(translation)]
    parts += [] if rotation is None else [degrees(rotation)]
    return ", ".join(parts)


def _titles(state: State) -> list[str]:
    """What each of `_ERRORS` is over."""
    name = state.names[0] if state.names else ""
    step = state.figure("conventional", "re_delta", of=name)
    unit = state.metrics.get(f"{name}: conventional" if name else "conventional", {}).get("re_unit")
    window = state.figure("window", "duration", of=name)
    last = "window" if window is None else f"last {window:.0f} s"
    return [
        "ATE, whole run",
        "RE" if step is None else f"RE, over {step:g} {unit}",
        f"accuracy, {last}",
        f"truth's std, {last}",
    ]


def _beside(state: State) -> Any:
    """Several estimates side by side."""
    from rich.table import Table

    table = Table(expand=True, box=None, padding=(0, 1), header_style="dim")
    table.add_column("", no_wrap=True, min_width=21)
    for name in state.names:
        table.add_column(name, justify="right", min_width=11)
    titles = _titles(state)
    for title, (_, status, key) in zip(titles, _ERRORS, strict=False):
        for show, part in ((metres, _PARTS[0]), (degrees, _PARTS[1])):
            cells = (state.figure(status, key.format(part), of=name) for name in state.names)
            table.add_row(title, *map(show, cells))
            title = ""
    _, status, key = _IN_STD[0]
    cells = (state.figure(status, key, of=name) for name in state.names)
    table.add_row(titles[-1], *map(compact, cells))
    shares = (state.figure("coverage", "time", of=name) for name in state.names)
    table.add_row("coverage", *("-" if share is None else percent(share) for share in shares))
    return table


def _alone(state: State) -> Any:
    """One estimate, and how it went."""
    from rich.table import Table
    from rich.text import Text

    table = Table(expand=True, box=None, padding=(0, 1), header_style="dim")
    table.add_column("", no_wrap=True, min_width=21)
    table.add_column("translation", justify="right", no_wrap=True, min_width=11)
    table.add_column("rotation", justify="right", no_wrap=True, min_width=11)
    table.add_column("trend", no_wrap=True, ratio=1)

    def trend(status: str, key: str) -> Text:
        return Text(sparkline(list(state.trends.get(f"{status}/{key}", ())), 13), style="cyan")

    titles = _titles(state)
    for title, (_, status, key) in zip(titles, _ERRORS, strict=False):
        translation, rotation = (state.figure(status, key.format(part)) for part in _PARTS)
        cells = metres(translation), degrees(rotation)
        table.add_row(title, *cells, trend(status, key.format(_PARTS[0])))
    worth = [f"{name} {compact(state.figure(status, key))}" for name, status, key in _IN_STD]
    table.add_row(titles[-1], *worth, trend(*_IN_STD[0][1:]))
    return table


def _health(state: State) -> list[Any]:
    """What is not well, a line each, and the rest in one."""
    from rich.table import Table
    from rich.text import Text

    known = [*_HEALTH[:1], *state.names, *_HEALTH[1:]]
    order = [name for name in known if name in state.health]
    order += sorted(set(state.health) - set(known))
    lines = Table.grid(padding=(0, 1))
    lines.add_column(no_wrap=True)
    lines.add_column()
    well = [name for name in order if not state.health[name].level]
    for name in order:
        entry = state.health[name]
        if entry.level:
            level = Text(LEVELS.get(entry.level, "?"), style=_STYLES.get(entry.level, ""))
            lines.add_row(level, f"{name}: {entry.message}")
    if well:
        lines.add_row(Text(LEVELS[0], style=_STYLES[0]), ", ".join(well))
    return [lines]


def _log(state: State) -> list[Any]:
    """The latest events, which may be over before one has read them elsewhere."""
    from rich.text import Text

    latest = list(state.events)[-_EVENTS_SHOWN:]
    lines = [
        Text(event.line, style=_STYLES.get(event.level, ""), no_wrap=True, overflow="ellipsis")
        for event in latest
    ]
    return [Text(""), *lines] if lines else []


def make_view() -> View:
    """Return the view that suits the terminal."""
    if sys.stdout.isatty():
        try:
            return RichView()
        except ImportError:
            print("(python3 -m pip install rich gives a live view)")
    return PlainView()
