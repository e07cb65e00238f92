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
from scipy.optimize import minimize

from trajeval_ros.error_model.likelihood import Data, Likelihood
from trajeval_ros.error_model.process import Kind

Array = npt.NDArray[np.float64]

# Of χ² with three degrees of freedom, one in a thousand lies beyond.
_RARE = 16.27
JUMP = 15.0
"""A disturbance of so many standard deviations is an event, not a part of drift."""

_USUAL = 3.0
_ROUNDS = 4
# Weights that change by less than this share do not change the fit.
_SETTLED = 0.05
_ANEW = 3.0
_LEAST_STD = 1e-7
_LARGEST_STD = 1e3
_STEP = 1e-3
# A search ends where another step gains less than this, nats.
_GAIN = 3e-2
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
    intervals = np.diff(data.times)
    span = float(data.times[-1] - data.times[0])
    shortest = float(np.median(intervals))
    std = (np.log(_LEAST_STD), np.log(_LARGEST_STD))
    time = (np.log(shortest), np.log(max(span, 2.0 * shortest)))
    return [time if name.endswith("time") else std for name in kind.names] * 2


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


def _climb(kind: Kind, start: Array, data: Data, gauge: Array, rounds: int) -> Likelihood:
    """The likeliest ψ for given weights."""
    shape, bounds = start.shape, np.array(_bounds(kind, data))
    # The logarithm of a standard deviation that three coordinates of N poses tell has a curvature
    # of about 6 N; so scaled, the search begins with steps of the right length.
    unit = np.sqrt(6.0 * len(data.times))
    last: dict[str, Likelihood] = {}

    def cost(flat: Array) -> tuple[float, Array]:
        try:
            here = Likelihood(kind, (flat / unit).reshape(shape), data, gauge)
        except np.linalg.LinAlgError:
            return 1e12, np.zeros(flat.size)
        if not last or here.value > last["best"].value:
            last["best"] = here
        return -here.value, -here.gradient().ravel() / unit

    begin = np.clip(start.ravel(), *bounds.T)
    first, _ = cost(begin * unit)
    minimize(
        cost,
        begin * unit,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds * unit,
        options={"maxiter": rounds, "ftol": _GAIN / max(abs(first), 1.0), "gtol": 1e-3},
    )
    if not last:
        raise np.linalg.LinAlgError("no likelihood at the start")
    return last["best"]


def _reweighted(found: Likelihood) -> Data:
    """The data with the weights that their disturbances ask for."""
    measured, measured_rest, moved, moved_rest = found.disturbances()
    data = found.data
    jitter = np.exp(2.0 * found.parameters[:, 0])
    own = found.own_noise() / data.moved
    return replace(
        data,
        measured=_inflation(measured, measured_rest, jitter),
        moved=_inflation(moved, moved_rest, own),
    )


def _inflation(square: Array, rest: Array, own: Array) -> Array:
    """The factor of ``own`` with which a disturbance is just what one in a thousand is."""
    own = np.maximum(own, 1e-300)
    limit = np.where(square > JUMP**2 * (own + rest), _USUAL, _RARE)
    return np.asarray(np.maximum((square / limit - rest) / own, 1.0))


def maximum(
    kind: Kind, start: Array, data: Data, gauge: Array, rounds: int = 30, weights: int = _ROUNDS
) -> Maximum:
    """The robust maximum from ``start`` (2, p): so many ``rounds`` of a search, and of weights."""
    least = _least(kind, data)
    found = _climb(kind, np.maximum(start, least), data, gauge, rounds)
    for _ in range(weights):
        weighted = _reweighted(found)
        change = max(
            float(np.abs(np.log(weighted.measured / data.measured)).max()),
            float(np.abs(np.log(weighted.moved / data.moved)).max()),
        )
        if change < _SETTLED:
            break
        data = weighted
        # What a jump has ruled so far is no place to go on from.
        begin = start if change > _ANEW else found.parameters
        found = _climb(kind, np.maximum(begin, least), data, gauge, rounds)
    return Maximum(kind, found, data, gauge)


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


def uncertainty(found: Maximum) -> Array:
    """The covariance of ψ, (2p, 2p), from the observed information; NaN of those at no optimum.

    A standard deviation that runs to zero has no curvature in its logarithm; see `upper_limit`.
    """
    start = found.parameters
    size, here = start.size, found.likelihood.gradient()
    information = np.zeros((size, size))
    for i in range(size):
        step = np.zeros(size)
        step[i] = _STEP
        there = Likelihood(found.kind, start + step.reshape(start.shape), found.data, found.gauge)
        information[i] = (here - there.gradient()).ravel() / _STEP
    information = 0.5 * (information + information.T)
    known = np.diag(information) > _FLAT
    covariance = np.full((size, size), np.nan)
    if known.any():
        part = information[np.ix_(known, known)]
        values, vectors = np.linalg.eigh(part)
        inverse = (vectors / np.maximum(values, 1e-3)) @ vectors.T
        covariance[np.ix_(known, known)] = inverse
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
