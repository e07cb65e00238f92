# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model in words: how good the estimate is, and what is not its fault."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from trajeval_ros.diagnosis.fitted import disagree
from trajeval_ros.error_model.nuisances import NAMES, OBSERVED_STD

Figures = Mapping[str, Any]

# Of what is not the estimator's fault, what gains ten nats is named: a chance of 7e-6, of nine.
_SIGMAS = 4.5
# What is known no better is not said to be nothing; and what they are called.
_SEEN = dict(zip(NAMES, OBSERVED_STD.tolist(), strict=True))
_TITLES = (
    ("clock", ("clock_offset",)),
    ("clock rate", ("clock_rate",)),
    ("lever arm", ("x", "y", "z")),
    ("mounting", ("roll", "pitch", "yaw")),
    ("scale", ("scale",)),
)
# Drift by distance is said where the mean speed is 1 m/s and more.
_FAST = 1.0
# Autocorrelations beyond this say that the model does not hold.
_WHITE = 0.2


def _number(value: float, std: float | None, factor: float = 1.0) -> str:
    """A figure with its standard deviation, to two digits of the latter."""
    value *= factor
    if std is None:
        return f"{value:.2g}"
    std *= factor
    if not std > 0.0:
        return f"{value:.3g}"
    digits = min(max(1 - math.floor(math.log10(std)), 0), 9)
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def _length(figure: Figures, unit: str = "") -> str:
    value, std = figure["value"], figure["std"]
    if max(abs(value), std or 0.0) < 0.5:
        return f"{_number(value, std, 1e3)} mm{unit}"
    return f"{_number(value, std)} m{unit}"


def _angle(figure: Figures, unit: str = "") -> str:
    return f"{_number(figure['value'], figure['std'], math.degrees(1.0))} deg{unit}"


def error_model_lines(model: Figures | None) -> list[str]:
    """Return the first lines of a result; none where nothing was fitted."""
    return [f"{title:13} {text}" for title, text in sentences(model)]


def sentences(model: Figures | None) -> list[tuple[str, str]]:
    """Return what there is to say, each with its title; nothing where nothing was fitted."""
    if model is None:
        return []
    return [("Error", _kind(model)), ("Not its fault", _faults(model)), *_doubts(model)]


def _kind(model: Figures) -> str:
    translation, rotation = model["translation"], model["rotation"]
    jitter = f"jitter {_length(translation['jitter_std'])}, {_angle(rotation['jitter_std'])}"
    if model["model"] == "wander":
        parts = f"wander {_length(translation['wander_std'])} over"
        parts += f" {_number(**translation['wander_time'])} s, {_angle(rotation['wander_std'])}"
        parts += f" over {_number(**rotation['wander_time'])} s"
    else:
        parts = f"drift {_length(translation['long_run_drift'], '/√s')},"
        parts += f" {_angle(rotation['long_run_drift'], '/√s')}"
        far = translation.get("long_run_drift_by_distance")
        if far is not None and far["value"] < _FAST * translation["long_run_drift"]["value"]:
            parts += f" ({_length(far, '/√m')})"
        if "velocity_std" in translation:
            parts += f" (velocity error {_length(translation['velocity_std'], '/s')} over"
            parts += f" {_number(**translation['velocity_time'])} s)"
    return f"{jitter}; {parts}"


def _faults(model: Figures) -> str:
    """What is there beyond doubt, and within what there is none of the rest."""
    found, none = [], []

    def sort(name: str, beyond: float, std: float, limit: float, shown: str) -> None:
        if abs(beyond) > _SIGMAS:
            found.append(f"{name} {shown}")
        elif std <= limit:
            none.append(f"{name} {shown}")

    clock, rate, scale = model["clock_offset"], model["clock_rate"], model["scale"]
    shown = f"{_number(clock['value'], clock['std'], 1e3)} ms"
    sort("clock", clock["value"] / clock["std"], clock["std"], _SEEN["clock_offset"], shown)
    shown = f"{_number(rate['value'], rate['std'], 1e6)} ppm"
    sort("clock rate", rate["value"] / rate["std"], rate["std"], _SEEN["clock_rate"], shown)
    for name, key, show, axis in (
        ("lever arm", "translation", _length, "x"),
        ("mounting", "rotation", _angle, "roll"),
    ):
        vector = model["extrinsic"][key]
        size = math.hypot(*vector["value"])
        std = max(vector["std"])
        beyond = max(abs(v) / s for v, s in zip(vector["value"], vector["std"], strict=True))
        sort(name, beyond, std, _SEEN[axis], show({"value": size, "std": std}))
    beyond = (scale["value"] - 1.0) / scale["std"]
    sort("scale", beyond, scale["std"], _SEEN["scale"], _number(**scale))
    gain = model["nats_per_pose"] - model["nats_per_pose_uncorrected"]
    if not found:
        return f"nothing beyond doubt ({', '.join(none)})" if none else "nothing that can be told"
    rest = f"; nothing beyond doubt in {', '.join(none)}" if none else ""
    return f"{', '.join(found)}: {gain:.3g} nats a pose{rest}"


def _doubts(model: Figures) -> list[tuple[str, str]]:
    found = []
    hidden = {name for each in model["unobserved"] for name in each["of"]}
    parts = []
    for title, names in _TITLES:
        of = [name for name in names if name in hidden]
        if of:
            axes = "" if len(of) == len(names) else f" ({', '.join(of)})"
            parts.append(f"{title}{axes}")
    if parts:
        found.append(("Not observed", f"{', '.join(parts)}: the motion does not show it"))
    jumps = model["jumps"]
    if jumps:
        largest = max(jumps, key=lambda jump: jump["translation"])
        found.append(
            (
                "Jumps",
                f"{len(jumps)}, the largest {1e3 * largest['translation']:.3g} mm,"
                f" {math.degrees(largest['rotation']):.2g} deg at {largest['stamp'] * 1e-9:.3f} s",
            )
        )
    if disagree(model):
        by = model["clock_offset_by"]
        first, second = (_number(**by[group], factor=1e3) for group in ("translation", "rotation"))
        text = f"positions alone say a clock of {first} ms, orientations alone {second} ms:"
        found.append(("Doubt", f"{text} no one offset puts both right"))
    for change in model.get("clock_changes", ())[:3]:
        size, when = change["after"] - change["before"], 0.5e-9 * (change["begin"] + change["end"])
        shown = _number(size, change["std"], 1e3)
        found.append(("Clock", f"changes by {shown} ms at {when:.1f} s"))
    worst = max(abs(lag) for part in model["whiteness"].values() for lag in part)
    if worst > _WHITE:
        text = f"errors are correlated beyond the model (by {worst:.2f}): the ± are too small"
        found.append(("Doubt", text))
    return found


def applied_lines(before: Figures | None, after: Figures, names: tuple[str, ...]) -> list[str]:
    """What an evaluation with corrections changed; none without any."""
    if before is None:
        return []
    changes = []
    for name, part, factor, unit in (
        ("ATE", "translation", 1.0, "m"),
        ("ATE", "rotation", math.degrees(1.0), "deg"),
        ("RE", "translation", 1.0, "m"),
        ("RE", "rotation", math.degrees(1.0), "deg"),
    ):
        key = f"{name.lower()}_{part}_rmse"
        errors = [each["conventional"].get(key) for each in (before, after)]
        if None not in errors:
            old, new = (factor * error for error in errors)
            changes.append(f"{name} {old:.4g} to {new:.4g} {unit}")
    return [f"Applied       {', '.join(names)}: {', '.join(changes)}"]
