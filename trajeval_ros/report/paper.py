# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of a paper: PDF and SVG in the widths of a column and of two. Needs matplotlib.

Text stays text: Type 42 fonts in PDF, as conferences ask for, and text elements in SVG. The colours
are those of Okabe and Ito, told apart also by the colour-blind; each has a dash pattern besides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from trajeval_ros.files.partial import remove_leftovers, replacing
from trajeval_ros.report.curves import Curves, breaks, largest
from trajeval_ros.report.series import vertical_axis

Array = npt.NDArray[np.float64]

WIDTHS = {"single": 3.5, "double": 7.16}
"""Widths in inches: a column, and two with the gap between them (IEEE's; others' are near)."""

_SECOND = 1_000_000_000
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (5, 1, 1, 1)))
_TRUTH, _BAND, _GRID = "#000000", "#BBBBBB", "#DDDDDD"
# A curve has at most so many points, the largest of each stretch.
_POINTS = 2000
_STYLE: Any = {
    "font.family": "serif",
    # The first is drawn with; an SVG's text has those of whoever looks at it.
    "font.serif": ["STIXGeneral", "Times New Roman", "Times", "Liberation Serif", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": _GRID,
    "grid.linewidth": 0.4,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "lines.linewidth": 1.0,
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "none",
    # The same run gives the same files.
    "svg.hashsalt": "trajeval_ros",
    "figure.constrained_layout.use": True,
}


def write_figures(folder: Path, drawn: Sequence[Curves]) -> tuple[str, ...]:
    """Write ``<figure>_<width>.pdf`` and ``.svg`` to the folder; return the names.

    The figures: ``trajectory``, ``error``, ``relative_error``, and with several ``comparison``.
    Each file appears whole. Raises OSError where one cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder, ".*.pdf.*.partial", ".*.svg.*.partial")
    makers: dict[str, Callable[[Sequence[Curves], float], Figure]] = {
        "trajectory": trajectory,
        "error": error,
        "relative_error": relative_error,
    }
    if len(drawn) > 1:
        makers["comparison"] = comparison
    names = []
    with mpl.rc_context(_STYLE):
        for name, make in makers.items():
            for width, inches in WIDTHS.items():
                figure = make(drawn, inches)
                for kind, dated in (("pdf", "CreationDate"), ("svg", "Date")):
                    path = folder / f"{name}_{width}.{kind}"
                    _save(figure, path, kind, {dated: None})
                    names.append(path.name)
    return tuple(names)


def _save(figure: Figure, path: Path, kind: str, metadata: Mapping[str, None]) -> None:
    with replacing(path) as file:
        figure.savefig(file, format=kind, metadata=metadata)


def trajectory(drawn: Sequence[Curves], width: float) -> Figure:
    """From above, each estimate aligned to the ground truth as for its ATE."""
    positions = max((one.ground_truth for one in drawn), key=len)
    up = vertical_axis(positions)
    across, along = (axis for axis in range(3) if axis != up)
    extent = np.ptp(np.concatenate([one.ground_truth for one in drawn]), axis=0)
    shape = float(np.clip(extent[along] / max(extent[across], 1e-9), 0.35, 1.0))
    figure = Figure(figsize=(width, 0.4 + 0.12 * len(drawn) + 0.85 * width * shape))
    axes = figure.subplots()
    axes.plot(
        *_line(positions[:, across], positions[:, along], _breaks_of(drawn, positions)),
        color=_TRUTH,
        linewidth=1.6,
        alpha=0.55,
        label="ground truth",
    )
    for one, look in zip(drawn, _looks(drawn), strict=True):
        places = one.estimate
        axes.plot(
            *_line(places[:, across], places[:, along], breaks(one.stamps)), **look, label=one.name
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"$\\mathit{{{'xyz'[across]}}}$ (m)")
    axes.set_ylabel(f"$\\mathit{{{'xyz'[along]}}}$ (m)")
    _legend(figure, axes)
    return figure


def error(drawn: Sequence[Curves], width: float) -> Figure:
    """The absolute errors over time, with what the ground truth is known to."""

    def band(axes: Any, part: int, start: int) -> None:
        # The ground truth is one, and this is its band where the most is known of it.
        widest = max(drawn, key=lambda one: len(one.known_at))
        seconds = (widest.known_at - start) / _SECOND
        axes.fill_between(
            seconds, 0.0, widest.known[part], color=_BAND, linewidth=0, label="ground truth, 2 σ"
        )

    titles = ("translation (m)", "rotation (°)")
    return _over_time(drawn, width, lambda one: (one.stamps, one.ate), titles, band)


def relative_error(drawn: Sequence[Curves], width: float) -> Figure:
    """The errors of the steps of RE over time, at the end of each."""
    titles = tuple(f"RE over {drawn[0].re_step} ({unit})" for unit in ("m", "°"))
    return _over_time(drawn, width, lambda one: (one.steps_end, one.re), titles, None)


def comparison(drawn: Sequence[Curves], width: float) -> Figure:
    """The share of the poses whose absolute error is below a value, for each estimate."""
    rotation = any(one.has_rotation for one in drawn)
    figure = Figure(figsize=(width, 0.62 * width if rotation and width < 5 else 0.4 * width))
    panels = figure.subplots(1, 2 if rotation else 1, sharey=True, squeeze=False)[0]
    titles = ("translation error (m)", "rotation error (°)")
    for part, (axes, title) in enumerate(zip(panels, titles, strict=False)):
        for one, look in zip(drawn, _looks(drawn), strict=True):
            values = np.sort(one.ate[part][np.isfinite(one.ate[part])])
            if len(values):
                share = np.linspace(0.0, 1.0, min(len(values), _POINTS))
                axes.plot(np.quantile(values, share), 100.0 * share, **look, label=one.name)
        axes.set_xlim(left=0.0)
        axes.set_ylim(0.0, 100.0)
        axes.set_xlabel(title)
    panels[0].set_ylabel("poses (%)")
    _legend(figure, panels[0])
    return figure


def _over_time(
    drawn: Sequence[Curves],
    width: float,
    values: Callable[[Curves], tuple[npt.NDArray[np.int64], tuple[Array, Array]]],
    titles: tuple[str, ...],
    band: Callable[[Any, int, int], None] | None,
) -> Figure:
    rotation = any(one.has_rotation for one in drawn)
    rows = 2 if rotation else 1
    figure = Figure(figsize=(width, 0.5 + rows * (1.15 if width < 5 else 1.25)))
    panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    start = min(int(one.stamps[0]) for one in drawn)
    for part, (axes, title) in enumerate(zip(panels, titles, strict=False)):
        if band is not None:
            band(axes, part, start)
        highest = 0.0
        for one, look in zip(drawn, _looks(drawn), strict=True):
            stamps, both = values(one)
            stamps, errors = largest(stamps, both[part], _POINTS)
            if not np.isfinite(errors).any():
                continue
            seconds = (stamps - start) / _SECOND
            axes.plot(*_line(seconds, errors, breaks(stamps)), **look, label=one.name)
            highest = max(highest, float(np.nanmax(errors)))
        # Of the errors: in a gap of the ground truth its band reaches far beyond them.
        axes.set_ylim(0.0, 1.08 * highest if highest > 0.0 else 1.0)
        axes.set_ylabel(title)
    end = max(int(one.stamps[-1]) for one in drawn)
    panels[-1].set_xlim(0.0, max((end - start) / _SECOND, 1e-3))
    panels[-1].set_xlabel("time (s)")
    figure.align_ylabels(panels)
    _legend(figure, panels[0])
    return figure


def _looks(drawn: Sequence[Curves]) -> list[dict[str, Any]]:
    return [
        {
            "color": _COLOURS[number % len(_COLOURS)],
            "linestyle": _DASHES[number % len(_DASHES)],
        }
        for number in range(len(drawn))
    ]


def _legend(figure: Figure, axes: Any) -> None:
    handles, labels = axes.get_legend_handles_labels()
    columns = 3 if figure.get_figwidth() < 5 else 5
    figure.legend(
        handles,
        labels,
        loc="outside upper center",
        ncols=min(len(labels), columns),
        borderaxespad=0.2,
        columnspacing=1.2,
    )


def _breaks_of(drawn: Sequence[Curves], positions: Array) -> npt.NDArray[np.intp]:
    return next(breaks(one.stamps) for one in drawn if one.ground_truth is positions)


def _line(x: Array, y: Array, breaks: npt.NDArray[np.intp]) -> tuple[Array, Array]:
    """The points with a hole at each break."""
    return np.insert(x, breaks, np.nan), np.insert(y, breaks, np.nan)
