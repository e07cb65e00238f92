# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tracker that was lost for a while and wrote something all the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.rotations import SECOND, Array, Stamps

# s and poses that one pose has to be repeated for; and how far the ground truth goes meanwhile (m).
_LEAST_SPAN, _LEAST_COUNT, _MOVED = 0.5, 4, 0.05
# Of all poses, at most.
_MOST = 0.5
# Stretches whose rows are given.
_SHOWN = 3


class _Stretch(NamedTuple):
    """Poses ``first`` to ``last`` that are one pose, the identity or not."""

    first: int
    last: int
    identity: bool


def lost(
    stamps: Stamps,
    poses: Array,
    truth_stamps: Stamps,
    truth: Array,
    row: Callable[[int], int],
) -> tuple[Cause, ...]:
    """Stretches in which an estimate repeats one pose while the ground truth moves.

    ``stamps`` (N,) ns on the ground truth's clock, ``poses`` (N, 7), position and quaternion as
    written; ``truth_stamps`` (M,) ns, increasing, with positions (M, 3); ``row``: of a pose, where
    it stands in the file.
    """
    found = [
        stretch
        for stretch in _stretches(stamps, poses)
        if _moved(stretch, stamps, truth_stamps, truth) >= _MOVED
    ]
    count = sum(each.last - each.first + 1 for each in found)
    # What repeats its poses most of the time is published more often than it is estimated.
    if not found or count > _MOST * len(stamps):
        return ()
    longest = max(found, key=lambda each: int(stamps[each.last] - stamps[each.first]))
    shown = ", ".join(f"{row(each.first)} to {row(each.last)}" for each in found[:_SHOWN])
    left = len(found) - _SHOWN
    more = f" and {left} {'stretch' if left == 1 else 'stretches'} more" if left > 0 else ""
    what = "the identity" if any(each.identity for each in found) else "one pose again and again"
    seconds = float(stamps[longest.last] - stamps[longest.first]) / SECOND
    moved = _moved(longest, stamps, truth_stamps, truth)
    return (
        Cause(
            "lost",
            f"the estimate writes {what} while the ground truth moves, as a tracker that is lost:"
            f" {count:,} of {len(stamps):,} poses, rows {shown}{more}; for up to {seconds:.2g} s,"
            f" in which the ground truth goes {moved:.2g} m",
            "leave these rows out; what is lost is no pose",
        ),
    )


def _stretches(stamps: Stamps, poses: Array) -> list[_Stretch]:
    """Where one pose is repeated for long."""
    if len(stamps) < _LEAST_COUNT:
        return []
    same = (poses[1:] == poses[:-1]).all(axis=1)
    edges = np.diff(np.concatenate([[False], same, [False]]).astype(np.int8))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    long = (stamps[last] - stamps[first] >= _LEAST_SPAN * SECOND) & (
        last - first + 1 >= _LEAST_COUNT
    )
    identity = (poses[:, :6] == 0.0).all(axis=1)
    return [
        _Stretch(int(a), int(b), bool(identity[a]))
        for a, b in zip(first[long], last[long], strict=True)
    ]


def _moved(stretch: _Stretch, stamps: Stamps, truth_stamps: Stamps, truth: Array) -> float:
    """How far the ground truth goes from where it was, m."""
    begin, end = np.searchsorted(truth_stamps, [stamps[stretch.first], stamps[stretch.last]])
    between = truth[begin:end]
    if len(between) < 2:
        return 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.linalg.norm(between - between[0], axis=1).max())
