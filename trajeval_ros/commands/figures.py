# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary as a person reads it in a terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

Figures = Mapping[str, Any]

_NONE = "-"
_PARTS = ("translation", "rotation")


def number(value: float | None, digits: int = 4) -> str:
    """Return a figure in few characters, with thousands separated, or a dash for None."""
    if value is None:
        return _NONE
    if isinstance(value, int):
        return f"{value:,}"
    size = abs(value)
    if size < 1e3:
        return f"{value:.{digits}g}"
    if size < 1e9:
        return f"{value:,.0f}" if size >= 1e4 else f"{value:,.1f}"
    return f"{value:.{digits - 1}e}"


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
    if counts.get("cut"):
        parts.append(f"{counts['cut']:,} cut before")
    return ", ".join(parts)


def table(rows: Sequence[tuple[str, ...]], left: int = 1) -> list[str]:
    """Return the rows as lines of aligned columns, the first ``left`` of them to the left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if column < left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
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
    columns: list[Figures] = [
        relative,
        absolute,
        window.get("relative") or {},
        window.get("absolute") or {},
    ]

    def row(title: str, key: str, show: Callable[[Any], str] = number) -> tuple[str, ...]:
        return (title, *(show(figures.get(key)) for figures in columns))

    last = f"last {parameters['window.duration']:g} s"
    lines += table(
        [
            ("Generalized error", "relative", "absolute", f"RE, {last}", f"AE, {last}"),
            row("log-likelihood, nats", "log_likelihood"),
            row("  chi2", "chi2"),
            row("  log-determinant", "log_det"),
            row("  degrees of freedom", "dof"),
            row("nats a pose", "nats_per_pose"),
            row("chi2/dof", "chi2_per_dof"),
            row("error, in ground-truth std", "error_in_ground_truth_std"),
            row("translation, RMSE", "translation_rmse", metres),
            row("rotation, RMSE", "rotation_rmse", degrees),
        ]
    )
    if absolute.get("log_likelihood_nonlinear") is not None:
        lines.append(
            f"Absolute log-likelihood, fully nonlinear over the whole run:"
            f" {number(absolute['log_likelihood_nonlinear'])} nats"
        )
    equivalent = [columns[3].get(f"noise_equivalent_{part}_std") for part in _PARTS]
    if None not in equivalent:
        lines.append(
            f"Noise-equivalent error, {last}: {metres(equivalent[0])}, {degrees(equivalent[1])}"
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
