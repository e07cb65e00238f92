# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Serves the page: a state that is read, once made and sent to however many there are.

``/`` is the page, ``/events`` server-sent events with the messages of `Feed`, ``/state.json`` its
whole state. There is nothing to send to it. A browser has no queue: one that is behind gets the
state as it is when it can take it, and one that takes nothing for long is let go and comes back by
itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from aiohttp import web

from trajeval_ros import charts
from trajeval_ros.commands.watching.feed import Feed

_HERE = Path(__file__).parent
_FILES: Mapping[str, Callable[[], str]] = {
    "charts.css": charts.style,
    "charts.js": charts.script,
    **{name: (_HERE / name).read_text for name in ("watch.css", "watch.js")},
}
"""What the page is made of, by the names that it asks for it by."""
_KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
# Something is sent this often, so that either side knows when the other is gone, s.
_SIGN_OF_LIFE = 10.0
# A browser that takes nothing for so long is let go, s; until then it costs the kernel's and our
# own buffer, bytes each.
_PATIENCE = 20.0
_BUFFER = 1 << 16
_MOST_BROWSERS = 64

_HEADERS = {
    "Cache-Control": "no-store",
    # The page is made of what this server sends, and speaks with nobody else.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'"
    " 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; frame-ancestors 'none';"
    " base-uri 'none'; form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass(frozen=True)
class Address:
    """Where the page is: a host that is bound, and a port."""

    host: str
    port: int

    @property
    def is_local(self) -> bool:
        """Whether this machine alone can reach it."""
        return is_local(self.host)

    @property
    def url(self) -> str:
        """What to open in a browser."""
        try:
            address = ipaddress.ip_address(self.host)
        except ValueError:
            return f"http://{self.host}:{self.port}/"
        if address.is_unspecified:
            return f"http://localhost:{self.port}/"
        host = f"[{address}]" if address.version == 6 else str(address)
        return f"http://{host}:{self.port}/"


def is_local(host: str) -> bool:
    """Whether a host is this machine's loopback."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class Server:
    """The page of a feed at an address."""

    def __init__(self, feed: Feed) -> None:
        """Make it; nothing is bound yet."""
        self._feed = feed
        self._turned = asyncio.Condition()
        self._closing = False
        self._browsers = 0
        self._only_local = True
        self._runner: web.AppRunner | None = None

    @property
    def browsers(self) -> int:
        """How many are connected."""
        return self._browsers

    async def start(self, host: str, port: int) -> Address:
        """Bind; port 0 is any that is free.

        Raises
        ------
        OSError
            If it cannot be bound.
        """
        self._only_local = is_local(host)
        application = web.Application(middlewares=[self._guard])
        application.router.add_get("/", self._page)
        application.router.add_get("/events", self._events)
        application.router.add_get("/state.json", self._state)
        application.router.add_get("/files/{name}", self._file)
        self._runner = web.AppRunner(
            application, handle_signals=False, access_log=None, shutdown_timeout=1.0
        )
        await self._runner.setup()
        site = web.TCPSite(self._runner, host, port)
        await site.start()
        return Address(host, self._runner.addresses[0][1])

    async def turn(self) -> None:
        """Send what has changed, if anybody is there to take it."""
        if self._browsers and self._feed.turn():
            async with self._turned:
                self._turned.notify_all()

    async def close(self) -> None:
        """Let the browsers go."""
        self._closing = True
        async with self._turned:
            self._turned.notify_all()
        if self._runner is not None:
            await self._runner.cleanup()

    # -------------------------------------------------------------------------------- what is asked

    @web.middleware
    async def _guard(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        """Refuse what a page of another site had a browser ask for under a name of its own."""
        if self._only_local and not is_local(_name_in(request.host)):
            raise web.HTTPMisdirectedRequest(text="this address is for this machine alone\n")
        return await handler(request)

    async def _page(self, request: web.Request) -> web.StreamResponse:
        return _sent("page.html", (_HERE / "page.html").read_text(encoding="utf-8"))

    async def _file(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info["name"]
        if name not in _FILES:
            raise web.HTTPNotFound
        return _sent(name, _FILES[name]())

    async def _state(self, request: web.Request) -> web.StreamResponse:
        self._feed.turn()
        return web.Response(
            body=self._feed.whole, content_type="application/json", headers=_HEADERS
        )

    async def _events(self, request: web.Request) -> web.StreamResponse:
        if self._browsers >= _MOST_BROWSERS:
            raise web.HTTPServiceUnavailable(text=f"{self._browsers} browsers are connected\n")
        response = web.StreamResponse(headers={**_HEADERS, "Content-Type": "text/event-stream"})
        self._browsers += 1
        try:
            with contextlib.suppress(ConnectionError, TimeoutError):
                await response.prepare(request)
                if request.transport is not None:
                    request.transport.set_write_buffer_limits(_BUFFER)
                    connection = request.transport.get_extra_info("socket")
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
                await self._follow(request, response)
        finally:
            self._browsers -= 1
        return response

    async def _follow(self, request: web.Request, response: web.StreamResponse) -> None:
        """Send each turn, or, to one that has missed any, the whole."""
        self._feed.turn()
        seen = -1
        while not self._closing:
            sequence = self._feed.sequence
            if sequence == seen:
                await self._send(request, response, b": here\n\n")
            else:
                missed = seen < 0 or sequence > seen + 1
                body = self._feed.whole if missed else self._feed.change
                await self._send(request, response, b"data: " + body + b"\n\n")
                seen = sequence
            await self._newer_than(seen)

    async def _newer_than(self, seen: int) -> None:
        """Wait for a turn that is not the one ``seen``, or for a sign of life to be due."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_SIGN_OF_LIFE), self._turned:
                await self._turned.wait_for(lambda: self._closing or self._feed.sequence != seen)

    async def _send(self, request: web.Request, response: web.StreamResponse, data: bytes) -> None:
        try:
            async with asyncio.timeout(_PATIENCE):
                await response.write(data)
        except TimeoutError:
            # What is on its way is given up with the connection.
            if request.transport is not None:
                request.transport.abort()
            raise


def _name_in(host: str) -> str:
    """The name in a header ``Host``, without the port; empty where there is none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _sent(name: str, text: str) -> web.Response:
    kind = _KINDS[name.rpartition(".")[2]]
    return web.Response(text=text, content_type=kind, charset="utf-8", headers=_HEADERS)
