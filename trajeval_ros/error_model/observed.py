# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The nuisances that the motion shows, and those that it does not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.error_model.likelihood import Data
from trajeval_ros.error_model.model import Unobserved
from trajeval_ros.error_model.nuisances import COUNT, OBSERVED_STD

Array = npt.NDArray[np.float64]

# The columns of a nuisance have to vary so many times more than errors of the ground truth do; and
# the variance, in units of `OBSERVED_STD`, of a direction that the motion does not show.
_BEYOND_ERRORS = 4.0
_UNKNOWN = 100.0
# Of what an alignment takes all of, so much may be left: of a clock, where the speed never changes.
_ROUND_OFF = 1e-10
_RULES = _BEYOND_ERRORS, _UNKNOWN, _ROUND_OFF
# Squares are summed over so many poses at a time, which lie in the processor's cache.
_PART = 500


def shown(
    theta: Array, covariance: Array, jitter: Array, data: Data, gauge: Array
) -> tuple[Array, Array]:
    """θ (9,) of the nuisances with its covariance (9, 9), as far as the motion shows them.

    theta, covariance: as found, with others after them. jitter: variances (2,).

    In the directions that it does not show there is nothing, and the covariance is large: there,
    each step would be as long as its standard deviation, and none the last.
    """
    if loops.there():
        squares, errors = _varied(jitter, data, gauge)
        found, known = np.empty(COUNT), np.empty((COUNT, COUNT))
        given = (*map(loops.doubles, (theta, covariance)), squares, errors, OBSERVED_STD)
        if loops.call("errors_told", len(theta), *given, *_RULES, found, known):
            raise np.linalg.LinAlgError("the nuisances' covariance is singular")
        return found, known
    units = OBSERVED_STD * OBSERVED_STD[:, None]
    information = np.linalg.inv(covariance[:COUNT, :COUNT]) * units
    seen, hidden = _directions(information, jitter, data, gauge)
    known = seen.T @ information @ seen
    right = seen.T @ information @ (theta[:COUNT] / OBSERVED_STD)
    scaled = seen @ np.linalg.inv(known) @ seen.T
    scaled += _UNKNOWN * hidden @ hidden.T
    return seen @ np.linalg.solve(known, right) * OBSERVED_STD, np.asarray(scaled * units)


def _directions(information: Array, jitter: Array, data: Data, gauge: Array) -> tuple[Array, Array]:
    """Axes seen and hidden: orthonormal columns, (9, r) and (9, 9 - r).

    information: (9, 9), in units of `OBSERVED_STD`. Hidden is what the data do not tell to within
    one unit, and what only errors of the ground truth tell: the attitude of a robot that does not
    turn varies by its noise, and a lever arm would follow that as it follows motion; a clock, the
    speed of one that stands.
    """
    squares, errors = _varied(jitter, data, gauge)
    taken = squares[6:, :6] @ np.linalg.pinv(squares[:6, :6], hermitian=True) @ squares[:6, 6:]
    least = _BEYOND_ERRORS * errors + _ROUND_OFF * np.diag(squares)[6:]
    beyond = squares[6:, 6:] - taken - np.diag(least)
    if (np.diag(beyond)[[2, 3, 4, 8]] <= 0.0).all():  # neither turns nor goes anywhere
        beyond[:2] = beyond[:, :2] = 0.0
    values, vectors = np.linalg.eigh(beyond * OBSERVED_STD * OBSERVED_STD[:, None])
    moved, hidden = vectors[:, values > 0.0], vectors[:, values <= 0.0]
    values, vectors = np.linalg.eigh(moved.T @ information @ moved)
    vectors = moved @ vectors
    seen = vectors[:, values >= 1.0]
    return seen, np.concatenate([hidden, vectors[:, values < 1.0]], axis=1)


def _varied(jitter: Array, data: Data, gauge: Array) -> tuple[Array, Array]:
    """How much the columns of alignment and nuisances vary, weighted, and would as errors alone.

    (15, 15) and (9,).
    """
    squares, errors = np.zeros((6 + COUNT, 6 + COUNT)), np.zeros(COUNT)
    if loops.there():
        given = data.covariance, data.measured, jitter, gauge, data.nuisances
        loops.call("errors_shown", len(gauge), *map(loops.doubles, given), squares, errors)
        return squares, errors
    noise = np.einsum("nii->ni", data.covariance).reshape(-1, 2, 3).mean(axis=2)
    weight = 1.0 / (noise + data.measured * jitter)
    for first in range(0, len(gauge), _PART):
        part = slice(first, first + _PART)
        both = np.concatenate([gauge[part], data.nuisances[part]], axis=2)
        flat = both.reshape(-1, 6 + COUNT)
        squares += flat.T @ (flat * np.repeat(weight[part], 3, axis=1).reshape(-1, 1))
    errors[2:5] = 2.0 * noise[:, 1] @ weight[:, 0]
    errors[5:8] = 2.0 * noise[:, 1] @ weight[:, 1]
    errors[8] = 3.0 * noise[:, 0] @ weight[:, 0]
    return squares, errors


def unobserved(covariance: Array) -> tuple[Unobserved, ...]:
    """The principal directions, in units of `OBSERVED_STD`, longer than one."""
    scaled = covariance / OBSERVED_STD / OBSERVED_STD[:, None]
    values, vectors = np.linalg.eigh(scaled)
    return tuple(
        Unobserved(float(value) ** 0.5 * vector * OBSERVED_STD)
        for value, vector in zip(values[::-1], vectors.T[::-1], strict=True)
        if value > 1.0
    )
