# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a benchmark is significantly worse than an earlier one."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trajeval_ros.benchmarking.figures import (
    FIGURES,
    Figure,
    Runs,
    costs,
    over_sequences,
    quartiles,
    values,
)
from trajeval_ros.benchmarking.grids import heading, number
from trajeval_ros.benchmarking.noise import holm, p_smaller
from trajeval_ros.benchmarking.ranks import LEVEL
from trajeval_ros.benchmarking.work import Row


class GateError(ValueError):
    """The two cannot be compared; the message is one line."""


@dataclasses.dataclass(frozen=True)
class Change:
    """A figure of a system, over the sequences that both benchmarks have.

    ``now``, ``before``: means over sequences of medians over runs (of errors geometric ones), in
    the figure's SI unit.
    ``p_value``: Holm's, of its being as it was or better, against worse.
    """

    system: str
    figure: Figure
    now: float
    before: float
    p_value: float

    @property
    def worse(self) -> bool:
        """Whether it is, beyond noise."""
        return self.p_value < LEVEL

    @property
    def difference(self) -> str:
        """How much larger it is, as a ratio, or of what is no error as a difference."""
        if not (np.isfinite(self.now) and np.isfinite(self.before)):
            return ""
        if not self.figure.ratios:
            return f"{self.figure.factor * (self.now - self.before):+.3g} {self.figure.unit}"
        return f"{self.now / self.before:.3f} times" if self.before > 0.0 else ""

    @property
    def line(self) -> str:
        """The change in words."""
        figure = self.figure
        now, before = (number(v * figure.factor) for v in (self.now, self.before))
        said = ", ".join([*filter(None, [self.difference]), f"p = {self.p_value:.2g}"])
        verdict = "worse" if self.worse else "not worse"
        return f"{self.system}  {heading(figure)}: {now}, was {before} ({said})  {verdict}"


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Every change, and what the baseline has and is not there any more: system and sequence."""

    changes: tuple[Change, ...]
    missing: tuple[tuple[str, str], ...]

    @property
    def regressed(self) -> bool:
        """Whether anything is worse, or missing."""
        return bool(self.missing) or any(change.worse for change in self.changes)


def judge(now: Sequence[Row], before: Sequence[Row]) -> Verdict:
    """Hold every system of the baseline to it; one-sided, Holm over systems and figures.

    Raises :class:`GateError` where a sequence's ground truth or parameters are others than they
    were: then the figures are of something else; and where there is nothing in common.
    """
    _same_question(now, before)
    changes = [
        change
        for system in sorted({str(row["system"]) for row in before})
        for figure in FIGURES
        if (change := _change(system, figure, now, before)) is not None
    ]
    if not changes:
        raise GateError("the baseline has no figure of a system and sequence that are in this one")
    sure = holm([change.p_value for change in changes])
    adjusted = [dataclasses.replace(c, p_value=p) for c, p in zip(changes, sure, strict=True)]
    there = {_pair(row) for row in now}
    missing = sorted({_pair(row) for row in before} - there)
    return Verdict(tuple(adjusted), tuple(missing))


def _pair(row: Row) -> tuple[str, str]:
    return str(row["system"]), str(row["sequence"])


def _same_question(now: Sequence[Row], before: Sequence[Row]) -> None:
    known = {row["sequence"]: row for row in before}
    for row in now:
        other = known.get(row["sequence"])
        for what in ("ground_truth", "parameters"):
            column = f"{what}_sha256"
            if other is not None and other.get(column) != row.get(column):
                shown = what.replace("_", " ")
                raise GateError(
                    f"sequence {row['sequence']}: its {shown} in the baseline is another,"
                    " so the figures cannot be compared"
                )


def _change(
    system: str, figure: Figure, now: Sequence[Row], before: Sequence[Row]
) -> Change | None:
    ours, theirs = _by_sequence(system, figure, now), _by_sequence(system, figure, before)
    common = sorted(set(ours) & set(theirs))
    if not common:
        return None
    p_value = p_smaller(
        {name: costs(theirs[name], figure) for name in common},
        {name: costs(ours[name], figure) for name in common},
        two_sided=False,
    )
    now_is, was = (_typical(runs, common, figure) for runs in (ours, theirs))
    return Change(system, figure, now_is, was, p_value)


def _by_sequence(system: str, figure: Figure, rows: Sequence[Row]) -> dict[str, Runs]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        if row["system"] == system:
            groups.setdefault(str(row["sequence"]), []).append(row)
    found = {name: values(group, figure) for name, group in groups.items()}
    return {name: runs for name, runs in found.items() if len(runs)}


def _typical(runs: dict[str, Runs], common: Sequence[str], figure: Figure) -> float:
    medians = np.array([quartiles(runs[name])[1] for name in common])
    return float(over_sequences(medians, figure))


def write_junit(path: Path, verdict: Verdict) -> None:
    """Write what CI servers show: a test case for each change, failed where it is worse."""
    failures = len(verdict.missing) + sum(change.worse for change in verdict.changes)
    counts = {
        "tests": str(len(verdict.changes) + len(verdict.missing)),
        "failures": str(failures),
        "errors": "0",
    }
    suites = ElementTree.Element("testsuites", counts)
    more = {"name": "benchmark", "skipped": "0", "time": "0"}
    suite = ElementTree.SubElement(suites, "testsuite", {**counts, **more})
    for change in verdict.changes:
        message = change.line if change.worse else None
        _case(suite, change.system, change.figure.title, message)
    for system, sequence in verdict.missing:
        _case(suite, system, sequence, f"{system} has no run on {sequence} any more")
    ElementTree.ElementTree(suites).write(path, encoding="utf-8", xml_declaration=True)


def _case(suite: ElementTree.Element, of: str, name: str, failure: str | None) -> None:
    case = ElementTree.SubElement(suite, "testcase", classname=_xml(of), name=_xml(name), time="0")
    if failure is not None:
        element = ElementTree.SubElement(case, "failure", message=_xml(failure), type="regression")
        element.text = _xml(failure)


def _xml(text: str) -> str:
    """Without what no XML may have, control characters above all."""
    return "".join(c if c.isprintable() else "?" for c in text)
