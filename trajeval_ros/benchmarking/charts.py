# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pictures of a benchmark: boxes over runs, bands over time, shares of runs, ranks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from trajeval_ros.benchmarking import svg
from trajeval_ros.benchmarking.errors import Band
from trajeval_ros.benchmarking.figures import Figure, Runs
from trajeval_ros.benchmarking.grids import number
from trajeval_ros.benchmarking.ranks import Ranks

_ROW = 24.0
_LONGEST = 16
_CHARACTER = 6.0
# Values further apart than this are drawn on a logarithmic axis.
_FAR_APART = 25.0
# So many dots of single runs are told apart in a box; more only hide it.
_MOST_DOTS = 60


def boxes(
    title: str, figure: Figure, runs: Mapping[int, Runs], systems: Sequence[str], wide: float = 360
) -> str:
    """A system a row: the middle half of its runs, their median, each run; failures counted.

    ``runs``: of the systems, by their place; whiskers reach to the last run within one and a half
    times the box.
    """
    finite = np.concatenate([each[np.isfinite(each)] for each in runs.values()] or [np.empty(0)])
    left = _margin(systems[place] for place in runs)
    bottom = 24.0 + _ROW * len(runs)
    right = wide - (8.0 if len(finite) == sum(map(len, runs.values())) else 50.0)
    parts = [svg.text(0.0, 12.0, title, "name")]
    if len(finite):
        axis = _axis(finite * figure.factor, left, right, zero=False, positive=figure.ratios)
        parts += svg.below(axis, bottom, 20.0, 6)
    for row, (place, values) in enumerate(runs.items()):
        y = 24.0 + _ROW * (row + 0.5)
        parts.append(svg.text(left - 8.0, y + 4.0, _short(systems[place]), "label", "end"))
        good = values[np.isfinite(values)] * figure.factor
        marks = _box(axis, good, y, colour(place)) if len(good) else []
        said = f"{systems[place]}, {title}: "
        said += f"median {number(float(np.median(good)))} {figure.unit}, " if len(good) else ""
        parts.append(svg.with_title(f"{said}{len(good)} of {len(values)} runs", marks))
        if len(good) < len(values):
            text = f"{len(values) - len(good)} failed"
            parts.append(svg.text(wide, y + 4.0, text, "failed", "end"))
    parts.append(svg.text((left + right) / 2, bottom + 27.0, _titled(figure), "tick", "middle"))
    return svg.picture(wide, bottom + 32.0, parts, f"{figure.title} over runs, {title}")


def _box(axis: svg.Axis, values: Runs, y: float, tone: str) -> list[str]:
    lower, median, upper = (float(v) for v in np.quantile(values, [0.25, 0.5, 0.75]))
    reach = 1.5 * (upper - lower)
    inside = values[(values >= lower - reach) & (values <= upper + reach)]
    low, high = float(inside.min()), float(inside.max())
    marks = []
    if len(values) > 1:
        marks += [
            svg.line(axis(low), y, axis(high), y, f"line {tone}"),
            svg.rectangle(axis(lower), y - 7.0, axis(upper) - axis(lower), 14.0, f"box {tone}"),
            svg.line(axis(median), y - 7.0, axis(median), y + 7.0, f"median {tone}"),
        ]
    if len(values) <= _MOST_DOTS:
        # Beside one another, so that equal runs are seen: in an order that is no chance.
        shifts = ((np.arange(len(values)) * 0.618034) % 1.0 - 0.5) * 8.0
        if len(values) == 1:
            shifts = np.zeros(1)
        pairs = zip(values.tolist(), shifts.tolist(), strict=True)
        marks += [svg.dot(axis(value), y + shift, 2.0, f"dot {tone}") for value, shift in pairs]
    else:
        outside = np.setdiff1d(values, inside)
        marks += [svg.dot(axis(float(value)), y, 1.6, f"dot {tone}") for value in outside]
    return marks


def bands(title: str, found: Mapping[int, Band], systems: Sequence[str], wide: float = 520) -> str:
    """The errors over time: of each system the median over runs, and the middle half shaded."""
    heights = [each.quartiles[np.isfinite(each.quartiles)] for each in found.values()]
    every = np.concatenate([*heights, np.empty(0)])
    end = max(float(each.seconds[-1] + each.seconds[0]) for each in found.values())
    across = svg.Axis(0.0, end, 46.0, wide - 8.0)
    parts = [svg.text(0.0, 12.0, title, "name")]
    if not len(every):
        parts.append(svg.text(46.0, 60.0, "Half of the runs never have a pose at once.", "tick"))
        return svg.picture(wide, 80.0, parts, f"Errors over time, {title}")
    upwards = _axis(every, 190.0, 24.0, zero=True, positive=True)
    parts += svg.below(across, 190.0, 24.0, 6)
    parts += svg.beside(upwards, 46.0, wide - 8.0)
    lines = []
    for place, each in found.items():
        there = np.isfinite(each.quartiles[:, 1])
        for piece in svg.runs_of(there):
            seconds, values = each.seconds[piece].tolist(), each.quartiles[piece].tolist()
            if len(seconds) == 1:
                lines.append(svg.dot(across(seconds[0]), upwards(values[0][1]), 1.5, colour(place)))
                continue
            x = [across(second) for second in seconds]
            lower, middle, upper = ([upwards(row[k]) for row in values] for k in range(3))
            area = [*zip(x, upper, strict=True), *reversed([*zip(x, lower, strict=True)])]
            if each.runs > 1:
                parts.append(svg.path(area, f"band {colour(place)}", closed=True))
            drawn = svg.path([*zip(x, middle, strict=True)], f"curve {colour(place)}")
            lines.append(svg.with_title(systems[place], [drawn]))
    parts += lines
    parts.append(
        svg.text(
            (46.0 + wide) / 2, 217.0, "time from the ground truth's begin (s)", "tick", "middle"
        )
    )
    parts.append(svg.text(wide - 8.0, 12.0, "position error (m)", "tick", "end"))
    return svg.picture(wide, 222.0, parts, f"Errors over time, {title}")


def shares(figure: Figure, runs: Mapping[int, Runs], systems: Sequence[str]) -> str:
    """The share of runs with an error below a limit; runs that failed are below none."""
    finite = np.concatenate([each[np.isfinite(each)] for each in runs.values()] or [np.empty(0)])
    if not len(finite):
        return ""
    wide = 720.0
    values = finite * figure.factor
    low, high = float(values.min()), float(values.max())
    across = _wider(low, high, 52.0, wide - 12.0)
    upwards = svg.Axis(0.0, 100.0, 250.0, 16.0)
    parts = [*svg.below(across, 250.0, 16.0, 9), *svg.beside(upwards, 52.0, wide - 12.0)]
    for place, each in runs.items():
        good = np.sort(each[np.isfinite(each)] * figure.factor)
        points = [(across.begin, upwards(0.0))]
        for count, value in enumerate(good.tolist()):
            x = across(value)
            points.append((x, upwards(100.0 * count / len(each))))
            points.append((x, upwards(100.0 * (count + 1) / len(each))))
        points.append((across.end, upwards(100.0 * len(good) / len(each))))
        said = f"{systems[place]}: {len(good)} of {len(each)} runs evaluated"
        parts.append(svg.with_title(said, [svg.path(points, f"curve {colour(place)}")]))
    parts.append(
        svg.text((52.0 + wide) / 2, 280.0, f"{_titled(figure)}, at most", "tick", "middle")
    )
    parts.append(svg.text(52.0, 9.0, "runs (%)", "tick", "middle"))
    return svg.picture(wide, 286.0, parts, f"Share of runs with {figure.title} at most")


def ranks(title: str, found: Ranks, places: Sequence[int], systems: Sequence[str]) -> str:
    """A system a row, best first: its mean rank, in a bar as wide as the critical difference.

    Two are told apart where their bars do not overlap.
    """
    wide = 360.0
    left = _margin(systems[place] for place in places)
    bottom = 24.0 + _ROW * len(places)
    half = 0.5 * found.critical_difference
    low = min(1.0, float(found.mean.min()) - half)
    high = max(float(len(places)), float(found.mean.max()) + half)
    axis = svg.Axis(low, high, left, wide - 10.0)
    parts = [svg.text(0.0, 12.0, title, "name")]
    for value in range(1, len(places) + 1, 1 + len(places) // 9):
        parts.append(svg.line(axis(value), 20.0, axis(value), bottom, "grid"))
        parts.append(svg.text(axis(value), bottom + 13.0, str(value), "tick", "middle"))
    for row, at in enumerate(np.argsort(found.mean, kind="stable").tolist()):
        y, mean, place = 24.0 + _ROW * (row + 0.5), float(found.mean[at]), places[at]
        parts.append(svg.text(left - 8.0, y + 4.0, _short(systems[place]), "label", "end"))
        begin, end = axis(mean - half), axis(mean + half)
        marks = [
            svg.rectangle(begin, y - 4.0, end - begin, 8.0, f"box {colour(place)}"),
            svg.dot(axis(mean), y, 4.0, f"dot {colour(place)}"),
        ]
        parts.append(svg.with_title(f"{systems[place]}: {mean:.2f}", marks))
    parts.append(
        svg.text((left + wide) / 2, bottom + 27.0, "mean rank (1 is best)", "tick", "middle")
    )
    return svg.picture(wide, bottom + 32.0, parts, f"Mean ranks by {title}")


def colour(place: int) -> str:
    """The class of a system's colour; a page has ten, and then again the first."""
    return f"s{place % 10}"


def _titled(figure: Figure) -> str:
    return f"{figure.title} ({figure.unit})"


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}…"


def _margin(names: Iterable[str]) -> float:
    longest = max((len(_short(name)) for name in names), default=0)
    return 10.0 + _CHARACTER * max(longest, 4)


def _axis(values: Runs, begin: float, end: float, *, zero: bool, positive: bool) -> svg.Axis:
    """Logarithmic where ``positive`` values are far apart; else from ``zero``, or the least one."""
    low, high = float(values.min()), float(values.max())
    if positive and low > 0.0 and float(np.quantile(values, 0.9)) > _FAR_APART * low:
        return _wider(low, high, begin, end)
    if zero:
        return svg.Axis(0.0, 1.04 * high if high > 0.0 else 1.0, begin, end)
    margin = 0.06 * (high - low) or 0.02 * abs(high) or 1.0
    return svg.Axis(low - margin, high + margin, begin, end)


def _wider(low: float, high: float, begin: float, end: float) -> svg.Axis:
    """A logarithmic axis with room on both sides, also around a single value."""
    low, high = max(low, 1e-12), max(high, 1e-12)
    room = max((high / low) ** 0.04, 1.05)
    if high / low < 2.0:
        room = 1.5
    return svg.Axis(low / room, high * room, begin, end, logarithmic=True)
