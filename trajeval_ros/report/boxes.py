# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes of the relative errors over sub-trajectories, as SVG to stand in the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from trajeval_ros.report.plots import ESTIMATE, INK, STYLE, svg

_PARTS = (
    ("translation", "Translation error in metres", 1.0),
    ("rotation", "Rotation error in degrees", math.degrees(1.0)),
)


def sub_trajectories(boxes: Sequence[Mapping[str, Any]]) -> str:
    """A picture of ``drift.sub_trajectories``: a box a length, translation and rotation."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.2, 3.0))
        places = {"left": 0.06, "right": 0.99, "bottom": 0.17, "top": 0.9, "wspace": 0.14}
        for axes, (part, title, factor) in zip(
            figure.subplots(1, 2, gridspec_kw=places), _PARTS, strict=True
        ):
            quantiles = [{key: factor * value for key, value in box[part].items()} for box in boxes]
            axes.bxp(
                [
                    {
                        "whislo": each["p5"],
                        "q1": each["q1"],
                        "med": each["median"],
                        "q3": each["q3"],
                        "whishi": each["p95"],
                        "label": _length(box["length"]),
                    }
                    for box, each in zip(boxes, quantiles, strict=True)
                ],
                showfliers=False,
                patch_artist=True,
                boxprops={"facecolor": ESTIMATE, "alpha": 0.35, "linewidth": 0.8},
                medianprops={"color": INK, "linewidth": 1.4},
                whiskerprops={"color": INK, "linewidth": 0.8},
                capprops={"color": INK, "linewidth": 0.8},
            )
            axes.set_ylim(bottom=0.0)
            axes.grid(visible=False, axis="x")
            axes.set_title(title)
            axes.set_xlabel("length of the sub-trajectory, m")
        return svg(figure, "boxes")


def _length(metres: float) -> str:
    return f"{metres:,.0f}" if metres >= 100.0 else f"{metres:.3g}"
