# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What to say where two trajectories have no time in common, or of one little is evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.time_bases import Found, offset_by_motion, time_base
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.accounting import Reason
from trajeval_ros.runs.far_offset import posed

SECOND = 1_000_000_000

# Of an estimate's poses, below which the share that is evaluated comes before all figures.
_SMALL = 0.5
# s. An offset by its size and one by the motion are the same.
_AGREE = 1.0


def likely_reason(truth: Trajectory, estimate: Trajectory, applied: float) -> str:
    """Why stamps have nothing in common, and what to set: clauses to append, or nothing.

    What the sizes of the stamps say is held against the motion, where that tells. ``applied`` (s)
    is added to the estimate's stamps already.
    """
    shift = round(applied * SECOND)
    shifted = np.array([stamp + shift for stamp in estimate.stamps.tolist()], dtype=np.float64)
    if np.abs(shifted).max() > 2.0**62:
        return ""
    cause = time_base(np.sort(truth.stamps), np.sort(estimate.stamps + shift), applied)
    found = _by_motion(truth, estimate)
    if found is not None:
        named = _agreeing(cause, found)
        return (
            f". {named}The two move alike (correlation {found.correlation:.2f}) with"
            f" {found.offset:.3f} s added to the estimate's stamps, known to {found.within:.2g} s."
            f" To try: set estimate.time_offset={found.offset:.3f}"
        )
    return "" if cause is None else f". Likely reason: {cause.text}. To try: {cause.advice}"


def _agreeing(cause: Cause | None, found: Found) -> str:
    """What the sizes say, where the motion says the same."""
    if cause is None or cause.code != "time_base":
        return ""
    advised = float(cause.advice.rpartition("=")[2])
    guessed = cause.advice.startswith("if ")
    agrees = guessed or abs(advised - found.offset) < _AGREE
    return f"Likely reason: {cause.text}. " if agrees else ""


def _by_motion(truth: Trajectory, estimate: Trajectory) -> Found | None:
    known, other = posed(truth), posed(estimate)
    if min(len(known[0]), len(other[0])) < 2:
        return None
    # Of coordinates beyond all measure no motion is told.
    with np.errstate(over="ignore", invalid="ignore"):
        return offset_by_motion(*known, *other)


def small_share(
    counts: Mapping[str, Any], truth: Trajectory, estimate: Trajectory, applied: float
) -> str | None:
    """What to say first where only a small part of an estimate is evaluated; else None.

    ``counts``: the estimate's account.
    """
    received, evaluated = counts["received"], counts["evaluated"]
    # What a later row corrects is no loss.
    received -= counts["rejected"].get(Reason.SUPERSEDED, 0)
    if not 0 < evaluated < _SMALL * received:
        return None
    reason, count = max(
        ((r, n) for r, n in counts["rejected"].items() if r != Reason.SUPERSEDED),
        key=lambda item: item[1],
        default=(None, 0),
    )
    text = f"only {evaluated:,} of {received:,} poses ({100 * evaluated / received:.2g} %)"
    text += " are evaluated, and the figures are of these"
    if reason is not None:
        text += f": {count:,} {reason}, {Reason(reason).explanation}"
    return text + by_stamps(reason, truth, estimate, applied)


def by_stamps(reason: str | None, truth: Trajectory, estimate: Trajectory, applied: float) -> str:
    """What the sizes of the stamps say of a ``reason`` of rejection: a clause, or nothing."""
    shift = round(applied * SECOND)
    if reason not in (Reason.NO_GROUND_TRUTH, Reason.OUTSIDE_GROUND_TRUTH):
        return ""
    cause = time_base(np.sort(truth.stamps), np.sort(estimate.stamps + shift), applied)
    return "" if cause is None else f". Likely reason: {cause.text}. To try: {cause.advice}"
