# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the page's script draws: plain values and arrays as text, in bounded size.

Seconds count from the first moment of the run on the ground truth's clock; positions from
``origin``, so that those of a map's grid (10^6 m) keep their millimetres in float32.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.charts import ESTIMATE_COLOURS, numbers
from trajeval_ros.charts.arrays import extremes
from trajeval_ros.likelihood.tails import even_chi2_quantile
from trajeval_ros.report.coverage import SECOND, Coverage
from trajeval_ros.report.moments import Moment, moments
from trajeval_ros.report.series import (
    Series,
    coverage_gaps,
    offset,
    rate_of,
    upwards,
    vertical_axis,
)
from trajeval_ros.report.shown import Shown

Array = npt.NDArray[np.float64]
Values = dict[str, Any]

# An hour is to be at most 400 kB with everything: so many poses of all estimates together, and of
# each in the likelihoods; of the whole ground truth; of uncertainties; and where a band is smooth.
_POSES, _FEWEST = 2000, 500
_LIKELIHOODS, _FEWEST_LIKELIHOODS = 800, 200
_WAY = 900
_ELLIPSOIDS = 150
_SMOOTH = 150
# Between this quantile of the normal distribution and its negative lie 99 %.
_USUAL = 2.5758293035489004
# On a linear scale the usual error is to be seen beside the largest.
_MOST_TIMES_THE_USUAL = 40.0
# An origin of its own where the place is so many times further off than the run is wide.
_FAR = 20.0
# An uncertainty is drawn where it is this share of the width of the map.
_SEEN = 0.004


def payload(estimates: Sequence[Shown]) -> Values:
    """Everything that is drawn. At least one of the estimates has a series."""
    drawn = [one for one in estimates if one.series is not None]
    serieses = [one.series for one in drawn if one.series is not None]
    start = min(series.start for series in serieses)
    end = max(series.end + (series.start - start) / SECOND for series in serieses)
    truth = max((series.ground_truth for series in serieses), key=len)
    up = vertical_axis(truth)
    across, along = (axis for axis in range(3) if axis != up)
    origin = _origin(truth)
    first = drawn[0].run
    single = len(estimates) == 1
    return {
        "start": str(start),
        "end": max(end, 1e-3),
        "axes": {"across": across, "along": along, "up": up, "sign": upwards(up)},
        "origin": origin.tolist(),
        "way": _way(first, start, origin),
        "gaps": [
            [(gap.start - start) / SECOND, (gap.end - start) / SECOND]
            for gap in coverage_gaps(first.ground_truth)
        ],
        "logarithmic": {
            "translation": any(_spreads(series.translation_error) for series in serieses),
            "rotation": any(_spreads(series.rotation_error) for series in serieses),
        },
        "kind": "ATE" if all(s.is_ate for s in serieses) else "error, aligned by likelihood",
        "window": first.parameters["window.duration"],
        "anew": [round((stamp - start) / SECOND, 3) for stamp in first.anew],
        "rates": _rates(estimates, start, end),
        "ellipsoids": _ellipsoids(serieses[0], start, origin, (across, along)) if single else [],
        "moments": [
            moment.values(start)
            for moment in dict.fromkeys(each for one in drawn for each in _of(one, single))
        ],
        "estimates": [
            _estimate(one, number, len(drawn), start, origin)
            for number, one in enumerate(estimates)
            if one.series is not None
        ],
    }


def _of(one: Shown, single: bool) -> list[Moment]:
    found = moments(one)
    return found if single else [moment.of(one.name) for moment in found]


def _origin(positions: Array) -> Array:
    middle, extent = np.median(positions, axis=0), np.ptp(positions, axis=0).max()
    if np.abs(middle).max() <= _FAR * max(float(extent), 1e-3):
        return np.zeros(3)
    return np.asarray(np.round(middle))


def _spreads(error: Array) -> bool:
    """Whether a linear axis would hide the usual error beside the largest."""
    return bool(error.max() > _MOST_TIMES_THE_USUAL * np.median(error) > 0.0)


def _estimate(one: Shown, number: int, of: int, start: int, origin: Array) -> Values:
    series = one.series
    assert series is not None
    degrees = np.degrees(series.rotation_axes)
    columns = [series.translation_error, series.translation_axes, series.rotation_error, degrees]
    if not series.has_rotation:
        columns = columns[:2]
    kept = extremes([*columns, series.translation_band], max(_POSES // of, _FEWEST))
    seconds = series.seconds + (series.start - start) / SECOND
    alignment = series.alignment
    values: Values = {
        "name": one.name,
        "colour": ESTIMATE_COLOURS[number % len(ESTIMATE_COLOURS)],
        "times": numbers(seconds[kept]),
        "breaks": _breaks_among(series.breaks, kept),
        "truth": numbers(series.ground_truth[kept] - origin),
        # Apart from the ground truth, so that a millimetre counts beside a kilometre.
        "off": numbers(series.translation_axes[kept]),
        "alignment": {
            "rotation": alignment.pose[:3, :3].ravel().tolist(),
            "translation": alignment.pose[:3, 3].tolist(),
            "scale": alignment.scale,
        },
        "poses": [len(kept), int(one.run.summary["estimate"]["evaluated"])],
        "largest": max(float(np.quantile(series.translation_error[series.known], 0.98)), 1e-9),
        "translationBand": numbers(series.translation_band[kept]),
        "rotationBand": numbers(np.degrees(series.rotation_band[kept])),
        "likelihood": _likelihood(one, series, seconds, of),
        "clock": _clock(one, start),
    }
    if series.has_rotation:
        values["rotationAxes"] = numbers(degrees[kept])
        values["rawRotation"] = numbers(np.degrees(series.raw_rotation_error[kept]))
    return values


def _breaks_among(breaks: npt.NDArray[np.intp], kept: npt.NDArray[np.intp]) -> list[int]:
    """Of the ``kept`` rows those before which a line is broken."""
    places = np.unique(np.searchsorted(kept, breaks))
    return [int(place) for place in places if 0 < place < len(kept)]


def _likelihood(one: Shown, series: Series, seconds: Array, of: int) -> Values:
    known = series.window_dof > 6.0
    dof = np.where(known, series.window_dof, 6.0)
    ratio = np.where(known, series.window_chi2 / dof, np.nan)
    columns = [
        series.relative_log_likelihood,
        series.absolute_log_likelihood,
        series.window_relative,
        series.window_absolute,
        ratio,
    ]
    kept = extremes(columns, max(_LIKELIHOODS // of, _FEWEST_LIKELIHOODS))
    names = ("relative", "absolute", "windowRelative", "windowAbsolute", "chi2")
    values: Values = {
        name: numbers(column[kept]) for name, column in zip(names, columns, strict=True)
    }
    values["times"] = numbers(seconds[kept])
    if one.run.summary["gauge"] == "sim3":
        # A step of the estimate is not in metres, and its likelihood means nothing.
        for name in ("relative", "windowRelative", "chi2"):
            del values[name]
    smooth = np.flatnonzero(known)
    if len(smooth) > 1:
        smooth = smooth[extremes([dof[smooth]], _SMOOTH)]
        values["usual"] = {
            "times": numbers(seconds[smooth]),
            "low": numbers(even_chi2_quantile(dof[smooth], -_USUAL) / dof[smooth]),
            "high": numbers(even_chi2_quantile(dof[smooth], _USUAL) / dof[smooth]),
        }
    return values


def _clock(one: Shown, start: int) -> list[Values]:
    """What stretches of the run say of the clock, ms: the value and a standard deviation."""
    model = one.run.summary.get("error_model") or {}
    return [
        {
            "time": (0.5 * (each["begin"] + each["end"]) - start) / SECOND,
            "offset": 1e3 * each["offset"],
            "std": 1e3 * each["std"],
        }
        for each in model.get("clock_stretches", ())
    ]


def _way(run: Any, start: int, origin: Array) -> Values | None:
    """All of the ground truth, so that it shows where there is no estimate."""
    if run.way is None or len(run.way.stamps) < 2:
        return None
    kept = extremes([run.way.positions], _WAY)
    return {
        "times": numbers((run.way.stamps[kept] - start) / SECOND),
        "positions": numbers(run.way.positions[kept] - origin),
        "lengths": numbers(run.way.lengths[kept]),
    }


def _rates(estimates: Sequence[Shown], start: int, end: float) -> list[Values]:
    """Messages a second of the ground truth and of each estimate."""
    topics: list[tuple[str, str, str | None, Coverage, int]] = [
        ("ground truth", "way", None, estimates[0].run.ground_truth, 0)
    ]
    for number, one in enumerate(estimates):
        colour = ESTIMATE_COLOURS[number % len(ESTIMATE_COLOURS)]
        topics.append((one.name, colour, one.name, one.run.estimate, offset(one.run)))
    found = []
    for label, colour, estimate, coverage, shift in topics:
        edges, rate = rate_of(coverage, start, end, shift)
        if len(rate):
            found.append(
                {
                    "label": label,
                    "colour": colour,
                    "estimate": estimate,
                    "times": numbers(edges),
                    "rates": numbers(np.append(rate, rate[-1])),
                }
            )
    return found


def _ellipsoids(
    series: Series, start: int, origin: Array, plane: tuple[int, int]
) -> list[Mapping[str, Any]]:
    """Two standard deviations of the ground truth, where they are large enough to be seen."""
    values, vectors = np.linalg.eigh(series.position_covariance)
    spread = 2.0 * np.sqrt(np.maximum(values, 0.0))
    extent = float(np.ptp(series.ground_truth[:, plane], axis=0).max())
    large = np.flatnonzero(2.0 * spread[:, 2] > _SEEN * extent)
    chosen = large[:: max(1, -(-len(large) // _ELLIPSOIDS))]
    axes = vectors[chosen] * spread[chosen, None, :]
    seconds = series.seconds[chosen] + (series.start - start) / SECOND
    places = series.ground_truth[chosen] - origin
    return [
        {"time": time, "place": place, "axes": axis}
        for time, place, axis in zip(
            np.round(seconds, 3).tolist(),
            _short(places).tolist(),
            _short(axes.reshape(-1, 9)).tolist(),
            strict=True,
        )
    ]


def _short(values: Array) -> Array:
    """To four digits of the largest."""
    largest = float(np.abs(values).max(initial=1e-9))
    return np.asarray(np.round(values, max(3 - int(np.floor(np.log10(largest))), 0)))
