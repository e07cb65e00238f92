# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model while a run goes on, in bounded memory: of a window, and of the run in blocks.

A fit takes a part of a second, so that it is for the caller to say when and where it is made: it
depends on what is handed out with it alone. What is fitted depends on stamps alone: a block ends
with the first pose that makes it long enough, and the window is that of the newest pose.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.error_model.at_samples import fit_independent
from trajeval_ros.error_model.changes import Stretch, clock_changes
from trajeval_ros.error_model.independent import counted
from trajeval_ros.error_model.model import ErrorModel, Figure, Jump
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
class Block:
    """A stretch of the run from ``begin`` to ``end``, ns.

    information: of the nuisances, (9, 9). figures: the value of each, and what stands for its
    standard deviation, (groups, figures, 2), as the model has them.
    """

    begin: int
    end: int
    model: ErrorModel
    information: Array
    figures: Array

    @staticmethod
    def of(begin: int, end: int, model: ErrorModel) -> Block:
        """With what it adds to a run."""
        shown = [[(f.value, _spread(f)) for f in group.values()] for group in model.groups.values()]
        information = np.asarray(np.linalg.inv(model.covariance), np.float64)
        return Block(begin, end, model, information, np.array(shown))


@dataclass(frozen=True, slots=True)
class Fitted:
    """``model``: of a stretch, or None; of a block also ``run``, with ``blocks`` and all before.

    ``run`` is left to whoever asks for it where the fit was made without.
    """

    model: ErrorModel | None
    blocks: tuple[Block, ...] = ()
    run: ErrorModel | None = None


@dataclass(frozen=True, slots=True)
class Due:
    """A fit that is due: of a block of the run, after ``blocks``, or of the window."""

    poses: Poses
    blocks: tuple[Block, ...] | None = None

    def fit(self, *, with_run: bool = True) -> Fitted:
        """Fit it, and say what the run is with it, unless nobody asks before the next block."""
        model = fit_poses(self.poses)
        if self.blocks is None:
            return Fitted(model)
        blocks = self.blocks
        if model is not None:
            stamps = self.poses.truth.stamps
            blocks = (*blocks, Block.of(int(stamps[0]), int(stamps[-1]), model))
        if len(blocks) > _REMEMBERED:
            blocks = blocks[::2]
        return Fitted(model, blocks, combined(blocks) if blocks and with_run else None)


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
        self._blocks: tuple[Block, ...] = ()
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
        if self._run is None and self._blocks:
            self._run = combined(self._blocks)
        return self._run

    @property
    def blocks(self) -> int:
        """How many blocks :attr:`run` is of."""
        return len(self._blocks)


def combined(blocks: Sequence[Block]) -> ErrorModel:
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
        Stretch(
            b.begin, b.end, b.model.nuisances.clock_offset, float(b.model.covariance[0, 0]) ** 0.5
        )
        for b in blocks
    ]
    return ErrorModel(
        kind,
        _groups([block for block in blocks if block.model.kind is kind]),
        nuisances,
        covariance,
        unobserved(covariance),
        int(poses.sum()),
        float(sum(m.log_likelihood for m in models)),
        float(sum(m.uncorrected for m in models)),
        float(share @ [m.chi2_per_dof for m in models]),
        np.asarray(np.einsum("n,ngl->gl", share, [m.whiteness for m in models])),
        _last_jumps(models),
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


def _last_jumps(models: Sequence[ErrorModel]) -> tuple[Jump, ...]:
    """The last ones, and no more than so many."""
    found: list[Jump] = []
    for model in reversed(models):
        found[:0] = model.jumps
        if len(found) >= _JUMPS:
            break
    return tuple(found[-_JUMPS:])


def _nuisances(blocks: Sequence[Block]) -> tuple[Nuisances, Array]:
    """Those of the run, about its middle, with their covariance (9, 9)."""
    count, several = len(blocks), [block.model.nuisances for block in blocks]
    reference = several[0]
    middle = 0.5 * (blocks[0].begin + blocks[-1].end)
    steps = np.empty((count, 9))
    steps[:, 0] = _column(n.clock_offset for n in several) - reference.clock_offset
    steps[:, 1] = _column(n.clock_rate for n in several)
    extrinsics = np.array([n.extrinsic for n in several])
    steps[:, 2:8] = se3.log(extrinsics @ se3.inverse(reference.extrinsic))
    steps[:, 8] = np.log(_column(n.scale for n in several) / reference.scale)
    designs = np.tile(np.eye(9), (count, 1, 1))
    designs[:, 0, 1] = _column((0.5 * (b.begin + b.end) - middle) * 1e-9 for b in blocks)
    weights = np.array([block.information for block in blocks])
    weighted = designs.swapaxes(1, 2) @ weights
    covariance = np.linalg.inv((weighted @ designs).sum(axis=0))
    delta = covariance @ np.einsum("nij,nj->i", weighted, steps)
    if count > 1:
        rest = steps - designs @ delta
        spread = float(np.einsum("ni,nij,nj->", rest, weights, rest, optimize=True))
        covariance = covariance * max(spread / (9.0 * (count - 1)), 1.0)
    moved = replace(reference, clock_rate=0.0).moved(delta)
    return moved, 0.5 * (covariance + covariance.T)


def _column(values: Iterable[float]) -> Array:
    return np.fromiter(values, np.float64)


def _spread(figure: Figure) -> float:
    """A standard deviation, or what stands for it: of an interval, half of its upper part."""
    if figure.interval is not None and not np.isfinite(figure.std):
        return 0.5 * (figure.interval[1] - figure.value)
    return figure.std if np.isfinite(figure.std) else float("inf")


def _groups(blocks: Sequence[Block]) -> dict[str, dict[str, Figure]]:
    """Of blocks of one process, the figures that all have: of one that stands, none by distance."""
    count, fewest = len(blocks), min(block.figures.shape[1] for block in blocks)
    value, spread = np.moveaxis(np.array([block.figures[:, :fewest] for block in blocks]), -1, 0)
    value = np.maximum(value, 1e-300)
    relative = spread / value
    weight = 1.0 / np.maximum(relative, 1e-2) ** 2
    told = weight.sum(axis=0) > 0.0
    weight[:, ~told], relative[:, ~told] = 1.0, np.nan
    total = weight.sum(axis=0)
    mean = (weight * np.log(value)).sum(axis=0) / total
    apart = (weight * (np.log(value) - mean) ** 2).sum(axis=0)
    excess = np.maximum(apart / max(count - 1, 1), 1.0)
    known = np.isfinite(relative).any(axis=0)
    std = np.where(known, np.sqrt(excess / total), np.nan)
    figures = np.stack([np.exp(mean), np.exp(mean) * std], axis=-1).tolist()
    return {
        group: {name: Figure(*figure) for name, figure in zip(names, own, strict=False)}
        for (group, names), own in zip(blocks[0].model.groups.items(), figures, strict=True)
    }
