# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A transform composed along a tree of frames, as tf2 does, at the stamps of its finest edge."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Collection, Mapping

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Frames = tuple[str, str]


@dataclasses.dataclass(frozen=True, eq=False)
class Edge:
    """A transform as it was published.

    Attributes:
        stamps: (N,) ns, increasing; N = 1 of a static one.
        poses: (N, 4, 4), ``T_parent_child``.
        static: whether it holds at all times.
    """

    stamps: Integers
    poses: Array
    static: bool

    @classmethod
    def of(cls, stamps: Integers, poses: Array, static: bool) -> Edge:
        """From transforms in any order; of one stamp, and of a static one, the last counts."""
        if static:
            return cls(stamps[-1:], poses[-1:], True)
        # The last of a stamp: unique gives the first of the reversed.
        kept, places = np.unique(stamps[::-1], return_index=True)
        return cls(kept, poses[::-1][places], False)

    def at(self, stamps: Integers) -> Array:
        """The poses (M, 4, 4) at stamps (M,) between its first and last: interpolated."""
        if self.static:
            return np.broadcast_to(self.poses[0], (len(stamps), 4, 4))
        after = np.searchsorted(self.stamps, stamps).clip(1, len(self.stamps) - 1)
        if len(self.stamps) == 1:
            return np.broadcast_to(self.poses[0], (len(stamps), 4, 4))
        begin, end = self.stamps[after - 1], self.stamps[after]
        weight = (stamps - begin) / (end - begin)
        step = se3.log(se3.compose(se3.inverse(self.poses[after - 1]), self.poses[after]))
        return np.asarray(se3.compose(self.poses[after - 1], se3.exp(weight[:, None] * step)))


def way(edges: Collection[Frames], parent: str, child: str) -> tuple[tuple[Frames, bool], ...]:
    """The edges from ``parent`` to ``child``, and which of them are walked from child to parent.

    Empty where there is no way.
    """
    neighbours: dict[str, list[tuple[str, Frames, bool]]] = {}
    for edge in edges:
        neighbours.setdefault(edge[0], []).append((edge[1], edge, False))
        neighbours.setdefault(edge[1], []).append((edge[0], edge, True))
    came: dict[str, tuple[str, Frames, bool] | None] = {parent: None}
    waiting = deque([parent])
    while waiting and child not in came:
        here = waiting.popleft()
        for there, edge, backward in neighbours.get(here, ()):
            if there not in came:
                came[there] = (here, edge, backward)
                waiting.append(there)
    result = []
    step = came.get(child)
    while step is not None:
        here, edge, backward = step
        result.append((edge, backward))
        step = came[here]
    return tuple(reversed(result))


def finest(edges: Mapping[Frames, Edge], steps: Collection[tuple[Frames, bool]]) -> Frames:
    """Of the edges on the way that move the one with most stamps."""
    moving = [frames for frames, _ in steps if not edges[frames].static]
    return max(moving or [next(iter(steps))[0]], key=lambda frames: len(edges[frames].stamps))


def composed(
    edges: Mapping[Frames, Edge], steps: Collection[tuple[Frames, bool]], timed_by: Frames
) -> tuple[Integers, Array]:
    """``T_parent_child`` along the ``steps`` of `way`.

    At the stamps of the edge ``timed_by`` where those that move are all known.

    Returns:
        Stamps (N,), poses (N, 4, 4).
    """
    stamps = edges[timed_by].stamps
    for frames, _ in steps:
        known = edges[frames].stamps
        if edges[frames].static:
            continue
        stamps = stamps[(stamps >= known[0]) & (stamps <= known[-1])]
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    for frames, backward in steps:
        pose = edges[frames].at(stamps)
        poses = se3.compose(poses, se3.inverse(pose) if backward else pose)
    return stamps, poses
