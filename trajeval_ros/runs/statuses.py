# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary's figures as the flat statuses of ``~/metrics``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from trajeval_ros.comparison.compare import Comparison

STATUSES = ("relative", "absolute", "window", "conventional", "coverage")

NUMBERS = {
    "ate/translation": ("conventional", "ate_translation_rmse"),
    "ate/rotation": ("conventional", "ate_rotation_rmse"),
    "re/translation": ("conventional", "re_translation_rmse"),
    "re/rotation": ("conventional", "re_rotation_rmse"),
    "accuracy/translation": ("window", "absolute_noise_equivalent_translation_std"),
    "accuracy/rotation": ("window", "absolute_noise_equivalent_rotation_std"),
    "coverage/time": ("coverage", "time"),
    "coverage/distance": ("coverage", "distance"),
}
"""The figures that are looked at most, as numbers that every plot takes: topic, status and key."""

# Of the error model, what is for ``summary.json`` alone.
_MATRICES = ("covariance", "pose")
_ENDS = ("low", "high")
# Of the error model, what has a figure of translation and one of rotation.
_BY_GROUP = ("clock_offset_by", "stamp_errors")
# Of the extrinsic, what is one number.
_SIZES = ("length", "angle")
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


def flatten(summary: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return the statuses with their keys and values, in plain snake_case.

    Numbers are ``repr(float)``, so that every digit arrives; what is None or not finite is left
    out, and so are lists and distributions, which are for ``summary.json``. A figure below another,
    such as ``window: {relative: {chi2}}``, is ``relative_chi2``. Of positions alone
    ``absolute`` has the lever arm: ``lever_arm_x``, ``lever_arm_std_x``, ...
    """
    found = {
        status: dict(_entries("", summary[status])) for status in STATUSES if status in summary
    }
    arm = summary.get("lever_arm")
    if arm is not None:
        for which, prefix in (("value", "lever_arm"), ("std", "lever_arm_std")):
            for axis, component in zip("xyz", arm[which], strict=True):
                found["absolute"][f"{prefix}_{axis}"] = repr(float(component))
    return found


def error_model_entries(models: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """The status ``error_model``: of the run, and of the window with ``window_`` before each key.

    Components of vectors are ``..._x``, ``_y``, ``_z``; of lists there is how many they hold.
    """
    found: dict[str, str] = {}
    for part, prefix in (("run", ""), ("window", "window_")):
        for key, value in _components(prefix, models.get(part, {})):
            found[key] = value
    return found


def latest_path_entries(figures: Mapping[str, Any]) -> dict[str, str]:
    """The status ``latest_path``; of the same poses as they came with ``online_`` before it."""
    return dict(_entries("", figures))


def error_models_of(entries: Mapping[str, float | str]) -> dict[str, dict[str, Any]]:
    """The error models of run and window again, from the status ``error_model``.

    What the status leaves out (covariances, lags beyond the first) is not there; a list is the
    number of what it holds.
    """
    models: dict[str, dict[str, Any]] = {}
    for entry, value in entries.items():
        part = "window" if entry.startswith("window_") else "run"
        model = models.setdefault(part, {})
        key = entry.removeprefix("window_")
        for group in ("translation", "rotation"):
            if key.startswith(f"{group}_"):
                _put(model.setdefault(group, {}), key.removeprefix(f"{group}_"), value)
            elif key.startswith(f"extrinsic_{group}_"):
                vectors = model.setdefault("extrinsic", {}).setdefault(group, {})
                name = key.removeprefix(f"extrinsic_{group}_")[:-2]  # value_x, value_y, value_z
                vectors.setdefault(name, []).append(value)
        for name in _SIZES:
            if key.startswith(f"extrinsic_{name}_"):
                _put(model.setdefault("extrinsic", {}), key.removeprefix("extrinsic_"), value)
        within = next((name for name in _BY_GROUP if key.startswith(f"{name}_")), None)
        if within is not None:
            _put(model.setdefault(within, {}), key.removeprefix(f"{within}_"), value)
        elif not key.startswith(("translation_", "rotation_", "extrinsic_")):
            _put(model, key, value)
    return models


def _put(figures: dict[str, Any], key: str, value: float | str) -> None:
    """Put a figure in its place: of one with a standard deviation, its value or that."""
    name, _, which = key.rpartition("_")
    if name.endswith("_interval") and which in _ENDS:
        found = figures.setdefault(name.removesuffix("_interval"), {"std": None})
        found.setdefault("interval", [None, None])[_ENDS.index(which)] = value
        return
    if which == "value" or (which == "std" and name in figures):
        figures.setdefault(name, {"std": None})[which] = value
    else:
        figures[key] = value


def _components(prefix: str, figures: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in figures.items():
        if key in _MATRICES:
            continue
        if key == "whiteness":
            for group, lags in value.items():
                yield f"{prefix}{key}_{group}", repr(float(lags[0]))
        elif isinstance(value, Mapping):
            yield from _components(f"{prefix}{key}_", value)
        elif isinstance(value, list) and key in ("value", "std"):
            for axis, component in zip("xyz", value, strict=True):
                yield f"{prefix}{key}_{axis}", repr(float(component))
        elif key == "interval":
            yield from _entries(f"{prefix}{key}_", dict(zip(_ENDS, value, strict=True)))
        elif isinstance(value, list):
            yield f"{prefix}{key}", repr(float(len(value)))
        else:
            yield from _entries(prefix, {key: value})


def _entries(prefix: str, figures: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in figures.items():
        if key == "distributions":
            continue
        if key == "alignment":
            yield from _alignment(value)
        elif isinstance(value, Mapping):
            yield from _entries(f"{prefix}{key}_", value)
        elif isinstance(value, str):
            yield f"{prefix}{key}", value
        elif isinstance(value, int | float) and math.isfinite(value):
            yield f"{prefix}{key}", repr(float(value))


def _alignment(alignment: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The alignment's pose and scale; its covariance is for ``summary.json``."""
    if alignment["pose"] is not None:
        for name, value in zip(_POSE, alignment["pose"], strict=True):
            yield f"alignment_{name}", repr(float(value))
    if alignment["scale"] is not None:
        yield "alignment_scale", repr(float(alignment["scale"]))


def flatten_comparison(comparison: Comparison) -> dict[str, str]:
    """Return a comparison's values as those of a status; an interval's ends are apart."""
    found: dict[str, Any] = {}
    for name, value in comparison.figures().items():
        if isinstance(value, Mapping) and value.get("interval") is not None:
            low, high = value["interval"]
            value = {**value, "interval_low": low, "interval_high": high}
        if isinstance(value, Mapping):
            found[name] = value
    return dict(_entries("", found))
