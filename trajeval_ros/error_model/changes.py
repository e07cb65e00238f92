# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A clock offset that is not the same all the time: by what stretches of a run say of it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.likelihood.tails import student_quantile
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]

# Of so many runs whose clock does not change, one is said to; at most, as places are taken for
# independent.
_RUNS = 1000.0
# The stretches' standard deviations count like so many degrees of freedom, beside their scatter; of
# that, each difference of neighbours tells so many by the median, which is that of χ² with one.
_KNOWN = 10.0
_OF_NEIGHBOURS = 0.25
_MEDIAN = 0.4549
# A change has to be e⁵ times as likely as a steady rate, and as a rate that changes steadily where
# that leaves no more than so many standard deviations of chance; and so long at the least, s.
_OVER_RATE = 10.0
_CHANCE = 3.0
_SHORTEST = 1e-3


class Stretch(NamedTuple):
    """What a part of a run says of the clock.

    begin, end: stamps of its first and last pose, ns. offset, std: s, of what is to be added to the
    estimate's stamps.
    """

    begin: int
    end: int
    offset: float
    std: float


class ClockChange(NamedTuple):
    """The offset went from ``before`` to ``after`` (s, ``std`` of the difference).

    About the stamps ``begin`` and ``end`` (ns), between two stretches.
    """

    begin: int
    end: int
    before: float
    after: float
    std: float


def joined(stretches: Sequence[Stretch], most: int) -> tuple[Stretch, ...]:
    """At most so many stretches: neighbours as one, their offsets' mean by weight."""
    known = [s for s in stretches if np.isfinite(s.std) and s.std > 0.0]
    size = max(1, -(-len(known) // most))
    found = []
    for first in range(0, len(known), size):
        parts = known[first : first + size]
        weight = np.array([part.std**-2 for part in parts])
        offset = float(weight @ [part.offset for part in parts]) / float(weight.sum())
        std = float(weight.sum()) ** -0.5
        found.append(Stretch(parts[0].begin, parts[-1].end, offset, std))
    return tuple(found)


def clock_changes(stretches: Sequence[Stretch]) -> tuple[ClockChange, ...]:
    """Where the offset changes other than at a steady rate; stretches in the order of time.

    The place that explains most, and so on within the two parts that it leaves.
    """
    known = [s for s in stretches if np.isfinite(s.std) and s.std > 0.0]
    offset, weight = np.array([s.offset for s in known]), np.array([s.std**-2 for s in known])
    when = np.array([0.5 * (s.begin + s.end) for s in known])
    if len(known) < 3:
        return ()
    scatter, degrees = _scatter(offset, weight)
    weight = weight / scatter
    few = 0.5 / (_RUNS * (len(known) - 1))
    places = _places(
        offset, weight, (when - when[0]) * 1e-9, lambda: student_quantile(few, degrees) ** 2
    )
    if not places:
        return ()
    edges = [0, *places, len(known)]
    levels = []
    for begin, end in itertools.pairwise(edges):
        mass = float(weight[begin:end].sum())
        levels.append((float(weight[begin:end] @ offset[begin:end]) / mass, 1.0 / mass))
    return tuple(
        ClockChange(
            known[k - 1].end,
            known[k].begin,
            before,
            after,
            float(np.sqrt(before_variance + after_variance)),
        )
        for k, (before, before_variance), (after, after_variance) in zip(
            places, levels[:-1], levels[1:], strict=True
        )
    )


def _scatter(offset: Array, weight: Array) -> tuple[float, float]:
    """By how much stretches (n,) scatter more than they should, in variance.

    By the median of what is between neighbours, which a few changes do not change. And by how many
    degrees of freedom that is known: the χ² of the best of n places is the square of Student's.
    """
    apart = np.diff(offset) ** 2 / (1.0 / weight[1:] + 1.0 / weight[:-1])
    told = _OF_NEIGHBOURS * len(apart)
    degrees = _KNOWN + told
    scatter = (_KNOWN + told * median(apart) / _MEDIAN) / degrees
    return max(scatter, 1.0), degrees


def _places(offset: Array, weight: Array, when: Array, rare: Callable[[], float]) -> list[int]:
    """The numbers of the stretches before which the offset (n,) changes; when: s, increasing.

    rare: gives the χ² that chance hardly ever does; asked last, for it takes SciPy to be loaded.
    """
    if len(offset) < 3:
        return []
    # Up to each: sums of weights and of weighted offsets, which give the gain of every place.
    mass, moment = np.cumsum(weight)[:-1], np.cumsum(weight * offset)[:-1]
    total, mean = weight.sum(), weight @ offset / weight.sum()
    rest = total - mass
    step = (total * mean - moment) / rest - moment / mass
    gain = step**2 * mass * rest / total
    k = int(np.argmax(gain))
    other = _smoothly(offset - mean, weight, when)
    if abs(step[k]) < _SHORTEST or gain[k] < other + _OVER_RATE or gain[k] < rare():
        return []
    left = _places(offset[: k + 1], weight[: k + 1], when[: k + 1], rare)
    right = _places(offset[k + 1 :], weight[k + 1 :], when[k + 1 :], rare)
    return [*left, k + 1, *(k + 1 + place for place in right)]


def _smoothly(offset: Array, weight: Array, when: Array) -> float:
    """What a steady rate explains of offsets (n,) about their mean, χ²; or one that changes so.

    The latter only where it explains them all but for chance: else it may be another step or two.
    """
    root = np.sqrt(weight)
    away = (when - when.mean()) / np.ptp(when)
    basis, _ = np.linalg.qr(root[:, None] * np.stack([np.ones_like(away), away, away**2], axis=1))
    explained = (basis.T @ (root * offset)) ** 2
    left = float(weight @ offset**2 - explained.sum())
    freedom = len(offset) - 3
    if left <= freedom + _CHANCE * np.sqrt(2.0 * freedom):
        return float(explained[1:].sum())
    return float(explained[1])
