# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What two estimates of one run have in common: time, and poses.

Poses are paired with the nearest in time, one to one, and not interpolated: an interpolated pose
averages the noise of two, and would make the estimate that is interpolated look better.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Stamps = npt.NDArray[np.int64]

# An estimate covers the time between two poses unless a tracker could have been lost between them:
# at least a second (keyframes come irregularly), and at least five of its usual intervals.
_GAP_SECONDS = 1.0
_GAP_INTERVALS = 5.0


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluated:
    """An estimate and the ground truth at its stamps.

    Attributes:
        name: what the sentences call it.
        stamps: (M,) int64 ns on the ground truth's clock, strictly increasing.
        ground_truth: (M, 4, 4), T_world_body at the stamps.
        estimate: (M, 4, 4) of the same body, in the estimate's own world, not aligned.

    Raises:
        ValueError: shapes that do not fit, stamps that do not increase, poses that are not finite.
    """

    name: str
    stamps: Stamps
    ground_truth: Array
    estimate: Array

    def __post_init__(self) -> None:
        count = len(self.stamps)
        if (
            self.stamps.shape != (count,)
            or self.stamps.dtype != np.int64
            or not self.ground_truth.shape == self.estimate.shape == (count, 4, 4)
        ):
            raise ValueError(
                f"{self.name}: stamps, ground_truth and estimate must be (M,) of int64, (M, 4, 4) "
                f"and (M, 4, 4), got {self.stamps.shape} of {self.stamps.dtype}, "
                f"{self.ground_truth.shape} and {self.estimate.shape}"
            )
        if np.any(self.stamps[1:] <= self.stamps[:-1]):
            raise ValueError(f"{self.name}: stamps must increase strictly")
        if not (np.isfinite(self.ground_truth).all() and np.isfinite(self.estimate).all()):
            raise ValueError(f"{self.name}: poses must be finite")

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, index: Indices | slice) -> Evaluated:
        """The poses at ascending indices, or of a slice."""
        return Evaluated(
            self.name, self.stamps[index], self.ground_truth[index], self.estimate[index]
        )


class Extent(NamedTuple):
    """How much of a run: number of poses, and time in s."""

    poses: int
    seconds: float


def pair_nearest(a: Stamps, b: Stamps) -> tuple[Indices, Indices]:
    """Indices into a and b of the poses that are each other's nearest, both ascending.

    No further apart than half the usual interval (the median) of the one that has fewer poses a
    second. Of two that are equally near the earlier counts.

    Args:
        a: (M,) ns, strictly increasing.
        b: (N,) ns, strictly increasing.
    """
    if len(a) == 0 or len(b) == 0:
        nothing = np.empty(0, dtype=np.int64)
        return nothing, nothing
    to_b, to_a = _nearest(a, b), _nearest(b, a)
    index_a = np.flatnonzero(to_a[to_b] == np.arange(len(a)))
    index_b = to_b[index_a]
    interval = max(usual_interval(a), usual_interval(b))
    near = 2 * np.abs(a[index_a] - b[index_b]) <= interval
    return index_a[near], index_b[near]


def usual_interval(stamps: Stamps) -> float:
    """The median time between poses, ns; 0 of fewer than two."""
    return median(np.diff(stamps)) if len(stamps) > 1 else 0.0


def _nearest(of: Stamps, among: Stamps) -> Indices:
    """For each stamp the index of the nearest of the others, (len(of),)."""
    after = np.clip(np.searchsorted(among, of), 1, max(len(among) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(among) - 1)
    later_is_nearer = np.abs(among[after] - of) < np.abs(of - among[before])
    return np.where(later_is_nearer, after, before).astype(np.int64)


class Coverage(NamedTuple):
    """What both cover, and what only one does."""

    common: Extent
    only_a: Extent
    only_b: Extent


def coverage(a: Stamps, b: Stamps, common_poses: int) -> Coverage:
    """The time that both cover and that one alone covers.

    An estimate covers the time between two successive poses if that is no gap: less than a
    second, or than five of its usual intervals where those take longer.

    Args:
        a: (M,) ns, strictly increasing.
        b: (N,) ns, strictly increasing.
        common_poses: how many pairs there are.
    """
    begins_a, ends_a = _stretches(a)
    begins_b, ends_b = _stretches(b)
    edges = np.unique(np.concatenate((begins_a, ends_a, begins_b, ends_b)))
    length = np.diff(edges)
    middle = edges[:-1] + length // 2
    in_a, in_b = _inside(middle, begins_a, ends_a), _inside(middle, begins_b, ends_b)
    return Coverage(
        Extent(common_poses, _seconds(length[in_a & in_b])),
        Extent(_outside(a, begins_b, ends_b), _seconds(length[in_a & ~in_b])),
        Extent(_outside(b, begins_a, ends_a), _seconds(length[~in_a & in_b])),
    )


def _stretches(stamps: Stamps) -> tuple[Stamps, Stamps]:
    """Where the stretches without a gap begin and end, (K,) each, ns."""
    if len(stamps) == 0:
        return stamps, stamps
    longest = max(_GAP_SECONDS * 1e9, _GAP_INTERVALS * usual_interval(stamps))
    gaps = np.flatnonzero(np.diff(stamps) >= longest)
    begins = stamps[np.concatenate(([0], gaps + 1))]
    return begins, stamps[np.concatenate((gaps, [len(stamps) - 1]))]


def _inside(stamps: Stamps, begins: Stamps, ends: Stamps) -> npt.NDArray[np.bool_]:
    """Whether each stamp lies in one of the stretches, their ends included."""
    if len(begins) == 0:
        return np.zeros(len(stamps), dtype=bool)
    last = np.searchsorted(begins, stamps, side="right") - 1
    return np.asarray((last >= 0) & (stamps <= ends[last]))


def _outside(stamps: Stamps, begins: Stamps, ends: Stamps) -> int:
    return int(np.count_nonzero(~_inside(stamps, begins, ends)))


def _seconds(lengths: Stamps) -> float:
    return float(lengths.sum() * 1e-9)
