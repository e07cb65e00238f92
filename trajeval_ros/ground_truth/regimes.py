# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What was learned of a recording, and how a stretch of it may differ.

A robot stands, drives, stops at a light and drives on. What is learned is the *shape* of the motion
and the noise: its length scales and how its parts compare. How lively the motion is and how large
the noise, a stretch's *regime*, are for its own samples to say.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.hyperparameters import (
    LEAST_NOISE,
    Component,
    GroupHyperparameters,
)
from trajeval_ros.ground_truth.kernels import Matern
from trajeval_ros.ground_truth.models import Grid, Model

Array = npt.NDArray[np.float64]
Numbers = tuple[float, ...]

# Natural logarithms of two standard deviations' ratio. That the motion changes by a multiple is
# common; that the noise does is not, and larger noise smooths motion away: it takes more evidence.
PRIOR_STDS = (3.0, 0.35)
# The most and, below zero, the least that either is.
MOST = 40
# Of two regimes with motions less than so many powers of two apart one tells enough of the other.
_ALIKE = 3


class Regime(NamedTuple):
    """Motion ``2**motion`` times as lively as learned, noise ``2**noise`` times as large."""

    motion: int = 0
    noise: int = 0

    def moved(self, motion: int, noise: int) -> Regime:
        """So many powers of two further."""
        return Regime(
            min(max(self.motion + motion, -MOST), MOST),
            min(max(self.noise + noise, -MOST), MOST),
        )

    @property
    def log_prior(self) -> float:
        """How probable it is beside the learned one, nats."""
        motion, noise = math.log(2.0) * self.motion, math.log(2.0) * self.noise
        return -0.5 * ((motion / PRIOR_STDS[0]) ** 2 + (noise / PRIOR_STDS[1]) ** 2)

    def of(self, theta: Array) -> Array:
        """θ (p,) of a :class:`Model` in this regime: every log σ and log n moved."""
        moved = theta.copy()
        moved[:-1:2] += math.log(2.0) * self.motion
        moved[-1] += math.log(2.0) * self.noise
        return moved


USUAL = Regime()


@dataclass(frozen=True, slots=True)
class Learned:
    """What one group's samples have taught: θ of ``model`` on ``grid``.

    ``accuracy``: the instrument's, in the group's unit, which adds to the noise; ``seen``: the
    regimes of the stretches that it was learned from.
    """

    model: Model
    grid: Grid
    theta: Array
    accuracy: float
    seen: frozenset[Regime] = frozenset({USUAL})
    _known: dict[Regime, GroupHyperparameters] = field(default_factory=dict, repr=False)
    _numbers: dict[Regime, Numbers] = field(default_factory=dict, repr=False)
    _parts: list[tuple[Array, Array]] = field(default_factory=list, repr=False)

    def is_new(self, regime: Regime) -> bool:
        """Whether nothing like it was seen."""
        return all(
            abs(regime.motion - known.motion) > _ALIKE or abs(regime.noise - known.noise) > 1
            for known in {USUAL, *self.seen}
        )

    def __eq__(self, other: object) -> bool:
        """Whether both stand for the same process."""
        if not isinstance(other, Learned):
            return NotImplemented
        return self is other or self.under(USUAL) == other.under(USUAL)

    __hash__ = None  # type: ignore[assignment]

    def under(self, regime: Regime) -> GroupHyperparameters:
        """The hyperparameters of a stretch in ``regime``."""
        if regime not in self._known:
            self._known[regime] = self._under(regime)
        return self._known[regime]

    def numbers(self, regime: Regime) -> Numbers:
        """The same: σ and l of each kernel, one after the other, and the noise's n."""
        if regime not in self._numbers:
            natural = self.model.natural(regime.of(self.theta), self.grid)[0]
            *pairs, noise = np.exp(natural).tolist()
            noise = max(math.hypot(noise, self.accuracy), LEAST_NOISE * max(pairs[::2]))
            self._numbers[regime] = (*pairs, noise)
        return self._numbers[regime]

    def parts(self) -> tuple[Array, Array]:
        """The same of every regime: ``rate / l`` of m Matérn kernels, and variances (m + 1, 2).

        Of each kernel's σ², and of n² but for the instrument's, what the motion's is and what the
        noise's: in a regime they are ``4**motion`` and ``4**noise`` times as large.
        """
        if not self._parts:
            lengths, parts = _parts(self.model, self.theta, self.grid)
            rates = [k.rate for k in self.model.kernels if isinstance(k, Matern)]
            self._parts.append((rates / np.exp(lengths), parts))
        return self._parts[0]

    def _under(self, regime: Regime) -> GroupHyperparameters:
        *pairs, noise = self.numbers(regime)
        return GroupHyperparameters(tuple(map(Component, pairs[::2], pairs[1::2])), noise)


def natural_in(model: Model, theta: Array, grid: Grid, regimes: Sequence[Regime]) -> Array:
    """What `Model.natural` says of θ in each of the regimes; (r, 2m + 1)."""
    lengths, parts = _parts(model, theta, grid)
    found = np.empty((len(regimes), 2 * len(lengths) + 1))
    found[:, 1::2] = lengths
    found[:, ::2] = 0.5 * np.log(4.0 ** np.array(regimes) @ parts.T)
    return found


def _parts(model: Model, theta: Array, grid: Grid) -> tuple[Array, Array]:
    """``log l`` of the kernels, (m,), and the variances (m + 1, 2) of `Learned.parts`."""
    still, exact = theta.copy(), theta.copy()
    still[:-1:2] = exact[-1] = -math.inf
    found = np.stack([model.natural(each, grid)[0] for each in (exact, still)], axis=1)
    return found[1:-1:2, 0], np.exp(2.0 * found[::2])
