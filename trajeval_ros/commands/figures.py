# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary as a person reads it in a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from trajeval_ros.report.accounted import account
from trajeval_ros.report.numbers import compact, number

Figures = Mapping[str, Any]

_NONE = "-"
_PARTS = ("translation", "rotation")


def metres(value: float | None) -> str:
    """Return a length in metres."""
    return _NONE if value is None else f"{number(value)} m"


def degrees(value: float | None) -> str:
    """Return an angle, given in radians, in degrees."""
    return _NONE if value is None else f"{number(math.degrees(value))} deg"


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


def side_by_side(summaries: Mapping[str, Figures]) -> list[str]:
    """Return what of several runs is looked at first, a line for each."""
    from trajeval_ros.report import covered

    rows = [("", "coverage", "ATE", "", "RE", "")]
    for name, summary in summaries.items():
        conventional, share = summary["conventional"], summary["coverage"]["time"]
        rows.append(
            (
                name,
                _NONE if share is None else covered.percent(share),
                metres(conventional.get("ate_translation_rmse")),
                degrees(conventional.get("ate_rotation_rmse")),
                metres(conventional.get("re_translation_rmse")),
                degrees(conventional.get("re_rotation_rmse")),
            )
        )
    return table(rows)


def summary_lines(summary: Figures, parameters: Figures) -> list[str]:
    """Return the summary of a run in lines of text: counts, errors, likelihoods.

    What a line says of the run has its name from what it is: no two lines share one.
    """
    truth = summary["ground_truth"]
    lines = [
        f"Estimate      {account(summary['estimate'], 'evaluated')}",
        f"Ground truth  {account(truth, 'used')}; {truth['segments']:,} segments",
    ]
    lines += ["", *_errors(summary, parameters), "", *_likelihoods(summary, parameters)]
    return lines


def _errors(summary: Figures, parameters: Figures) -> list[str]:
    """What is in metres and degrees, each by its own definition."""
    conventional, gauge = summary["conventional"], summary["gauge"]
    window = (summary.get("window") or {}).get("absolute") or {}
    step = f"{parameters['relative.delta']:g} {parameters['relative.unit']}"
    alignment = "as it is" if gauge == "none" else f"aligned, {gauge}"
    drift = summary.get("drift") or {}
    named = (
        (f"ATE, RMSE ({alignment})", conventional, "ate_{}_rmse"),
        (f"RE, RMSE (over {step})", conventional, "re_{}_rmse"),
        (f"RE, RMSE (over {step}, all pairs)", drift.get("all_pairs") or {}, "re_{}_rmse"),
        (f"noise-equivalent, {_last(parameters)}", window, "noise_equivalent_{}_std"),
    )
    position_only = summary.get("position_only")
    rows: list[tuple[str, ...]] = [("Error", *(_PARTS[:1] if position_only else _PARTS))]
    for title, figures, key in named:
        translation, rotation = (figures.get(key.format(part)) for part in _PARTS)
        if (translation, rotation) != (None, None):
            row = (title, metres(translation), degrees(rotation))
            rows.append(row[:2] if position_only else row)
    kitti = drift.get("kitti")
    if kitti is not None:
        translation = f"{number(100.0 * kitti['translation'])} %"
        rows.append(
            ("drift over 100 to 800 m (KITTI)", translation, f"{degrees(kitti['rotation'])}/m")
        )
    lines = table(rows)
    if no_drift(drift):
        lines.append(f"No KITTI drift: {no_drift(drift)}")
    if gauge == "sim3":
        lines.append(f"Scale correction, of ATE's alignment  {scale(summary)}")
    return lines


def no_drift(drift: Figures) -> str:
    """Why the drift of a run has none of KITTI's; empty where it has."""
    if drift.get("kitti") or "kitti" not in drift:
        return ""
    path = drift.get("path_length")
    if path is not None and drift.get("all_pairs") is None:
        return "it takes orientations"
    if path is not None:
        return f"the path is {number(path)} m long, and it takes 100 m and more"
    return "the path is not known beyond the ground truth's noise, or the scale not at all"


def scale(summary: Figures) -> str:
    """Return the factor that ATE's alignment has put on the estimate's positions."""
    found = (summary["conventional"].get("alignment") or {}).get("scale")
    return _NONE if found is None else f"{found:.5g}"


def _last(parameters: Figures) -> str:
    return f"last {parameters['window.duration']:g} s"


def _likelihoods(summary: Figures, parameters: Figures) -> list[str]:
    window = summary.get("window") or {}
    columns: list[tuple[str, str, Figures]] = [
        ("relative", "whole run", summary["relative"]),
        ("absolute", "whole run", summary["absolute"]),
        ("relative", _last(parameters), window.get("relative") or {}),
        ("absolute", _last(parameters), window.get("absolute") or {}),
    ]
    left_out = summary["gauge"] == "sim3"
    if left_out:
        columns = [column for column in columns if column[0] == "absolute"]

    def row(title: str, key: str) -> tuple[str, ...]:
        return (title, *(compact(figures.get(key)) for _, _, figures in columns))

    lines = table(
        [
            ("", *(span for _, span, _ in columns)),
            ("Likelihood", *(which for which, _, _ in columns)),
            row("log-likelihood, nats", "log_likelihood"),
            row("  chi2", "chi2"),
            row("  log-determinant", "log_det"),
            row("  degrees of freedom", "dof"),
            row("nats a pose", "nats_per_pose"),
            row("chi2/dof", "chi2_per_dof"),
            row("error, in ground-truth std", "error_in_ground_truth_std"),
        ]
    )
    nonlinear = summary["absolute"].get("log_likelihood_nonlinear")
    if nonlinear is not None:
        lines.append(f"Absolute, nonlinear over the whole run: {compact(nonlinear)} nats")
    if left_out:
        lines.append("Relative likelihood: left out, as under sim3 it does not know the scale")
    return lines
