# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``watch``: a real node, real publishers, the real process, HTTP clients and a browser."""

import json
import math
import os
import re
import signal
import socket
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from browser import Browser, get, whole
from chromium import chromium

from trajeval_ros.commands import watch
from trajeval_ros.commands.simulate import write_files
from trajeval_ros.report.words import angle, length

pytest.importorskip("aiohttp", reason="aiohttp is not installed")
pytest.importorskip("rclpy", reason="needs ROS 2")

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from node.data import run
from node.harness import Graph, Process, save_samples, values_of

pytestmark = pytest.mark.ros

AXE = "TRAJEVAL_AXE"
"""Names the file axe.min.js of axe-core, as for the tests of the report."""


@pytest.fixture
def graph(domain: int, tmp_path: Path) -> Iterator[Graph]:
    made = Graph(domain, tmp_path)
    yield made
    made.close()


class Watch:
    """The process, and what it answers."""

    def __init__(self, graph: Graph, *arguments: str) -> None:
        self.process: Process = graph.start(
            "-m", "trajeval_ros.commands.watch", "--port", "0", *arguments
        )
        said = graph.until(
            lambda: re.search(r" at http://127\.0\.0\.1:(\d+)/\n", self.process.output),
            "the address",
        )
        self.port = int(said[1])

    @property
    def message(self) -> dict[str, Any]:
        status, body, _ = get(self.port, "/state.json")
        assert status == 200
        return json.loads(body)

    @property
    def sections(self) -> dict[str, Any]:
        return self.message["sections"]

    def is_said(self, state: str, words: str = "") -> bool:
        connection = self.sections["connection"]
        return connection["state"] == state and words in connection["text"]


def play(graph: Graph, folder: Path) -> tuple[int, Process]:
    """Publish a short run in a process of its own; return how many estimates there are."""
    paths = [folder / "ground_truth.npz", folder / "estimate.npz"]
    samples = run()
    for path, each in zip(paths, samples, strict=True):
        save_samples(path, each)
    player = Path(__file__).parents[2] / "node" / "player.py"
    return len(samples[1]), graph.start(str(player), *map(str, paths), "600")


def topics_figures(message: Any) -> dict[str, dict[str, Any]]:
    """What a message of ``~/metrics`` says, numbers as numbers."""

    def value(text: str) -> float | str:
        try:
            return float(text)
        except ValueError:
            return text

    return {
        status.name: {each.key: value(each.value) for each in status.values}
        for status in message.status
    }


def until_shown(graph: Graph, page: Watch, metrics: list[Any]) -> dict[str, Any]:
    """Wait until the page has the figures of the topic's last message; return the sections."""

    def there() -> dict[str, Any] | None:
        graph.spin()
        sections = page.sections
        shown = sections.get("estimate/estimate", {}).get("figures")
        return sections if metrics and shown == topics_figures(metrics[-1]) else None

    return graph.until(there, "the topic's figures on the page")


def until_met(graph: Graph, page: Watch, node: str = "/evaluator", run: int = 0) -> None:
    """Wait until the node, of this run on the page, knows of all that page and test listen to.

    The page's reader of the health is the one that was made last.
    """

    def met() -> bool:
        message = page.message
        return message["run"] >= run and bool(message["sections"]["health"]["now"])

    graph.until(met, "the node's health on the page")
    graph.until_known(node.removeprefix("/"))


def whole_rows(message: Any) -> list[Any]:
    """The errors' rows in which no column is missing."""
    curves = whole(message)[2].get("errors/estimate", {"rows": []})
    return [row for row in curves["rows"] if None not in row]


def test_every_browser_shows_the_topics_figures(graph: Graph, tmp_path: Path) -> None:
    page = Watch(graph)
    assert page.is_said("waiting", "waiting for /evaluator")
    browsers = [Browser(page.port) for _ in range(10)]
    sleeper = socket.create_connection(("127.0.0.1", page.port))
    sleeper.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    metrics = graph.listen(DiagnosticArray, "/evaluator/metrics")
    vectors = graph.listen(Vector3Stamped, "/evaluator/absolute/translation_error")
    evaluator = graph.start_evaluator()
    until_met(graph, page)
    graph.until(lambda: page.is_said("waiting", "nothing is evaluated yet"), "the node, waiting")
    count, _ = play(graph, tmp_path)
    graph.until_accounted("estimate", count)
    sections = until_shown(graph, page, metrics)
    graph.until(lambda: page.is_said("live"), "life")
    # One subscription serves all; and it publishes nothing.
    assert graph.node.count_subscribers("/evaluator/metrics") == 2
    (name,) = [n for n in graph.node.get_node_names() if n.startswith("watch_")]
    published = graph.node.get_publisher_names_and_types_by_node(name, "/")
    assert {topic for topic, _ in published} <= {"/parameter_events"}
    services = graph.node.get_service_names_and_types_by_node(name, "/")
    assert services == []
    # In words, as the report has them.
    figures = sections["estimate/estimate"]["figures"]
    tiles = {tile["title"]: tile for tile in sections["estimate/estimate"]["tiles"]}
    conventional = figures["conventional"]
    assert tiles["ATE"]["value"] == length(conventional["ate_translation_rmse"])
    assert tiles["ATE"]["remark"].startswith(angle(conventional["ate_rotation_rmse"]))
    # What a burst has no room for comes, too.
    nearly_all = 0.9 * count
    graph.until(lambda: len(vectors) > nearly_all, "an error an estimate")

    graph.until(lambda: len(whole_rows(page.message)) > nearly_all, "a row an estimate")
    # Every browser has what a new one is told.
    message = page.message
    expected = whole(message)
    graph.until(
        lambda: all(each.known.sequence >= message["sequence"] for each in browsers),
        "ten browsers",
    )
    graph.until(
        lambda: all(
            each.known.sections["estimate/estimate"] == page.sections["estimate/estimate"]
            for each in browsers
        ),
        "the same in ten browsers",
    )
    errors = expected[2]["errors/estimate"]
    assert errors["columns"][1:3] == ["translation_error", "rotation_error"]
    start = expected[1]["run"]["start"]
    sent = {
        round(each.header.stamp.sec + each.header.stamp.nanosec * 1e-9 - start, 3): math.hypot(
            each.vector.x, each.vector.y, each.vector.z
        )
        for each in vectors
    }
    both = [(row[1], sent[row[0]]) for row in errors["rows"] if row[0] in sent and row[1]]
    assert len(both) > nearly_all
    assert all(shown == pytest.approx(published, rel=1e-5) for shown, published in both)
    graph.until(
        lambda: len(page.sections["path/estimate"]["seconds"]) >= len(errors["rows"]) - 1,
        "the whole path",
    )
    with chromium() as browser:
        show_in_a_browser(browser, graph, page)
    # The one that never took anything is no matter at the end either.
    assert page.process.end() == 0
    assert evaluator.end() == 0
    graph.until(lambda: all(each.ended for each in browsers), "the end of ten browsers")
    sleeper.close()


def is_as_wide_as(tab: Any, width: int) -> bool:
    return bool(tab.evaluate("document.documentElement.scrollWidth") <= width)


def show_in_a_browser(browser: Any, graph: Graph, page: Watch) -> None:
    session = browser.new_context(viewport={"width": 1200, "height": 900})
    tab = session.new_page()
    said: list[str] = []
    tab.on("console", lambda message: message.type == "error" and said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.goto(f"http://127.0.0.1:{page.port}/")
    tab.wait_for_selector("#chart-translation canvas")
    assert tab.inner_text("#connection") == "live"
    tiles = page.sections["estimate/estimate"]["tiles"]
    shown = tab.locator(".tile").all()
    assert [each.locator("b").inner_text() for each in shown] == [t["value"] for t in tiles]
    tab.click("summary")
    figures = page.sections["estimate/estimate"]["figures"]
    table = "[...document.querySelectorAll('#figures tr')].map(row => "
    table += "[...row.cells].map(cell => cell.textContent))"
    cells = dict(graph.until(lambda: tab.evaluate(table), "every figure"))
    assert float(cells["ate_translation_rmse"]) == figures["conventional"]["ate_translation_rmse"]
    # The cursor on a chart is the cursor on all.
    tab.hover("#chart-translation .over", position={"x": 200, "y": 60})
    assert "m" in tab.inner_text("#chart-translation .entry b")
    assert re.search(r"[\d.]+ s", tab.inner_text("#bar output"))
    for width in (1200, 400):
        tab.set_viewport_size({"width": width, "height": 800})
        graph.until(partial(is_as_wide_as, tab, width), f"a page {width} px wide")
    # Printed, every figure is vectors: an error there is one on the console.
    assert tab.pdf().startswith(b"%PDF")
    if os.environ.get(AXE):
        for scheme in ("light", "dark"):
            tab.emulate_media(color_scheme=scheme)
            tab.evaluate(Path(os.environ[AXE]).read_text(encoding="utf-8"))
            found = tab.evaluate("axe.run()")["violations"]
            serious = [each for each in found if each["impact"] in ("serious", "critical")]
            assert [(each["id"], each["nodes"][0]["html"]) for each in serious] == []
    # A page that is hidden is not connected; one that is seen again knows all.
    rows = "page.state.curves['errors/estimate']?.rows.length ?? 0"
    before = tab.evaluate(rows)
    assert before > 0
    tab.evaluate("leave(); page.state.curves = {}; listen();")
    graph.until(lambda: tab.evaluate(rows) >= before, "all of it again")
    assert said == []
    session.close()


@pytest.mark.slow
def test_a_node_that_ends_and_comes_back_is_said(graph: Graph, tmp_path: Path) -> None:
    page = Watch(graph)
    first = graph.start_evaluator()
    until_met(graph, page)
    count, _ = play(graph, tmp_path)
    graph.until_accounted("estimate", count)
    graph.until(lambda: whole_rows(page.message), "curves")
    assert first.end() == 0
    graph.until(lambda: page.is_said("ended", "/evaluator has ended"), "its end")
    # What was there stays to be looked at.
    assert whole_rows(page.message)
    assert page.message["run"] == 0
    graph.received["/diagnostics"].clear()
    metrics = graph.listen(DiagnosticArray, "/evaluator/metrics")
    graph.start_evaluator()
    until_met(graph, page, run=1)
    count, _ = play(graph, tmp_path)
    graph.until_accounted("estimate", count)
    until_shown(graph, page, metrics)
    message = page.message
    assert message["sections"]["run"]["number"] == 1
    assert len(message["curves"]["errors/estimate"]["rows"]) <= count
    # A reset begins a run, too.
    graph.call("/evaluator/reset")
    graph.until(lambda: page.message["run"] == 2, "a run after the reset")
    assert page.process.end(signal.SIGTERM) == 0


def test_a_player_that_leaves_is_a_warning_unless_it_had_sent_all(
    graph: Graph, tmp_path: Path
) -> None:
    page = Watch(graph)
    graph.start_evaluator()
    until_met(graph, page)
    files = [str(path) for path in write_files(tmp_path / "run", 6.0, 3)]
    replay = ("-m", "trajeval_ros.commands.replay", *files, "--no-clock")

    def is_said(level: str, words: str) -> bool:
        now = {each["name"]: each for each in page.sections["health"]["now"]}
        said = [now.get(name, {"level": "", "text": ""}) for name in ("estimate", "ground truth")]
        return all(each["level"] == level and words in each["text"] for each in said)

    # Long enough to meet the page, too: of that it does not wait, nor do we learn of it.
    player = graph.start(*replay, "--rate", "2")
    graph.until(lambda: "all acknowledged" in player.output, "the end of the player")
    graph.until(lambda: is_said("OK", "all has been sent"), "that all has been sent")
    events = [event["text"] for event in page.sections["health"]["events"]]
    assert not any("publisher is gone" in text for text in events)
    # Another one, and it is interrupted.
    health = graph.health()
    received = {
        topic: int(values_of(health[topic.replace("_", " ")])["received"])
        for topic in ("ground_truth", "estimate")
    }
    player = graph.start(*replay, "--rate", "0.5")
    for topic, number in received.items():
        graph.until_accounted(topic, number + 5)
    assert player.end() == 0
    graph.until(lambda: is_said("WARN", "its publisher is gone"), "that it has left")


@pytest.mark.slow
def test_a_node_that_is_killed_is_said_and_comes_back(graph: Graph, tmp_path: Path) -> None:
    page = Watch(graph)
    first = graph.start_evaluator()
    until_met(graph, page)
    first.kill()
    graph.until(lambda: page.is_said("silent"), "silence")
    # DDS gives a dead participant some twenty seconds.
    graph.until(lambda: page.is_said("gone", "the publisher is gone"), "gone")
    graph.received["/diagnostics"].clear()
    metrics = graph.listen(DiagnosticArray, "/evaluator/metrics")
    graph.start_evaluator()
    until_met(graph, page, run=1)
    count, _ = play(graph, tmp_path)
    graph.until_accounted("estimate", count)
    until_shown(graph, page, metrics)
    graph.until(lambda: page.is_said("live"), "life")


def test_another_node_is_named(graph: Graph) -> None:
    page = Watch(graph)
    graph.start_evaluator("-r", "__ns:=/robot")
    graph.until(
        lambda: page.is_said("waiting", "there is /robot/evaluator: --node /robot/evaluator"),
        "the other node",
    )
    other = Watch(graph, "--node", "robot/evaluator")
    until_met(graph, other, "/robot/evaluator")


def test_two_signals_end_it_once(graph: Graph) -> None:
    page = Watch(graph)
    browser = Browser(page.port)
    graph.until(lambda: browser.known.sequence >= 0, "a browser")
    page.process.send(signal.SIGINT)
    page.process.send(signal.SIGINT)
    assert page.process.wait() == 0
    graph.until(lambda: browser.ended, "the browser's end")
    assert "Traceback" not in page.process.output


def test_a_port_that_is_taken_is_one_line_and_it_says_who_can_read_it(graph: Graph) -> None:
    page = Watch(graph)
    assert "For this machine alone" in page.process.output
    second = graph.start("-m", "trajeval_ros.commands.watch", "--port", str(page.port))
    assert second.wait() == 1
    assert second.output == (
        f"watch: error: port {page.port} of 127.0.0.1 is taken; --port 0 takes a free one\n"
    )
    opened = graph.start("-m", "trajeval_ros.commands.watch", "--port", "0", "--host", "0.0.0.0")
    graph.until(lambda: "warning: listening at 0.0.0.0" in opened.output, "the warning")
    assert opened.end() == 0


@pytest.mark.parametrize(
    "arguments",
    [["--port", "70000"], ["--node", "a b"], ["--node", ""], ["--port", "x"], ["--host", ""]],
)
def test_wrong_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        watch.main(arguments)
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("usage: watch")


def test_a_host_that_cannot_be_one_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp is not installed")
    assert watch.main(["--host", "a..b", "--port", "0"]) == 1
    assert capsys.readouterr().err == "watch: error: not the name of a host: 'a..b'\n"


def test_without_the_library_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "trajeval_ros.commands.watching.server", raising=False)
    monkeypatch.delattr("trajeval_ros.commands.watching.server", raising=False)
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    assert watch.main([]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("watch: error: the page needs the library aiohttp")
    assert "pip install aiohttp" in line
