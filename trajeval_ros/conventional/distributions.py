# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mean, median, spread and extremes of errors, in constant memory."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.median import median

Array = npt.NDArray[np.float64]

CAPACITY = 4096
"""Poses, and pairs, of which distributions are taken: 0.7 MB of memory."""


class Distribution(NamedTuple):
    """Statistics of an error, m or rad; evo's mean, median, std (over N), min and max."""

    mean: float
    median: float
    std: float
    minimum: float
    maximum: float


class Distributions(NamedTuple):
    """The distribution of each error; None where the RMSE is None.

    Attributes:
        ate_translation: m.
        ate_rotation: rad.
        re_translation: m.
        re_rotation: rad.
        sampled_poses: how many of the poses ATE's are of. Exact where that is all of them.
        sampled_pairs: how many of the pairs RE's medians are of, and in `sim3` all of its
            translation's statistics.
    """

    ate_translation: Distribution | None
    ate_rotation: Distribution | None
    re_translation: Distribution | None
    re_rotation: Distribution | None
    sampled_poses: int
    sampled_pairs: int


@dataclasses.dataclass(frozen=True)
class RunningMoments:
    """Count, mean, centred sum of squares, minimum and maximum of values >= 0.

    Batches are merged as Chan, Golub and LeVeque do: no digits are lost however small the spread
    is beside the mean.
    """

    count: int = 0
    mean: float = 0.0
    centred: float = 0.0
    minimum: float = math.inf
    maximum: float = 0.0

    def updated(self, values: Array) -> "RunningMoments":
        """With values (N,), N > 0."""
        added, mean = len(values), float(values.mean())
        count, step = self.count + added, mean - self.mean
        within = float(((values - mean) ** 2).sum())
        return RunningMoments(
            count,
            self.mean + step * added / count,
            self.centred + within + step**2 * self.count * added / count,
            min(self.minimum, float(values.min())),
            max(self.maximum, float(values.max())),
        )

    @property
    def variance(self) -> float:
        """Over N, not N - 1."""
        return self.centred / self.count

    @property
    def mean_square(self) -> float:
        """About zero."""
        return self.mean**2 + self.variance


def distribution(values: Array, whole: RunningMoments | None = None) -> Distribution:
    """Of values (N,), N > 0; all but the median of the ``whole`` run where that is known."""
    known = RunningMoments().updated(values) if whole is None else whole
    return Distribution(
        mean=known.mean,
        median=median(values),
        std=math.sqrt(known.variance),
        minimum=known.minimum,
        maximum=known.maximum,
    )


class EvenSample:
    """Every k-th row of a stream, k the smallest power of two for which they fit.

    Which rows those are depends on their number alone.
    """

    def __init__(self, capacity: int, width: int) -> None:
        self._buffer = np.empty((capacity, width))
        self._kept = 0
        self._seen = 0
        self._stride = 1

    @property
    def rows(self) -> Array:
        """The sample, (K, width), K at most the capacity."""
        return self._buffer[: self._kept]

    def update(self, rows: Array) -> None:
        """Add rows (N, width)."""
        seen = self._seen + len(rows)
        stride = self._stride
        while -(-seen // stride) > len(self._buffer):
            stride *= 2
        if stride > self._stride:
            thinned = self._buffer[: self._kept : stride // self._stride].copy()
            self._kept = len(thinned)
            self._buffer[: self._kept] = thinned
        new = rows[-self._seen % stride :: stride]
        self._buffer[self._kept : self._kept + len(new)] = new
        self._kept += len(new)
        self._seen, self._stride = seen, stride
