# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run as a recording for Rerun: trajectories, the ground truth's uncertainty, errors over time.

Written with the library rerun-sdk, the extra ``rerun``, and with a blueprint, so that the viewer
opens it as it is meant: the map, the errors beside it, and the answer in words.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.files.partial import workshop
from trajeval_ros.online.coverage import Way
from trajeval_ros.report.curves import Curves, breaks
from trajeval_ros.report.series import upwards, vertical_axis
from trajeval_ros.report.track import Records
from trajeval_ros.runs.trail import DEVIATIONS, SMALLEST, ellipsoids

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_SECOND = 1_000_000_000
_APPLICATION = "trajeval_ros"
RUN, STAMP = "run", "stamp"
"""The time lines: seconds from the first pose, and the stamps themselves."""
TRUTH = "world/ground_truth"
_TRUTH_COLOUR = (120, 130, 140)
_KNOWN_COLOUR = (47, 125, 70)
# Those of Okabe and Ito, told apart also by the colour-blind.
_COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0))
# A path is drawn with at most so many points.
_POINTS = 5000
# Of ellipsoids of the run so many, where they are larger than this share of its extent.
_ELLIPSOIDS = 80
_SEEN = 2e-3
# The viewer has 32-bit coordinates, which beyond this far (m) are off by a millimetre.
_FAR = 1e4


class RecordingError(Exception):
    """The recording cannot be written; the message is one line."""


@dataclass(frozen=True)
class Shown:
    """One estimate: its `Curves`, and poses (M, 4, 4) at their stamps in the ground truth's world.

    ``buckets``: of the run, with the ground truth's covariance.
    """

    curves: Curves
    ground_truth: Array
    estimate: Array
    buckets: Records

    @property
    def name(self) -> str:
        """What it is called."""
        return self.curves.name


def library() -> Any:
    """The library.

    Raises
    ------
    RecordingError
        If it is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise RecordingError(
            f"writing it needs the library rerun-sdk ({error}): pip install rerun-sdk"
        ) from None
    return rerun


def write_recording(path: Path, way: Way | None, shown: Sequence[Shown], said: str) -> None:
    """Write the file: a reader sees the old one or the new one.

    ``way``: the ground truth's, also where there is no estimate; ``said``: the answer in words,
    Markdown.

    Raises
    ------
    RecordingError
        If the library is not installed, or the file cannot be written.
    """
    rerun = library()
    path = path.absolute()
    try:
        with workshop(path) as folder:
            partial = folder / path.name
            stream = rerun.RecordingStream(_APPLICATION)
            stream.save(partial, default_blueprint=_blueprint(shown))
            _Recording(rerun, stream, way, shown).log(said)
            stream.flush()
            stream.disconnect()
            if not partial.stat().st_size:
                raise RecordingError(f"cannot write {path}: nothing was written")
            os.replace(partial, path)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error


class _Recording:
    """What is logged, entity by entity."""

    def __init__(self, rerun: Any, stream: Any, way: Way | None, shown: Sequence[Shown]) -> None:
        self._rerun = rerun
        self._stream = stream
        self._way = way
        self._shown = shown
        self._start = min(int(one.curves.stamps[0]) for one in shown)
        self._origin = _origin(shown)
        self._size = _extent(shown)

    def log(self, said: str) -> None:
        """Log all of it."""
        rerun = self._rerun
        moved = ""
        if self._origin.any():
            moved = "\n\nThe origin of the map is " + ", ".join(f"{x:.0f}" for x in self._origin)
        self._static("said", rerun.TextDocument(said + moved, media_type="text/markdown"))
        # A camera's y points down.
        down = vertical_axis(self._shown[0].ground_truth[:, :3, 3]) == 1
        axes = rerun.ViewCoordinates.RDF if down else rerun.ViewCoordinates.RIGHT_HAND_Z_UP
        self._static("world", axes)
        self._log_truth()
        for one, colour in zip(self._shown, _repeated(_COLOURS, len(self._shown)), strict=True):
            self._log_estimate(one, colour)

    def _log_truth(self) -> None:
        widest = max(self._shown, key=lambda one: len(one.curves.stamps))
        stamps, positions = widest.curves.stamps, widest.ground_truth[:, :3, 3]
        if self._way is not None and len(self._way.stamps) > 1:
            stamps, positions = self._way.stamps, self._way.positions
        self._log_path(f"{TRUTH}/path", stamps, positions, _TRUTH_COLOUR)
        self._log_poses(f"{TRUTH}/pose", widest.curves.stamps, widest.ground_truth)
        self._log_uncertainty(widest)
        at = widest.curves.known_at
        for part, values in zip(("translation", "rotation"), widest.curves.known, strict=True):
            entity = f"errors/{part}/ground_truth"
            self._log_series(entity, "ground truth, 2 σ", at, values, _KNOWN_COLOUR)

    def _log_uncertainty(self, one: Shown) -> None:
        """Ellipsoids of the ground truth's position, as time goes on and all along the run."""
        poses, covariance = one.buckets["ground_truth"], one.buckets["covariance"]
        centres, turned, deviations = ellipsoids(poses, covariance)
        shown = {
            "half_sizes": np.maximum(DEVIATIONS * deviations, SMALLEST),
            "centers": centres - self._origin,
            "quaternions": turned,
        }
        colours = [_KNOWN_COLOUR] * len(centres)
        columns = self._rerun.Ellipsoids3D.columns(**shown, colors=colours)
        self._columns(f"{TRUTH}/uncertainty", one.curves.known_at, columns)
        # Those that are large enough to be seen in the whole.
        large = np.flatnonzero(shown["half_sizes"].max(axis=1) > _SEEN * self._size)
        if len(large):
            large = large[_thinned(len(large), _ELLIPSOIDS)]
            self._static(
                f"{TRUTH}/uncertainty_of_the_run",
                self._rerun.Ellipsoids3D(
                    **{name: values[large] for name, values in shown.items()},
                    colors=[(*_KNOWN_COLOUR, 30)],
                    fill_mode=self._rerun.components.FillMode.Solid,
                ),
            )

    def _log_estimate(self, one: Shown, colour: tuple[int, int, int]) -> None:
        curves = one.curves
        entity = f"world/{one.name}"
        self._log_path(f"{entity}/path", curves.stamps, curves.estimate, colour)
        self._log_poses(f"{entity}/pose", curves.stamps, one.estimate)
        for part, ate, relative in zip(
            ("translation", "rotation"), curves.ate, curves.re, strict=True
        ):
            self._log_series(f"errors/{part}/{one.name}", one.name, curves.stamps, ate, colour)
            self._log_series(
                f"relative_errors/{part}/{one.name}", one.name, curves.steps_end, relative, colour
            )

    def _log_path(
        self, entity: str, stamps: Stamps, positions: Array, colour: tuple[int, int, int]
    ) -> None:
        """The whole of it, whatever the time; broken where there is nothing for long."""
        pieces = np.split(positions - self._origin, breaks(stamps))
        most = max(_POINTS // len(pieces), 2)
        strips = [piece[_thinned(len(piece), most)] for piece in pieces if len(piece) > 1]
        radius = self._rerun.Radius.ui_points(1.2)
        self._static(entity, self._rerun.LineStrips3D(strips, colors=[colour], radii=[radius]))

    def _log_poses(self, entity: str, stamps: Stamps, poses: Array) -> None:
        """The body as time goes on."""
        positions, quaternions = se3.to_position_quaternion(poses)
        transforms = self._rerun.Transform3D.columns(
            translation=positions - self._origin, quaternion=quaternions
        )
        self._columns(entity, stamps, transforms)
        self._static(entity, self._rerun.TransformAxes3D(0.05 * self._size))

    def _log_series(
        self, entity: str, title: str, stamps: Stamps, values: Array, colour: tuple[int, int, int]
    ) -> None:
        known = np.isfinite(values)
        if not known.any():
            return
        stamps, values = stamps[known], values[known]
        # The viewer breaks a line where a value is NaN.
        holes = breaks(stamps)
        stamps = np.insert(stamps, holes, stamps[holes - 1] + 1)
        values = np.insert(values, holes, np.nan)
        self._columns(entity, stamps, self._rerun.Scalars.columns(scalars=values))
        self._static(entity, self._rerun.SeriesLines(colors=[colour], names=[title], widths=[1.5]))

    def _static(self, entity: str, content: Any) -> None:
        self._rerun.log(entity, content, static=True, recording=self._stream)

    def _columns(self, entity: str, stamps: Stamps, columns: Any) -> None:
        times = [
            self._rerun.TimeColumn(RUN, duration=(stamps - self._start) / _SECOND),
            self._rerun.TimeColumn(STAMP, timestamp=stamps.astype("datetime64[ns]")),
        ]
        self._rerun.send_columns(entity, times, columns, recording=self._stream)


def _blueprint(shown: Sequence[Shown]) -> Any:
    """The map on the left; errors and the answer on the right."""
    from rerun import blueprint

    # The viewer's own choice is half a minute about the moment looked at.
    everlasting = blueprint.TimeRangeBoundary.infinite()
    whole = blueprint.TimeRange(start=everlasting, end=everlasting)

    def plot(origin: str, name: str, values: Sequence[Array]) -> Any:
        """Of the errors: in a gap of the ground truth its band reaches far beyond them."""
        found = np.concatenate(values)
        highest = 1.08 * float(np.nanmax(found)) if np.isfinite(found).any() else 1.0
        return blueprint.TimeSeriesView(
            origin=origin,
            name=name,
            axis_x=blueprint.TimeAxis(view_range=whole),
            axis_y=blueprint.ScalarAxis(range=(0.0, highest or 1.0)),
            plot_legend=blueprint.PlotLegend(blueprint.Corner2D.RightTop),
        )

    curves = [one.curves for one in shown]
    plots = [
        plot("errors/translation", "Absolute error, m", [one.ate[0] for one in curves]),
        plot(
            "relative_errors/translation",
            f"Error over {curves[0].re_step}, m",
            [one.re[0] for one in curves],
        ),
    ]
    if any(one.has_rotation for one in curves):
        angles = [one.ate[1] for one in curves]
        plots.insert(1, plot("errors/rotation", "Absolute error, °", angles))
    return blueprint.Blueprint(
        blueprint.Horizontal(
            blueprint.Spatial3DView(origin="world", name="Map", eye_controls=_eye(shown)),
            blueprint.Vertical(*plots, blueprint.TextDocumentView(origin="said", name="Answer")),
            column_shares=[3, 2],
        ),
        blueprint.TimePanel(timeline=RUN, state="collapsed"),
        collapse_panels=True,
    )


def _eye(shown: Sequence[Shown]) -> Any:
    """From where all of it is seen."""
    from rerun import blueprint

    positions = np.concatenate([one.ground_truth[:, :3, 3] for one in shown])
    centre = 0.5 * (positions.min(axis=0) + positions.max(axis=0)) - _origin(shown)
    up = vertical_axis(positions)
    upwards_, across, along = (
        np.eye(3)[up] * upwards(up),
        *np.eye(3)[[a for a in range(3) if a != up]],
    )
    away = 1.1 * _extent(shown) * (0.35 * across - 0.75 * along + 0.6 * upwards_)
    return blueprint.EyeControls3D(position=centre + away, look_target=centre, eye_up=upwards_)


def _origin(shown: Sequence[Shown]) -> Array:
    """What is taken for the origin of the map."""
    first = shown[0].ground_truth[0, :3, 3]
    return np.round(first) if np.linalg.norm(first) > _FAR else np.zeros(3)


def _extent(shown: Sequence[Shown]) -> float:
    """How far the run reaches, m."""
    extent = np.ptp(shown[0].ground_truth[:, :3, 3], axis=0)
    return max(float(np.linalg.norm(extent)), 1e-3)


def markdown(name: str, answer: Sequence[tuple[str, str]], lines: Sequence[str]) -> str:
    """An estimate's answer: sentences with their titles, then its figures."""
    said = "\n".join(f"- **{title}**: {' '.join(text.split())}" for title, text in answer)
    figures = "\n".join(lines)
    return f"# {name}\n\n{said}\n\n```\n{figures}\n```"


def _thinned(count: int, most: int) -> npt.NDArray[np.intp]:
    """Indices of at most so many of them, evenly, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))


def _repeated(colours: Sequence[tuple[int, int, int]], count: int) -> list[tuple[int, int, int]]:
    return [colours[number % len(colours)] for number in range(count)]
