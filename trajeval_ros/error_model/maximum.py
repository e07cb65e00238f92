# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likeliest parameters of one process, robustly.

Real errors are heavy-tailed: a lost track, a loop closure. As Huber's estimate does, a disturbance
that lies beyond what one in a thousand of a Gaussian's would gets a variance that brings it back
to there, so that ten poses of a thousand do not rule the fit; of Gaussian errors it changes nothing
that shows.
"""

from __future__ import annotations

from typing import Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Of χ² with three degrees of freedom, one in a thousand lies beyond.
_RARE = 16.27
JUMP = 15.0
"""A disturbance of so many standard deviations is an event, not a part of drift."""

_USUAL = 3.0
# Changes of the weights' logarithms move the gradient, whose standard deviation is the root of the
# number of errors, by about their sum: below this share of it they do not change the fit.
_SETTLED = 0.02
# Weights are found anew in so many rounds, with the whole of each change in the first ones, then a
# half, a third and so on: neighbours take each other's outliers in turn otherwise, for ever.
_ROUNDS = 8
_WHOLE = 3
# No step of a search is longer than this in the logarithm of a parameter; one that promises less
# than so many nats need not be compared with where it came from.
_LONGEST = 2.0
_SURE = 0.3
# What the data hardly tell has so much information, as if known to within a factor of thirty: a
# step there would be any that round-off says.
_LITTLE = 0.1
# Less of the curvature that is expected is no curvature, and a step of less (nats) tells of none.
_TRUSTED = 0.1
_TELLING = 1e-4


class Climbable(Protocol):
    """A likelihood at one place."""

    parameters: Array
    value: float

    def gradient(self) -> Array:
        """By the parameters, of their shape."""

    def average_information(self) -> Array:
        """Of the p parameters in a row, (p, p)."""

    def disturbances(self) -> tuple[Array, Array, Array, Array]:
        """Of poses and of steps, each the squares, and the variances beside the own one's."""

    def own_noise(self) -> tuple[Array, Array]:
        """The variances of one axis that poses and steps have where their weights are 1."""

    @property
    def weights(self) -> tuple[Array, Array]:
        """Factors of the variances, of poses and of steps."""

    def at(self, parameters: Array, weights: tuple[Array, Array]) -> Self:
        """The likelihood at another place.

        Raises numpy.linalg.LinAlgError where there is none.
        """


Place = TypeVar("Place", bound=Climbable)


def climb(
    here: Place,
    low: Array,
    high: Array,
    gain: float,
    steps: int,
    round_: int = 0,
    *,
    near: bool = False,
) -> Place:
    """The robust maximum from ``here``: Newton steps with the average information.

    low, high: bounds of the parameters in a row, (p,). The weights follow each step, from the
    ``round_`` on that they are known from. It ends where another step gains less than ``gain``,
    nats. ``near``: the maximum is so near that the curvature of the first place serves.
    """
    curvature: Array | None = None
    before: tuple[Array, Array] | None = None
    for _ in range(steps):
        slope = here.gradient().ravel()
        if curvature is None or not near:
            curvature = here.average_information()
        if before is not None:
            curvature = _updated(curvature, before[0], before[1] - slope)
        step, expected = _newton_step(here.parameters.ravel(), slope, curvature, low, high)
        weights, settled = here.weights, round_ >= _ROUNDS
        if not settled:
            weights, settled = _reweighted(here, 1.0 / max(round_ - _WHOLE + 2, 1))
            round_ += 1
        if settled:
            if expected < gain:
                break
            weights = here.weights
        there = _moved(here, step, weights) if expected < _SURE else None
        if there is None:
            base = here if settled else here.at(here.parameters, weights)
            there = _along(base, step)
            if there is here:
                break
        moved = (there.parameters - here.parameters).ravel()
        before = (moved, slope) if settled else None
        here = there
    return here


def _updated(curvature: Array, step: Array, fallen: Array) -> Array:
    """The curvature (p, p) corrected by how much a ``step`` has lowered the slope (BFGS).

    The average information is not the observed one: a search by it alone gains a half each time.
    """
    along, seen = curvature @ step, float(step @ fallen)
    told = float(step @ along)
    if not seen > max(_TRUSTED * told, _TELLING):
        return curvature
    return np.asarray(
        curvature - np.outer(along, along) / told + np.outer(fallen, fallen) / seen, np.float64
    )


def _newton_step(
    here: Array, slope: Array, curvature: Array, low: Array, high: Array
) -> tuple[Array, float]:
    """A step (p,) between bounds (p,), and the gain it promises.

    Parameters that it would take out of bounds end there, and the others step as fits that.
    """
    curvature = curvature + _LITTLE * np.eye(len(here))
    step: Array = np.zeros(len(here))
    free = ((here > low) | (slope > 0.0)) & ((here < high) | (slope < 0.0))
    low, high = np.maximum(low, here - _LONGEST), np.minimum(high, here + _LONGEST)
    for _ in range(len(here)):
        rest = slope[free] - curvature[free][:, ~free] @ step[~free]
        step[free] = np.linalg.solve(curvature[free][:, free], rest)
        within = np.clip(here + step, low, high) - here
        out = free & (within != step)
        if not out.any():
            break
        # The first that is met on the way.
        share = np.where(out, within / np.where(out, step, 1.0), np.inf)
        first = int(np.argmin(share))
        step[first], free[first] = within[first], False
    return step, float(slope @ step - 0.5 * step @ curvature @ step)


def _along(here: Place, step: Array) -> Place:
    """The first point on a shrinking ``step`` (p,) that is better; ``here`` where there is none."""
    for share in (1.0, 0.5, 0.2, 0.05):
        there = _moved(here, share * step, here.weights)
        if there is not None and there.value > here.value:
            return there
    return here


def _moved(here: Place, step: Array, weights: tuple[Array, Array]) -> Place | None:
    """A ``step`` (p,) on; None where there is no likelihood."""
    try:
        return here.at(here.parameters + step.reshape(here.parameters.shape), weights)
    except np.linalg.LinAlgError:
        return None


def _reweighted(here: Climbable, share: float) -> tuple[tuple[Array, Array], bool]:
    """The weights that the disturbances ask for; whether those are the ones there are.

    Or so great a ``share`` of the way: neighbours take each other's outliers in turn otherwise.
    """
    measured, measured_rest, moved, moved_rest = here.disturbances()
    own, own_move = here.own_noise()
    of_poses, of_moves = here.weights
    change = np.log(_inflation(measured, measured_rest, own) / of_poses)
    change_of_moves = np.log(_inflation(moved, moved_rest, own_move) / of_moves)
    total = float(np.abs(change).sum() + np.abs(change_of_moves).sum())
    weights = of_poses * np.exp(share * change), of_moves * np.exp(share * change_of_moves)
    return weights, total < _SETTLED * np.sqrt(3.0 * of_poses.size)


def _inflation(square: Array, rest: Array, own: Array) -> Array:
    """The factor of ``own`` with which a disturbance is just what one in a thousand is."""
    own = np.maximum(own, 1e-300)
    limit = np.where(square > JUMP**2 * (own + rest), _USUAL, _RARE)
    return np.asarray(np.maximum((square / limit - rest) / own, 1.0))
