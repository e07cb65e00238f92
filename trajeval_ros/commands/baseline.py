# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``--baseline``: whether an estimate is significantly worse than in an earlier run's folder."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.commands.console import CommandError, UsageError
from trajeval_ros.files.trajectory import TrajectoryFileError

if TYPE_CHECKING:
    from trajeval_ros.comparison.regression import Change
    from trajeval_ros.files.poses import WrittenPoses
    from trajeval_ros.online.settings import Settings
    from trajeval_ros.runs.offline import Scored

_SUMMARY, _POSES = "summary.json", "poses.csv"


@dataclass(frozen=True)
class Baseline:
    """An earlier run of one estimate: where it is, its summary, and its poses if they are there."""

    source: Path
    summary: Mapping[str, Any]
    poses: WrittenPoses | None


@dataclass(frozen=True)
class Judgement:
    """What comes of it: ``said`` for the reader; ``worse``, a line for each figure that is.

    ``failure``: why nothing could be judged; None where something could.
    """

    said: tuple[str, ...]
    worse: tuple[str, ...]
    failure: str | None


def read(path: str, names: Sequence[str]) -> dict[str, Baseline]:
    """Read the baseline of each estimate, a ``summary.json`` or the folder that it is in.

    With several estimates, each has its own in a summary of several, by its name; or all have the
    same, of one.

    Raises
    ------
    UsageError
        For what is no summary, or is of other estimates.
    CommandError
        For poses beside it that cannot be read.
    """
    source = Path(path).expanduser()
    source = source / _SUMMARY if source.is_dir() else source
    summary = _summary(source)
    several = summary.get("estimates")
    if several is None:
        one = Baseline(source, summary, _poses(source.parent))
        return dict.fromkeys(names, one)
    missing = [name for name in names if name not in several]
    if missing:
        hint = (
            f"; name {source.parent / next(iter(several), 'NAME') / _SUMMARY}"
            if len(names) == 1
            else ""
        )
        raise UsageError(
            f"--baseline: {source} is of {', '.join(several)}, not of {', '.join(missing)}{hint}"
        )
    return {name: Baseline(source, several[name], _poses(source.parent / name)) for name in names}


def _summary(source: Path) -> Mapping[str, Any]:
    try:
        found = json.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UsageError(f"--baseline: {source}: it cannot be read: {reason}") from error
    except ValueError as error:
        raise UsageError(f"--baseline: {source}: it is not JSON") from error
    parts = found.get("estimates", {"estimate": found}) if isinstance(found, dict) else {"": None}
    if not parts or not all(isinstance(p, dict) and "conventional" in p for p in parts.values()):
        raise UsageError(f"--baseline: {source}: it is no summary of an evaluation")
    return found


def _poses(folder: Path) -> WrittenPoses | None:
    from trajeval_ros.files.poses import read_poses

    path = folder / _POSES
    if not path.is_file():
        return None
    try:
        return read_poses(path)
    except TrajectoryFileError as error:
        raise CommandError(f"--baseline: {error}") from error


def judge(name: str, baseline: Baseline, scored: Scored, settings: Settings) -> Judgement:
    """Hold an estimate to its baseline.

    ``settings`` are those of this run, by which the poses of both are compared.
    """
    from trajeval_ros.comparison.regression import FIGURES, lost_seconds, paired, unpaired

    failure = None
    worse: list[str] = []
    poses = baseline.poses
    if poses is not None:
        from trajeval_ros.comparison.compare import Evaluated, compare

        stamps = poses.stamps + _offset(baseline.summary, settings.estimates[name].time_offset)
        before = Evaluated("baseline", stamps, poses.ground_truth, poses.estimate)
        evaluation = settings.evaluation
        comparison = compare(
            scored.evaluated,
            before,
            evaluation.gauge.name,
            evaluation.relative_delta,
            evaluation.relative_unit,
        )
        # What this run has no figure of, for want of orientations or of motion, is not compared.
        known = scored.summary["conventional"]
        figures = [name for name in FIGURES if known.get(f"{name}_rmse") is not None]
        changes = paired(comparison, figures)
        common = comparison.coverage.common.poses
        how = f"paired on {common:,} poses"
        if common == 0:
            failure = "it has no poses at the times of this run's"
        lost = lost_seconds(scored.stamps, stamps) if common else 0.0
        if lost:
            worse.append(f"{lost:.1f} s that were covered are not any more")
    else:
        changes = unpaired(scored.summary, baseline.summary)
        how = (
            f"no {_POSES} beside it: the error models' intervals are compared, as of two runs"
            " that have nothing in common"
        )
        if not changes:
            failure = (
                f"there is no {_POSES} beside it, and the error models have no figure in common"
            )
    if failure is None and all(change.p_value is None for change in changes) and not worse:
        failure = "none of its figures has an interval"
    said = [f"Baseline      {baseline.source}, {how}", *_table(changes)]
    worse += [_worse(change) for change in changes if change.worse]
    return Judgement(tuple(said), tuple(worse), failure)


def _offset(summary: Mapping[str, Any], otherwise: int) -> int:
    """By how much (ns) the stamps of that run's poses were late; a summary of old has it not."""
    given = (summary.get("parameters") or {}).get("estimate.time_offset")
    return otherwise if given is None else round(float(given) * 1e9)


def _worse(change: Change) -> str:
    if change.before <= 0.0:
        return f"{change.name} is {_shown(change.name, change.now)}, and was exact"
    ratio = change.now / change.before
    if ratio < 2.0:
        bounds = [100.0 * (bound - 1.0) for bound in change.interval or ()]
        by, unit = f"{100.0 * (ratio - 1.0):.3g} % larger", "%"
    else:
        bounds = list(change.interval or ())
        by, unit = f"{ratio:.3g} times as large", "times"
    sure = f" (95 %: {bounds[0]:.3g} to {bounds[1]:.3g} {unit})" if bounds else ""
    now, before = (_shown(change.name, value) for value in (change.now, change.before))
    return f"{change.name} is {by}{sure}: {now}, and was {before}"


_REASONS = {
    "too_few": "too few errors to tell",
    "one_walk": "not worse than two walks differ",
    "zero": "one is exact",
}


def _table(changes: Iterable[Change]) -> list[str]:
    from trajeval_ros.commands.figures import table

    rows = [("  figure", "now", "before", "ratio", "95 %")]
    verdicts = [""]
    for change in changes:
        interval = change.interval
        ratio = change.now / change.before if change.before else math.nan
        rows.append(
            (
                f"  {change.name}",
                _shown(change.name, change.now),
                _shown(change.name, change.before),
                f"{ratio:.4g}" if math.isfinite(ratio) else "-",
                "-" if interval is None else f"{interval[0]:.4g} to {interval[1]:.4g}",
            )
        )
        said = _REASONS.get(change.reason or "", "not worse")
        verdicts.append("worse" if change.worse else said)
    lines = zip(table(rows), verdicts, strict=True)
    return [f"{line}  {verdict}".rstrip() for line, verdict in lines] if len(rows) > 1 else []


def _shown(name: str, value: float) -> str:
    """In metres or degrees; a random walk's by the square root of a second."""
    from trajeval_ros.commands.figures import degrees, metres

    shown = degrees(value) if "rotation" in name else metres(value)
    if name.endswith("drift_std"):
        return f"{shown}/sqrt(s)"
    return f"{shown}/s" if name.endswith("velocity_std") else shown
