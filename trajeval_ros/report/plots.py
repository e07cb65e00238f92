# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report's figures, as SVG to stand in the page. This module and boxes know matplotlib."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator
from scipy.special import chdtri

from trajeval_ros.online.coverage import Way
from trajeval_ros.report.coverage import SECOND, Coverage, Gap
from trajeval_ros.report.run import Run
from trajeval_ros.report.series import (
    Series,
    coverage_gaps,
    offset,
    rate_of,
    upwards,
    vertical_axis,
)

Array = npt.NDArray[np.float64]

INK = "#1d2733"
_MUTED = "#66727f"
_GRID = "#e3e7eb"
_TRUTH = "#c3cad1"
ESTIMATE = "#1769aa"
_ABSOLUTE = "#c2560c"
_BAND = "#7fbf8e"
_GAP = "#f3d9d4"
_COLOURS = 24
_AXES = ("#b3403a", "#3f8f55", "#3563ab")
# The ground truth where there is no estimate: dotted, below all else.
_WHOLE: Any = {"color": "#8f9aa5", "linewidth": 1.0, "linestyle": (0, (1, 1.6)), "zorder": 1}
# On a linear scale the usual error is to be seen beside the largest.
_MOST_TIMES_THE_USUAL = 40.0
# Labels this near (of the picture's extent) share one place.
_TOGETHER = 0.06

# matplotlib types the names of its settings one by one.
STYLE: Any = {
    # Laid out in the font that matplotlib brings; the page shows its own, narrower one.
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 6.0,
    "axes.labelsize": 9.0,
    "axes.labelcolor": _MUTED,
    "axes.edgecolor": "#b8c0c8",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": _GRID,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": _MUTED,
    "ytick.color": _MUTED,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.3,
    "svg.fonttype": "none",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


def trajectory(run: Run, series: Series) -> str:
    """From above and in height, coloured by the absolute error."""
    up = vertical_axis(series.ground_truth)
    across, along = (axis for axis in range(3) if axis != up)
    sign = upwards(up)
    names = "xyz"
    colours = {
        "cmap": mpl.colormaps["viridis"],
        "norm": _colour_scale(series.translation_error),
    }
    with mpl.rc_context(STYLE):
        # Places by hand: finding them takes matplotlib longer than drawing.
        figure = Figure(figsize=(10.2, 4.7))
        plan, height = figure.subplots(
            1,
            2,
            width_ratios=(1.15, 1.0),
            gridspec_kw={"left": 0.04, "right": 0.885, "bottom": 0.1, "top": 0.93, "wspace": 0.16},
        )
        _draw_whole(plan, run, across, along)
        _draw_path(plan, series, across, along, colours)
        plan.set_aspect("equal", adjustable="datalim")
        plan.set_title(f"From above: {names[across]}, {names[along]} in metres")
        _label_ends(plan, series, across, along)

        spread = 2.0 * np.sqrt(series.position_covariance[:, up, up])
        truth = sign * series.ground_truth[:, up]
        _shade_gaps(height, series, coverage_gaps(run.ground_truth))
        if run.way is not None and len(run.way.stamps):
            seconds = (run.way.stamps - series.start) / SECOND
            height.plot(seconds, sign * run.way.positions[:, up], **_WHOLE)
        for piece in _pieces(series):
            height.fill_between(
                series.seconds[piece],
                (truth - spread)[piece],
                (truth + spread)[piece],
                color=_BAND,
                alpha=0.55,
                linewidth=0,
            )
            height.plot(series.seconds[piece], truth[piece], color=_TRUTH, linewidth=3.0)
        lines = _coloured(
            np.stack([series.seconds, sign * series.estimate[:, up]], axis=1), series, colours
        )
        height.add_collection(lines)
        height.autoscale_view()
        height.set_xlim(0.0, max(series.end, 1e-3))
        minus = "" if sign > 0.0 else "−"
        height.set_title(f"Height: {minus}{names[up]} in metres over time")
        height.set_xlabel("time, s")
        bar = figure.colorbar(lines, cax=figure.add_axes((0.91, 0.2, 0.018, 0.6)), extend="max")
        bar.outline.set_visible(False)
        bar.set_label(f"{_kind(series)}, translation, m")
        return svg(figure, "trajectory")


def _draw_whole(axes: Any, run: Run, across: int, along: int) -> None:
    """All of the ground truth, so that it shows where there is no estimate."""
    if run.way is not None and len(run.way.stamps):
        axes.plot(run.way.positions[:, across], run.way.positions[:, along], **_WHOLE)


def _kind(series: Series) -> str:
    """What the errors are called."""
    return "ATE" if series.is_ate else "error, aligned by likelihood"


def _draw_path(axes: Any, series: Series, across: int, along: int, colours: Any) -> None:
    for piece in _pieces(series):
        axes.plot(
            series.ground_truth[piece, across],
            series.ground_truth[piece, along],
            color=_TRUTH,
            linewidth=3.0,
            solid_capstyle="round",
        )
    _draw_ellipses(axes, series, across, along)
    axes.add_collection(_coloured(series.estimate[:, [across, along]], series, colours))
    axes.autoscale_view()


def _draw_ellipses(axes: Any, series: Series, across: int, along: int) -> None:
    """Two standard deviations of the ground truth, where they are large enough to be seen."""
    plane = series.position_covariance[:, [across, along]][:, :, [across, along]]
    values, vectors = np.linalg.eigh(plane)
    extent = float(np.ptp(series.ground_truth[:, [across, along]], axis=0).max())
    large = np.flatnonzero(4.0 * np.sqrt(values[:, 1]) > 0.004 * extent)
    shown = large[:: max(1, len(large) // 300)]
    axes.add_collection(
        EllipseCollection(
            4.0 * np.sqrt(values[shown, 1]),
            4.0 * np.sqrt(values[shown, 0]),
            np.degrees(np.arctan2(vectors[shown, 1, 1], vectors[shown, 0, 1])),
            units="xy",
            offsets=series.ground_truth[shown][:, [across, along]],
            offset_transform=axes.transData,
            facecolor=_BAND,
            edgecolor="#3f8f55",
            linewidth=0.4,
            alpha=0.25,
        )
    )


def _label_ends(axes: Any, series: Series, across: int, along: int) -> None:
    worst = series.worst
    extent = float(np.ptp(series.estimate[:, [across, along]], axis=0).max())
    middle = np.median(series.estimate[:, across])
    # Those at one place share a label, or they would be printed over one another.
    labels: list[tuple[Array, str]] = []
    for index, text, marker in (
        (0, "start", "o"),
        (-1, "end", "s"),
        (worst, f"worst: {series.translation_error[worst]:.3g} m", "v"),
    ):
        place = series.estimate[index, [across, along]]
        axes.plot(*place, marker, color=INK, markersize=5, markerfacecolor="white")
        for number, (other, said) in enumerate(labels):
            if np.linalg.norm(place - other) <= _TOGETHER * extent:
                labels[number] = (other, f"{said}, {text}")
                break
        else:
            labels.append((place, text))
    for place, text in labels:
        # Towards the middle of the picture, so that nothing is cut off.
        left = place[0] > middle
        axes.annotate(
            text,
            place,
            xytext=(-7 if left else 7, 5),
            textcoords="offset points",
            horizontalalignment="right" if left else "left",
            fontsize=8.5,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.8, "linewidth": 0},
        )


def over_time(run: Run, series: Series) -> str:
    """Errors, as a whole and by axes, log-likelihoods, χ² and coverage on one time axis."""
    gaps = coverage_gaps(run.ground_truth)
    with mpl.rc_context(STYLE):
        # χ² by steps is the relative likelihood's, which does not know a scale.
        scaled = run.summary["gauge"] == "sim3"
        heights = (1.2, 1.0, 1.2, 1.0, 1.0, 1.0, *(() if scaled else (1.0,)), 0.9)
        figure = Figure(figsize=(10.2, 1.9 * sum(heights)))
        panels = figure.subplots(
            len(heights),
            1,
            sharex=True,
            height_ratios=heights,
            gridspec_kw={
                "left": 0.065,
                "right": 0.99,
                "bottom": 0.045,
                "top": 0.985,
                "hspace": 0.26,
            },
        )
        kind = _kind(series)
        degrees = np.degrees(series.rotation_error), np.degrees(series.rotation_band)
        _draw_error(panels[0], series, series.translation_error, series.translation_band)
        _title(panels[0], f"{kind}, translation, m")
        _draw_axes(panels[1], series, series.translation_axes)
        panels[1].set_title("The same along the world's axes, m")
        _draw_error(panels[2], series, *degrees)
        _title(panels[2], f"{kind}, rotation, degrees")
        _draw_axes(panels[3], series, np.degrees(series.rotation_axes))
        panels[3].set_title("The same about the world's axes, degrees")
        _draw_likelihoods(panels[4], panels[5], run, series)
        if not scaled:
            _draw_chi2(panels[6], run, series)
        _draw_coverage(panels[-1], run, series)
        for axes in panels:
            _shade_gaps(axes, series, gaps)
            axes.set_xlim(0.0, max(series.end, 1e-3))
            axes.tick_params(labelbottom=axes is panels[-1])
        below = ""
        if run.way is not None and len(run.way.stamps) > 1:
            panels[-1].xaxis.set_major_formatter(FuncFormatter(_with_distance(run.way, series)))
            below = " (below: distance along the ground truth)"
        panels[-1].set_xlabel(f"time, s{below}; shaded: no ground truth")
        return svg(figure, "time")


def _with_distance(way: Way, series: Series) -> Callable[[float, object], str]:
    """Labels of the time axis with the distance that the ground truth has gone by then."""
    stamps = (way.stamps - series.start) / SECOND

    def label(seconds: float, _: object) -> str:
        distance = float(np.interp(seconds, stamps, way.lengths))
        return (
            f"{seconds:g}\n{distance:,.0f} m"
            if distance >= 100.0
            else (f"{seconds:g}\n{distance:.3g} m")
        )

    return label


def _title(axes: Any, text: str) -> None:
    logarithmic = " (logarithmic)" if axes.get_yscale() == "log" else ""
    axes.set_title(f"{text}{logarithmic}")


def _draw_error(axes: Any, series: Series, error: Array, band: Array) -> None:
    """An error and the band of what the ground truth is known to, on a scale made for the error."""
    largest, usual = float(error.max()), float(np.median(error))
    logarithmic = largest > _MOST_TIMES_THE_USUAL * usual > 0.0
    low = 0.3 * float(np.quantile(error[error > 0.0], 0.02)) if logarithmic else 0.0
    high = (2.0 if logarithmic else 1.08) * max(largest, 1.5 * float(np.median(band)), 1e-9)
    for count, piece in enumerate(_pieces(series)):
        axes.fill_between(
            series.seconds[piece],
            low,
            np.clip(band[piece], low, high),
            color=_BAND,
            alpha=0.6,
            linewidth=0,
            label="ground truth known to, two standard deviations" if count == 0 else None,
        )
        axes.plot(
            series.seconds[piece],
            error[piece],
            color=ESTIMATE,
            label="error of the estimate" if count == 0 else None,
        )
    if logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(numticks=7))
        axes.minorticks_off()
    axes.set_ylim(low, high)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    _legend(axes)


def _draw_axes(axes: Any, series: Series, errors: Array) -> None:
    """Errors (B, 3) by the world's axes."""
    for axis, (name, colour) in enumerate(zip("xyz", _AXES, strict=True)):
        for count, piece in enumerate(_pieces(series)):
            axes.plot(
                series.seconds[piece],
                errors[piece, axis],
                color=colour,
                linewidth=1.0,
                label=name if count == 0 else None,
            )
    axes.axhline(0.0, color=_GRID, linewidth=1.0)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    _legend(axes, columns=3)


def _draw_likelihoods(running: Any, windowed: Any, run: Run, series: Series) -> None:
    duration = run.parameters["window.duration"]
    for axes, relative, absolute, title in (
        (
            running,
            series.relative_log_likelihood,
            series.absolute_log_likelihood,
            "Log-likelihood since the start, nats",
        ),
        (
            windowed,
            series.window_relative,
            series.window_absolute,
            f"Log-likelihood gained within {duration:g} s, given all before, nats",
        ),
    ):
        # The relative one lies under the absolute one where they are the same, as they often are.
        if run.summary["gauge"] != "sim3":
            axes.plot(series.ends, relative, color=ESTIMATE, linewidth=2.6, label="relative")
        axes.plot(series.ends, absolute, color=_ABSOLUTE, linewidth=1.1, label="absolute")
        axes.set_title(title)
        axes.yaxis.set_major_formatter(FuncFormatter(_compact))
        _legend(axes)


def _draw_chi2(axes: Any, run: Run, series: Series) -> None:
    known = series.window_dof > 6.0
    seconds, dof = series.ends[known], series.window_dof[known]
    low, high = (chdtri(dof, tail) / dof for tail in (0.995, 0.005))
    axes.fill_between(
        seconds,
        low,
        high,
        color=_BAND,
        alpha=0.8,
        linewidth=0,
        label="as good as the ground truth (99 % of such windows)",
    )
    axes.axhline(1.0, color="#3f8f55", linewidth=0.7)
    axes.plot(seconds, series.window_chi2[known] / dof, color=ESTIMATE, label="relative")
    axes.set_yscale("log")
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(FuncFormatter(_compact))
    duration = run.parameters["window.duration"]
    axes.set_title(f"χ²/dof gained within {duration:g} s, given all before (logarithmic)")
    _legend(axes)


def _draw_coverage(axes: Any, run: Run, series: Series) -> None:
    topics: Sequence[tuple[Coverage, int, str, str]] = (
        (run.ground_truth, 0, "#4f5b67", "ground truth"),
        (run.estimate, offset(run), ESTIMATE, "estimate"),
    )
    for coverage, shift, colour, label in topics:
        edges, rate = rate_of(coverage, series.start, series.end, shift)
        axes.stairs(rate, edges, color=colour, fill=True, alpha=0.18)
        axes.stairs(rate, edges, color=colour, linewidth=1.2, label=label)
    axes.set_ylim(bottom=0.0)
    axes.set_title("Coverage: messages a second")
    _legend(axes)


def _legend(axes: Any, columns: int = 2) -> None:
    """Beside the title, where no curve runs."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=columns)


def _shade_gaps(axes: Any, series: Series, gaps: Sequence[Gap]) -> None:
    for gap in gaps:
        axes.axvspan(
            (gap.start - series.start) / SECOND,
            (gap.end - series.start) / SECOND,
            color=_GAP,
            linewidth=0,
            zorder=0,
        )


def _pieces(series: Series) -> list[slice]:
    """The stretches between which nothing was scored."""
    edges = [0, *series.breaks.tolist(), len(series.seconds)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def _colour_scale(error: Array) -> Any:
    return mpl.colors.Normalize(0.0, max(float(np.quantile(error, 0.98)), 1e-9))


def _coloured(points: Array, series: Series, colours: Any) -> LineCollection:
    """A line through ``points`` (B, 2) in the colour of its error, in steps of colour.

    A stretch of one colour is one path: a tenth of the size of a path a step.
    """
    norm = colours["norm"]
    error = np.maximum(series.translation_error[:-1], series.translation_error[1:])
    level = np.minimum((error / norm.vmax * _COLOURS).astype(int), _COLOURS)
    level[series.breaks - 1] = -1
    starts = np.flatnonzero(np.diff(level, prepend=-2))
    ends = np.append(starts, len(level))[1:]
    stretches = [(a, b) for a, b in zip(starts, ends, strict=True) if level[a] >= 0]
    lines = LineCollection(
        [points[a : b + 1] for a, b in stretches],
        linewidths=1.6,
        capstyle="round",
        joinstyle="round",
        **colours,
    )
    shown = np.array([level[a] for a, _ in stretches])
    lines.set_array((shown + 0.5) / _COLOURS * norm.vmax)
    return lines


def _compact(value: float, _: object) -> str:
    """-12,300,000 as -12.3M."""
    for size, suffix in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g}{suffix}"
    return f"{value:g}"


def svg(figure: Figure, name: str) -> str:
    """Return the figure as an SVG element whose ids are its own."""
    with mpl.rc_context({"svg.hashsalt": name}):
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Several figures stand in one page: ids, and what refers to them, get the figure's name.
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    # The size is the page's affair; viewBox keeps the proportions.
    return re.sub(
        r'<svg ([^>]*?)width="[^"]*" ?',
        r"<svg \1",
        re.sub(r' height="[\d.]+pt"', "", text, count=1),
        count=1,
    )
