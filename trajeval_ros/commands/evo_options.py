# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The options of evo that ``evaluate`` has not, and what takes their place."""

from __future__ import annotations

from collections.abc import Sequence

_PLOTS = "--output DIR writes the plots into report.html, --figures DIR those of a paper"
_ALIGNED = "that is done by default (gauge=se3)"
_SCALED = "--set gauge=sim3"
_BOTH = "translation and rotation are both always given"

INSTEAD = {
    "-a": _ALIGNED,
    "--align": _ALIGNED,
    "-s": _SCALED,
    "-as": _SCALED,
    "-sa": _SCALED,
    "--correct_scale": _SCALED,
    "--align_origin": "--align-origin",
    "-r": _BOTH,
    "--pose_relation": _BOTH,
    "-d": "--set relative.delta=D",
    "--delta": "--set relative.delta=D",
    "-u": "--set relative.unit=m (s, m or f)",
    "--delta_unit": "--set relative.unit=m (s, m or f)",
    "--all_pairs": "both are always given",
    "--t_offset": "--set estimate.time_offset=S",
    "--t_start": "--start",
    "--t_end": "--end",
    "--t_max_diff": "nothing: the ground truth is asked at the estimate's own stamps",
    "-p": _PLOTS,
    "--plot": _PLOTS,
    "--save_plot": _PLOTS,
    "--save_results": "--output DIR",
    "-v": "nothing: all is said",
    "--verbose": "nothing: all is said",
    "-va": _ALIGNED,
    "--silent": "--quiet",
    "-c": "--params FILE",
}
"""Each with what to write here, or why nothing."""


def refusal(unknown: Sequence[str]) -> str:
    """Return the line about arguments that nobody knows; those of evo with what to write."""
    said = [f"unrecognized arguments: {' '.join(unknown)}"]
    options = dict.fromkeys(one.partition("=")[0] for one in unknown)
    said += [f"{one} of evo: {INSTEAD[one]}" for one in options if one in INSTEAD]
    return "; ".join(said)
