# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""``demo``: the node and a player as real processes over DDS, watched in the terminal."""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import sys
import time
import webbrowser
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from trajeval_ros.commands import completion, console, inputs
from trajeval_ros.commands.domain import own_domain
from trajeval_ros.commands.processes import Child

DESCRIPTION = """\
Show a live evaluation: starts the node evaluator and a player that publishes ground truth and
estimate over DDS, shows the running figures, and ends by itself. Without files, on a simulated
flight, with two estimates of which one is better."""

# The replay is to take about this long, so that all is over within a minute.
_REPLAY_SECONDS = 38.0
_FASTEST = 10.0
_SIMULATED_SECONDS = 80.0

_READY_PATIENCE = 30.0
# On a busy machine; both end as soon as all is there. A second Ctrl-C does not wait.
_SETTLE_PATIENCE = 30.0
_SHUTDOWN_PATIENCE = 60.0

_interruptions: list[int] = []


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="demo",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    console.add_version(parser)
    parser.add_argument("--ground-truth", metavar="FILE", help="a TUM file")
    parser.add_argument(
        "--estimate", metavar="FILE", action="append", help="a TUM file; may be repeated"
    )
    parser.add_argument(
        "--rate",
        type=console.number(0.1, 100.0),
        metavar="R",
        help=f"times the recorded speed (default: so that it takes {_REPLAY_SECONDS:g} s, at most"
        f" {_FASTEST:g})",
    )
    parser.add_argument(
        "--no-browser",
        action="store_true",
        help="do not open the page of the running figures; its address is said all the same",
    )
    parser.add_argument(
        "--output", default="output/demo", metavar="DIR", help="default: output/demo"
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = make_parser()
    completion.complete(parser)
    arguments = parser.parse_args(argv)
    if (arguments.ground_truth is None) != (arguments.estimate is None):
        parser.error("give both --ground-truth and --estimate, or neither")
    # `make` and service managers send SIGTERM, a terminal that is closed SIGHUP (not under nohup);
    # the children end with us either way.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _note)
    signal.signal(signal.SIGTERM, _interrupt)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, _interrupt)
    return console.run(lambda: _told(arguments), "demo")


def _told(arguments: argparse.Namespace) -> int:
    """The demo; rclpy may make another error of an interruption while it takes a message."""
    try:
        return demo(arguments)
    except RuntimeError as error:
        if _interruptions:
            raise KeyboardInterrupt from error
        raise


def _interrupt(signum: int, frame: FrameType | None) -> Any:
    # A second one must not disturb the children's end: shell and kernel both send SIGHUP.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    _note(signum, frame)


def _note(signum: int, frame: FrameType | None) -> Any:
    _interruptions.append(signum)
    raise KeyboardInterrupt


def demo(arguments: argparse.Namespace) -> int:
    """Start, watch, end, check."""
    output = Path(arguments.output).absolute()
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise console.CommandError(f"cannot write {output}: {error.strerror}") from error
    files = _files(arguments, output)
    data = inputs.read(
        argparse.Namespace(
            format="tum", ground_truth=files[0], estimate=files[1:], times=None, strict=False
        )
    )
    for estimate in data.estimates:
        inputs.check_overlap(data.ground_truth, estimate, 0.0)
    first = min(int(each.stamps.min()) for each in (data.ground_truth, *data.estimates))
    last = max(int(each.stamps.max()) for each in (data.ground_truth, *data.estimates))
    seconds = (last - first) / inputs.SECOND
    rate = arguments.rate or min(max(seconds / _REPLAY_SECONDS, 1.0), _FASTEST)

    # A domain of our own on this machine: a demo hears no other robot, and no robot hears it.
    with own_domain() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        return _run(data, output, rate, files, _Page(output, opens=not arguments.no_browser))


def _files(arguments: argparse.Namespace, output: Path) -> list[str]:
    """The ground truth and the estimates."""
    if arguments.ground_truth is not None:
        return [arguments.ground_truth, *arguments.estimate]
    from trajeval_ros.commands.simulate import write_two

    print(
        f"Simulating {_SIMULATED_SECONDS:g} s of flight, and two estimates: one drifts ...",
        flush=True,
    )
    return [str(path) for path in write_two(output, _SIMULATED_SECONDS, 1)]


def _run(data: inputs.Inputs, output: Path, rate: float, files: Sequence[str], page: _Page) -> int:
    from trajeval_ros.commands import live

    try:
        from trajeval_ros.commands.monitor import Monitor
    except ImportError as error:
        raise console.CommandError(
            f"the demo needs ROS 2 ({error}); source it, or: python3 -m pip install"
            " 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces"
        ) from error

    several = len(data.names) > 1
    state = live.State(
        first=min(each.stamps.min() for each in data.estimates) / 1e9,
        last=max(each.stamps.max() for each in data.estimates) / 1e9,
        names=data.names if several else (),
    )
    # What an earlier demo has left.
    for folder in (output, *(output / name for name in data.names)):
        for name in ("summary.json", "poses.csv", "report.html"):
            (folder / name).unlink(missing_ok=True)
    node_arguments = ["--ros-args", "-p", "use_sim_time:=true", "-p", f"output.directory:={output}"]
    node_arguments += ["-p", f"estimates:=[{', '.join(data.names)}]"]
    player_arguments = ["tum", *files, "--rate", repr(rate), "--wait", str(_READY_PATIENCE)]
    with (
        page,
        Monitor(state) as monitor,
        Child(
            "trajeval_ros.node.main", node_arguments, output / "evaluator.log", _SHUTDOWN_PATIENCE
        ) as node,
        live.make_view() as view,
    ):
        state.phase = "starting"
        _wait(monitor, view, state, node, page)
        log = output / "replay.log"
        with Child("trajeval_ros.commands.replay", player_arguments, log) as player:
            _watch(monitor, view, state, node, player, rate, page)
        published = _published(player, data.names)
        _settle(monitor, view, state, node, published)
        state.phase = "writing the results"
        code = node.interrupt(_SHUTDOWN_PATIENCE)
    if code != 0:
        raise console.CommandError(f"the node ended with exit code {code}: {node.last_words()}")
    if state.events:
        print("Events, by the time of the run")
        console.say([*(event.line for event in state.events), ""], indent=16)
    return _conclude(output, published, rate)


class _Page:
    """``watch`` beside the demo, where its library is there; a page that fails is no matter."""

    def __init__(self, output: Path, *, opens: bool) -> None:
        self._log = output / "watch.log"
        self._child: Child | None = None
        self._opens = opens and _has_screen()

    @property
    def is_alive(self) -> bool:
        """Whether there is a page, or may be one yet."""
        return self._child is not None and self._child.exit_code() is None

    def offer(self, state: Any) -> None:
        """Say the address once it is there, and open it where there is a screen."""
        if self._child is None or state.page:
            return
        found = re.search(r" at (http://\S+)", self._log.read_text(encoding="utf-8"))
        if found is not None:
            state.page = found[1]
            if self._opens:
                webbrowser.open(state.page)

    def __enter__(self) -> Self:
        if find_spec("aiohttp") is not None:
            self._child = Child("trajeval_ros.commands.watch", ["--port", "0"], self._log)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._child is not None:
            self._child.__exit__(kind, error, traceback)


def _has_screen() -> bool:
    """Whether somebody sits before a screen that a browser would be on."""
    if not sys.stdout.isatty() or "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform == "darwin" or bool({"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ))


def _wait(monitor: Any, view: Any, state: Any, node: Child, page: _Page) -> None:
    """Wait until the node is heard and the page is there, or as long as discovery may take."""

    def is_ready() -> bool:
        return monitor.is_connected and bool(state.page or not page.is_alive)

    deadline = time.monotonic() + _READY_PATIENCE
    while not is_ready() and time.monotonic() < deadline:
        monitor.listen(0.05)
        page.offer(state)
        view.show(state)
        _check_alive(node)


def _watch(
    monitor: Any, view: Any, state: Any, node: Child, player: Child, rate: float, page: _Page
) -> None:
    """Show the run until the player is done."""
    while player.exit_code() is None:
        monitor.listen(0.05)
        page.offer(state)
        state.phase = f"replaying {rate:.3g}x" if state.messages else "starting"
        view.show(state)
        _check_alive(node)
    if player.exit_code() != 0:
        raise console.CommandError(f"the player failed: {player.last_words()}")


def _settle(monitor: Any, view: Any, state: Any, node: Child, published: Mapping[str, int]) -> None:
    """Wait until the node's health has counted what was acknowledged, that is, in its queue."""

    def is_all_there() -> bool:
        known = {name.replace(" ", "_"): health for name, health in state.health.items()}
        return all(
            topic in known and int(known[topic].values.get("received", 0)) >= count
            for topic, count in published.items()
        )

    state.phase = "finishing"
    deadline = time.monotonic() + _SETTLE_PATIENCE
    while not is_all_there() and time.monotonic() < deadline:
        monitor.listen(0.05)
        view.show(state)
        _check_alive(node)


def _check_alive(node: Child) -> None:
    code = node.exit_code()
    if code is not None:
        raise console.CommandError(f"the node ended with exit code {code}: {node.last_words()}")


def _published(player: Child, names: Sequence[str]) -> dict[str, int]:
    topics = ("ground_truth", *names)
    counts = ", ".join(rf"{topic} (\d+)" for topic in topics)
    match = re.search(f"published {counts}", player.log.read_text(encoding="utf-8"))
    if match is None:
        raise console.CommandError(f"the player did not say what it sent: {player.last_words()}")
    return dict(zip(topics, map(int, match.groups()), strict=True))


def _conclude(output: Path, published: dict[str, int], rate: float) -> int:
    """Print the summary; check that every message that was sent was received."""
    from trajeval_ros.commands import figures
    from trajeval_ros.comparison.compare import read
    from trajeval_ros.comparison.words import sentence
    from trajeval_ros.online.parameters import complete
    from trajeval_ros.report import answers

    path = output / "summary.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise console.CommandError(f"the node has not written {path}") from error
    received = {"ground_truth": summary["ground_truth"]["received"]}
    estimates = summary.get("estimates")
    if estimates is None:
        received["estimate"] = summary["estimate"]["received"]
        parameters = complete({})
        lines = answers.first_lines(summary, parameters)
        console.say([*lines, "", *figures.summary_lines(summary, parameters)], indent=14)
    else:
        received |= {name: one["estimate"]["received"] for name, one in estimates.items()}
        print("\n".join(figures.side_by_side(estimates)) + "\n")
        console.say(f"{sentence(read(pair))}." for pair in summary["comparison"])
    lost = {
        topic: count - received[topic]
        for topic, count in published.items()
        if count != received[topic]
    }
    total = sum(published.values())
    print()
    if lost:
        counts = ", ".join(f"{count:,} of {topic}" for topic, count in lost.items())
        raise console.CommandError(f"of {total:,} messages at {rate:.3g}x, lost: {counts}")
    print(f"Published {total:,} messages at {rate:.3g}x over DDS, received {total:,}: none lost.")
    print(f"Report: {output / 'report.html'}")
    return console.DONE


if __name__ == "__main__":
    sys.exit(main())
