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
# Of so many poses the filter, 12 MB at the most, is kept as it is made.
_FEW = 5000


def regressed(system: System) -> Regressed:
    """The system with its states integrated out, by the loops where they are.

    Raises numpy.linalg.LinAlgError where a matrix is not positive definite.
    """
    columns = system.nuisances.shape[2] + system.gauge.shape[2] + 1
    return Band(system) if loops.there() and columns <= _MOST_LANES else Information(system)


class Band:
    """`Regressed`.

    Of more poses than a few thousand the filter is kept only once it is asked for: where
    likelihoods are compared, it never is.
    """

    def __init__(self, system: System) -> None:
        """Filter K and z.

        Raises numpy.linalg.LinAlgError where a matrix is not positive definite.
        """
        count, k = len(system.errors), system.moves.shape[1]
        c, d = system.nuisances.shape[2], system.gauge.shape[2]
        self._columns, self._begin = c + d, system.predicted
        self._count, self._size = count, 6 * k
        self._lanes = -(-(c + d + 1) // _LANES) * _LANES
        self._arrays = tuple(
            map(
                loops.doubles,
                (
                    system.covariance,
                    system.jitter,
                    system.nuisances,
                    system.gauge,
                    system.errors,
                    system.moves,
                    system.noise,
                    system.prior,
                    system.travel,
                ),
            )
        )
        self._sizes = count, c, d, k, self._lanes
        room = count if count <= _FEW else 1
        kept, normal, self.log_det = self._filtered(room)
        self._kept = kept if room == count else None
        used = self._columns + 1
        self.normal: Array = normal[:used, :used]

    def _filtered(self, room: int) -> tuple[Array, Array, float]:
        """The filter of the last ``room`` poses, the normal equations, log |.|."""
        size = loops.call("band_size", *self._sizes[3:])
        kept, normal = np.empty((room, size)), np.empty((self._lanes, self._lanes))
        log_det = np.empty(1)
        if loops.call("band_filter", *self._arrays, *self._sizes, room, kept, normal, log_det):
            raise np.linalg.LinAlgError("a matrix is not positive definite")
        return kept, normal, float(log_det[0])

    def _all(self) -> Array:
        """The filter of all poses."""
        if self._kept is None:
            self._kept = self._filtered(self._count)[0]
        return self._kept

    def told(self, theta: Array, root: Array) -> Told:
        """What the data say."""
        count, k, size = self._count, self._size // 6, self._columns
        ends = np.zeros((self._lanes, self._lanes))
        ends[:size, :size], ends[:size, size], ends[size, size] = root, -theta, 1.0
        states, scores = np.empty((count, self._size)), np.empty((count, 6))
        felt, of_poses = np.empty((count - 1, self._size)), np.empty((2, 2, count))
        of_steps, crossed = np.empty((2, 2, k, k, count - 1)), np.empty((2, k, count - 1))
        first = np.empty(2)
        loops.call(
            "band_smooth",
            *self._arrays,
            *self._sizes,
            self._all(),
            ends,
            states,
            scores,
            felt,
            of_poses,
            of_steps,
            crossed,
            first,
        )
        squares, informed = of_poses
        moves, moved = of_steps
        return Told(states, scores, felt, squares, informed, moves, moved, crossed, first)

    def average(self, told: Told, slopes: Slopes) -> tuple[Array, Array]:
        """Twice the average information before θ is integrated out, and what both share."""
        p = len(slopes.noise)
        found, ahead = np.empty((2 * _PARAMETERS,) * 2), np.empty((self._lanes, 2 * _PARAMETERS))
        loops.call(
            "band_average",
            *self._arrays,
            *self._sizes,
            self._all(),
            slopes.noise,
            slopes.moves,
            p,
            told.states,
            told.scores,
            told.felt,
            np.empty((self._count, 6)),
            found,
            ahead,
        )
        own = (np.array([[0], [_PARAMETERS]]) + np.arange(p)).ravel()
        return found[np.ix_(own, own)], ahead[: self._columns, own]

    def whitened(self) -> Array:
        """As the filter has them."""
        size = self._size
        white = self._all()[self._begin :, 6 * (6 + size) : 6 * (6 + size + self._lanes)]
        return white.reshape(-1, 6, self._lanes)[..., : self._columns + 1]
