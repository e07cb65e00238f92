# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""``watch``: the running figures of a node in a browser."""

from __future__ import annotations

import argparse
import asyncio
import errno
import re
import signal
import sys
import time
from collections.abc import Sequence
from types import FrameType
from typing import Any

from trajeval_ros.commands import completion, console

DESCRIPTION = """\
Show the running figures of a node in a browser, beside it: a process of its own that subscribes
and publishes nothing. The page is read-only, and this machine's alone unless --host says
otherwise. Ends on Ctrl-C."""

PORT = 8765
_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")
# What has arrived is taken this often, s.
_LISTEN = 0.05
# What has changed is sent this often, s.
_TURN = 0.25


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="watch",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    console.add_version(parser)
    parser.add_argument(
        "--node",
        type=_node,
        default="/evaluator",
        metavar="NAME",
        help="the node to watch, with its namespace (default: /evaluator)",
    )
    parser.add_argument(
        "--port",
        type=console.integer(0, 65535),
        default=PORT,
        metavar="N",
        help=f"of the page; 0: any that is free (default: {PORT})",
    )
    parser.add_argument(
        "--host",
        type=_host,
        default="127.0.0.1",
        metavar="ADDRESS",
        help="to listen at; 0.0.0.0: everybody in the network can read it, without a password"
        " (default: 127.0.0.1, this machine alone)",
    )
    return parser


def _node(text: str) -> str:
    if not _NAME.fullmatch(text):
        raise argparse.ArgumentTypeError(f"not the name of a node: {text!r}")
    return f"/{text.lstrip('/')}"


def _host(text: str) -> str:
    # The library would listen at every address there is.
    if not text.strip():
        raise argparse.ArgumentTypeError("no address; 0.0.0.0 is every one there is")
    return text


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = make_parser()
    completion.complete(parser)
    arguments = parser.parse_args(argv)
    return console.run(lambda: watch(arguments), "watch")


def watch(arguments: argparse.Namespace) -> int:
    """Listen to the node, and serve the page until a signal says that it is enough."""
    try:
        from trajeval_ros.commands.watching import server
    except ModuleNotFoundError as error:
        raise console.CommandError(
            f"the page needs the library aiohttp ({error}): python3 -m pip install aiohttp"
            " (on ROS machines: apt install python3-aiohttp)"
        ) from error
    try:
        from trajeval_ros.commands.watching.listener import Listener
    except ImportError as error:
        raise console.CommandError(
            f"watch needs ROS 2 ({error}); source it, or: python3 -m pip install"
            " 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces"
        ) from error
    from trajeval_ros.commands.watching.feed import Feed
    from trajeval_ros.commands.watching.state import Watched

    enough = _Enough()
    watched = Watched(arguments.node)
    with Listener(arguments.node, watched) as listener:
        page = server.Server(Feed(watched))
        asyncio.run(_serve(listener, page, arguments, enough))
    return console.DONE


class _Enough:
    """Whether SIGINT or SIGTERM has come; another one does not disturb the end."""

    def __init__(self) -> None:
        self.said = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._say)

    def _say(self, number: int, frame: FrameType | None) -> None:
        self.said = True


async def _serve(listener: Any, page: Any, arguments: argparse.Namespace, enough: _Enough) -> None:
    """Until it is enough."""
    host, port = arguments.host, arguments.port
    try:
        address = await page.start(host, port)
    except OSError as error:
        raise console.CommandError(_refused(host, port, error)) from error
    except UnicodeError as error:
        raise console.CommandError(f"not the name of a host: {host!r}") from error
    print(f"Watching {arguments.node} at {address.url}", flush=True)
    if address.is_local:
        print("For this machine alone; Ctrl-C ends it.", flush=True)
    else:
        print(
            f"warning: listening at {host}: whoever reaches this machine can read it, there is no"
            " password; Ctrl-C ends it.",
            flush=True,
        )
    next_turn = time.monotonic()
    try:
        while not enough.said:
            listener.listen()
            if time.monotonic() >= next_turn:
                next_turn = time.monotonic() + _TURN
                await page.turn()
            await asyncio.sleep(_LISTEN)
    finally:
        await page.close()


def _refused(host: str, port: int, error: OSError) -> str:
    if isinstance(error, PermissionError):
        return f"port {port} of {host} is not allowed: take one from 1024 on"
    if error.errno == errno.EADDRINUSE:
        return f"port {port} of {host} is taken; --port 0 takes a free one"
    return f"cannot listen at {host}, port {port}: {error.strerror or error}"


if __name__ == "__main__":
    sys.exit(main())
