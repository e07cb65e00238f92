# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likeliest parameters of one process, robustly, and how certain they are.

Real errors are heavy-tailed: a lost track, a loop closure. As Huber's estimate does, a disturbance
that lies beyond what one in a thousand of a Gaussian's would gets a variance that brings it back
to there, so that ten poses of a thousand do not rule the fit; of Gaussian errors it changes nothing
that shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from trajeval_ros.error_model.likelihood import Data, Likelihood, scatter
from trajeval_ros.error_model.process import Kind

Array = npt.NDArray[np.float64]

# Of χ² with three degrees of freedom, one in a thousand lies beyond.
_RARE = 16.27
JUMP = 15.0
"""A disturbance of so many standard deviations is an event, not a part of drift."""

_USUAL = 3.0
# Weights whose logarithms change by less than this in sum do not change the fit. They are found
# anew so often at the most, at first with the whole of each change.
_SETTLED = 1.0
_ROUNDS = 10
_WHOLE = 3
_LEAST_STD = 1e-7
_LARGEST_STD = 1e3
# Noise of this share of the ground truth's standard deviation, or a drift of it in all of the time,
# is none.
_NONE = 0.03
# Steps of a search; none is longer than this in the logarithm of a parameter.
_STEPS = 25
_LONGEST = 2.0
_LITTLE = 1e-6
# A search ends where another step gains less than this, nats.
_GAIN = 1e-2
# Below this curvature of log L (of log σ), a standard deviation is not told from none.
_FLAT = 1.0


@dataclass(frozen=True, slots=True)
class Maximum:
    """The fit of one process.

    likelihood: at the parameters. data: with the weights that were found. gauge: (N, 6, 6).
    """

    kind: Kind
    likelihood: Likelihood
    data: Data
    gauge: Array

    @property
    def parameters(self) -> Array:
        """ψ, (2, p)."""
        return self.likelihood.parameters


def _bounds(kind: Kind, data: Data) -> list[tuple[float, float]]:
    """The least and the largest of each parameter, (2 p, 2)."""
    intervals = np.diff(data.times)
    span = float(data.times[-1] - data.times[0])
    shortest = float(np.median(intervals))
    known = np.sqrt(np.median(np.einsum("nii->ni", data.covariance), axis=0).reshape(2, 3).mean(1))
    found = []
    for std in known:
        none = max(_NONE * float(std), _LEAST_STD)
        least = {"jitter_std": none, "drift_std": none / np.sqrt(span), "wander_std": none}
        least["velocity_std"] = none / span
        for name in kind.names:
            if name.endswith("time"):
                found.append((np.log(shortest), np.log(max(span, 2.0 * shortest))))
            else:
                found.append((np.log(least[name]), np.log(_LARGEST_STD)))
    return found


def rough(kind: Kind, data: Data, time: float = 1.0) -> Array:
    """Where a search may begin; (2, p). time: of an Ornstein-Uhlenbeck process, s."""
    found = []
    interval = float(np.median(np.diff(data.times)))
    for group in (slice(0, 3), slice(3, 6)):
        error = data.errors[:, group]
        step = max(float(np.median(np.linalg.norm(np.diff(error, axis=0), axis=1))) / 2.5, 1e-6)
        jitter, drift = 0.6 * step, 0.4 * step / np.sqrt(interval)
        values = {
            "jitter_std": jitter,
            "drift_std": drift,
            "velocity_std": drift / np.sqrt(2.0 * time),
            "velocity_time": time,
            "wander_std": max(drift * np.sqrt(0.5 * time), 0.5 * jitter),
            "wander_time": time,
        }
        found.append([np.log(values[name]) for name in kind.names])
    return np.array(found)


def maximum(
    kind: Kind, start: Array, data: Data, gauge: Array, gain: float = _GAIN, rounds: int = _STEPS
) -> Maximum:
    """The robust maximum from ``start`` (2, p): Newton steps with the average information.

    The weights follow each step. It ends where another gains less than ``gain``, nats, and the
    weights stay as they are.
    """
    low, high = np.array(_bounds(kind, data)).T
    begin = np.clip(np.maximum(start, _least(kind, data)).ravel(), low, high)
    here = Likelihood(kind, begin.reshape(start.shape), data, gauge)
    settled = False
    for number in range(rounds):
        if not settled:
            here, settled = _reweighted(here, 1.0 if number < _WHOLE else 0.5)
            settled = settled or number == _ROUNDS
        step, expected = _newton_step(here, low, high)
        if settled and expected < gain:
            break
        better = _along(here, step)
        if settled and (better is None or better.value - here.value < gain):
            here = better or here
            break
        here = better or here
    return Maximum(kind, here, here.data, gauge)


def _newton_step(here: Likelihood, low: Array, high: Array) -> tuple[Array, float]:
    """A step (2p,) between bounds (2p,), and the gain it promises."""
    flat, slope = here.parameters.ravel(), here.gradient().ravel()
    free = ((flat > low) | (slope > 0.0)) & ((flat < high) | (slope < 0.0))
    information = here.average_information()[np.ix_(free, free)]
    # What the data hardly tell has a little information, so that no step is endless.
    least = _LITTLE * max(float(np.diag(information).max(initial=0.0)), 1.0)
    step = np.zeros(flat.size)
    step[free] = np.linalg.solve(information + least * np.eye(free.sum()), slope[free])
    step = np.clip(flat + np.clip(step, -_LONGEST, _LONGEST), low, high) - flat
    return step, 0.5 * float(slope @ step)


def _along(here: Likelihood, step: Array) -> Likelihood | None:
    """The first point on a shrinking ``step`` (2p,) that is better; None where there is none."""
    for share in (1.0, 0.5, 0.2, 0.05):
        there = _moved(here, share * step, here.data)
        if there is not None and there.value > here.value:
            return there
    return None


def _moved(here: Likelihood, step: Array, data: Data) -> Likelihood | None:
    """A ``step`` (2p,) on, with the weights of ``data``; None where there is no likelihood."""
    parameters = here.parameters + step.reshape(here.parameters.shape)
    try:
        return Likelihood(here.kind, parameters, data, here.gauge)
    except np.linalg.LinAlgError:
        return None


def _reweighted(found: Likelihood, share: float) -> tuple[Likelihood, bool]:
    """With the weights that the disturbances ask for; whether those are the ones there are.

    Or so great a ``share`` of the way: neighbours take each other's outliers in turn otherwise.
    """
    measured, measured_rest, moved, moved_rest = found.disturbances()
    data = found.data
    jitter = np.exp(2.0 * found.parameters[:, 0])
    own = found.own_noise() / data.moved
    of_poses = np.log(_inflation(measured, measured_rest, jitter) / data.measured)
    of_moves = np.log(_inflation(moved, moved_rest, own) / data.moved)
    if float(np.abs(of_poses).sum() + np.abs(of_moves).sum()) < _SETTLED:
        return found, True
    weighted = replace(
        data,
        measured=data.measured * np.exp(share * of_poses),
        moved=data.moved * np.exp(share * of_moves),
    )
    return Likelihood(found.kind, found.parameters, weighted, found.gauge), False


def _inflation(square: Array, rest: Array, own: Array) -> Array:
    """The factor of ``own`` with which a disturbance is just what one in a thousand is."""
    own = np.maximum(own, 1e-300)
    limit = np.where(square > JUMP**2 * (own + rest), _USUAL, _RARE)
    return np.asarray(np.maximum((square / limit - rest) / own, 1.0))


def _least(kind: Kind, data: Data) -> Array:
    """What a search does not begin below, (2, p).

    The logarithm of a standard deviation that has gone to zero has no slope to come back by, as it
    must when weights have changed.
    """
    least = np.full((2, len(kind.names)), -np.inf)
    known = rough(kind, data) - np.log(5.0)
    for i, name in enumerate(kind.names):
        if name in ("jitter_std", "drift_std"):
            least[:, i] = known[:, i]
    return least


def at(kind: Kind, parameters: Array, data: Data, gauge: Array) -> Maximum:
    """What is no maximum, but at given parameters, with the weights that the data have."""
    return Maximum(kind, Likelihood(kind, parameters, data, gauge), data, gauge)


def uncertainty(found: Maximum, blocks: int) -> Array:
    """The covariance of ψ, (2p, 2p); NaN of those at no optimum.

    From the average information, or where it is larger from the scores' scatter over so many
    ``blocks`` of time (White's estimate). A standard deviation that runs to zero has no curvature
    in its logarithm; see `upper_limit`.
    """
    information = found.likelihood.average_information()
    known = np.diag(information) > _FLAT
    covariance = np.full(information.shape, np.nan)
    if known.any():
        values, vectors = np.linalg.eigh(information[np.ix_(known, known)])
        inverse = (vectors / np.maximum(values, 1e-3)) @ vectors.T
        scores = found.likelihood.scores().reshape(found.likelihood.count, -1)[:, known]
        shown = inverse @ scatter(scores, blocks) @ inverse
        ratio = np.sqrt(np.maximum(np.diag(shown) / np.diag(inverse), 1.0))
        covariance[np.ix_(known, known)] = inverse * ratio * ratio[:, None]
    return covariance


def upper_limit(found: Maximum, group: int, number: int) -> float:
    """The value at which log L has fallen by ½: one standard deviation up from none."""
    here = found.likelihood.value
    parameters = found.parameters.copy()
    for _ in range(60):
        parameters[group, number] += 0.5
        try:
            there = Likelihood(found.kind, parameters, found.data, found.gauge).value
        except np.linalg.LinAlgError:
            break
        if there < here - 0.5:
            break
    return float(np.exp(parameters[group, number]))
