# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drawing in SVG: marks, and an axis with its ticks. Colours and fonts are the page's."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Point = tuple[float, float]


@dataclass(frozen=True)
class Axis:
    """From values to the picture: ``low`` is drawn at ``begin``, ``high`` at ``end``."""

    low: float
    high: float
    begin: float
    end: float
    logarithmic: bool = False

    def __call__(self, value: float) -> float:
        """Where a value is drawn; what lies outside, at the end."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        share = (self._scaled(value) - low) / (high - low)
        return self.begin + (self.end - self.begin) * min(max(share, 0.0), 1.0)

    def _scaled(self, value: float) -> float:
        return math.log(max(value, 1e-300)) if self.logarithmic else value

    def ticks(self, most: int = 5) -> list[float]:
        """Round values, at most about so many."""
        if self.logarithmic:
            return self._decades(most)
        step = nice_step((self.high - self.low) / most)
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return [round(step * k, 12) for k in range(first, last + 1)]

    def _decades(self, most: int) -> list[float]:
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        for digits in (range(1, 10), (1, 2, 5), (1, 3), (1,)):
            found = [
                digit * 10.0**decade
                for decade in decades
                for digit in digits
                if self.low <= digit * 10.0**decade * (1 + 1e-9)
                and digit * 10.0**decade <= self.high * (1 + 1e-9)
            ]
            if len(found) <= most + 1:
                return found
        every = math.ceil(len(found) / most)
        return found[::every]


def nice_step(rough: float) -> float:
    """1, 2 or 5 times a power of ten, no less than ``rough``."""
    power = 10.0 ** math.floor(math.log10(rough))
    return next(power * digit for digit in (1, 2, 5, 10) if rough <= power * digit * (1 + 1e-9))


def shown(value: float) -> str:
    """A tick's text."""
    if value != 0.0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")
    return f"{value:.10g}"


def picture(width: float, height: float, parts: Iterable[str], label: str) -> str:
    """A picture in a page, as wide as its place; ``label`` says what it shows."""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{html.escape(label)}">'
        f"{''.join(parts)}</svg>"
    )


def text(x: float, y: float, words: str, kind: str = "", anchor: str = "start") -> str:
    """Words at a place; ``kind`` is a class of the page's style."""
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f"<text {place}{_class(kind)}>{html.escape(words)}</text>"


def line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    """A straight line."""
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"{_class(kind)}/>'


def rectangle(x: float, y: float, width: float, height: float, kind: str) -> str:
    """A rectangle, at least a hair wide."""
    place = f'x="{x:.1f}" y="{y:.1f}" width="{max(width, 0.5):.1f}" height="{height:.1f}"'
    return f"<rect {place}{_class(kind)}/>"


def dot(x: float, y: float, radius: float, kind: str) -> str:
    """A filled circle."""
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"{_class(kind)}/>'


def path(points: Sequence[Point], kind: str, *, closed: bool = False) -> str:
    """A line through points, or the area within."""
    steps = "L".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<path d="M{steps}{"Z" if closed else ""}"{_class(kind)}/>'


def with_title(title: str, parts: Iterable[str]) -> str:
    """Marks that say more where the pointer rests on them."""
    return f"<g><title>{html.escape(title)}</title>{''.join(parts)}</g>"


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def below(axis: Axis, y: float, top: float, most: int = 5) -> list[str]:
    """Ticks and their grid, of a horizontal axis drawn at ``y``, up to ``top``."""
    parts = []
    for value in axis.ticks(most):
        x = axis(value)
        parts.append(line(x, top, x, y, "grid"))
        parts.append(text(x, y + 13.0, shown(value), "tick", "middle"))
    return parts


def beside(axis: Axis, x: float, right: float, most: int = 5) -> list[str]:
    """Ticks and their grid, of a vertical axis drawn at ``x``, up to ``right``."""
    parts = []
    for value in axis.ticks(most):
        y = axis(value)
        parts.append(line(x, y, right, y, "grid"))
        parts.append(text(x - 5.0, y + 3.5, shown(value), "tick", "end"))
    return parts


def runs_of(there: npt.NDArray[np.bool_]) -> list[slice]:
    """The stretches without a hole."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]])))
    return [slice(int(b), int(e)) for b, e in zip(edges[::2], edges[1::2], strict=True)]
