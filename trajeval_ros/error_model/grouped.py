# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The steps of translation's and rotation's processes together, as the likelihood takes them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.error_model.process import NUMBERS, Kind, Steps, first, steps
from trajeval_ros.error_model.system import Slopes, inverse

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class GroupedSteps:
    """At parameters (2, p), over intervals (n,), s, with factors (n, 2) as in `steps`.

    Arrays of the steps have the step as their last axis.
    """

    kind: Kind
    parameters: Array
    intervals: Array
    factors: Array

    @cached_property
    def _steps(self) -> list[Steps]:
        """By NumPy."""
        return [
            steps(self.kind, each, self.intervals, factors)
            for each, factors in zip(self.parameters, self.factors.T, strict=True)
        ]

    def _call(self, name: str, *found: Array) -> int:
        n, p = len(self.intervals), self.parameters.shape[1]
        given = map(loops.doubles, (self.parameters, self.intervals, self.factors))
        return loops.call(name, NUMBERS[self.kind], n, p, *given, *found)

    @cached_property
    def all(self) -> tuple[Array, Array, Array, float]:
        """F, Q and Q⁻¹, (2, k, k, n), and the sum of the log-determinants of Q.

        Raises numpy.linalg.LinAlgError where one is not positive definite.
        """
        if loops.there():
            k = self.kind.components
            found, log_det = np.empty((3, 2, k, k, len(self.intervals))), np.empty(1)
            if self._call("process_steps", *found, log_det):
                raise np.linalg.LinAlgError("a step without noise")
            return found[0], found[1], found[2], float(log_det[0])
        noise = np.stack([step.noise.transpose(1, 2, 0) for step in self._steps])
        moves = np.stack([step.transition.transpose(1, 2, 0) for step in self._steps])
        return moves, noise, *inverse(noise)

    @cached_property
    def begin(self) -> tuple[Array, float, Array]:
        """The first pose's prior, (2, k, k), its log-determinant, and the slope of that, (2, p)."""
        prior, _, log_prior, slope = zip(*self._first, strict=True)
        return np.stack(prior), sum(log_prior), np.stack(slope)

    @property
    def _first(self) -> list[tuple[Array, Array, float, Array]]:
        return [first(self.kind, each) for each in self.parameters]

    @cached_property
    def slopes(self) -> Slopes:
        """By the parameters."""
        prior = np.stack([each[1] for each in self._first], axis=1)
        if loops.there():
            k, p = self.kind.components, self.parameters.shape[1]
            shape = (2, k, k, len(self.intervals))
            noise, moves = np.empty((p, *shape)), np.empty(shape)
            self._call("process_slopes", noise, moves)
            return Slopes(noise, moves, prior)
        return Slopes(
            np.stack([step.slope_noise.transpose(0, 2, 3, 1) for step in self._steps], axis=1),
            np.stack([step.slope_transition[-1].transpose(1, 2, 0) for step in self._steps]),
            prior,
        )
