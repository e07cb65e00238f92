# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of a run in the log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from trajeval_ros.report import covered
from trajeval_ros.report.accounted import account
from trajeval_ros.report.after_closure import after_closure
from trajeval_ros.report.numbers import compact


def summary_lines(
    figures: Mapping[str, Any], latest_path: Mapping[str, Any] | None = None
) -> list[str]:
    """Return the figures of a whole run in a few lines for the log."""
    estimate, coverage = figures["estimate"], figures["coverage"]
    lines = [f"estimates: {account(estimate, 'evaluated')}"]
    if not estimate["evaluated"]:
        return [f"nothing was evaluated; {lines[0]}"]
    lost = covered.losses(coverage)
    lines.append(f"coverage: {covered.of_the_run(coverage)}{'; ' + lost if lost else ''}")
    conventional = figures["conventional"]
    position_only = figures.get("position_only")
    if position_only:
        lines.append(
            f"ATE, RMSE: {compact(conventional.get('ate_translation_rmse'))} m;"
            " positions alone: what needs orientations is left out"
        )
    for name, title in () if position_only else (("ate", "ATE"), ("re", "RE")):
        step = f" over {conventional['re_delta']:g} {conventional['re_unit']}"
        lines.append(
            f"{title}, RMSE{step if name == 're' else ''}:"
            f" {compact(conventional.get(f'{name}_translation_rmse'))} m,"
            f" {_degrees(conventional.get(f'{name}_rotation_rmse'))} deg"
        )
    lines += filter(None, [after_closure(latest_path)])
    for name in ("relative", "absolute"):
        lines.append(
            f"{name} log-likelihood: {compact(figures[name].get('log_likelihood'))} nats,"
            f" chi2/dof {compact(figures[name].get('chi2_per_dof'))}"
        )
    arm = figures.get("lever_arm")
    if arm is not None:
        value, std = (", ".join(f"{each:.3g}" for each in arm[key]) for key in ("value", "std"))
        lines.append(f"lever arm: {value} m, ± {std}")
    return lines


def _degrees(radians: float | None) -> str:
    return compact(None if radians is None else math.degrees(radians))
