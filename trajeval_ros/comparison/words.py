# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A comparison as a sentence that a person can repeat."""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.comparison.ratio import Ratio, Reason

_DIFFERENT_BELOW = 0.05
# Said from here on: less is a pose at the beginning or the end.
_WORTH_SAYING = 1.0


def sentence(comparison: Comparison) -> str:
    """What one alone covers, how the two differ, what both cover; in one line without full stop.

    E.g. ``vins's translation drifts 4 % less (95 %: 1 to 7 %), rotation drift no difference to be
    told; translation ATE no difference to be told, ...; both cover 98 s``.
    """
    covered = comparison.coverage
    if covered.common.poses == 0:
        return f"{comparison.a} and {comparison.b} have no poses in common"
    parts = [
        f"{name} alone covers {_seconds(only.seconds)}"
        for name, only in ((comparison.a, covered.only_a), (comparison.b, covered.only_b))
        if only.seconds >= _WORTH_SAYING
    ]
    drifts = (comparison.re_translation, comparison.re_rotation)
    errors = (comparison.ate_translation, comparison.ate_rotation)
    parts.append(_both(comparison, drifts, "drift", "drifts {} less"))
    parts.append(_both(comparison, errors, "ATE", "ATE is {} smaller"))
    parts.append(f"both cover {_seconds(covered.common.seconds)}")
    if comparison.since is not None:
        parts.append(f"from {comparison.since * 1e-9:.3f} s on, as older poses are not kept")
    return "; ".join(part for part in parts if part)


def sentences(comparisons: Sequence[Comparison]) -> list[str]:
    """The sentence of each pair; of several it says which, as ``vins vs orb: ...``."""
    several = len(comparisons) > 1
    return [
        f"{one.a} vs {one.b}: {sentence(one)}" if several else sentence(one) for one in comparisons
    ]


def _both(
    comparison: Comparison, ratios: tuple[Ratio | None, Ratio | None], noun: str, words: str
) -> str:
    """What can be told of translation and rotation; empty where there is neither."""
    said = []
    subject = ""
    for part, ratio in zip(("translation", "rotation"), ratios, strict=True):
        if ratio is None:
            continue
        verdict = _verdict(ratio)
        if isinstance(verdict, str):
            said.append(f"{part} {noun} {verdict}")
            continue
        a_is_better, share, sure = verdict
        better = comparison.a if a_is_better else comparison.b
        owner = "its" if better == subject else f"{better}'s"
        said.append(f"{owner} {part} {words.format(f'{share} %')} ({sure})")
        subject = better
    return ", ".join(said)


def _verdict(ratio: Ratio) -> str | tuple[bool, str, str]:
    """Why nothing can be told; or whether a is the better one, by how many %, how surely."""
    if ratio.ratio is None or ratio.reason is Reason.ZERO:
        return "not to be compared (one is exact)"
    if ratio.reason is Reason.TOO_FEW:
        return f"not to be compared ({ratio.errors} errors are too few)"
    a_is_better = ratio.ratio < 1.0
    share = ratio.ratio if a_is_better else 1.0 / ratio.ratio
    if ratio.interval is None or ratio.p_value is None:
        return a_is_better, _percent(1.0 - share), "on this run; no interval"
    if ratio.p_value >= _DIFFERENT_BELOW:
        return "no difference to be told"
    low, high = ratio.interval
    if not a_is_better:
        low, high = 1.0 / high, 1.0 / low
    return (
        a_is_better,
        _percent(1.0 - share),
        f"95 %: {_percent(1.0 - high)} to {_percent(1.0 - low)} %",
    )


def _percent(share: float) -> str:
    """Whole per cents; one more digit below 2 %, and more only where it would be zero."""
    percent = 100.0 * share
    return f"{percent:.0f}" if percent >= 2.0 else f"{percent:.1g}" if percent else "0"


def _seconds(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds >= 10.0 else f"{seconds:.1f} s"
