# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What browsers are sent: the whole state, or what has changed since the turn before.

A message is a JSON object with ``sequence``, the turn; ``whole``, whether it stands by itself;
``run``; ``sections``, values by their names; and ``curves``, by their names: ``columns`` (seconds
first), ``rows``, which follow after the first ``from`` of those that the browser has, and ``tail``,
a last row that will be another one. Made once, whoever it is for.
"""

from __future__ import annotations

import json
from typing import Any

from trajeval_ros.commands.watching.history import Curves, Row
from trajeval_ros.commands.watching.state import Watched

_DIGITS = 6


class Feed:
    """The turns of a state that changes."""

    def __init__(self, watched: Watched) -> None:
        """Begin with the state as it is."""
        self._watched = watched
        self.sequence = 0
        self.change = b""
        """The last turn's message."""
        self._whole: tuple[int, bytes] | None = None
        self._sent: dict[str, int] = {}
        self._curves_sent: dict[str, tuple[int, int, int]] = {}
        self._run_sent = -1
        self.turn()

    def turn(self) -> bool:
        """Take what has changed for a message; return whether anything has."""
        watched = self._watched
        if watched.run != self._run_sent:
            self._sent, self._curves_sent, self._run_sent = {}, {}, watched.run
        sections = {
            name: make()
            for name, make in watched.sections().items()
            if self._sent.get(name) != watched.version(name)
        }
        curves = {
            name: _rows(each, self._begin(name, each))
            for name, each in watched.curves().items()
            if self._curves_sent.get(name, (0, 0, -1))[2] != each.version
        }
        if not sections and not curves:
            return False
        self.sequence += 1
        self.change = self._message(sections, curves, whole=False)
        self._sent |= {name: watched.version(name) for name in sections}
        self._curves_sent |= {
            name: (each.generation, len(each.rows), each.version)
            for name, each in watched.curves().items()
        }
        return True

    @property
    def whole(self) -> bytes:
        """All there is to know, for those who have not had the turn before the last."""
        if self._whole is None or self._whole[0] != self.sequence:
            sections = {name: make() for name, make in self._watched.sections().items()}
            curves = {name: _rows(each, 0) for name, each in self._watched.curves().items()}
            self._whole = (self.sequence, self._message(sections, curves, whole=True))
        return self._whole[1]

    def _begin(self, name: str, curves: Curves) -> int:
        """The number of rows that have been sent and stand as they are."""
        generation, count, _ = self._curves_sent.get(name, (-1, 0, -1))
        return count if generation == curves.generation else 0

    def _message(self, sections: Any, curves: Any, *, whole: bool) -> bytes:
        message = {
            "sequence": self.sequence,
            "whole": whole,
            "run": self._watched.run,
            "sections": sections,
            "curves": curves,
        }
        return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()


def _rows(curves: Curves, begin: int) -> dict[str, Any]:
    return {
        "columns": ["seconds", *curves.names],
        "from": begin,
        "rows": [_rounded(row) for row in curves.rows[begin:]],
        "tail": None if curves.tail is None else _rounded(curves.tail),
    }


def _rounded(row: Row) -> list[float | None]:
    """To the millisecond, and to so many digits as can be drawn."""
    seconds, *values = row
    return [
        None if seconds is None else round(seconds, 3),
        *(None if value is None else float(f"{value:.{_DIGITS}g}") for value in values),
    ]
