# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model while a run goes on, in bounded memory: of a window, and of the run in blocks.

A fit takes a part of a second, so that it is for the caller to say when and where it is made: it
depends on what is handed out with it alone. What is fitted depends on stamps alone: a block ends
with the first pose that makes it long enough, and the window is that of the newest pose.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.error_model.at_samples import fit_independent
from trajeval_ros.error_model.changes import Stretch, clock_changes
from trajeval_ros.error_model.independent import counted
from trajeval_ros.error_model.model import ErrorModel, Figure
from trajeval_ros.error_model.nuisances import Nuisances
from trajeval_ros.error_model.observed import unobserved
from trajeval_ros.error_model.recorded import Recorded
from trajeval_ros.error_model.stamping import Scatter

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
# Blocks that wait for a fit; beyond, the oldest is lost, and counted. Blocks that are remembered;
# beyond, every second is forgotten.
_WAITING = 3
_REMEMBERED = 4096
_JUMPS = 100


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


def fit_poses(poses: Poses) -> ErrorModel | None:
    """The error model of a stretch, by what was answered at its poses."""
    truth = poses.truth
    known = truth.at(truth.stamps)
    return fit_independent(truth.stamps, poses.estimate, poses.nearest, truth.at, known, MOST)


@dataclass(frozen=True, slots=True)
class _Block:
    begin: int
    end: int
    model: ErrorModel


@dataclass(frozen=True, slots=True)
class Fitted:
    """``model``: of a stretch, or None; of a block also ``run``, with ``blocks`` and all before."""

    model: ErrorModel | None
    blocks: tuple[_Block, ...] = ()
    run: ErrorModel | None = None


@dataclass(frozen=True, slots=True)
class Due:
    """A fit that is due: of a block of the run, after ``blocks``, or of the window."""

    poses: Poses
    blocks: tuple[_Block, ...] | None = None

    def fit(self) -> Fitted:
        """Fit it."""
        model = fit_poses(self.poses)
        if self.blocks is None:
            return Fitted(model)
        blocks = self.blocks
        if model is not None:
            stamps = self.poses.truth.stamps
            blocks = (*blocks, _Block(int(stamps[0]), int(stamps[-1]), model))
        if len(blocks) > _REMEMBERED:
            blocks = blocks[::2]
        return Fitted(model, blocks, combined(blocks) if blocks else None)


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
        self._blocks: tuple[_Block, ...] = ()
        self._asked: tuple[int, int] | None = None  # the window that was handed out last
        self.lost = 0
        self.run: ErrorModel | None = None
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
            self._blocks, self.run = fitted.blocks, fitted.run

    @property
    def blocks(self) -> int:
        """How many blocks :attr:`run` is of."""
        return len(self._blocks)


def combined(blocks: Sequence[_Block]) -> ErrorModel:
    """One model of several blocks.

    The nuisances by generalised least squares, a clock rate between the blocks with them, and their
    covariance larger where the blocks scatter by more than they should; each parameter the
    geometric mean, weighted, over the blocks of the process that most poses are of.
    """
    models = [block.model for block in blocks]
    poses = np.array([model.poses for model in models])
    kind = max({m.kind for m in models}, key=lambda k: sum(m.poses for m in models if m.kind is k))
    nuisances, covariance = _nuisances(blocks)
    share = poses / poses.sum()
    stretches = [
        Stretch(b.begin, b.end, b.model.nuisances.clock_offset, float(b.model.std[0]))
        for b in blocks
    ]
    return ErrorModel(
        kind,
        _groups([m for m in models if m.kind is kind]),
        nuisances,
        covariance,
        unobserved(covariance),
        int(poses.sum()),
        float(sum(m.log_likelihood for m in models)),
        float(sum(m.uncorrected for m in models)),
        float(share @ [m.chi2_per_dof for m in models]),
        np.asarray(sum(s * m.whiteness for s, m in zip(share, models, strict=True))),
        tuple(jump for m in models for jump in m.jumps)[-_JUMPS:],
        {
            k: float(share @ [m.alternatives[k] for m in models])
            for k in models[0].alternatives
            if all(k in m.alternatives for m in models)
        },
        clock_changes(stretches),
        tuple(stretches),
        stamps=Scatter.of([(model.stamps, model.poses) for model in models]),
        converged=all(model.converged for model in models),
    )


def _nuisances(blocks: Sequence[_Block]) -> tuple[Nuisances, Array]:
    """Those of the run, about its middle, with their covariance (9, 9)."""
    reference = blocks[0].model.nuisances
    middle = 0.5 * (blocks[0].begin + blocks[-1].end)
    information, right = np.zeros((9, 9)), np.zeros(9)
    steps, designs, weights = [], [], []
    for block in blocks:
        found = block.model.nuisances
        step = np.concatenate(
            [
                [found.clock_offset - reference.clock_offset, found.clock_rate],
                se3.log(found.extrinsic @ se3.inverse(reference.extrinsic)),
                [np.log(found.scale / reference.scale)],
            ]
        )
        design = np.eye(9)
        design[0, 1] = (0.5 * (block.begin + block.end) - middle) * 1e-9
        weight = np.linalg.inv(block.model.covariance)
        information += design.T @ weight @ design
        right += design.T @ weight @ step
        steps.append(step)
        designs.append(design)
        weights.append(weight)
    covariance = np.linalg.inv(information)
    delta = covariance @ right
    spread = 0.0
    for step, design, weight in zip(steps, designs, weights, strict=True):
        rest = step - design @ delta
        spread += float(rest @ weight @ rest)
    if len(blocks) > 1:
        covariance = covariance * max(spread / (9.0 * (len(blocks) - 1)), 1.0)
    moved = replace(reference, clock_rate=0.0).moved(delta)
    return moved, 0.5 * (covariance + covariance.T)


def _spread(figure: Figure) -> float:
    """A standard deviation, or what stands for it: of an interval, half of its upper part."""
    if figure.interval is not None and not np.isfinite(figure.std):
        return 0.5 * (figure.interval[1] - figure.value)
    return figure.std if np.isfinite(figure.std) else float("inf")


def _groups(models: list[ErrorModel]) -> dict[str, dict[str, Figure]]:
    groups: dict[str, dict[str, Figure]] = {}
    for group, names in models[0].groups.items():
        groups[group] = {}
        for name in names:
            known = [m.groups[group][name] for m in models]
            value = np.maximum([f.value for f in known], 1e-300)
            relative = np.array([_spread(f) for f in known]) / value
            weight = 1.0 / np.maximum(relative, 1e-2) ** 2
            if not weight.sum() > 0.0:
                weight = np.ones(len(known))
                relative = np.full(len(known), np.nan)
            mean = float(weight @ np.log(value) / weight.sum())
            spread = float(weight @ (np.log(value) - mean) ** 2)
            excess = max(spread / (len(known) - 1), 1.0) if len(known) > 1 else 1.0
            std = np.sqrt(excess / weight.sum()) if np.isfinite(relative).any() else np.nan
            groups[group][name] = Figure(float(np.exp(mean)), float(np.exp(mean) * std))
    return groups
