# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Completion of the command line by the shell, where argcomplete is installed."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from typing import Any

WithFormat = Callable[[Sequence[str]], list[str]]


def complete(parser: argparse.ArgumentParser, with_format: WithFormat | None = None) -> None:
    """Answer the shell, and exit, if it is the shell that asks; else do nothing.

    ``with_format`` says what arguments of which the first is no format stand for.
    """
    if not is_asked():
        return
    try:
        import argcomplete
    except ImportError:
        return
    if with_format is not None:
        _insert_format(with_format)
    argcomplete.autocomplete(parser)


def is_asked() -> bool:
    """Whether it is the shell that asks."""
    return "_ARGCOMPLETE" in os.environ


def _insert_format(with_format: WithFormat) -> None:
    """The shell's line with the format in it that is left out, and the cursor moved with it."""
    line, point = os.environ.get("COMP_LINE", ""), os.environ.get("COMP_POINT", "")
    program, _, rest = line.partition(" ")
    # The word under the cursor is not the first: that one may yet become a format.
    given = rest[: max(int(point or 0) - len(program) - 1, 0)].split(" ")
    if len(given) < 2:
        return
    added = " ".join(with_format(given)[: -len(given)])
    if added:
        os.environ["COMP_LINE"] = f"{program} {added} {rest}"
        os.environ["COMP_POINT"] = str(int(point) + len(added) + 1)


def assignments(prefix: str, **_: Any) -> list[str]:
    """Complete the names of parameters, and of those that have choices the values."""
    from trajeval_ros.online.parameters import PARAMETERS

    name = prefix.partition("=")[0]
    if name in PARAMETERS:
        return [f"{name}={choice}" for choice in PARAMETERS[name].choices]
    return [f"{known}=" for known in PARAMETERS]
