# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model while a run goes on, in bounded memory: of a window, and of the run in blocks.

A fit takes a part of a second, so that it is for the caller to say when and where it is made: it
depends on what is handed out with it alone. What is fitted depends on stamps alone: a block ends
with the first pose that makes it long enough, and the window is that of the newest pose.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.error_model.at_samples import fit_independent
from trajeval_ros.error_model.blocks import NO_BLOCKS, Blocks
from trajeval_ros.error_model.independent import counted
from trajeval_ros.error_model.model import ErrorModel
from trajeval_ros.error_model.recorded import Recorded

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# A fit is of every k-th pose of a stretch, so that it is of no more than this.
MOST = 1000
# A block has so many poses, of a sample of the ground truth no more than two, and lasts so long
# (ns), at the least.
_BLOCK = 200
_DURATION = 20_000_000_000
# A stretch holds no more poses than this.
_LONGEST = 20_000
# Blocks that wait for a fit; beyond, the oldest is lost, and counted.
_WAITING = 3


@dataclass(frozen=True, slots=True)
class Poses:
    """Evaluated poses: those of the estimate (N, 4, 4), and the ground truth there.

    Their stamps are on the ground truth's clock, as evaluated. nearest: those of its samples
    nearest to each, (N,) ns.
    """

    truth: Recorded
    estimate: Array
    nearest: Stamps

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.truth.stamps)

    def __getitem__(self, index: slice) -> Poses:
        """Some of them."""
        t = self.truth
        kept = (t.stamps[index], t.poses[index], t.covariances[index], t.twists[index])
        return Poses(Recorded(*kept), self.estimate[index], self.nearest[index])

    @staticmethod
    def joined(parts: list[Poses]) -> Poses:
        """One after the other."""
        columns = (
            np.concatenate([getattr(p.truth, name) for p in parts])
            for name in ("stamps", "poses", "covariances", "twists")
        )
        return Poses(
            Recorded(*columns),
            np.concatenate([p.estimate for p in parts]),
            np.concatenate([p.nearest for p in parts]),
        )


def fit_poses(poses: Poses, *, parts: bool = True) -> ErrorModel | None:
    """The error model of a stretch, by what was answered at its poses; ``parts``: as there."""
    truth = poses.truth
    given = truth.stamps, poses.estimate, poses.nearest, truth.at, truth.at(truth.stamps)
    return fit_independent(*given, MOST, parts=parts)


class Fitted(NamedTuple):
    """``model``: of a stretch, or None; of a block also ``run``, with ``blocks`` and all before.

    ``run`` is left to whoever asks for it where the fit was made without.
    """

    model: ErrorModel | None
    blocks: Blocks = NO_BLOCKS
    run: ErrorModel | None = None


class Due(NamedTuple):
    """A fit that is due: of a block of the run, after ``blocks``, or of the window."""

    poses: Poses
    blocks: Blocks | None = None

    def fit(self, *, with_run: bool = True) -> Fitted:
        """Fit it, and say what the run is with it, unless nobody asks before the next block."""
        # Of a block the run takes neither the clocks of parts nor those of groups.
        model = fit_poses(self.poses, parts=self.blocks is None)
        if self.blocks is None:
            return Fitted(model)
        blocks = self.blocks
        if model is not None:
            stamps = self.poses.truth.stamps
            blocks = blocks.with_one(int(stamps[0]), int(stamps[-1]), model)
        return Fitted(model, blocks, blocks.together() if with_run else None)


class RunningErrorModel:
    """Takes evaluated poses; says which fit is due, and takes what it says, one at a time."""

    def __init__(self, window: int) -> None:
        """Start empty. window: ns, :attr:`duration`, which may change."""
        self.duration = window
        self._window: deque[Poses] = deque()
        self._in_window = 0
        self._open: list[Poses] = []
        self._in_open = self._counted = 0
        self._sample: tuple[int, int] | None = None  # of the newest open pose, and its poses so far
        self._closed: deque[Poses] = deque()
        self._blocks = NO_BLOCKS
        self._run: ErrorModel | None = None
        self._asked: tuple[int, int] | None = None  # the window that was handed out last
        self.lost = 0
        self.window: ErrorModel | None = None

    def add(self, poses: Poses) -> None:
        """Take poses, later than all before."""
        if not len(poses):
            return
        self._window.append(poses)
        self._in_window += len(poses)
        oldest = int(poses.truth.stamps[-1]) - self.duration
        while self._window[0].truth.stamps[-1] < oldest or (
            self._in_window > _LONGEST and len(self._window) > 1
        ):
            self._in_window -= len(self._window.popleft())
        while len(poses):
            poses = self._extend(poses)

    def _extend(self, poses: Poses) -> Poses:
        """Add to the open block; return what is for the next one."""
        begin = int((self._open[0] if self._open else poses).truth.stamps[0])
        numbers = self._in_open + np.arange(1, len(poses) + 1)
        counts = self._counted + counted(poses.nearest, self._sample)
        full = (counts >= _BLOCK) & (poses.truth.stamps >= begin + _DURATION)
        full |= numbers >= _LONGEST
        if not full.any():
            self._open.append(poses)
            self._in_open, self._counted = int(numbers[-1]), int(counts[-1])
            sample = int(poses.nearest[-1])
            same = len(poses) - int(np.searchsorted(poses.nearest, sample))
            if same == len(poses) and self._sample is not None and self._sample[0] == sample:
                same += self._sample[1]
            self._sample = sample, same
            return poses[:0]
        end = int(np.argmax(full)) + 1
        self._closed.append(Poses.joined([*self._open, poses[:end]]))
        self._open, self._in_open, self._counted, self._sample = [], 0, 0, None
        if len(self._closed) > _WAITING:
            self._closed.popleft()
            self.lost += 1
        return poses[end:]

    def block_due(self) -> Due | None:
        """The oldest of the blocks that wait, if any does."""
        return Due(self._closed.popleft(), self._blocks) if self._closed else None

    def window_due(self) -> Due | None:
        """The window, if it has changed since it was handed out last."""
        if not self._window:
            return None
        newest = int(self._window[-1].truth.stamps[-1])
        if self._asked == (newest, self.duration):
            return None
        self._asked = newest, self.duration
        poses = Poses.joined(list(self._window))
        first = int(np.searchsorted(poses.truth.stamps, newest - self.duration))
        return Due(poses[first:])

    def take(self, due: Due, fitted: Fitted) -> None:
        """Take what a fit that was `Due` says: of the :attr:`window`, or of the :attr:`run`."""
        if due.blocks is None:
            self.window = fitted.model
        else:
            self._blocks, self._run = fitted.blocks, fitted.run

    @property
    def run(self) -> ErrorModel | None:
        """That of all blocks together."""
        if self._run is None:
            self._run = self._blocks.together()
        return self._run

    @property
    def blocks(self) -> int:
        """How many blocks :attr:`run` is of."""
        return self._blocks.count
