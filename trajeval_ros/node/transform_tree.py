# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One transform composed along a tree of frames while the tree arrives; no ROS here.

A pose is made at each stamp of the finest edge on the way, as soon as every other edge is known on
both sides of that stamp: what is composed depends on stamps and their order alone, and nothing is
extrapolated. `trajeval_ros.files.transforms` does the same for a bag, where all is known.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.files.transforms import Edge, Frames, composed, way

MEMORY = 10_000_000_000
"""How far back an edge is known, ns: tf2's own default."""
_SLACK = MEMORY // 10


@dataclass(frozen=True, slots=True)
class Transform:
    """``T_parent_child`` at a stamp (ns), as published: x y z and qx qy qz qw."""

    stamp: int
    parent: str
    child: str
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]

    @property
    def is_usable(self) -> bool:
        """Whether it is finite, and its quaternion of norm 1 to a hundredth."""
        finite = np.isfinite((*self.position, *self.quaternion)).all()
        return bool(finite and abs(np.linalg.norm(self.quaternion) - 1.0) < 1e-2)


@dataclass(slots=True)
class _History:
    """What is known of an edge; the last of a stamp counts."""

    static: bool
    values: dict[int, tuple[float, ...]] = field(default_factory=dict)
    newest: int = 0

    def add(self, each: Transform) -> None:
        if self.static:
            self.values.clear()
        self.newest = max(self.newest, each.stamp) if self.values else each.stamp
        self.values[each.stamp] = (*each.position, *each.quaternion)

    def forget(self, before: int) -> None:
        """Let go of what lies before a stamp, but for the newest of it; once it is worth it."""
        if not self.values or next(iter(self.values)) > before - _SLACK:
            return
        old = sorted(stamp for stamp in self.values if stamp <= before)
        for stamp in old[:-1]:
            del self.values[stamp]

    def edge(self) -> Edge:
        values = np.array(list(self.values.values()))
        poses = se3.from_position_quaternion(values[:, :3], values[:, 3:])
        return Edge.of(np.array(list(self.values), dtype=np.int64), poses, self.static)


class TransformTree:
    """The frames that are known, and the poses of ``child`` in ``parent`` made of them."""

    def __init__(self, parent: str, child: str) -> None:
        """Compose ``T_parent_child``; names with or without the leading slash of older systems."""
        self.parent, self.child = _frame(parent), _frame(child)
        self._edges: dict[Frames, _History] = {}
        self._parent_of: dict[str, str] = {}
        self._steps: tuple[tuple[Frames, bool], ...] = ()
        self._finest: Frames | None = None
        self._made: int | None = None
        self.unusable = 0
        """Transforms on the way, so far, that are not finite or whose quaternion is none."""
        self._ready: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]] = []

    @property
    def frames(self) -> frozenset[str]:
        """Every frame that has been named."""
        return frozenset(frame for edge in self._edges for frame in edge)

    @property
    def problem(self) -> str | None:
        """Why nothing can be composed, however long one waits; None where it can."""
        if self._steps or not self._edges:
            return None
        for frame in (self.parent, self.child):
            if frame not in self.frames:
                return f"there is no frame {frame!r}; there are {', '.join(sorted(self.frames))}"
        return f"{self.parent!r} and {self.child!r} are not connected"

    def add(self, transforms: Iterable[Transform], static: bool) -> None:
        """Take transforms in the order of their arrival; `unusable` ones on the way are counted.

        A frame has one parent, as in tf2: a new one replaces the old. Stamps that go back by more
        than is remembered begin anew.
        """
        for each in transforms:
            edge = (_frame(each.parent), _frame(each.child))
            if not each.is_usable:
                # What is wrong with another joint of the robot is not of interest.
                self.unusable += any(edge == step for step, _ in self._steps)
                continue
            history = self._edges.get(edge)
            if history is None or history.static != static:
                history = self._change(edge, static)
            elif not static and each.stamp < history.newest - MEMORY:
                self._compose()
                history.values.clear()
                self._made = None
            history.add(each)
            if self._finest is None:
                self._finest = self._choose()

    def take(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """The poses that could be made since the last call: stamps (N,), poses (N, 4, 4)."""
        self._compose()
        ready, self._ready = self._ready, []
        stamps = [np.empty(0, dtype=np.int64), *(each[0] for each in ready)]
        poses = [np.empty((0, 4, 4)), *(each[1] for each in ready)]
        self._forget()
        return np.concatenate(stamps), np.concatenate(poses)

    def _change(self, edge: Frames, static: bool) -> _History:
        """Another edge, or another kind of it: what the old tree gives is composed before."""
        self._compose()
        parent, child = edge
        self._edges.pop((self._parent_of.get(child, parent), child), None)
        self._parent_of[child] = parent
        self._edges[edge] = _History(static)
        steps = way(self._edges, self.parent, self.child)
        if steps != self._steps or edge in self._moving:
            self._steps, self._finest = steps, None
        return self._edges[edge]

    @property
    def _moving(self) -> list[Frames]:
        return [edge for edge, _ in self._steps if not self._edges[edge].static]

    def _choose(self) -> Frames | None:
        """The edge with the shortest mean interval; None until each on the way is known twice."""
        moving = {edge: self._edges[edge].values for edge in self._moving}
        if not moving or any(len(values) < 2 for values in moving.values()):
            return None
        return min(moving, key=lambda e: (max(moving[e]) - min(moving[e])) / (len(moving[e]) - 1))

    def _compose(self) -> None:
        if self._finest is None:
            return
        edges = {edge: self._edges[edge].edge() for edge, _ in self._steps}
        stamps, poses = composed(edges, self._steps, self._finest)
        if self._made is not None:
            new = stamps > self._made
            stamps, poses = stamps[new], poses[new]
        if len(stamps):
            self._made = int(stamps[-1])
            self._ready.append((stamps, poses))

    def _forget(self) -> None:
        moving = self._moving
        for edge, history in self._edges.items():
            if history.static:
                continue
            before = history.newest - MEMORY
            if edge in moving and self._made is not None:
                before = max(before, self._made)
            history.forget(before)


def _frame(name: str) -> str:
    return name.removeprefix("/")
