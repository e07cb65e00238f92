# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps of an estimate against the ground truth, and which of the two has jumped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Figures = Mapping[str, Any]

# ns: the ground truth on either side of a cut is known by fewer samples for so long, and the poses
# of a slow estimate lie so far apart.
_NEAR = 250_000_000


def of_ground_truth(jumps: Sequence[Figures], summary: Figures) -> list[bool]:
    """Say of each jump of the error model whether the ground truth itself jumps there."""
    model = summary.get("error_model") or {}
    clock = round(1e9 * model.get("clock_offset", {"value": 0.0})["value"])
    places = [
        stamp
        for fault in summary["ground_truth"].get("faults", ())
        for stamp in fault.get("stamps", ())
    ]
    return [any(abs(jump["stamp"] + clock - at) < _NEAR for at in places) for jump in jumps]
