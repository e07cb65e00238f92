# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary as a person reads it in a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

Figures = Mapping[str, Any]

_NONE = "-"


def number(value: float | None, digits: int = 4) -> str:
    """Return a figure in few characters, with thousands separated, or a dash for None."""
    if value is None:
        return _NONE
    if value == 0 or 1e-4 <= abs(value) < 1e4:
        return f"{value:.{digits}g}" if abs(value) < 1000 else f"{value:,.1f}"
    return f"{value:,.0f}" if 1e4 <= abs(value) < 1e12 else f"{value:.{digits}g}"


def metres(value: float | None) -> str:
    """Return a length in metres."""
    return _NONE if value is None else f"{number(value)} m"


def degrees(value: float | None) -> str:
    """Return an angle, given in radians, in degrees."""
    return _NONE if value is None else f"{number(math.degrees(value))} deg"


def account(counts: Figures, taken: str) -> str:
    """Return one line that accounts for every message: received = taken + pending + rejected."""
    parts = [f"{counts['received']:,} received", f"{counts[taken]:,} {taken}"]
    if counts.get("pending"):
        parts.append(f"{counts['pending']:,} pending")
    rejected = {reason: count for reason, count in counts["rejected"].items() if count}
    if rejected:
        reasons = ", ".join(f"{count:,} {reason}" for reason, count in rejected.items())
        parts.append(f"{sum(rejected.values()):,} rejected ({reasons})")
    return ", ".join(parts)


def table(rows: list[tuple[str, ...]]) -> list[str]:
    """Return the rows as lines of aligned columns, the first one to the left."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        row[0].ljust(widths[0])
        + "".join(cell.rjust(width + 3) for cell, width in zip(row[1:], widths[1:], strict=True))
        for row in rows
    ]


def summary_lines(summary: Figures, parameters: Figures) -> list[str]:
    """Return the summary of a run in lines of text."""
    truth = summary["ground_truth"]
    lines = [
        f"Estimate      {account(summary['estimate'], 'evaluated')}",
        f"Ground truth  {account(truth, 'used')}; {truth['segments']:,} segments",
        "",
    ]
    relative, absolute = summary["relative"], summary["absolute"]
    window = summary.get("window") or {}
    last = f"last {parameters['window.duration']:g} s"
    columns: list[tuple[str, Figures]] = [
        ("relative", relative),
        ("absolute", absolute),
        (f"relative, {last}", window.get("relative") or {}),
        (f"absolute, {last}", window.get("absolute") or {}),
    ]

    def row(title: str, key: str, show: Any = number) -> tuple[str, ...]:
        return (title, *(show(figures.get(key)) for _, figures in columns))

    rows = [
        ("Generalized error", *(title for title, _ in columns)),
        row("log-likelihood, nats", "log_likelihood"),
        row("chi2", "chi2"),
        row("degrees of freedom", "dof"),
        row("chi2/dof (1: as good as the ground truth)", "chi2_per_dof"),
        row("translation RMSE", "translation_rmse", metres),
        row("rotation RMSE", "rotation_rmse", degrees),
    ]
    lines += table(rows)
    if absolute.get("log_likelihood_nonlinear") is not None:
        lines.append(
            f"Absolute, over the whole run: first order"
            f" {number(absolute.get('log_likelihood_first_order'))},"
            f" nonlinear {number(absolute['log_likelihood_nonlinear'])} nats"
        )
    lines.append("")
    lines += _conventional(summary["conventional"], summary["gauge"], parameters)
    return lines


def _conventional(figures: Figures, gauge: str, parameters: Figures) -> list[str]:
    step = f"{parameters['relative.delta']:g} {parameters['relative.unit']}"
    alignment = "as it is" if gauge == "none" else f"aligned, {gauge}"
    return table(
        [
            ("Conventional error", "translation", "rotation"),
            (
                f"ATE, RMSE ({alignment})",
                metres(figures.get("ate_translation_rmse")),
                degrees(figures.get("ate_rotation_rmse")),
            ),
            (
                f"RE, RMSE (over {step})",
                metres(figures.get("re_translation_rmse")),
                degrees(figures.get("re_rotation_rmse")),
            ),
        ]
    )
