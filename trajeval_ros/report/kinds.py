# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What kind of error it is: how it grows, and whether the error model has explained it."""

from __future__ import annotations

import html
from collections.abc import Sequence

from trajeval_ros.charts import ESTIMATE_COLOURS
from trajeval_ros.report import drawings
from trajeval_ros.report.answers import WHITE
from trajeval_ros.report.glossary import CAPTIONS
from trajeval_ros.report.shown import Shown

_NOTHING = "How errors grow with the length is told of whole runs, from files, that are off at all."
_PARTS = (("translation", "m"), ("rotation", "°"))
_OVER = (
    ("time", "length of the sub-trajectory, s"),
    ("distance", "length of the sub-trajectory, m of path"),
)


def section(estimates: Sequence[Shown]) -> str:
    """The section's content; a sentence where there is too little to say."""
    grown, white = _growth(estimates), _whiteness(estimates)
    parts = []
    if grown:
        key = ""
        if len(estimates) > 1:
            names = "".join(
                f'<span><i style="background:var(--{_colour(number)})"></i>'
                f"{html.escape(one.name)}</span>"
                for number, one in enumerate(estimates)
            )
            key = f"<div class=key>{names}</div>"
        parts.append(f"{key}<div class=drawings>{grown}</div>{_caption('growth')}")
    if white:
        parts.append(f"<div class=drawings>{white}</div>{_caption('whiteness')}")
    return "".join(parts) or f"<p>{_NOTHING}</p>"


def _colour(number: int) -> str:
    return ESTIMATE_COLOURS[number % len(ESTIMATE_COLOURS)]


def _growth(estimates: Sequence[Shown]) -> str:
    drawn = []
    for over, along in _OVER:
        for part, unit in _PARTS:
            boxes = [
                drawings.boxes_of(one.name, _colour(number), one.run.growth.get(over, ()), part)
                for number, one in enumerate(estimates)
            ]
            known = [each for each in boxes if each.boxes]
            if known:
                drawn.append(drawings.growth(part.capitalize(), unit, along, known))
    return "".join(drawn)


def _whiteness(estimates: Sequence[Shown]) -> str:
    drawn = []
    for number, one in enumerate(estimates):
        found = (one.run.summary.get("error_model") or {}).get("whiteness") or {}
        of = f" of {one.name}" if len(estimates) > 1 else ""
        drawn += [
            drawings.whiteness(
                f"Autocorrelation of what is left{of}, {part}", _colour(number), lags, WHITE
            )
            for part, lags in found.items()
            if len(lags)
        ]
    return "".join(drawn)


def _caption(name: str) -> str:
    return f"<p class=caption>{CAPTIONS[name]}</p>"
