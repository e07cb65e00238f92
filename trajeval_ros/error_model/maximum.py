# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likeliest parameters of one process, robustly.

Real errors are heavy-tailed: a lost track, a loop closure. So each disturbance, of a pose or of a
step, has a variance of its own, λ ≥ 1 times what the process says, with the improper density
``λ^-κ`` of its logarithm, and maximal is

    Φ(ψ, λ) = log L(ψ, λ) - κ Σ log λ.

Where a disturbance is well seen, λ brings it back to what one in a thousand of a Gaussian's would
be, as Huber's estimate does, so that ten poses of a thousand do not rule the fit; of Gaussian
errors it changes nothing that shows. As one function is climbed, no step goes in circles.

In one λ, others held, the likelihood is that of a disturbance whose estimate has the squared size
q over three axes and the variance r beside its own o λ,

    -½ (3 log(o λ + r) + q / (o λ + r)) - κ log λ,

whose maximum is at the larger root of a quadratic equation, or at λ = 1.
"""

from __future__ import annotations

from typing import Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops

Array = npt.NDArray[np.float64]

# Of χ² with three degrees of freedom, one in a thousand lies beyond.
_RARE = 16.27
_KAPPA = 0.5 * (_RARE - 3.0)
JUMP = 15.0
"""A disturbance of so many standard deviations is an event, not a part of drift."""

# Neighbours take each other's outliers. So of those within so many poses only the λ changes that
# gains most, at first, and of more of them after a step that gained nothing.
_NEIGHBOURS = 1
_FARTHER = 4
# All change that do so by less than this in the logarithm.
_LITTLE_CHANGE = 0.3
UNFINISHED = 0.5
"""What a step of one standard deviation gains, nats: one that promises more is to be taken."""

# Below this gain of the factors (nats), or that of the parameters, a change of slope is theirs.
_SETTLED = 0.3
# After a longer step, in the logarithm of a parameter, its information is found anew.
_FAR = 0.3
# Near the maximum, after a step that promises less (nats), a twentieth of it is left, hardly more.
_SURE = 0.3
# Where the factors alone promise so much (nats), they are found first, in so many rounds at most.
_MUCH = 3.0
_ALONE = 4
# No step of a search is longer than this in the logarithm of a parameter.
_LONGEST = 2.0
# What the data hardly tell has so much information, as if known to within a factor of thirty: a
# step there would be any that round-off says.
_LITTLE = 0.1
# Less of the curvature that is expected is no curvature, and a step of less (nats) tells of none.
_TRUSTED = 0.1
_TELLING = 1e-4

RULES: Array = np.array(
    [
        _KAPPA,
        _RARE,
        _LITTLE_CHANGE,
        _NEIGHBOURS,
        _FARTHER,
        _MUCH,
        _ALONE,
        _SETTLED,
        _FAR,
        _SURE,
        _TRUSTED,
        _TELLING,
        _LITTLE,
        _LONGEST,
    ]
)
"""All of these, as `climb.c` takes them."""


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
    *,
    near: bool = False,
    weighted: bool = True,
) -> Place:
    """The maximum of Φ from ``here``: Newton steps with the average information, λ along with them.

    low, high: bounds of the parameters in a row, (p,). It ends where another step promises less
    than ``gain``, nats. ``near``: the maximum is so near that the curvature of the first place
    serves, and a step that promises little is the last.
    """
    curvature: Array | None = None
    before: tuple[Array, Array] | None = None
    value, apart, alone = penalised(here), _NEIGHBOURS, 0
    far = False
    for _ in range(steps):
        weights, promised = _reweighted(here, apart) if weighted else (here.weights, 0.0)
        if promised > _MUCH and alone < _ALONE:
            alone += 1
            there, reached = _moved(here, np.zeros(here.parameters.size), weights)
            if there is not None and reached > value:
                before, here, value = None, there, reached
                continue
            apart *= _FARTHER
        alone = 0
        slope = here.gradient().ravel()
        fresh = curvature is None or far
        if curvature is None or far:
            curvature = here.average_information()
        if before is not None:
            curvature = _updated(curvature, before[0], before[1] - slope)
        step, expected = _newton_step(here.parameters.ravel(), slope, curvature, low, high)
        if expected + promised < gain:
            break
        stuck = False
        there, reached = _moved(here, step, weights)
        if there is None or reached < value:
            apart *= _FARTHER
            there, reached = _along(here, step, value, whole=weighted)
            if there is None:
                # The curvature is that of another place, or the step can only be noise.
                if fresh and promised < gain:
                    break
                stuck = True
                there, reached = _moved(here, 0.0 * step, weights)
                if there is None or reached < value:
                    if apart > len(weights[0]):
                        break
                    continue
        moved = (there.parameters - here.parameters).ravel()
        settled = promised < max(gain, expected, _SETTLED)
        before = (moved, slope) if settled else None
        far = stuck or (not near and (not settled or float(np.abs(moved).max()) > _FAR))
        here, value = there, reached
        if near and expected < _SURE:
            break
    return here


def penalised(here: Climbable) -> float:
    """``Φ``."""
    return here.value - penalty(here)


def penalty(here: Climbable) -> float:
    """``κ Σ log λ``."""
    return _KAPPA * sum(float(np.log(each).sum()) for each in here.weights)


def promised(here: Climbable, low: Array, high: Array) -> float:
    """What a step of the parameters would gain, nats, by the average information.

    low, high: bounds of the parameters in a row, (p,).
    """
    given = here.parameters.ravel(), here.gradient().ravel(), here.average_information()
    return _newton_step(*given, low, high)[1]


def reweighted(here: Place, gain: float) -> Place:
    """With likelier factors λ and the same parameters, as long as others promise ``gain`` nats."""
    value, apart = penalised(here), _NEIGHBOURS
    for _ in range(_ALONE):
        weights, promised = _reweighted(here, apart)
        if promised < gain:
            break
        there, reached = _moved(here, np.zeros(here.parameters.size), weights)
        if there is not None and reached > value:
            here, value = there, reached
        else:
            apart *= _FARTHER
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
    if loops.there():
        step, promised = np.empty(len(here)), np.empty(1)
        given = map(loops.doubles, (here, slope, curvature, low, high))
        if loops.call("newton_step", len(here), *given, _LITTLE, _LONGEST, step, promised):
            raise np.linalg.LinAlgError("no curvature")
        return step, float(promised[0])
    # Near nothing a standard deviation has little information in its logarithm, whose slope may
    # promise much all the same.
    own = np.diag(curvature)
    promising = slope * slope > 2.0 * _LITTLE * np.maximum(own, 1e-300)
    curvature = curvature + np.diag(np.where(promising, 0.0, _LITTLE))
    step = np.zeros(len(here))
    free = ((here > low) | (slope > 0.0)) & ((here < high) | (slope < 0.0))
    low, high = np.maximum(low, here - _LONGEST), np.minimum(high, here + _LONGEST)
    if free.all():
        step = np.asarray(np.linalg.solve(curvature, slope), np.float64)
        there = here + step
        if (there >= low).all() and (there <= high).all():
            return step, 0.5 * float(slope @ step)
        step = np.zeros(len(here))
    for _ in range(len(here)):
        rest = slope[free] - curvature[free][:, ~free] @ step[~free]
        step[free] = np.linalg.solve(curvature[free][:, free], rest)
        within = np.clip(here + step, low, high) - here
        out = free & ((here + step < low) | (here + step > high))
        if not out.any():
            break
        # The first that is met on the way.
        share = np.where(out, within / np.where(out, step, 1.0), np.inf)
        first = int(np.argmin(share))
        step[first], free[first] = within[first], False
    return step, float(slope @ step - 0.5 * step @ curvature @ step)


def _along(here: Place, step: Array, value: float, *, whole: bool) -> tuple[Place | None, float]:
    """The first point on a shrinking ``step`` (p,) that is better than ``value``, if any.

    whole: from all of it on.
    """
    for share in (1.0, 0.5, 0.2, 0.05)[not whole :]:
        there, reached = _moved(here, share * step, here.weights)
        if there is not None and reached > value:
            return there, reached
    return None, -np.inf


def _moved(here: Place, step: Array, weights: tuple[Array, Array]) -> tuple[Place | None, float]:
    """A ``step`` (p,) on, with Φ there; None where there is no likelihood."""
    try:
        there = here.at(here.parameters + step.reshape(here.parameters.shape), weights)
    except np.linalg.LinAlgError:
        return None, -np.inf
    return there, penalised(there)


def _reweighted(here: Climbable, apart: int) -> tuple[tuple[Array, Array], float]:
    """The factors λ that the disturbances ask for, and what they gain, nats."""
    measured, measured_rest, moved, moved_rest = here.disturbances()
    own, own_move = here.own_noise()
    weights = here.weights
    if loops.there():
        return _reweighted_in_c(
            apart, (measured, measured_rest), (moved, moved_rest), own, own_move, weights
        )
    poses, pose_gain = likeliest(measured, measured_rest, own, weights[0])
    moves, move_gain = likeliest(moved, moved_rest, own_move, weights[1])
    if not (pose_gain.any() or move_gain.any()):
        return weights, 0.0
    # Poses and the steps between them in the order of time.
    gains = np.zeros((2 * len(pose_gain) - 1, *pose_gain.shape[1:]))
    gains[::2], gains[1::2] = pose_gain, move_gain
    most = _largest_within(gains, min(2 * apart, len(gains)))
    found, total = [], 0.0
    for new, old, each, around in zip(
        (poses, moves), weights, (pose_gain, move_gain), (most[::2], most[1::2]), strict=True
    ):
        taken = (each >= around) | (np.abs(np.log(new / old)) < _LITTLE_CHANGE)
        found.append(np.where(taken, new, old))
        total += float(each[taken].sum())
    return (found[0], found[1]), total


def _reweighted_in_c(
    apart: int,
    poses: tuple[Array, Array],
    steps: tuple[Array, Array],
    own: Array,
    own_move: Array,
    weights: tuple[Array, Array],
) -> tuple[tuple[Array, Array], float]:
    """As `_reweighted`, one group after the other."""
    count, groups = len(poses[0]), own.size
    reach = min(2 * apart, 2 * count - 1)
    work, promised = np.empty(4 * count - 2 + 2 * reach), np.empty(1)
    square, rest, moved, moved_rest, move, measured, leapt = (
        loops.doubles(each.reshape(-1, groups).T) for each in (*poses, *steps, own_move, *weights)
    )
    new, total = np.empty((groups, 2 * count - 1)), 0.0
    for g in range(groups):
        given = square[g], rest[g], float(own[g]), measured[g], moved[g], moved_rest[g], move[g]
        rules = _KAPPA, _RARE, _LITTLE_CHANGE
        loops.call("reweigh", count, reach, *given, leapt[g], *rules, new[g], work, promised)
        total += float(promised[0])
    found = np.ascontiguousarray(new.T).reshape(-1, *weights[0].shape[1:])
    return (found[:count], found[count:]), total


def _largest_within(values: Array, reach: int) -> Array:
    """The largest of those within so many places, and of zero, at each of ``values`` (n, ...)."""
    width, have = 2 * reach + 1, 1
    beyond = np.zeros((reach, *values.shape[1:]))
    largest = np.concatenate([beyond, values, beyond])
    while have < width:
        # Of twice as many from two that may overlap.
        step = min(have, width - have)
        largest = np.maximum(largest[:-step], largest[step:])
        have += step
    return largest


def likeliest(square: Array, rest: Array, own: Array, now: Array) -> tuple[Array, Array]:
    """The likeliest λ of each disturbance, others held, and what it gains over ``now``.

    square, rest: q and r. own: o.
    """
    own = np.maximum(own, 1e-300)
    square, rest = square / own, rest / own
    half = 0.5 * (square - (3.0 + 4.0 * _KAPPA) * rest)
    below = half * half - 2.0 * _KAPPA * _RARE * rest * rest
    root = (half + np.sqrt(np.maximum(below, 0.0))) / _RARE
    value = np.where(root > 1.0, root, 1.0)

    def nats(factor: Array) -> Array:
        variance = factor + rest
        return -1.5 * np.log(variance) - 0.5 * square / variance - _KAPPA * np.log(factor)

    least = nats(np.ones_like(value))
    best = nats(value)
    value = np.where((below > 0.0) & (best > least), value, 1.0)
    return value, np.maximum(np.maximum(best, least) - nats(now), 0.0)
