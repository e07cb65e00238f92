# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of an error model, at the likelihood's maximum."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from trajeval_ros.error_model.changes import Stretch, clock_changes
from trajeval_ros.error_model.intervals import Profiles
from trajeval_ros.error_model.likelihood import Likelihood, clustered_ratio, scatter
from trajeval_ros.error_model.maximum import JUMP, UNFINISHED, penalty, promised
from trajeval_ros.error_model.model import ErrorModel, Figure, Jump
from trajeval_ros.error_model.nuisances import COUNT, PRIOR_STD, Nuisances
from trajeval_ros.error_model.observed import shown, unobserved
from trajeval_ros.error_model.process import GROUPS, Kind
from trajeval_ros.error_model.search import Guess, bounds, by_one_group
from trajeval_ros.error_model.stamping import Scatter
from trajeval_ros.error_model.whiteness import autocorrelation

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_LAGS = 5
# Stretches of time, of so many poses at least, by which the scatter of the nuisances is judged.
_BLOCK = 20
_BLOCKS = 40
# A change of the clock is looked for between parts of so many poses that last so long (s).
_PART = 60
_PART_DURATION = 5.0
_FIXED = 1e16
# Where a parameter is known no better than this, its logarithm is no Gaussian any more.
_ROUGH = 0.3
# Of what is near nothing, scores may scatter by round-off: no more than this is believed.
_LARGER = 2.0
# Information of a logarithm that is round-off, to what it is raised, and what it is at the least.
_ROUND_OFF, _RAISED, _LEAST = 1e-4, 1e-2, 1e-16
# Of a logarithm: nothing can be told of it.
_NO_INFORMATION = 1e-30


def described(
    stamps: Stamps,
    nuisances: Nuisances,
    here: Likelihood,
    alternatives: dict[Kind, float],
    scatter_of_stamps: Scatter | None = None,
    *,
    parts: bool = True,
) -> ErrorModel:
    """What is found.

    stamps: (N,) ns, the estimate's own. nuisances: at which the errors of ``here`` are, which has
    what is left of a step. alternatives: nats a pose of each process. scatter_of_stamps: of the
    estimate's, where they scatter. parts: as in `trajeval_ros.error_model.fit.fit`.
    """
    blocks = _blocks(here.count)
    columns, white = here.whitened()
    ratio = clustered_ratio(columns, white, here.theta_covariance, blocks)[:COUNT]
    inflation = np.maximum(ratio, 1.0)
    data, own = here.data, here.theta_covariance
    step, covariance = shown(here.theta, own, np.exp(2.0 * here.parameters[:, 0]), data, here.gauge)
    low, high = (each.ravel() for each in bounds(here.kind, data))
    converged = promised(here, low, high) < UNFINISHED and (step**2 < np.diag(covariance)).all()
    told = np.linalg.inv(covariance)
    covariance = covariance * inflation * inflation[:, None]
    clocks = _clock_by_group(nuisances, here, float(inflation[0])) if parts else ()
    nuisances = nuisances.moved(step)
    std = np.sqrt(np.diag(covariance))
    stretches = _stretches(stamps, nuisances, columns, white, std, own) if parts else []
    whiteness = np.array([autocorrelation(part, _LAGS) for part in (white[:, :3], white[:, 3:])])
    theta, nats = nuisances.vector, reached(here)
    return ErrorModel(
        here.kind,
        _groups(here, blocks),
        nuisances,
        covariance,
        unobserved(covariance),
        here.count,
        nats,
        # Without them the alignment, and what the motion does not show, are others.
        nats - 0.5 * float(theta @ told @ theta),
        float((white**2).mean()),
        whiteness,
        _jumps(stamps, here),
        alternatives,
        clock_changes(stretches),
        tuple(stretches),
        clocks,
        scatter_of_stamps,
        bool(converged),
    )


def reached(here: Likelihood) -> float:
    """The log-likelihood at the nuisances found, less what outliers cost."""
    return here.at_theta - penalty(here)


def _blocks(count: int) -> int:
    """Into how many stretches so many poses are cut."""
    return min(max(count // _BLOCK, 4), _BLOCKS)


def _clock_by_group(nuisances: Nuisances, here: Likelihood, ratio: float) -> tuple[Figure, ...]:
    """The clock offset by positions alone and by orientations alone.

    Where the two differ, they were not taken at one time, or the errors are of another kind.
    ratio: by how much the standard deviation is larger than the model says.
    """
    count = here.data.nuisances.shape[2]
    guess = Guess(here.kind, here.parameters, *here.weights, here.theta[:count], np.eye(count))
    return tuple(
        Figure(nuisances.clock_offset + float(theta[0]), ratio * float(covariance[0, 0]) ** 0.5)
        for theta, covariance in by_one_group(guess, here.data, here.gauge)
    )


def _stretches(
    stamps: Stamps, nuisances: Nuisances, columns: Array, white: Array, std: Array, own: Array
) -> list[Stretch]:
    """What parts of a run say of the clock, all else being as the whole says, to within ``std``.

    By the innovations of each: columns (N, 6, c) and white (N, 6) as whitened. own: the covariance
    of θ, of which ``std`` (9,) is as much larger as errors of a stretch are.
    """
    seconds = (stamps - stamps[0]) * 1e-9
    edges = [0]
    for i in range(_PART, len(stamps)):
        if i - edges[-1] >= _PART and seconds[i] - seconds[edges[-1]] >= _PART_DURATION:
            edges.append(i)
    precision = 1.0 / std**2
    precision[0] = PRIOR_STD[0] ** -2
    precision[1] = _FIXED
    parts = []
    for begin, end in itertools.pairwise(edges):
        part = columns[begin:end, :, :COUNT].reshape(-1, COUNT)
        covariance = np.linalg.inv(part.T @ part + np.diag(precision))
        change = float(covariance[0] @ (part.T @ white[begin:end].ravel()))
        middle = 0.5 * (seconds[begin] + seconds[end - 1] - seconds[-1])
        offset = nuisances.clock_offset + nuisances.clock_rate * middle + change
        spread = float(std[0]) * float(covariance[0, 0] / own[0, 0]) ** 0.5
        parts.append(Stretch(int(stamps[begin]), int(stamps[end - 1]), offset, spread))
    return parts


def _groups(here: Likelihood, blocks: int) -> dict[str, dict[str, Figure]]:
    """Each parameter's value and standard deviation or interval, and the long-run drift's.

    Also by distance, at the mean speed.
    """
    near = _off_nothing(here)
    covariance, ratio = uncertainty(near, blocks)
    names, data = here.kind.names, here.data
    size = len(names)
    way = float(np.linalg.norm(data.travel, axis=1).sum())
    speed = way / float(data.times[-1] - data.times[0])
    groups: dict[str, dict[str, Figure]] = {}
    for g, group in enumerate(GROUPS):
        values, raised = np.exp(here.parameters[g]), np.exp(near.parameters[g])
        part = slice(g * size, (g + 1) * size)
        own = covariance[part, part]
        profiles = None
        figures = {}
        for i, name in enumerate(names):
            value = float(values[i])
            relative = float(own[i, i]) ** 0.5 * float(raised[i] / value) ** 2
            if relative < _ROUGH:
                figures[name] = Figure(value, value * relative)
                continue
            profiles = Profiles(here, g) if profiles is None else profiles
            larger = min(float(ratio[part][i]), _LARGER)
            low, high = profiles.interval(i, relative / float(ratio[part][i]), larger)
            std = value * relative if name.endswith("time") else np.nan
            figures[name] = Figure(value, std, (min(low, value), max(high, value)))
        if here.kind is not Kind.WANDER:
            drift = figures["drift_std"]
            if here.kind is Kind.VELOCITY:
                drift = Figure(_long_run(values, own).value, _long_run(raised, own).std)
            figures["long_run_drift"] = drift
            if speed > 0.0:
                figures["long_run_drift_by_distance"] = drift.divided(float(np.sqrt(speed)))
        else:
            figures["short_run_drift"] = _short_run(values, own)
        groups[group] = figures
    return groups


def _off_nothing(here: Likelihood) -> Likelihood:
    """The same, with what is so near nothing that its information is round-off raised from there.

    Information of a logarithm goes with the fourth power of a standard deviation.
    """
    told = np.diag(here.average_information()).reshape(here.parameters.shape)
    sizes = np.array([not name.endswith("time") for name in here.kind.names])
    tiny = sizes & (told < _ROUND_OFF)
    if not tiny.any():
        return here
    factor = (_RAISED / np.maximum(told, _LEAST)) ** 0.25
    raised = here.parameters + np.where(tiny, np.log(factor), 0.0)
    try:
        return here.at(raised, here.weights)
    except np.linalg.LinAlgError:
        return here


def uncertainty(here: Likelihood, blocks: int) -> tuple[Array, Array]:
    """The covariance of ψ, (2p, 2p), and by how much it makes standard deviations larger, (2p,).

    From the average information, or where it is larger from the scores' scatter over so many
    ``blocks`` of time (White's estimate). A component near nothing has little information in its
    logarithm, but as much as ever in its variance: others know what it may take of theirs.
    """
    information = here.average_information()
    unit = 1.0 / np.sqrt(np.maximum(np.diag(information), _NO_INFORMATION))
    values, vectors = np.linalg.eigh(unit[:, None] * information * unit)
    vectors = unit[:, None] * vectors
    inverse = (vectors / np.maximum(values, 1e-3)) @ vectors.T
    scores = here.scores().reshape(here.count, -1)
    scattered = inverse @ scatter(scores, blocks) @ inverse
    ratio = np.sqrt(np.maximum(np.diag(scattered) / np.diag(inverse), 1.0))
    return np.asarray(inverse * ratio * ratio[:, None]), np.asarray(ratio)


def _long_run(values: Array, covariance: Array) -> Figure:
    """``sqrt(w² + 2 σ² T)``, and its standard deviation by the delta method."""
    drift = values[1] ** 2
    velocity = 2.0 * values[2] ** 2 * values[3] if len(values) > 2 else 0.0
    total = float(np.sqrt(drift + velocity))
    slope = np.zeros(len(values))
    slope[1] = drift / total
    if len(values) > 2:
        slope[2], slope[3] = velocity / total, 0.5 * velocity / total
    variance = float(slope @ np.nan_to_num(covariance) @ slope)
    return Figure(total, float(np.sqrt(max(variance, 0.0))))


def _short_run(values: Array, covariance: Array) -> Figure:
    """``sqrt(2 σ² / T)``: the walk that a wander (j, σ, T) is within much less than its time."""
    rate = float(values[1] * np.sqrt(2.0 / values[2]))
    slope = np.array([0.0, rate, -0.5 * rate])
    variance = float(slope @ np.nan_to_num(covariance) @ slope)
    return Figure(rate, float(np.sqrt(max(variance, 0.0))))


def _jumps(stamps: Stamps, here: Likelihood) -> tuple[Jump, ...]:
    _, _, square, rest = here.disturbances()
    # What has no factor is none, whatever round-off says of a process that is as good as nothing.
    leaps = (here.weights[1] > 1.0) & (square > JUMP**2 * (here.own_noise()[1] + rest))
    found = np.flatnonzero(leaps.any(axis=1))
    sizes = np.sqrt(square)
    return tuple(
        Jump(int(stamps[i + 1]), float(sizes[i, 0]), float(sizes[i, 1])) for i in found.tolist()
    )
