# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small figures without a time axis, as SVG in the colours of the page."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trajeval_ros.conventional.sub_trajectories import BOX_QUANTILES, Box

# What is drawn of BOX_QUANTILES.
_SHARES = {"p5": 0.05, "q1": 0.25, "median": 0.5, "q3": 0.75, "p95": 0.95}
_WIDTH, _HEIGHT = 500.0, 250.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 12.0, 30.0, 38.0


@dataclass(frozen=True)
class Boxes:
    """The boxes of an estimate: its name, its colour, and of each length the quantiles."""

    name: str
    colour: str
    boxes: Sequence[tuple[float, Mapping[str, float]]]


@dataclass(frozen=True)
class _Axis:
    """A logarithmic axis from ``low`` to ``high``, drawn from ``begin`` to ``end``."""

    low: float
    high: float
    begin: float
    end: float

    def at(self, value: float) -> float:
        share = math.log(max(value, 1e-12) / self.low) / math.log(self.high / self.low)
        return self.begin + min(max(share, 0.0), 1.0) * (self.end - self.begin)

    def ticks(self, most: int) -> list[float]:
        """Of 1, 2, 5, 10, ... those that lie on it; powers of ten alone where that is enough."""
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        for digits in ((1, 2, 5), (1,)):
            found = [digit * 10.0**power for power in range(first, last + 1) for digit in digits]
            found = [value for value in found if self.low * 0.999 <= value <= self.high * 1.001]
            if len(found) <= most:
                return found
        return found[:: -(-len(found) // most)]


def growth(title: str, unit: str, along: str, estimates: Sequence[Boxes]) -> str:
    """Errors over the length of the sub-trajectory, both axes logarithmic.

    The box holds the middle half, the line in it the median, the whiskers nine in ten.
    """
    lengths = [length for each in estimates for length, _ in each.boxes]
    lows = [box["p5"] for each in estimates for _, box in each.boxes if box["p5"] > 0.0]
    highs = [box["p95"] for each in estimates for _, box in each.boxes]
    high = max(highs)
    if not high > 0.0:
        return ""
    low = max(min(lows, default=high), 1e-4 * high)
    across = _Axis(0.7 * min(lengths), 1.4 * max(lengths), _LEFT, _WIDTH - _RIGHT)
    up = _Axis(0.8 * low, 1.25 * high, _HEIGHT - _BOTTOM, _TOP)
    parts = [_frame(across, up, along)]
    for number, each in enumerate(estimates):
        shift = 9.0 * (number - 0.5 * (len(estimates) - 1))
        points = []
        for length, box in each.boxes:
            x = across.at(length) + shift
            places = {name: up.at(value) for name, value in box.items()}
            points.append(f"{x:.1f},{places['median']:.1f}")
            parts.append(_box(x, places, each.colour))
        parts.append(
            f'<polyline points="{" ".join(points)}" fill="none" stroke-width="1.6"'
            f' style="stroke:var(--{each.colour})"/>'
        )
    medians = "; ".join(
        f"{each.name}: "
        + ", ".join(f"{_short(box['median'])} {unit} over {_short(at)}" for at, box in each.boxes)
        for each in estimates
    )
    return _svg(f"{title}, {unit}", f"{title} over {along}, medians: {medians}", parts)


def _box(x: float, y: Mapping[str, float], colour: str) -> str:
    return (
        f'<g style="stroke:var(--{colour})">'
        f'<path fill="none" d="M{x:.1f} {y["p5"]:.1f}V{y["q1"]:.1f}'
        f'M{x:.1f} {y["q3"]:.1f}V{y["p95"]:.1f}"/>'
        f'<rect x="{x - 4:.1f}" y="{y["q3"]:.1f}" width="8" height="{y["q1"] - y["q3"]:.1f}"'
        f' style="fill:var(--{colour})" fill-opacity="0.25"/>'
        f'<path stroke-width="2" d="M{x - 4:.1f} {y["median"]:.1f}h8"/></g>'
    )


def whiteness(title: str, colour: str, lags: Sequence[float], limit: float) -> str:
    """Autocorrelations of what is left when the model has explained the errors, by lag."""
    reach = max(0.5, *(abs(lag) for lag in lags))
    middle = 0.5 * (_TOP + _HEIGHT - _BOTTOM)
    half = 0.5 * (_HEIGHT - _BOTTOM - _TOP)
    step = (_WIDTH - _LEFT - _RIGHT) / len(lags)

    def at(value: float) -> float:
        return middle - half * value / reach

    parts = [
        f'<rect x="{_LEFT}" width="{_WIDTH - _LEFT - _RIGHT}" y="{at(limit):.1f}"'
        f' height="{at(-limit) - at(limit):.1f}" style="fill:var(--band)" fill-opacity="0.45"/>',
        _line(_LEFT, at(0.0), _WIDTH - _RIGHT, at(0.0), "axis"),
    ]
    for value in (-reach, -limit, 0.0, limit, reach):
        parts.append(_text(_LEFT - 6.0, at(value), f"{value:.2g}".replace("-", "−"), "end"))
    for number, lag in enumerate(lags):
        x = _LEFT + (number + 0.5) * step
        shown = colour if abs(lag) <= limit else "mark"
        top, bottom = sorted((at(lag), at(0.0)))
        parts.append(
            f'<rect x="{x - 0.3 * step:.1f}" width="{0.6 * step:.1f}" y="{top:.1f}"'
            f' height="{max(bottom - top, 1.0):.1f}" style="fill:var(--{shown})"/>'
        )
        parts.append(_text(x, _HEIGHT - _BOTTOM + 14.0, f"{number + 1}", "middle"))
    parts.append(_text(0.5 * (_LEFT + _WIDTH), _HEIGHT - 8.0, "lag, poses", "middle"))
    said = ", ".join(f"{lag:.2f}" for lag in lags)
    return _svg(title, f"{title} at lags of 1 to {len(lags)} poses: {said}", parts)


def _frame(across: _Axis, up: _Axis, along: str) -> str:
    bottom = _HEIGHT - _BOTTOM
    parts = []
    for value in across.ticks(8):
        x = across.at(value)
        parts.append(_line(x, _TOP, x, bottom, "grid"))
        parts.append(_text(x, bottom + 14.0, _short(value), "middle"))
    for value in up.ticks(8):
        y = up.at(value)
        parts.append(_line(_LEFT, y, _WIDTH - _RIGHT, y, "grid"))
        parts.append(_text(_LEFT - 6.0, y, _short(value), "end"))
    parts.append(_text(0.5 * (_LEFT + _WIDTH), _HEIGHT - 8.0, along, "middle"))
    return "".join(parts)


def _line(x: float, y: float, to_x: float, to_y: float, colour: str) -> str:
    return f'<path d="M{x:.1f} {y:.1f}L{to_x:.1f} {to_y:.1f}" style="stroke:var(--{colour})"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" dy="0.35em" text-anchor="{anchor}" font-size="11.5"'
        f' style="fill:var(--muted)">{html.escape(text)}</text>'
    )


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000.0 else f"{value:.3g}"


def _svg(title: str, label: str, parts: Sequence[str]) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img"'
        f' aria-label="{html.escape(label)}">'
        f'<text x="0" y="12" font-size="13" font-weight="600" style="fill:var(--ink)">'
        f"{html.escape(title)}</text>{''.join(parts)}</svg>"
    )


def boxes_of(name: str, colour: str, found: Sequence[Box], part: str) -> Boxes:
    """Of an estimate the boxes of a part, "translation" in metres or "rotation" in degrees."""
    factor = 1.0 if part == "translation" else math.degrees(1.0)
    boxes = []
    for box in found:
        values = box.translation if part == "translation" else box.rotation
        quantiles = dict(zip(BOX_QUANTILES, values, strict=True))
        at = {key: factor * quantiles[share] for key, share in _SHARES.items()}
        boxes.append((box.length, at))
    return Boxes(name, colour, boxes)
