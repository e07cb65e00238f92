# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of a paper: PDF and SVG in the widths of a column and of two. Needs matplotlib.

Text stays text: Type 42 fonts in PDF, as conferences ask for, and text elements in SVG. The colours
are those of Okabe and Ito, told apart also by the colour-blind; each has a dash pattern besides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.comparison.compare import Evaluated
from trajeval_ros.comparison.errors import errors_of, steps
from trajeval_ros.files.partial import remove_leftovers, replacing
from trajeval_ros.online.ate import ate_errors
from trajeval_ros.online.settings import EvaluationSettings
from trajeval_ros.report.series import vertical_axis
from trajeval_ros.report.track import Records

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
    "font.serif": ["STIXGeneral", "DejaVu Serif"],
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


@dataclass(frozen=True)
class Curves:
    """What is drawn of an estimate; angles in degrees, times in ns on the ground truth's clock.

    ``stamps`` (M,) with ``ground_truth`` and ``estimate`` (M, 3), aligned as for ATE, whose errors
    are ``translation`` and ``rotation`` (M,); ``known_at`` (B,) with two standard deviations of the
    ground truth, ``known`` (translation, rotation); ``steps_end`` (K,) with the errors of the steps
    that end there, ``re`` (translation, rotation). NaN where there is none.
    """

    name: str
    stamps: npt.NDArray[np.int64]
    ground_truth: Array
    estimate: Array
    ate: tuple[Array, Array]
    known_at: npt.NDArray[np.int64]
    known: tuple[Array, Array]
    steps_end: npt.NDArray[np.int64]
    re: tuple[Array, Array]
    re_step: str

    @property
    def has_rotation(self) -> bool:
        """Whether the orientations mean something."""
        return bool(np.isfinite(self.ate[1]).any())


def curves(
    evaluated: Evaluated,
    summary: Mapping[str, Any],
    buckets: Records,
    settings: EvaluationSettings,
    offset: int,
) -> Curves | None:
    """Compute them from the poses of an estimate; None where it has no ATE.

    ``offset`` (ns): what is added to the stamps of ``buckets``.
    """
    conventional = summary["conventional"]
    if len(evaluated) == 0 or conventional.get("ate_translation_rmse") is None:
        return None
    found = conventional["alignment"]
    pose = np.array(found["pose"])
    alignment = Similarity(se3.from_position_quaternion(pose[:3], pose[3:]), found["scale"])
    translation, rotation = ate_errors(conventional, evaluated.ground_truth, evaluated.estimate)
    delta, unit = settings.relative_delta, settings.relative_unit
    begin, end = steps(evaluated, delta, unit)
    errors = errors_of(evaluated, begin, end, settings.gauge.name, delta, unit)
    nothing = np.full(len(end), np.nan)
    turned = conventional.get("re_rotation_rmse") is not None
    spread = [
        2.0 * np.sqrt(np.linalg.eigvalsh(buckets["covariance"][:, part, part])[:, -1])
        for part in (slice(3), slice(3, None))
    ]
    return Curves(
        name=evaluated.name,
        stamps=evaluated.stamps,
        ground_truth=evaluated.ground_truth[:, :3, 3],
        estimate=alignment.apply(evaluated.estimate)[:, :3, 3],
        ate=(translation, np.degrees(rotation)),
        known_at=buckets["stamp"] + offset,
        known=(spread[0], np.degrees(spread[1])),
        steps_end=evaluated.stamps[end],
        re=(
            nothing if errors.re_translation is None else errors.re_translation,
            np.degrees(errors.re_rotation) if turned else nothing,
        ),
        re_step=f"{delta:g} {unit if unit != 'f' else 'poses'}",
    )


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
            *_line(places[:, across], places[:, along], _breaks(one.stamps)), **look, label=one.name
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

    return _over_time(drawn, width, lambda one: (one.stamps, one.ate), "", band)


def relative_error(drawn: Sequence[Curves], width: float) -> Figure:
    """The errors of the steps of RE over time, at the end of each."""
    over = f" over {drawn[0].re_step}"
    return _over_time(drawn, width, lambda one: (one.steps_end, one.re), over, None)


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
    over: str,
    band: Callable[[Any, int, int], None] | None,
) -> Figure:
    rotation = any(one.has_rotation for one in drawn)
    rows = 2 if rotation else 1
    figure = Figure(figsize=(width, 0.5 + rows * (1.15 if width < 5 else 1.25)))
    panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    start = min(int(one.stamps[0]) for one in drawn)
    titles = (f"translation{over} (m)", f"rotation{over} (°)")
    for part, (axes, title) in enumerate(zip(panels, titles, strict=False)):
        if band is not None:
            band(axes, part, start)
        largest = 0.0
        for one, look in zip(drawn, _looks(drawn), strict=True):
            stamps, both = values(one)
            stamps, errors = _largest(stamps, both[part])
            if not np.isfinite(errors).any():
                continue
            seconds = (stamps - start) / _SECOND
            axes.plot(*_line(seconds, errors, _breaks(stamps)), **look, label=one.name)
            largest = max(largest, float(np.nanmax(errors)))
        # Of the errors: in a gap of the ground truth its band reaches far beyond them.
        axes.set_ylim(0.0, 1.08 * largest if largest > 0.0 else 1.0)
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


def _largest(stamps: npt.NDArray[np.int64], values: Array) -> tuple[npt.NDArray[np.int64], Array]:
    """The largest value of each of at most so many stretches, and its stamp."""
    size = -(-len(values) // _POINTS)
    if size <= 1:
        return stamps, values
    padding = -len(values) % size
    rows = np.concatenate([np.nan_to_num(values, nan=-1.0), np.full(padding, -1.0)])
    chosen = np.argmax(rows.reshape(-1, size), axis=1) + size * np.arange(len(rows) // size)
    return stamps[chosen], values[chosen]


def _breaks(stamps: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Before which points a line is broken: there was nothing for long."""
    gaps = np.diff(stamps)
    if len(gaps) == 0:
        return np.empty(0, np.intp)
    return np.flatnonzero(gaps > max(10.0 * float(np.median(gaps)), 0.5 * _SECOND)) + 1


def _breaks_of(drawn: Sequence[Curves], positions: Array) -> npt.NDArray[np.intp]:
    return next(_breaks(one.stamps) for one in drawn if one.ground_truth is positions)


def _line(x: Array, y: Array, breaks: npt.NDArray[np.intp]) -> tuple[Array, Array]:
    """The points with a hole at each break."""
    return np.insert(x, breaks, np.nan), np.insert(y, breaks, np.nan)
