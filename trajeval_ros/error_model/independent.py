# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The poses whose ground truth errs independently, where it is sampled more rarely than they come.

Of the poses of each sample it is the nearest one, whose error is mostly the sample's own.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Stamps = npt.NDArray[np.int64]
Counts = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]

MOST = 2
"""Poses of a sample, on average, of which all count: one before it, and one after it."""


def independent(stamps: Stamps, nearest: Stamps) -> Indices:
    """The numbers of the poses that count; all of them, unless there are many to a sample.

    stamps: (N,) ns, increasing. nearest: of the ground truth's sample nearest to each, (N,) ns.
    """
    every = np.arange(len(stamps))
    begins = np.flatnonzero(_is_first(nearest))
    if len(stamps) <= MOST * len(begins):
        return every
    samples = np.cumsum(_is_first(nearest))
    by_distance = np.lexsort((np.abs(stamps - nearest), samples))
    return np.asarray(by_distance[begins])


def counted(nearest: Stamps, before: tuple[int, int] | None = None) -> Counts:
    """How many of the poses (N,) up to each count at the most: `MOST` of a sample.

    before: the sample of the last pose before these, and how many poses of it there were.
    """
    begins = _is_first(nearest)
    start = 0
    if before is not None and len(nearest) and nearest[0] == before[0]:
        begins[0], start = False, before[1]
    numbers = np.arange(len(nearest))
    since = numbers - np.maximum.accumulate(np.where(begins, numbers, -start))
    return np.cumsum(since < MOST)


def _is_first(nearest: Stamps) -> npt.NDArray[np.bool_]:
    """Which poses (N,) are the first of their sample."""
    return np.concatenate([np.ones(min(len(nearest), 1), np.bool_), np.diff(nearest) != 0])
