# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One error model of the many blocks of a run: of any number as much is kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.error_model.changes import Stretch, clock_changes, joined
from trajeval_ros.error_model.model import ErrorModel, Figure, Jump
from trajeval_ros.error_model.nuisances import COUNT, Nuisances
from trajeval_ros.error_model.observed import unobserved
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.stamping import Scatters

Array = npt.NDArray[np.float64]

_JUMPS = 100
# Stretches of the clock that are kept apart; of more, every two neighbours are made one.
_STRETCHES = 1024
# No figure of a block counts for more than one that is known to this share of itself.
_BEST = 1e-2


@dataclass(frozen=True, slots=True)
class _Figures:
    """Sums over the blocks of one process.

    figures: weights, weighted logarithms and their weighted squares, and logarithms, of each figure
    that all of them have, (4, groups, figures). names: of these, by group.
    """

    blocks: int
    poses: int
    figures: Array
    names: dict[str, tuple[str, ...]]

    @staticmethod
    def of(model: ErrorModel) -> _Figures:
        """Those of one block."""
        groups = model.groups.values()
        value = np.maximum(
            [[figure.value for figure in group.values()] for group in groups], 1e-300
        )
        spread = np.array([[_spread(figure) for figure in group.values()] for group in groups])
        weight, logarithm = 1.0 / np.maximum(spread / value, _BEST) ** 2, np.log(value)
        figures = np.stack([weight, weight * logarithm, weight * logarithm**2, logarithm])
        names = {group: tuple(own) for group, own in model.groups.items()}
        return _Figures(1, model.poses, figures, names)

    def __add__(self, other: _Figures) -> _Figures:
        """Of both; of a block that stands there are none by distance."""
        few = min(self, other, key=lambda each: each.figures.shape[-1])
        size = few.figures.shape[-1]
        return _Figures(
            self.blocks + other.blocks,
            self.poses + other.poses,
            self.figures[..., :size] + other.figures[..., :size],
            few.names,
        )

    def together(self) -> dict[str, dict[str, Figure]]:
        """The geometric means by weight, and how far the blocks tell them, or scatter."""
        weight, first, second, logarithms = self.figures
        told = weight > 0.0
        total = np.where(told, weight, self.blocks)
        mean = np.where(told, first, logarithms) / total
        apart = np.maximum(second - first * mean, 0.0)
        excess = np.maximum(apart / max(self.blocks - 1, 1), 1.0)
        std = np.where(told, np.exp(mean) * np.sqrt(excess / total), np.nan)
        figures = np.stack([np.exp(mean), std], axis=-1).tolist()
        return {
            group: {name: Figure(*figure) for name, figure in zip(own, found, strict=True)}
            for (group, own), found in zip(self.names.items(), figures, strict=True)
        }


def _spread(figure: Figure) -> float:
    """A standard deviation, or what stands for it: of an interval, half of its upper part."""
    if figure.interval is not None and not np.isfinite(figure.std):
        return 0.5 * (figure.interval[1] - figure.value)
    return figure.std if np.isfinite(figure.std) else float("inf")


@dataclass(frozen=True, slots=True)
class Blocks:
    """Sums over the blocks of a run so far; each by itself a model of a stretch.

    begin, end: stamps of the run's first and last pose, ns. middle: the stamp (ns) to which what is
    said of the clock is related, that of the first block, and reference its nuisances. information,
    moments: of the least squares of the nuisances' steps from there, (9, 9), (9,); left: their χ²,
    that of each block's about those before it: about no step a clock that drifts for a day has one
    that leaves no digit for what blocks scatter by. chi2, whiteness: sums by poses.
    """

    count: int = 0
    begin: int = 0
    end: int = 0
    middle: float = 0.0
    reference: Nuisances = field(default_factory=Nuisances.none)
    information: Array = field(default_factory=lambda: np.zeros((COUNT, COUNT)))
    moments: Array = field(default_factory=lambda: np.zeros(COUNT))
    left: float = 0.0
    poses: int = 0
    log_likelihood: float = 0.0
    uncorrected: float = 0.0
    chi2: float = 0.0
    whiteness: Array | float = 0.0
    alternatives: Mapping[Kind, float] = field(default_factory=dict)
    figures: Mapping[Kind, _Figures] = field(default_factory=dict)
    jumps: tuple[Jump, ...] = ()
    stretches: tuple[Stretch, ...] = ()
    scatters: Scatters = field(default_factory=Scatters)
    converged: bool = True

    def with_one(self, begin: int, end: int, model: ErrorModel) -> Blocks:
        """And of another one, later than all before, from ``begin`` to ``end`` (ns)."""
        middle, poses, found = 0.5 * (begin + end), model.poses, model.nuisances
        here = self if self.count else replace(self, begin=begin, middle=middle, reference=found)
        information, moments, left = here._squares(middle, model)
        mine, kind = _Figures.of(model), model.kind
        figures = here.figures[kind] + mine if kind in here.figures else mine
        before = here.alternatives if here.count else dict.fromkeys(model.alternatives, 0.0)
        stretch = Stretch(begin, end, found.clock_offset, float(model.std[0]))
        stretches = (*here.stretches, stretch)
        if len(stretches) > _STRETCHES:
            stretches = joined(stretches, _STRETCHES // 2)
        return replace(
            here,
            count=here.count + 1,
            end=end,
            information=here.information + information,
            moments=here.moments + moments,
            left=here.left + left,
            poses=here.poses + poses,
            log_likelihood=here.log_likelihood + model.log_likelihood,
            uncorrected=here.uncorrected + model.uncorrected,
            chi2=here.chi2 + poses * model.chi2_per_dof,
            whiteness=here.whiteness + poses * model.whiteness,
            alternatives={
                each: before[each] + poses * nats
                for each, nats in model.alternatives.items()
                if each in before
            },
            figures={**here.figures, kind: figures},
            jumps=(*here.jumps, *model.jumps)[-_JUMPS:],
            stretches=stretches,
            scatters=here.scatters.with_one(model.stamps, poses),
            converged=here.converged and model.converged,
        )

    def _squares(self, middle: float, model: ErrorModel) -> tuple[Array, Array, float]:
        """What a block about its ``middle`` (ns) adds to the least squares."""
        found, reference = model.nuisances, self.reference
        step = np.empty(COUNT)
        step[0] = found.clock_offset - reference.clock_offset
        step[1] = found.clock_rate
        step[2:8] = se3.log(se3.compose(found.extrinsic, se3.inverse(reference.extrinsic)))
        step[8] = np.log(found.scale / reference.scale)
        design = _later(middle - self.middle)
        weight = np.linalg.inv(model.covariance)
        weighted = design.T @ weight
        if not self.count:
            return weighted @ design, weighted @ step, 0.0
        known = np.linalg.inv(self.information)
        off = step - design @ (known @ self.moments)
        spread = model.covariance + design @ known @ design.T
        return weighted @ design, weighted @ step, float(off @ np.linalg.solve(spread, off))

    def together(self) -> ErrorModel | None:
        """One model of all; None of none.

        The nuisances by generalised least squares, a clock rate between the blocks with them, and
        their covariance larger where the blocks scatter by more than they should; each parameter
        the geometric mean, weighted, over the blocks of the process that most poses are of.
        """
        if not self.count:
            return None
        kind = max(self.figures, key=lambda each: self.figures[each].poses)
        nuisances, covariance = self._nuisances()
        return ErrorModel(
            kind,
            self.figures[kind].together(),
            nuisances,
            covariance,
            unobserved(covariance),
            self.poses,
            self.log_likelihood,
            self.uncorrected,
            self.chi2 / self.poses,
            np.asarray(self.whiteness / self.poses),
            self.jumps,
            {each: nats / self.poses for each, nats in self.alternatives.items()},
            clock_changes(self.stretches),
            self.stretches,
            stamps=self.scatters.together(),
            converged=self.converged,
        )

    def _nuisances(self) -> tuple[Nuisances, Array]:
        """Those of the run, about its middle, with their covariance (9, 9)."""
        covariance = np.linalg.inv(self.information)
        delta = covariance @ self.moments
        if self.count > 1:
            covariance = covariance * max(self.left / (COUNT * (self.count - 1)), 1.0)
        there = _later(0.5 * (self.begin + self.end) - self.middle)
        covariance = there @ covariance @ there.T
        moved = self.reference._replace(clock_rate=0.0).moved(there @ delta)
        return moved, 0.5 * (covariance + covariance.T)


def _later(after: float) -> Array:
    """What is said of the clock, so much later (ns); (9, 9)."""
    design = np.eye(COUNT)
    design[0, 1] = after * 1e-9
    return design


NO_BLOCKS = Blocks()
