# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The server, without a node: who is served, with what, and what it costs."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from browser import Browser, get, whole

from trajeval_ros.commands.watching.feed import Feed
from trajeval_ros.commands.watching.state import Watched

pytest.importorskip("aiohttp", reason="aiohttp is not installed")

from trajeval_ros.commands.watching import server

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
PATIENCE = 120.0


class Served:
    """A server in a thread; its state is touched in its own loop alone."""

    def __init__(self) -> None:
        self.watched = Watched("/evaluator")
        self.page = server.Server(Feed(self.watched))
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever)
        self._thread.start()
        self.address = self.call(self.page.start("127.0.0.1", 0))
        self.port = self.address.port

    def call(self, coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(PATIENCE)

    def turn(self, change: Callable[[Watched], None]) -> None:
        async def both() -> None:
            change(self.watched)
            await self.page.turn()

        self.call(both())

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.01)

    def close(self) -> None:
        self.call(self.page.close())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()


@pytest.fixture
def served() -> Iterator[Served]:
    made = Served()
    yield made
    made.close()


def metrics(value: float) -> dict[str, dict[str, str]]:
    return {"conventional": {"ate_translation_rmse": repr(value)}}


def test_ten_browsers_are_told_the_same(served: Served) -> None:
    browsers = [Browser(served.port) for _ in range(10)]
    served.until(lambda: served.page.browsers == 10)
    for number in range(30):
        served.turn(
            lambda watched, number=number: watched.take_metrics(START + number, metrics(number))
        )
        if number == 20:
            # One more, in the middle; and one goes.
            browsers.append(Browser(served.port))
            browsers.pop(0).close()
            served.until(lambda: served.page.browsers == 10)
    last = served.page._feed.sequence
    served.until(lambda: all(each.known.sequence == last for each in browsers))
    _, body, _ = get(served.port, "/state.json")
    expected = whole(json.loads(body))
    for each in browsers:
        assert each.known.state == expected
        assert each.known.changes
    figures = expected[1]["estimate/estimate"]["figures"]
    assert figures["conventional"]["ate_translation_rmse"] == 29.0


def test_nothing_is_made_for_nobody(served: Served) -> None:
    before = served.page._feed.sequence
    served.turn(lambda watched: watched.take_metrics(START, metrics(1.0)))
    assert served.page._feed.sequence == before


def test_a_browser_that_takes_nothing_holds_nobody_up_and_is_let_go(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_PATIENCE", 0.5)
    sleeper = socket.socket()
    sleeper.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    sleeper.connect(("127.0.0.1", served.port))
    sleeper.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    served.until(lambda: served.page.browsers == 1)
    awake = Browser(served.port)
    served.until(lambda: served.page.browsers == 2)
    # More than sockets hold.
    turns = 0
    while served.page.browsers == 2:
        turns += 1
        assert turns < 2000

        def change(watched: Watched, turns: int = turns) -> None:
            stamp = START + turns * 1000
            watched.take_metrics(stamp, metrics(float(turns)))
            watched.take_errors("estimate", [(stamp + k, [0.1, 0.2, 0.3, 0.4]) for k in range(999)])

        served.turn(change)
        time.sleep(0.01)
    # The one that is awake has it all, turn by turn; the other finds all of it when it is back.
    last = served.page._feed.sequence
    served.until(lambda: awake.known.sequence == last)
    sleeper.close()
    back = Browser(served.port)
    served.until(lambda: back.known.sequence >= last)
    assert back.known.state == awake.known.state
    assert back.known.wholes == 1


def test_it_is_read_only(served: Served) -> None:
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        for path in ("/", "/events", "/state.json", "/files/watch.js"):
            assert get(served.port, path, method)[0] == 405


def test_files_are_those_of_the_page_and_no_others(served: Served) -> None:
    status, page, headers = get(served.port, "/")
    assert status == 200
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    for name in ("charts.css", "watch.css", "charts.js", "watch.js"):
        assert f'"files/{name}"'.encode() in page
        assert get(served.port, f"/files/{name}")[0] == 200
    for path in ("/files/server.py", "/files/../server.py", "/files/%2e%2e%2fserver.py", "/x"):
        assert get(served.port, path)[0] == 404


def test_a_page_of_another_name_is_refused(served: Served) -> None:
    # What a site elsewhere would do whose name is made to lead here.
    for host in ("evil.example", "[::1", "127.0.0.1.evil.example"):
        assert get(served.port, "/state.json", host=host)[0] in (400, 421)
    for host in ("localhost", "127.0.0.1", "[::1]"):
        assert get(served.port, "/state.json", host=host)[0] == 200


@pytest.mark.parametrize(
    ("host", "local", "url"),
    [
        ("127.0.0.1", True, "http://127.0.0.1:8765/"),
        ("localhost", True, "http://localhost:8765/"),
        ("::1", True, "http://[::1]:8765/"),
        ("0.0.0.0", False, "http://localhost:8765/"),
        ("::", False, "http://localhost:8765/"),
        ("192.168.1.7", False, "http://192.168.1.7:8765/"),
        ("robot.local", False, "http://robot.local:8765/"),
    ],
)
def test_the_address_says_who_can_reach_it(host: str, local: bool, url: str) -> None:
    address = server.Address(host, 8765)
    assert address.is_local == local
    assert address.url == url
