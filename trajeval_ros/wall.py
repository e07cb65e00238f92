# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The wall: what explains a run (causes, report, pictures) never takes down what computes it."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

_PACKAGE = Path(__file__).parent


def shield(what: str, explain: Callable[[], T], otherwise: T, say: Callable[[str], None]) -> T:
    """Return what ``explain`` returns; after a defect of it, ``otherwise``.

    ``say`` is then given one line: what failed, the exception and its place. Only for what the
    figures do not depend on.
    """
    try:
        return explain()
    except Exception as error:  # noqa: BLE001 (any defect, and it is said: what counts goes on)
        say(f"{what} failed: {described(error)}; please report this defect. All else holds.")
        return otherwise


def described(error: Exception) -> str:
    """The exception's type, the first line of its text, and the last place of ours it came by."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if Path(frame.filename).is_relative_to(_PACKAGE)]
    text = next(iter(str(error).splitlines()), "")
    name = type(error).__name__ + (f": {text}" if text else "")
    if not frames:
        return name
    place = (ours or list(frames))[-1]
    path = Path(place.filename)
    shown = path.relative_to(_PACKAGE).as_posix() if ours else path.name
    return f"{name} ({shown}:{place.lineno}, {place.name})"
