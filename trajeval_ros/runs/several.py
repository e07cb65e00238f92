# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Several estimates of one run: compared each with each, and in one summary."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trajeval_ros.comparison.compare import Comparison, Evaluated, compare
from trajeval_ros.comparison.hat import shared_error
from trajeval_ros.comparison.ratio import Method
from trajeval_ros.comparison.words import sentences
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.online.results import Evaluations
from trajeval_ros.online.settings import EvaluationSettings
from trajeval_ros.runs.position_only import comparisons_on_positions
from trajeval_ros.wall import shield

Figures = dict[str, Any]

_SAME_INSTANTS = 0.99
"""So large a part of the poses of both are pairs where both are at the same instants."""
# Of more estimates than this a terminal has not every pair.
_FEW = 3
# Jumps are the same within so long (ns) of one another, and where the lengths are in this ratio;
# by chance alone one or two may be.
_AT_ONCE, _AS_MUCH = 150_000_000, 0.8
_FEWEST_SHARED = 3
MOST_POSES = 100_000
"""So many poses of each estimate are kept to be compared while a node runs: 80 minutes at 20 Hz."""


def compared(
    evaluated: Iterable[Evaluated], settings: EvaluationSettings, method: Method | None = None
) -> tuple[Comparison, ...]:
    """Return the comparison of each pair of estimates, of the poses that both have.

    ``method``: where the intervals come from; the best that is installed where None.
    """
    return tuple(_pair(a, b, settings, method) for a, b in itertools.combinations(evaluated, 2))


def newest_compared(
    kept: Sequence[NewestPoses], settings: EvaluationSettings, method: Method | None = None
) -> tuple[Comparison, ...]:
    """Return the comparison of each pair, from where on no pose of either has been forgotten."""
    found = []
    for one, other in itertools.combinations(kept, 2):
        begins = [each.begin for each in (one, other) if each.begin is not None]
        since = max(begins, default=None)
        a, b = (_from(each.evaluated(), since) for each in (one, other))
        found.append(replace(_pair(a, b, settings, method), since=since))
    return tuple(found)


def _pair(
    a: Evaluated, b: Evaluated, settings: EvaluationSettings, method: Method | None
) -> Comparison:
    gauge, delta, unit = settings.gauge.name, settings.relative_delta, settings.relative_unit
    return compare(a, b, gauge, delta, unit, method)


def _from(evaluated: Evaluated, since: int | None) -> Evaluated:
    if since is None:
        return evaluated
    return evaluated[int(np.searchsorted(evaluated.stamps, since)) :]


def causes_of_all(evaluated: Sequence[Evaluated]) -> tuple[Cause, ...]:
    """Return what is likely wrong by what the estimates have in common, if anything is."""
    found = shared_error(evaluated)
    if found is None:
        return ()
    when = " and ".join(
        f"from {begin * 1e-9:.3f} s to {end * 1e-9:.3f} s" for begin, end in found.stretches
    )
    text = (
        f"{'in the whole run' if found.whole else when} {found.a} and {found.b} agree with each"
        f" other to {_length(found.from_each_other)}, and neither comes nearer to the ground truth"
        f" than {_length(found.from_truth)} (displacements over {found.step:.2g} s, whatever scale,"
        f" axes, lever arm and clock): the ground truth's are off by about"
        f" {_length(found.truth_std)}, or they share an error"
    )
    advice = "see whether the ground truth's body, markers or solution changed" + (
        "" if found.whole else ", and leave that part out"
    )
    return (Cause("ground_truth_or_shared", text, advice),)


def jumps_of_all(summaries: Mapping[str, Mapping[str, Any]]) -> tuple[Cause, ...]:
    """Return where two estimates jump at once and by as much, which is the ground truth's doing."""
    found = [
        (a, b, shared)
        for (a, one), (b, other) in itertools.combinations(summaries.items(), 2)
        if len(shared := shared_jumps(one, other)) >= _FEWEST_SHARED
    ]
    if not found:
        return ()
    a, b, shared = max(found, key=lambda each: len(each[2]))
    stamp, size = max(shared, key=lambda jump: jump[1])
    text = (
        f"{a} and {b} jump at the same {len(shared)} moments by the same lengths, the largest"
        f" {_length(size)} at {stamp * 1e-9:.3f} s: the ground truth jumps there, or they"
        " share a front end"
    )
    return (Cause("ground_truth_jumps", text, "do not count these jumps against either"),)


def shared_jumps(one: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[tuple[int, float], ...]:
    """Return the jumps of two summaries' error models that are the same: stamp (ns) and size (m).

    Stamps are the ground truth's, by what each model says of its clock.
    """
    first, second = _jumps_of(one), _jumps_of(other)
    return tuple(
        (stamp, size)
        for stamp, size in first
        if any(
            abs(stamp - at) <= _AT_ONCE and min(size, length) > _AS_MUCH * max(size, length)
            for at, length in second
        )
    )


def _jumps_of(summary: Mapping[str, Any]) -> list[tuple[int, float]]:
    model = summary.get("error_model")
    if model is None:
        return []
    clock = round(1e9 * model["clock_offset"]["value"])
    return [(jump["stamp"] + clock, jump["translation"]) for jump in model["jumps"]]


def _length(metres: float) -> str:
    return f"{metres:.3g} m" if metres >= 0.1 else f"{100.0 * metres:.2g} cm"


def looked_at_together(
    evaluated: Mapping[str, Evaluated],
    summaries: Mapping[str, Mapping[str, Any]],
    settings: EvaluationSettings,
    say: Callable[[str], None],
) -> tuple[tuple[Comparison, ...], tuple[Cause, ...]]:
    """Compare each pair of whole runs, and look for what they have in common.

    ``say`` gets a line for a defect of either, which costs no figures.
    """
    no_comparisons: tuple[Comparison, ...] = ()
    no_causes: tuple[Cause, ...] = ()
    comparisons = shield(
        "the comparison",
        lambda: comparisons_on_positions(compared(evaluated.values(), settings), summaries),
        no_comparisons,
        say,
    )
    turning = [one for name, one in evaluated.items() if not summaries[name].get("position_only")]
    causes = shield("the search for likely causes", lambda: causes_of_all(turning), no_causes, say)
    causes += shield("the search for jumps", lambda: jumps_of_all(summaries), no_causes, say)
    return comparisons, causes


def together(
    summaries: Mapping[str, Mapping[str, Any]],
    comparisons: Sequence[Comparison],
    causes: Sequence[Cause] = (),
) -> Figures:
    """Return the summary of several estimates against one ground truth.

    ``summaries``: each one's alone, by its name; ``causes``: what is likely wrong by what they have
    in common. Each is as it is there, but for the ground truth,
    which stands beside them.
    """
    first = next(iter(summaries.values()))
    return {
        "ground_truth": first["ground_truth"],
        "estimates": {
            name: {key: value for key, value in one.items() if key != "ground_truth"}
            for name, one in summaries.items()
        },
        "comparison": [
            {**one.figures(), "nats_per_second": nats_per_second(one, summaries)}
            for one in comparisons
        ],
        "likely_causes": [cause._asdict() for cause in causes],
    }


def nats_per_second(
    comparison: Comparison, summaries: Mapping[str, Mapping[str, Any]]
) -> dict[str, float] | None:
    """How likely each one's errors are under its own error model, nats a second, and a's less b's.

    None where one has no error model, or the two are not at the same instants: the likelihood of
    poses that come more often is another one.
    """
    models = [summaries[name].get("error_model") for name in (comparison.a, comparison.b)]
    common = comparison.coverage.common
    if None in models or common.seconds <= 0.0:
        return None
    rate = common.poses / common.seconds
    known = [(model["poses"], model["nats_per_pose"] * rate) for model in models if model]
    if common.poses < _SAME_INSTANTS * max(poses for poses, _ in known):
        return None
    (_, a), (_, b) = known
    return {"a": a, "b": b, "difference": a - b}


def sentences_of_all(
    comparisons: Sequence[Comparison],
    causes: Sequence[Cause],
    summaries: Mapping[str, Mapping[str, Any]],
    say: Callable[[str], None],
) -> tuple[str, ...]:
    """Return what there is to say of several; ``say`` gets a line for a defect, and that is all."""

    def said() -> tuple[str, ...]:
        pairs = (
            f"{text}.{_likelier(one, summaries)}"
            for one, text in zip(comparisons, sentences(comparisons), strict=True)
        )
        return (*pairs, *(cause.sentence for cause in causes))

    nothing: tuple[str, ...] = ()
    return shield("the words of the comparison", said, nothing, say)


def against_the_best(
    summaries: Mapping[str, Mapping[str, Any]],
    comparisons: Sequence[Comparison],
    said: Sequence[str],
) -> tuple[str, ...]:
    """Return what :func:`sentences_of_all` ``said``, of many estimates of the best's pairs alone.

    The best has the smallest ATE. Of three and fewer all there is.
    """
    errors = {
        name: summary["conventional"].get("ate_translation_rmse")
        for name, summary in summaries.items()
    }
    known = {name: error for name, error in errors.items() if error is not None}
    # Without a sentence of each pair the words have failed, and that has been said.
    if len(errors) <= _FEW or not known or len(said) < len(comparisons):
        return tuple(said)
    best = min(known, key=known.__getitem__)
    of_pairs = zip(comparisons, said, strict=False)
    return (
        *(text for one, text in of_pairs if best in (one.a, one.b)),
        f"Each with {best}, whose ATE is the smallest; the other pairs are in summary.json.",
        *said[len(comparisons) :],
    )


def _likelier(comparison: Comparison, summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Whose errors are likelier under its own error model; empty where that cannot be told."""
    nats = nats_per_second(comparison, summaries)
    if nats is None:
        return ""
    better = comparison.a if nats["difference"] > 0.0 else comparison.b
    return (
        f" Under its own error model {better} is likelier by {abs(nats['difference']):.2g}"
        " nats a second."
    )


class NewestPoses:
    """The newest evaluated poses of an estimate outside the ground truth's gaps.

    Memory is bounded: beyond ``most`` poses the oldest are forgotten.
    """

    def __init__(self, name: str, offset: int, most: int = MOST_POSES) -> None:
        """Start empty; ``offset`` (ns) is that of the estimate's clock from the ground truth's."""
        self._name = name
        self._offset = offset
        self._most = most
        self.clear()

    def clear(self) -> None:
        """Start over."""
        self._kept = [Evaluated(self._name, *_NONE)]
        self._count = 0
        self._forgotten = False

    def add(self, evaluations: Evaluations) -> None:
        """Take in the next poses."""
        known = evaluations.sampled
        if not known.any():
            return
        stamps = evaluations.stamps[known] + self._offset
        self._kept.append(
            Evaluated(
                self._name, stamps, evaluations.ground_truth[known], evaluations.estimate[known]
            )
        )
        self._count += len(stamps)
        if self._count > 2 * self._most:
            self._join()

    def copy(self) -> NewestPoses:
        """Another one with the same poses, to be read in another thread."""
        joined, other = self._join(), NewestPoses(self._name, self._offset, self._most)
        other._kept, other._count, other._forgotten = [joined], self._count, self._forgotten
        return other

    def _join(self) -> Evaluated:
        if len(self._kept) == 1:
            return self._kept[0]
        fields = ("stamps", "ground_truth", "estimate")
        joined = (np.concatenate([getattr(one, f) for one in self._kept]) for f in fields)
        self._forgotten = self._forgotten or self._count > self._most
        newest = Evaluated(self._name, *(array[-self._most :] for array in joined))
        self._kept, self._count = [newest], len(newest)
        return newest

    def evaluated(self) -> Evaluated:
        """Return the poses, their stamps on the ground truth's clock."""
        return self._join()

    @property
    def begin(self) -> int | None:
        """Stamp (ns) before which poses have been forgotten; None where none have."""
        newest = self._join()
        return int(newest.stamps[0]) if self._forgotten else None


_NONE = np.empty(0, dtype=np.int64), np.empty((0, 4, 4)), np.empty((0, 4, 4))
