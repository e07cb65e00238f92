# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Work that takes a part of a second, and that a run need not wait for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Work:
    """A piece of work, whose result depends on what it was made with alone.

    ``do`` touches nothing of the run, and may be called beside it, in another thread. ``take`` is
    called by the run's owner with what returns the result, or raises what ``do`` raised.
    """

    do: Callable[[], Any]
    take: Callable[[Callable[[], Any]], None]

    def at_once(self) -> None:
        """Do it here and now."""
        self.take(self.do)
