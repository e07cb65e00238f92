# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which likely causes the log has told, so that each change is told once."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trajeval_ros.diagnosis.cause import Cause

# A cause that comes and goes is told again no sooner (s) than this after it went.
_QUIET = 60.0


class Told:
    """The likely causes of one estimate that a reader of the log believes to hold."""

    def __init__(self) -> None:
        self._held: dict[str, Cause] = {}
        self._went: dict[str, float] = {}

    def news(self, causes: Sequence[Cause], now: float) -> tuple[list[Cause], list[Cause]]:
        """Return those that are to be told, and those told that hold no longer; ``now``: s."""
        holding = {cause.code for cause in causes}
        gone = [cause for code, cause in self._held.items() if code not in holding]
        for cause in gone:
            del self._held[cause.code]
            self._went[cause.code] = now
        come = [
            cause
            for cause in causes
            if cause.code not in self._held
            and now - self._went.get(cause.code, -math.inf) >= _QUIET
        ]
        self._held |= {cause.code: cause for cause in come}
        return come, gone

    def clear(self) -> None:
        """Start over."""
        self._held.clear()
        self._went.clear()
