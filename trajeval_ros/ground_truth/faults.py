# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the ground truth: named, counted, with its times."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

EXPLANATIONS = {
    "outliers": "samples far from those before and after them, left out",
    "flip": "turns no body makes, as where it was taken for another: left out or turned back",
    "origin_jump": "jumps no body makes, from where the poses go on: cut there (large ones are"
    " moved back)",
    "put_back": "jumps no body makes, to where it began or had jumped to before: cut there, as"
    " where a simulation is reset",
    "frozen": "samples that repeat the one before while the body moves on, left out",
    "stamp_bursts": "samples stamped close together after a late one, but taken as far apart as"
    " others: stamps of their arrival",
    "stamps_late": "samples of a regular clock stamped late",
    "stamps_quantised": "stamps rounded",
    "noise_grows": "seconds with noise several times that at the beginning",
}
"""Each fault's code and what it counts."""


# Stamps close together are named from so many on, and from so large a share of the samples on.
_BURSTS, _BURST_SHARE = 10, 0.01
_STAMPS = 100


@dataclass(frozen=True, slots=True)
class Fault:
    """Faults of one kind: ``code`` of :data:`EXPLANATIONS`, from ``begin`` to ``end`` (ns).

    ``detail``: how large it is, in words; ``stamps``: when each of the newest hundred jumps was.
    """

    code: str
    begin: int
    end: int
    count: int
    detail: str = ""
    stamps: tuple[int, ...] = ()

    @property
    def text(self) -> str:
        """One line for the user."""
        explained = EXPLANATIONS[self.code]
        if self.count == 1:
            plural, _, rest = explained.partition(" ")
            explained = f"{plural.removesuffix('s')} {rest}".replace(
                "that repeat ", "that repeats "
            )
        detail = f" ({self.detail})" if self.detail else ""
        return f"{self.count} {explained}{detail}"

    def and_then(self, begin: int, end: int, count: int) -> Fault:
        """With later ones."""
        return replace(
            self,
            begin=min(self.begin, begin),
            end=max(self.end, end),
            count=self.count + count,
        )


class Faults:
    """The faults so far, one entry a kind."""

    def __init__(self) -> None:
        """Start without any."""
        self.passed = 0
        """Number of samples used."""
        self.bursts_told = False
        """Whether the poses say that stamps close together are of arrival."""
        self._found: dict[str, Fault] = {}
        self._jumped: dict[str, tuple[float, float]] = {}

    def add(self, code: str, begin: int, end: int, count: int = 1) -> None:
        """Note some more."""
        known = self._found.get(code)
        fault = known.and_then(begin, end, count) if known else Fault(code, begin, end, count)
        self._found[code] = fault

    def jumped(self, code: str, stamp: int, moved: float, turned: float) -> None:
        """Note a jump of all poses from a sample on, m and rad."""
        largest = self._jumped.get(code, (0.0, 0.0))
        moved, turned = max(largest[0], moved), max(largest[1], turned)
        self._jumped[code] = moved, turned
        self.add(code, stamp, stamp)
        known = self._found[code]
        degrees = math.degrees(turned)
        size = f"{moved:.3g} m" + (f" and {degrees:.2g} deg" if degrees else "")
        detail = size if known.count == 1 else f"{size} at most"
        stamps = (*known.stamps, stamp)[-_STAMPS:]
        self._found[code] = replace(known, detail=detail, stamps=stamps)

    @property
    def found(self) -> tuple[Fault, ...]:
        """All of them, in the order of :data:`EXPLANATIONS`."""
        return tuple(self._found[code] for code in EXPLANATIONS if self._is_found(code))

    def _is_found(self, code: str) -> bool:
        count = self._found[code].count if code in self._found else 0
        if code == "stamp_bursts":
            return self.bursts_told and count >= max(_BURSTS, _BURST_SHARE * self.passed)
        return count > 0
