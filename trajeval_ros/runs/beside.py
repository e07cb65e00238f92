# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Work that takes a part of a second, and that a run need not wait for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

Outcome = Callable[[], Any]
"""Returns a result, or raises what was raised in its stead."""


@dataclass(frozen=True, slots=True)
class Work:
    """A piece of work, whose result depends on what it was made with alone.

    ``do`` touches nothing of the run, and may be called beside it, in another thread. ``take`` is
    called by the run's owner with the outcome.
    """

    do: Callable[[], Any]
    take: Callable[[Outcome], None]

    def at_once(self) -> None:
        """Do it here and now."""
        self.take(self.do)

    @staticmethod
    def together(pieces: Sequence[Work]) -> Work | None:
        """One after the other; None of none."""

        def take(outcomes: Outcome) -> None:
            for piece, outcome in zip(pieces, outcomes(), strict=True):
                piece.take(outcome)

        return Work(lambda: [outcome_of(each.do) for each in pieces], take) if pieces else None


def outcome_of(do: Callable[[], Any]) -> Outcome:
    """Do it."""
    try:
        result = do()
    except Exception as error:  # noqa: BLE001 (raised where the outcome is taken)
        raised = error
    else:
        return lambda: result

    def outcome() -> Any:
        raise raised

    return outcome
