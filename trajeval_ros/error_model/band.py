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
# Of so many poses an elimination, 15 MB at the most, is kept as it is made.
_FEW = 5000


def regressed(system: System) -> Regressed:
    """The system with its states integrated out, by the loops where they are.

    Raises numpy.linalg.LinAlgError where a matrix is not positive definite.
    """
    columns = system.nuisances.shape[2] + system.gauge.shape[2] + 1
    return Band(system) if loops.there() and columns <= _MOST_LANES else Information(system)


class Band:
    """`Regressed`.

    Of more poses than a few thousand the elimination is kept only once it is asked for, m (2m + c)
    numbers a pose: where likelihoods are compared, it never is.
    """

    def __init__(self, system: System) -> None:
        """Eliminate the states of one pose after the other.

        Raises numpy.linalg.LinAlgError where a matrix is not positive definite.
        """
        self._system = system
        count, k = len(system.errors), system.moves.shape[1]
        c, d = system.nuisances.shape[2], system.gauge.shape[2]
        self._columns = c + d
        self._sizes = count, k, c, d, -(-(c + d + 1) // _LANES) * _LANES
        contiguous = loops.doubles
        self._regressors = tuple(
            contiguous(each) for each in (system.nuisances, system.gauge, system.errors)
        )
        self._travel, self._prior = contiguous(system.travel), contiguous(system.prior)
        self._noise = contiguous(system.covariance), contiguous(system.jitter)
        self._moves = contiguous(system.moves)
        self._precision, self._step_noise = contiguous(system.precision), contiguous(system.noise)
        room = count if count <= _FEW else 2
        weight, kept, normal, log_dets = self._eliminated(room)
        self._elimination = (weight, kept) if room == count else None
        used = self._columns + 1
        self.normal: Array = normal[:used, :used]
        self.noise_log_det, self.log_det = (float(each) for each in log_dets)

    def _eliminated(self, room: int) -> tuple[Array, Array, Array, Array]:
        """R⁻¹ and the elimination of the last ``room`` poses, the normal equations, log |.|."""
        _, k, _, _, lanes = self._sizes
        found = (
            np.empty((room, 6, 6)),
            np.empty((room, 6 * k, 12 * k + lanes)),
            np.empty((lanes, lanes)),
            np.empty(2),
        )
        failed = loops.call(
            "band_forward",
            *self._noise,
            *self._regressors,
            self._moves,
            self._precision,
            self._prior,
            self._travel,
            *found,
            room,
            *self._sizes,
        )
        if failed:
            raise np.linalg.LinAlgError("a matrix is not positive definite")
        return found

    def _all(self) -> tuple[Array, Array]:
        """The elimination of all poses, and R⁻¹ before it as C takes them."""
        if self._elimination is None:
            self._elimination = self._eliminated(self._sizes[0])[:2]
        weight, kept = self._elimination
        return kept, weight

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
            *self._all(),
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
            *self._all(),
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
        self._elimination = None  # nothing more is asked of it, most likely
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
