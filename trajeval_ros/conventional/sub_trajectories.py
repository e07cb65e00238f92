# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relative errors over sub-trajectories, of a run that is there as a whole.

Of poses i < j, as in `running`: translation ``|t|``, m, and rotation, rad, of the error
``(T_gt_i^-1 T_gt_j)^-1 (T_est_i^-1 T_est_j)``, the estimate scaled where the gauge is `sim3`.

- `kitti_drift`: the KITTI odometry benchmark's (A. Geiger, P. Lenz, R. Urtasun, CVPR 2012, and its
  development kit): for each of 100, 200, ... 800 m, from every 10th pose to the first one more than
  so far along the ground truth, the errors divided by that length; and their means, over all.
- `boxes`: as Z. Zhang and D. Scaramuzza draw them (IROS 2018): over 10, 20, ... 50 % of the path
  along the ground truth, from every pose to the one that is nearest to so far ahead, a fifth of the
  length off at most.
- `growth`: over lengths of 1, 2, 5, 10 ... up to half of what there is, of time or of path, from
  some hundred poses each to the one that is nearest to so far ahead, a tenth of it off at most.
- `all_pairs`: RE from every pose to the one that is nearest to a step ahead, a tenth of it off at
  most, along the estimate (in `sim3` along the ground truth); in frames to the one so many on. In m
  and in frames these are evo's ``all_pairs``; evo has no step in seconds.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.conventional.step_pairs import StepUnit

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Stamps = npt.NDArray[np.int64]

KITTI_LENGTHS = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
"""m."""
KITTI_EVERY = 10
"""Poses from one begin to the next: a second at the benchmark's 10 Hz."""
BOX_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5)
BOX_QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
_BOX_TOLERANCE = 0.2
_PAIR_TOLERANCE = 0.1
# Of a length so many pairs at most, over three decades of lengths.
_GROWTH_PAIRS, _GROWTH_LENGTHS = 500, 10
_COARSE = 1_000_000_000
# So many pairs at a time: a run may be long.
_PIECE = 1024
# The mean length of a normal vector in three dimensions, in its standard deviations on an axis.
_MEAN_LENGTH = math.sqrt(8.0 / math.pi)


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """Relative errors of (K,) pairs of poses.

    Attributes:
        translation: (K,), m.
        rotation: (K,), rad.
    """

    translation: Array
    rotation: Array

    @property
    def count(self) -> int:
        """K."""
        return len(self.translation)


def errors_between(
    ground_truth: Array, estimate: Array, begin: Indices, end: Indices, scale: float = 1.0
) -> Steps:
    """The relative errors of the pairs of poses ``begin`` to ``end``, (K,) each.

    Args:
        ground_truth: (M, 4, 4).
        estimate: (M, 4, 4).
        begin: indices.
        end: indices.
        scale: of the estimate, in the ground truth's metre.
    """
    pieces = [
        _errors_of_pairs(ground_truth, estimate, begin[some], end[some], scale)
        for some in (slice(at, at + _PIECE) for at in range(0, max(len(begin), 1), _PIECE))
    ]
    return Steps(
        np.concatenate([piece.translation for piece in pieces]),
        np.concatenate([piece.rotation for piece in pieces]),
    )


def _errors_of_pairs(
    ground_truth: Array, estimate: Array, begin: Indices, end: Indices, scale: float
) -> Steps:
    truth, moved = (
        se3.compose(se3.inverse(poses[begin]), poses[end]) for poses in (ground_truth, estimate)
    )
    back = np.swapaxes(truth[:, :3, :3], -1, -2)
    difference = scale * moved[:, :3, 3] - truth[:, :3, 3]
    return Steps(
        np.linalg.norm(difference, axis=-1),
        np.linalg.norm(se3.log_so3(back @ moved[:, :3, :3]), axis=-1),
    )


def path_along(poses: Array) -> Array:
    """The path from the first pose to each, (M,), m, of poses (M, 4, 4)."""
    lengths = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=-1)
    return np.concatenate((np.zeros(min(len(poses), 1)), np.cumsum(lengths)))


def is_noise(stamps: Stamps, ground_truth: Array, covariance: Array) -> bool:
    """Whether the path along the ground truth is its own noise rather than motion.

    So it is where a body stands: its steps add up as if it moved. Where independent noise of the
    covariance would make half of the path or more, and the path over steps of a second is either
    less than half as long, or half of it noise too. A smooth error does not make a path longer.

    Args:
        stamps: (M,) ns, strictly increasing.
        ground_truth: (M, 4, 4).
        covariance: (M, 6, 6), translation first.
    """
    if len(stamps) < 2:
        return False
    seconds = (stamps - stamps[0]) // _COARSE
    coarse = np.flatnonzero(np.concatenate(([True], np.diff(seconds) > 0)))
    fine_path, fine_noise = _path_and_noise(ground_truth, covariance)
    coarse_path, coarse_noise = _path_and_noise(ground_truth[coarse], covariance[coarse])
    if 2.0 * fine_noise < fine_path:
        return False
    return fine_path > 2.0 * coarse_path or 2.0 * coarse_noise >= coarse_path


def _path_and_noise(poses: Array, covariance: Array) -> tuple[float, float]:
    """The path's length, and what it would be were there nothing but independent noise, m."""
    traces = np.trace(covariance[:, :3, :3], axis1=1, axis2=2) / 3.0
    noise = _MEAN_LENGTH * float(np.sqrt(traces[1:] + traces[:-1]).sum())
    return float(path_along(poses)[-1]), noise


class Drift(NamedTuple):
    """Mean relative errors over sub-trajectories, each divided by its length.

    Attributes:
        length: m; None where it is over all lengths.
        subsequences: how many.
        translation: m/m; times 100 it is the benchmark's %.
        rotation: rad/m.
    """

    length: float | None
    subsequences: int
    translation: float
    rotation: float


class KittiDrift(NamedTuple):
    """The benchmark's figures: over all sub-trajectories, and those of each length there is."""

    overall: Drift
    by_length: tuple[Drift, ...]


def kitti_drift(ground_truth: Array, estimate: Array, scale: float = 1.0) -> KittiDrift | None:
    """The KITTI odometry benchmark's drift; None where the path is no longer than 100 m.

    Args:
        ground_truth: (M, 4, 4), the benchmark's frames.
        estimate: (M, 4, 4) at the same instants, not aligned.
        scale: of the estimate; 1 in the benchmark.
    """
    place = path_along(ground_truth)
    begins = np.arange(0, len(place), KITTI_EVERY)
    found: list[tuple[float, Steps]] = []
    for length in KITTI_LENGTHS:
        # The first place that is beyond, as the development kit's "greater than" has it.
        ends = np.searchsorted(place, place[begins] + length, side="right")
        there = ends < len(place)
        if there.any():
            steps = errors_between(ground_truth, estimate, begins[there], ends[there], scale)
            found.append((length, steps))
    if not found:
        return None
    by_length = tuple(
        Drift(
            length,
            steps.count,
            float(steps.translation.mean()) / length,
            float(steps.rotation.mean()) / length,
        )
        for length, steps in found
    )
    total = sum(drift.subsequences for drift in by_length)
    return KittiDrift(
        Drift(
            None,
            total,
            sum(drift.subsequences * drift.translation for drift in by_length) / total,
            sum(drift.subsequences * drift.rotation for drift in by_length) / total,
        ),
        by_length,
    )


class Box(NamedTuple):
    """The quantiles `BOX_QUANTILES` of the errors over sub-trajectories of one length.

    Attributes:
        length: m, or s where it is one of time.
        subsequences: how many.
        translation: m.
        rotation: rad.
    """

    length: float
    subsequences: int
    translation: tuple[float, ...]
    rotation: tuple[float, ...]


def boxes(ground_truth: Array, estimate: Array, scale: float = 1.0) -> tuple[Box, ...]:
    """The errors over a tenth to a half of the path; none where nothing moves.

    Args:
        ground_truth: (M, 4, 4).
        estimate: (M, 4, 4) at the same instants, not aligned.
        scale: of the estimate.
    """
    place = path_along(ground_truth)
    if len(place) < 2 or place[-1] <= 0.0:
        return ()
    found = []
    for share in BOX_SHARES:
        length = share * float(place[-1])
        begin, end = nearest_ahead(place, length, _BOX_TOLERANCE * length)
        if len(begin) == 0:
            continue
        found.append(_box(length, errors_between(ground_truth, estimate, begin, end, scale)))
    return tuple(found)


def growth(
    place: Array, ground_truth: Array, estimate: Array, scale: float = 1.0
) -> tuple[Box, ...]:
    """How the errors grow with the length of the sub-trajectory; none where there is no length.

    Args:
        place: (M,), not decreasing: seconds, or m along a path.
        ground_truth: (M, 4, 4).
        estimate: (M, 4, 4) at the same instants, not aligned.
        scale: of the estimate.
    """
    steps = np.diff(place)
    if len(steps) == 0 or not place[-1] > place[0]:
        return ()
    shortest, longest = 2.0 * float(np.median(steps)), 0.5 * float(place[-1] - place[0])
    power = math.floor(math.log10(longest))
    series = [
        digit * 10.0**exponent for exponent in range(power - 4, power + 1) for digit in (1, 2, 5)
    ]
    lengths = [length for length in series if shortest <= length <= longest][-_GROWTH_LENGTHS:]
    found = []
    for length in lengths:
        begin, end = nearest_ahead(place, length, _PAIR_TOLERANCE * length)
        if len(begin) == 0:
            continue
        every = -(-len(begin) // _GROWTH_PAIRS)
        found.append(
            _box(
                length, errors_between(ground_truth, estimate, begin[::every], end[::every], scale)
            )
        )
    return tuple(found)


def _box(length: float, steps: Steps) -> Box:
    translation, rotation = (
        tuple(np.quantile(errors, BOX_QUANTILES).tolist())
        for errors in (steps.translation, steps.rotation)
    )
    return Box(length, steps.count, translation, rotation)


def all_pairs(
    stamps: Stamps,
    ground_truth: Array,
    estimate: Array,
    delta: float,
    unit: StepUnit,
    scale: float | None = None,
) -> Steps:
    """The relative errors over every step of ``delta``, which overlap.

    Args:
        stamps: (M,) ns, strictly increasing.
        ground_truth: (M, 4, 4) at the stamps.
        estimate: (M, 4, 4) at the stamps, not aligned.
        delta: the step.
        unit: `s`, `m` or `f`.
        scale: of the estimate in the gauge `sim3`; None: its metre is right.
    """
    if unit == "f":
        begin = np.arange(max(len(stamps) - int(delta), 0))
        end = begin + int(delta)
    else:
        if unit == "s":
            place = np.asarray((stamps - stamps[:1]) * 1e-9, dtype=np.float64)
        else:
            place = path_along(estimate if scale is None else ground_truth)
        begin, end = nearest_ahead(place, delta, _PAIR_TOLERANCE * delta)
    return errors_between(ground_truth, estimate, begin, end, 1.0 if scale is None else scale)


def nearest_ahead(place: Array, ahead: float, tolerance: float) -> tuple[Indices, Indices]:
    """From each place the later one that is nearest to ``ahead`` further on.

    Only those no further off than ``tolerance``; of several as near the first.

    Args:
        place: (M,), not decreasing.
        ahead: above zero.
        tolerance: not below zero.

    Returns:
        Indices of the begins and the ends, (K,) each.
    """
    count = len(place)
    begin = np.arange(max(count - 1, 0))
    target = place[begin] + ahead
    above = np.clip(np.searchsorted(place, target), begin + 1, count - 1)
    # The first of those that are as far on as the one before.
    below = np.maximum(np.searchsorted(place, place[above - 1]), begin + 1)
    below = np.minimum(below, above)
    off_below, off_above = (
        np.abs((place[index] - place[begin]) - ahead) for index in (below, above)
    )
    end = np.where(off_below <= off_above, below, above)
    near = np.minimum(off_below, off_above) <= tolerance
    return begin[near], end[near]
