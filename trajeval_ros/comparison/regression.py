# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether an estimate has become worse than it was.

Where the poses of before are known, their errors are paired with those of now as in `compare`.
Without them there is no interval for the ratio of two RMSEs: then the standard deviations of the
error models' parameters are compared, which have one, as two that have nothing in common.

Where the errors are one walk through the whole run, as the ATE of odometry is, no interval comes
from within it. But how far two equal walks differ has a distribution. Of those simulated (of
position and of velocity, along one axis and three, of a heading, on lines, loops and walks) the
widest is that of a heading that drifts along a line; its mean squares' ratio stays below Fisher's
F of two and two degrees of freedom: P(RMSE_a / RMSE_b > r) = 1 / (1 + r^2). So a loop closure that
is lost is worse from 6 to 9 times on.

One run asks several such questions. The gate as a whole is to be wrong in no more than one of
twenty runs in which nothing has changed: of k figures each may be in one of 20 k (Bonferroni), on
the one side that is worse. And what is less than a hundredth worse is not worse, however surely:
the last digits differ between two machines.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from trajeval_ros.comparison.common import Stamps, coverage
from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.comparison.ratio import Ratio, Reason
from trajeval_ros.likelihood.tails import normal_tail

Figures = Mapping[str, Any]

WRONG = 0.05
"""How often the gate as a whole says "worse" where nothing has changed."""
NEGLIGIBLE = 0.01
"""What is less worse than this share is not worse."""
FIGURES = ("ate_translation", "ate_rotation", "re_translation", "re_rotation")
EXACT = 1e-9
"""m or rad: an error below this is round-off."""
_GAP = 1.0
_PARTS = ("translation", "rotation")
_PROCESS = ("jitter_std", "drift_std", "velocity_std", "wander_std")
_LIMIT_OF_95 = 1.959963984540054


@dataclasses.dataclass(frozen=True)
class Change:
    """A figure now against the same before.

    Attributes:
        name: as in ``summary.json``: ``re_translation``, ``translation.jitter_std``.
        now: in its SI unit.
        before: the same.
        interval: 95 % interval of the ratio of now to before; None where there is none.
        p_value: of the ratio being 1, two-sided; None where there is none.
        reason: why there is none; `one_walk` also where the two are those of two walks.
        worse: whether it is, significantly; decided by `decided`.
    """

    name: str
    now: float
    before: float
    interval: tuple[float, float] | None
    p_value: float | None
    reason: str | None = None
    worse: bool = False


def paired(comparison: Comparison, figures: Sequence[str] = FIGURES) -> tuple[Change, ...]:
    """What a comparison of now (a) with before (b) says of each of the figures that both have."""
    ratios = {name: getattr(comparison, name) for name in figures}
    return decided(_of_ratio(name, one) for name, one in ratios.items() if one is not None)


def unpaired(now: Figures, before: Figures) -> tuple[Change, ...]:
    """What two summaries, as of ``summary.json``, say of each parameter of the error models.

    Nothing where one has no error model. Of a part (translation, rotation) that is told by other
    parameters than before, nothing either: those are not the same figures.
    """
    models = [summary.get("error_model") or {} for summary in (now, before)]
    found: list[Change] = []
    for part in _PARTS:
        groups = [model.get(part) or {} for model in models]
        if set(groups[0]) != set(groups[1]):
            continue
        found += [
            _of_parameters(f"{part}.{key}", groups[0][key], groups[1][key])
            for key in _PROCESS
            if key in groups[0]
        ]
    return decided(found)


def lost_seconds(now: Stamps, before: Stamps) -> float:
    """How much less is covered than before, s, ``now`` and ``before`` (M,) ns; 0 if hardly any.

    Less than a second, or than a hundredth of what was covered, is hardly any.
    """
    found = coverage(now, before, 0)
    lost = found.only_b.seconds
    least = max(_GAP, NEGLIGIBLE * (lost + found.common.seconds))
    return lost if lost >= least else 0.0


def decided(changes: Iterable[Change]) -> tuple[Change, ...]:
    """Return the changes with what is to be said of each."""
    every = tuple(changes)
    asked = sum(change.p_value is not None for change in every)
    return tuple(
        dataclasses.replace(
            change,
            worse=change.p_value is not None
            and change.now > (1.0 + NEGLIGIBLE) * change.before
            and change.now > EXACT
            and 0.5 * change.p_value < WRONG / asked,
        )
        for change in every
    )


def _of_ratio(name: str, ratio: Ratio) -> Change:
    change = Change(name, ratio.rmse_a, ratio.rmse_b, ratio.interval, ratio.p_value)
    if ratio.reason is Reason.ONE_WALK and ratio.ratio is not None:
        p_value, half = _of_two_walks(ratio.ratio)
        interval = (ratio.ratio / half, ratio.ratio * half)
        return dataclasses.replace(change, interval=interval, p_value=p_value, reason="one_walk")
    if ratio.reason is Reason.ZERO:
        # What was exact and is not any more has become worse, whatever chance may do.
        p_value = 0.0 if ratio.rmse_b <= EXACT < ratio.rmse_a else 1.0
        return dataclasses.replace(change, p_value=p_value, reason="zero")
    reason = None if ratio.reason is None else str(ratio.reason)
    return dataclasses.replace(change, reason=reason)


def _of_two_walks(ratio: float) -> tuple[float, float]:
    """The two-sided p-value of two equal walks' RMSE having this ratio; 95 % are within a factor.

    Of Fisher's F of two and two degrees of freedom, P(F > x) = 1 / (1 + x).
    """
    tail = 1.0 / (1.0 + max(ratio, 1.0 / ratio) ** 2)
    return min(2.0 * tail, 1.0), (1.0 / 0.025 - 1.0) ** 0.5


def _of_parameters(name: str, now: Figures, before: Figures) -> Change:
    """Of two standard deviations that are lognormal, as those are that are surely positive."""
    values = (now["value"], before["value"])
    shares = [
        None
        if figure["std"] is None or not figure["value"] > figure["std"]
        else figure["std"] / figure["value"]
        for figure in (now, before)
    ]
    if None in shares:
        return _of_a_zero(name, now, before)
    std = math.hypot(*(share for share in shares if share is not None))
    log_ratio = math.log(values[0] / values[1])
    half = _LIMIT_OF_95 * std
    interval = (math.exp(log_ratio - half), math.exp(log_ratio + half))
    p_value = 2.0 * normal_tail(abs(log_ratio) / std) if std > 0.0 else float(log_ratio == 0.0)
    return Change(name, *values, interval, p_value)


def _of_a_zero(name: str, now: Figures, before: Figures) -> Change:
    """Of two of which one may be zero: as normal, where both are told."""
    values = (now["value"], before["value"])
    stds = [_deviation(figure) for figure in (now, before)]
    if None in stds:
        return Change(name, *values, None, None, "zero")
    std = math.hypot(*(each for each in stds if each is not None))
    apart = abs(values[0] - values[1])
    p_value = 2.0 * normal_tail(apart / std) if std > 0.0 else float(apart <= EXACT)
    return Change(name, *values, None, p_value, "zero")


def _deviation(figure: Figures) -> float | None:
    """A figure's standard deviation, or what its interval's upper part says of one."""
    if figure["std"] is not None:
        return float(figure["std"])
    high = (figure.get("interval") or (None, None))[1]
    return None if high is None else (float(high) - float(figure["value"])) / _LIMIT_OF_95
