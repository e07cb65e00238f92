# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Moments of note: where a reader wants to look."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from trajeval_ros.diagnosis.cause import earlier_or_later
from trajeval_ros.report.coverage import SECOND
from trajeval_ros.report.jumps import of_ground_truth
from trajeval_ros.report.series import coverage_gaps
from trajeval_ros.report.shown import Shown
from trajeval_ros.report.words import length

# So many of each kind, the largest: a list is there to be read.
_MOST = 5


@dataclass(frozen=True)
class Moment:
    """A stretch from ``begin`` to ``end`` (ns, the ground truth's clock); an instant is short.

    ``kind``: "worst", "gap", "lost", "jump", "clock" or "fault"; ``estimate``: whose it is, if
    one's own.
    """

    kind: str
    text: str
    begin: int
    end: int
    estimate: str | None = None

    def of(self, estimate: str) -> Moment:
        """The same, said to be this estimate's, unless it is of the ground truth."""
        if self.kind in _OF_THE_GROUND_TRUTH:
            return self
        return replace(self, text=f"{estimate}: {self.text}", estimate=estimate)

    def values(self, start: int) -> dict[str, Any]:
        """As the page's script takes it, in seconds from ``start``."""
        return {
            "kind": self.kind,
            "text": self.text,
            "begin": round((self.begin - start) / SECOND, 4),
            "end": round((self.end - start) / SECOND, 4),
            "estimate": self.estimate,
        }


_OF_THE_GROUND_TRUTH = ("gap", "fault", "learned")


def moments(one: Shown) -> list[Moment]:
    """Those of an estimate that has a series."""
    series, summary = one.series, one.run.summary
    assert series is not None
    # Of a whole run the answer names it, of the poses outside the gaps.
    named = (summary.get("headline") or {}).get("worst")
    if named is None:
        worst = series.start + round(series.seconds[series.worst] * SECOND)
        error = float(series.translation_error[series.worst])
    else:
        worst, error = named["stamp"], named["translation"]
    found = []
    if named is not None or series.shows_errors:
        found.append(Moment("worst", f"worst, {length(error)}", worst, worst))
    model = summary.get("error_model") or {}
    jumps = model.get("jumps", ())
    # Where the ground truth itself jumps, that is a moment of its own.
    blamed = zip(jumps, of_ground_truth(jumps, summary), strict=True)
    jumps = [jump for jump, not_its in blamed if not not_its]
    jumps = sorted(jumps, key=lambda jump: -float(jump["translation"]))
    for jump in jumps[:_MOST]:
        size = f"{length(jump['translation'])}, {math.degrees(jump['rotation']):.2g}°"
        found.append(Moment("jump", f"jump of {size}", jump["stamp"], jump["stamp"]))
    for change in model.get("clock_changes", ())[:_MOST]:
        by = change["after"] - change["before"]
        text = f"stamps {1e3 * abs(by):.2g} ms {earlier_or_later(by)} from here on"
        found.append(Moment("clock", text, change["begin"], change["end"]))
    gaps = sorted(coverage_gaps(one.run.ground_truth), key=lambda gap: -gap.seconds)[:_MOST]
    found += [Moment("gap", f"gap of {gap.seconds:.3g} s", gap.start, gap.end) for gap in gaps]
    loss = summary["coverage"]["longest_loss"]
    if loss is not None:
        end = loss["begin"] + round(loss["duration"] * SECOND)
        found.append(Moment("lost", f"lost for {loss['duration']:.3g} s", loss["begin"], end))
    faults = summary["ground_truth"].get("faults", ())[:_MOST]
    found += [
        Moment("fault", str(fault["code"]).replace("_", " "), fault["begin"], fault["end"])
        for fault in faults
    ]
    return sorted(found, key=lambda moment: (moment.kind != "worst", moment.begin))
