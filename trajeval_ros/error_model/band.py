# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A regression with the states integrated out, one pose after the other, in C (`band.c`)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.error_model.information import Information
from trajeval_ros.error_model.system import Regressed, Slopes, System, Told

Array = npt.NDArray[np.float64]

# As in band.c: columns come as many as a multiple of the first, and no more than the second; each
# group has room for so many parameters.
_LANES = 4
_MOST_LANES = 32
_PARAMETERS = 4


def regressed(system: System) -> Regressed:
    """The system with its states integrated out, by the loops where they are.

    Raises numpy.linalg.LinAlgError where a matrix is not positive definite.
    """
    columns = system.nuisances.shape[2] + system.gauge.shape[2] + 1
    return Band(system) if loops.there() and columns <= _MOST_LANES else Information(system)


class Band:
    """`Regressed`, in memory of m (2m + c) numbers a pose."""

    def __init__(self, system: System) -> None:
        """Eliminate the states of one pose after the other.

        Raises numpy.linalg.LinAlgError where a matrix is not positive definite.
        """
        self._system = system
        count, k = len(system.errors), system.moves.shape[1]
        c, d = system.nuisances.shape[2], system.gauge.shape[2]
        self._columns = c + d
        lanes = -(-(c + d + 1) // _LANES) * _LANES
        self._sizes = count, k, c, d, lanes
        contiguous = np.ascontiguousarray
        self._regressors = tuple(
            contiguous(each) for each in (system.nuisances, system.gauge, system.errors)
        )
        self._weight = np.empty((count, 6, 6))
        self._kept = np.empty((count, 6 * k, 12 * k + lanes))
        normal, log_dets = np.empty((lanes, lanes)), np.empty(2)
        self._travel, self._prior = contiguous(system.travel), contiguous(system.prior)
        self._noise = contiguous(system.covariance), contiguous(system.jitter)
        self._moves = contiguous(system.moves)
        self._precision, self._step_noise = contiguous(system.precision), contiguous(system.noise)
        failed = loops.call(
            "band_forward",
            *self._noise,
            *self._regressors,
            self._moves,
            self._precision,
            self._prior,
            self._travel,
            self._weight,
            self._kept,
            normal,
            log_dets,
            *self._sizes,
        )
        if failed:
            raise np.linalg.LinAlgError("a matrix is not positive definite")
        used = self._columns + 1
        self.normal: Array = normal[:used, :used]
        self.noise_log_det, self.log_det = (float(each) for each in log_dets)

    def told(self, theta: Array, root: Array) -> Told:
        """What the data say."""
        count, k, _, _, lanes = self._sizes
        size = self._columns
        ends = np.zeros((lanes, lanes))
        ends[:size, :size], ends[:size, size], ends[size, size] = root, -theta, 1.0
        states, scores = np.empty((count, 6 * k)), np.empty((count, 6))
        of_poses, of_steps = np.empty((3, 2, count)), np.empty((4, 2, k, k, count - 1))
        first = np.empty((2, k, k))
        loops.call(
            "band_backward",
            self._kept,
            self._weight,
            *self._regressors,
            ends,
            self._moves,
            self._travel,
            states,
            scores,
            of_poses,
            of_steps,
            first,
            *self._sizes,
        )
        weight, known, squares = of_poses
        moved, earlier, moves, mixed = of_steps
        return Told(states, scores, weight, known, squares, moved, earlier, moves, mixed, first)

    def average(self, told: Told, slopes: Slopes) -> tuple[Array, Array]:
        """Twice the average information before θ is integrated out, and what both share."""
        count, k, c, d, lanes = self._sizes
        p = len(slopes.noise)
        found, ahead = np.empty((2 * _PARAMETERS,) * 2), np.empty((lanes, 2 * _PARAMETERS))
        loops.call(
            "band_average",
            self._kept,
            self._weight,
            *self._regressors,
            self._noise[1],
            told.states,
            told.scores,
            self._moves,
            self._precision,
            self._step_noise,
            self._travel,
            self._prior,
            slopes.noise,
            slopes.moves,
            slopes.prior,
            found,
            ahead,
            count,
            k,
            p,
            c,
            d,
            lanes,
        )
        own = (np.array([[0], [_PARAMETERS]]) + np.arange(p)).ravel()
        return found[np.ix_(own, own)], ahead[: self._columns, own]

    def whitened(self) -> Array:
        """By a Kalman filter."""
        count, *sizes = self._sizes
        begin = self._system.predicted
        white = np.empty((count - begin, 6, self._sizes[-1]))
        failed = loops.call(
            "band_whiten",
            *self._noise,
            *self._regressors,
            self._moves,
            self._step_noise,
            self._prior,
            self._travel,
            white,
            begin,
            count,
            *sizes,
        )
        if failed:
            raise np.linalg.LinAlgError("an innovation's covariance is not positive definite")
        return white[..., : self._columns + 1]
