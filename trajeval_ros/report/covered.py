# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much of a run an estimate covers, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Figures = Mapping[str, Any]


def percent(share: float) -> str:
    """A share of 1; 100 % only where nothing is missing, 0 % only where nothing is there."""
    shown = f"{100.0 * share:.3g}"
    if share < 1.0 and shown == "100":
        shown = "99.9"
    if share > 0.0 and float(shown) < 0.1:
        shown = "< 0.1"
    return f"{shown} %"


def seconds(value: float) -> str:
    """A duration in s, to three digits or to the second."""
    return f"{value:,.0f} s" if value >= 1000.0 else f"{value:.3g} s"


def of_the_run(coverage: Figures) -> str:
    """How much of the ground truth's time and way the estimate is there for."""
    if coverage["time"] is None:
        return "not known yet"
    parts = [f"{percent(coverage['time'])} of {seconds(coverage['duration'])}"]
    if coverage["distance"] is not None:
        parts.append(f"{percent(coverage['distance'])} of {_metres(coverage['path_length'])}")
    return ", ".join(parts)


def _metres(value: float) -> str:
    return f"{value:,.0f} m" if value >= 1000.0 else f"{value:.4g} m"


def losses(coverage: Figures) -> str:
    """How often, how long and when the estimate was lost; empty where it never was."""
    longest = coverage["longest_loss"]
    if longest is None:
        return ""
    begin = longest["seconds_from_start"]
    length = longest["duration"]
    if begin <= 0.0:
        where = f"the first {length:.3g} s"
    elif begin + length >= coverage["duration"]:
        where = f"the last {length:.3g} s, from {begin:.4g} s on"
    else:
        where = f"{length:.3g} s from {begin:.4g} s on"
    return (
        f"lost for {where}"
        if coverage["losses"] == 1
        else (f"lost {coverage['losses']} times, longest for {where}")
    )
