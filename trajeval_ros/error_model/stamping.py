# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimate's stamps, where they scatter: what is not the estimator's fault, either.

A pose that is stamped when it arrives, δ too late, is off by ``v δ`` along its own twist v, in
position and orientation at once. Its error's covariance grows by ``σ² v vᵀ``, as a ground truth's
sample does (``ground_truth.stamping``). Errors along the way alone, as of depth before a camera
that drives ahead, or errors that are larger where a robot is faster, are no evidence of that: only
where positions and orientations are off by the *same* times is it a matter of stamps.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.error_model.likelihood import Data, Likelihood
from trajeval_ros.error_model.maximum import climb
from trajeval_ros.error_model.system import AXES

Array = npt.NDArray[np.float64]

# So many standard deviations are beyond doubt: a chance of 3e-6, on one side.
_BEYOND_DOUBT = 4.5
# Poses so far apart have no stamp in common: by what these seem to have, it is judged.
_FIRST_LAG, _LAST_LAG = 3, 64
# s: below, no driver is asked to stamp anything better.
_SHORTEST = 2e-4
# A change of log σ by which the likelihood's slope is found, and its longest step.
_APART = 0.1
_LONGEST = 0.7
# It is found where the next step is less than this share of its standard deviation.
_CONVERGED = 0.3
_STEPS = 6
# As `fit`'s: the parameters' maximum, beside each σ.
_GAIN = 5e-3
_CLIMBS = 10


class Scatter(NamedTuple):
    """By how much stamps scatter.

    value, std: a standard deviation, and how well it is known, s. nats: by how much the likelihood
    is larger with it. translation, rotation: what it moves a pose by, root mean square, m and rad.
    """

    value: float
    std: float
    nats: float
    translation: float
    rotation: float

    def larger(self, factor: float) -> Scatter:
        """All but the nats."""
        value, std = factor * self.value, factor * self.std
        return Scatter(value, std, self.nats, factor * self.translation, factor * self.rotation)


class Scatters(NamedTuple):
    """Sums over stretches.

    poses: of all; scattered: of those whose stamps scatter. squares: of value, translation and
    rotation, by poses, (3,); variance: of the value's sum.
    """

    poses: int = 0
    scattered: int = 0
    nats: float = 0.0
    squares: tuple[float, float, float] = (0.0, 0.0, 0.0)
    variance: float = 0.0

    def with_one(self, scatter: Scatter | None, poses: int) -> Scatters:
        """And of another stretch of so many poses."""
        if scatter is None:
            return self._replace(poses=self.poses + poses)
        value, translation, rotation = (
            before + poses * each**2
            for before, each in zip(
                self.squares, (scatter.value, scatter.translation, scatter.rotation), strict=True
            )
        )
        return Scatters(
            self.poses + poses,
            self.scattered + poses,
            self.nats + scatter.nats,
            (value, translation, rotation),
            self.variance + (poses * scatter.std) ** 2,
        )

    def together(self) -> Scatter | None:
        """That of all; None where most poses' stamps do not scatter."""
        if 2 * self.scattered <= self.poses:
            return None
        value, translation, rotation = (math.sqrt(each / self.scattered) for each in self.squares)
        std = math.sqrt(self.variance) / self.scattered
        return Scatter(value, std, self.nats, translation, rotation)


def way(data: Data) -> Array:
    """What a second of a stamp moves each error by; (N, 6)."""
    return np.asarray(data.nuisances[:, :, 0])


def with_scatter(data: Data, more: float) -> Data:
    """The data with so much ``more`` variance (s²) of the stamps, which may be negative."""
    along = way(data)
    return replace(data, covariance=data.covariance + more * along[:, :, None] * along[:, None, :])


def shared_scatter(here: Likelihood) -> float | None:
    """The variance (s²) of the times by which positions and orientations are off together.

    By what they have in common: where an error's covariance is Σ, what the likelihood P makes of
    it, ``u = P z``, has ``E[uₜ uᵣᵀ] = P Σ P``, to which stamps alone add ``σ² Pₜ v ωᵀ Pᵣ``,
    whatever else P takes wrongly. What stays the same in the body's axes is left out: errors about
    another point of the body have that. None where it is not beyond doubt.
    """
    told, data = here.told, here.data
    axes = data.nuisances[:, :3, 2:5]
    velocity, turning = (way(data)[:, None, part] @ axes for part in (slice(3), slice(3, 6)))
    position, orientation = (told.scores[:, None, part] @ axes for part in (slice(3), slice(3, 6)))
    # A step of one second has this product of what it moves and what it turns, (N, 3, 3).
    step = velocity.swapaxes(1, 2) @ turning
    known = np.maximum(told.informed, 0.0) / AXES
    weight = known[0] * known[1]
    varied = step - np.average(step, axis=0, weights=np.maximum(weight, 1e-300))
    size = float(weight @ np.einsum("nij,nij->n", varied, step))
    felt = np.einsum("nij,ni->nj", varied, position[:, 0])
    turned = orientation[:, 0]
    total = float(np.vdot(felt, turned))
    # Of what has nothing in common: by the model, or as of orientations of some poses before.
    lags = range(_FIRST_LAG, min(_LAST_LAG, len(felt) // 4))
    apart = [float(np.vdot(felt[lag:], turned[:-lag])) for lag in lags]
    spread = float(weight @ np.einsum("nij,nij->n", varied, varied))
    spread = max(spread, float(np.mean(np.square(apart))) if apart else np.inf)
    if not (size > 0.0 and total > _BEYOND_DOUBT * spread**0.5):
        return None
    variance = total / size
    return variance if variance > _SHORTEST**2 else None


def likeliest_scatter(
    here: Likelihood, variance: float, low: Array, high: Array
) -> tuple[Likelihood, float, float]:
    """The likelihood at the likeliest scatter of the stamps, that (s), and how well it is known.

    The parameters follow it. here: where ``variance`` (s²) of it is in the data. low, high: bounds
    of the parameters.
    """
    data, begin = here.data, variance

    def at(logarithm: float) -> Likelihood:
        there = Likelihood(
            here.kind,
            here.parameters,
            with_scatter(data, float(np.exp(2.0 * logarithm)) - begin),
            here.gauge,
        )
        return climb(there, low, high, _GAIN, _CLIMBS, near=True, weighted=False)

    place = 0.5 * float(np.log(begin))
    for _ in range(_STEPS):
        here = at(place)
        below, above = at(place - _APART).value, at(place + _APART).value
        slope = (above - below) / (2.0 * _APART)
        curvature = (2.0 * here.value - above - below) / _APART**2
        curvature = max(curvature, 2.0 * abs(slope) / _LONGEST, 1e-3)
        std, step = curvature**-0.5, slope / curvature
        if abs(step) < _CONVERGED * std:
            break
        place += float(np.clip(step, -_LONGEST, _LONGEST))
    else:
        here = at(place)
    value = float(np.exp(place))
    return here, value, value * std


def described_scatter(here: Likelihood, value: float, std: float, nats: float) -> Scatter:
    """With what it moves the poses by."""
    squares = np.mean(way(here.data) ** 2, axis=0)
    translation, rotation = (value * float(squares[k : k + 3].sum()) ** 0.5 for k in (0, 3))
    return Scatter(value, std, nats, translation, rotation)
