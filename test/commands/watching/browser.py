# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A slow and obvious twin of the page's state, and an HTTP client that keeps one."""

import contextlib
import http.client
import json
import socket
import threading
from typing import Any


class Known:
    """What a browser knows, from the messages that it was sent."""

    def __init__(self) -> None:
        self.run: int | None = None
        self.sections: dict[str, Any] = {}
        self.curves: dict[str, Any] = {}
        self.sequence = -1
        self.wholes = 0
        self.changes = 0

    def take(self, message: dict[str, Any]) -> None:
        if message["whole"] or message["run"] != self.run:
            self.run, self.sections, self.curves = message["run"], {}, {}
        self.wholes += message["whole"]
        self.changes += not message["whole"]
        self.sequence = message["sequence"]
        self.sections |= message["sections"]
        for name, sent in message["curves"].items():
            before = self.curves.get(name, {"rows": []})["rows"]
            assert sent["from"] <= len(before)
            self.curves[name] = {
                "columns": sent["columns"],
                "rows": before[: sent["from"]] + sent["rows"],
                "tail": sent["tail"],
            }

    @property
    def state(self) -> tuple[Any, Any, Any]:
        return self.run, self.sections, self.curves


def whole(message: dict[str, Any]) -> tuple[Any, Any, Any]:
    """The state that a whole message alone gives."""
    known = Known()
    known.take(message)
    return known.state


class Browser(threading.Thread):
    """Keeps what it knows up to date, from ``/events``, until it is closed or the server ends."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.known = Known()
        self.ended = False
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
        self.start()

    def run(self) -> None:
        try:
            self._connection.request("GET", "/events")
            response = self._connection.getresponse()
            assert response.status == 200
            while line := response.readline():
                if line.startswith(b"data: "):
                    self.known.take(json.loads(line[6:]))
        except (OSError, http.client.HTTPException, AttributeError, ValueError):
            pass  # closed, by either side
        self.ended = True

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._connection.sock.shutdown(socket.SHUT_RDWR)


def get(
    port: int, path: str, method: str = "GET", host: str = "127.0.0.1"
) -> tuple[int, bytes, dict[str, str]]:
    """Ask once: status, body, headers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    try:
        connection.request(method, path, headers={"Host": f"{host}:{port}"})
        response = connection.getresponse()
        return response.status, response.read(), dict(response.getheaders())
    finally:
        connection.close()
