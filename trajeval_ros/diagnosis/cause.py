# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A likely cause: what is wrong, by what evidence, and what to do about it."""

from __future__ import annotations

from typing import NamedTuple


class Cause(NamedTuple):
    """``code`` in snake_case, ``text`` with the evidence, ``advice``: what to set."""

    code: str
    text: str
    advice: str

    @property
    def sentence(self) -> str:
        """What is wrong and what to do about it."""
        return f"likely cause: {self.text}. To try: {self.advice}."


def too_early(offset: float, digits: int, unit: str = "s", known: str = "") -> str:
    """How stamps are off to which ``offset`` is to be added: by how much, and on which side."""
    side = "early" if offset > 0.0 else "late"
    return f"the estimate's stamps are {abs(offset):,.{digits}f}{known} {unit} too {side}"


def earlier_or_later(change: float) -> str:
    """How stamps go on where what is to be added to them changes by so much."""
    return "earlier" if change > 0.0 else "later"
