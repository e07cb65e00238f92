# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Cholesky factor ``K = L Lᵀ`` of Markov kernels, sample by sample, as loops in C.

What `factors` does in blocks, in blocks of one. Let ``M = Wᵀ W`` and ``N = Wᵀ [g z]`` be of the
samples so far, and of the next one: n its noise, x its coordinates, and Φ the transition to it.
Then, with ``f = future(0)`` and ``p = past(0)``,

    M <- Φᵀ M Φ,   N <- Φᵀ N,
    l² = k(0) + n - fᵀ M f,   [g z] = ([1 x] - fᵀ N) / l,   w = (p - M f) / l,
    M <- M + w wᵀ,   N <- N + w [g z]ᵀ.

Of a query, ``v = wᵀ f`` of the samples up to it, with its own future f after each; from then on,
with ``s = Wᵀ v - p`` and its past p before each,

    s <- Φᵀ s,   v = -fᵀ s / l,   s <- s + w v.

Of a kernel with σ and coefficients c the future is ``σ² q_j(a)`` here, ``a = r u / l``, and the
past ``Σ_i i! c_i q_(i-j)(a)``, ``i >= j``, with ``q_j(a) = aʲ / j! exp(-a)``, of which there is no
future but that of one power.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.ground_truth.factors import Counts, Factor, Observed, rounded_up
from trajeval_ros.ground_truth.kernel_sum import MarkovSum
from trajeval_ros.ground_truth.kernels import Matern

Array = npt.NDArray[np.float64]

# Room is made for so many samples at once; N and M are kept after every so many, in rows of a
# multiple of so many numbers.
_BLOCK = 32
_SPAN = 8
_LANES = 4


@lru_cache(maxsize=64)
def _numbers(kernel: MarkovSum) -> tuple[npt.NDArray[np.int64], Array, int, Array]:
    """A sum of kernels as C takes it.

    What `_powers` has; m; rates, those of the kernels that are motion, and variances, (G, 3, m).
    """
    sizes, past, moves = _powers(tuple(type(each) for each in kernel.kernels))
    constants = np.empty((len(kernel.rates), 3, len(sizes)))
    constants[:, 0] = kernel.rates
    constants[:, 1] = kernel.rates * moves
    constants[:, 2] = kernel.component_variances
    return sizes, past, len(sizes), constants


@cache
def _powers(kinds: tuple[type[Matern], ...]) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """How many powers each has, ``past(0)`` of all (r,), and whether it is motion; (m,)."""
    coefficients = [kind.coefficients for kind in kinds]
    past = [math.factorial(j) * c for each in coefficients for j, c in enumerate(each)]
    moves = [kind().curvature > 0.0 for kind in kinds]
    return np.array([len(each) for each in coefficients]), np.array(past), np.array(moves)


class RecursiveFactor(Factor):
    """With Markov kernels: its size and the time it takes grow with the samples."""

    _kernel: MarkovSum

    def __init__(self, kernel: MarkovSum, information: Array, coordinates: int) -> None:
        """Start without samples."""
        super().__init__(kernel, information, coordinates)
        self._numbers = _numbers(kernel)
        groups, rank = len(information), kernel.rank
        lanes = sum(-(-each // _LANES) * _LANES for each in (self._columns, rank))
        # [g z], l, the sums, tr zᵀ z, e² and d, w, and powers.
        self._rows = np.empty((groups, 0, 2 * self._columns + 5 + 2 * rank))
        self._spans = np.empty((groups, 0, rank, lanes))  # [N M]
        self._state = np.zeros((groups, rank, lanes))  # the same after the last sample
        self._addresses: tuple[int, ...] | None = None

    @property
    def white(self) -> Array:
        """Row after row."""
        return self._rows[..., : self._columns]

    @property
    def pivots(self) -> Array:
        """Row after row."""
        return self._rows[..., self._columns]

    @property
    def sums(self) -> Array:
        """Row after row."""
        return self._rows[..., self._columns + 1 : 2 * self._columns + 2]

    def innovations(self, first: int) -> Array:
        """Known since the samples are."""
        begin = 2 * self._columns + 3
        return self._rows[:, first : self.count, begin : begin + 2]

    def _reserve(self, more: int) -> None:
        """Rows are made room for when they are written: no more than there are samples."""

    def _make_room(self, known: int) -> None:
        """For all samples, to the next block; twice what there was where that is too little."""
        before = self._rows.shape[1]
        if self.count <= before:
            return
        room = max(-(-self.count // _BLOCK) * _BLOCK, 2 * before)
        self._rows = _with_room(self._rows, known, room)
        self._spans = _with_room(self._spans, known // _SPAN, room // _SPAN)

    def extend(self, samples: Observed) -> None:
        """Sample after sample."""
        self.take(
            "factor_add", samples.times, loops.doubles(samples.values), loops.doubles(samples.noise)
        )

    def take(self, name: str, times: Array, *further: loops.Argument) -> int:
        """Take all samples so far by a loop that takes what ``factor_add`` does, up to `seen`.

        Return what it returns, which is 1 where their covariance is not positive definite.
        """
        self._addresses = None
        known = self._note(times)
        self._make_room(known)
        state = self._state.copy()
        found = loops.call(
            name,
            *self._process,
            self._information,
            self.times,
            known,
            self.count,
            self._rows.shape[1],
            self._rows,
            self._spans,
            state,
            np.empty(state.shape[2]),
            *further,
        )
        if found == 1:
            raise self._refuse(known)
        self._state = state
        return found

    def _work(self, most: int) -> Array:
        """For C to work with, where a query asks for so many samples."""
        rank, lanes = self._state.shape[1:]
        return np.empty(_LANES * (most + 4 * rank + self._columns + 1 + lanes))

    def products(self, times: Array, counts: Counts, kinds: int) -> tuple[Array, Array]:
        """Query after query."""
        explained = np.empty((kinds, self._groups, len(times)))
        found = np.empty((*explained.shape, self._columns))
        if len(times):
            loops.call(
                "factor_products",
                *self._known,
                loops.doubles(times),
                np.ascontiguousarray(counts),
                len(times),
                kinds,
                found,
                explained,
                most := int(counts.max()),
                self._work(most),
            )
        return found, explained

    @property
    def addresses(self) -> tuple[int, ...]:
        """As ``posterior.c`` has an epoch's, from ``priors`` on; good until more samples come."""
        if self._addresses is None:
            sizes, past, number, constants = self._numbers
            whole = (self._kernel.variances, sizes, past, constants)
            priors, *process = map(loops.address, whole)
            own = map(loops.address, (self.times, self._rows, self._spans))
            self._addresses = (
                *(priors, *process[:2], number, process[2], self._groups, self._columns - 1),
                *(*own, self._rows.shape[1]),
            )
        return self._addresses

    @property
    def _process(self) -> tuple[loops.Argument, ...]:
        return *self._numbers, self._groups, self._columns - 1

    @property
    def _known(self) -> tuple[loops.Argument, ...]:
        return (
            *self._process,
            self.times,
            self._rows,
            self._spans,
            self._rows.shape[1],
        )

    def whitened(self, times: Array, counts: Counts) -> Array:
        """Query after query."""
        size = rounded_up(int(counts.max(initial=0)))
        white = np.empty((self._groups, len(times), size))
        loops.call(
            "factor_whitened",
            *self._known,
            loops.doubles(times),
            np.ascontiguousarray(counts),
            len(times),
            white,
            size,
            size,
            self._work(size),
        )
        return white

    def weights(self, right: Array, counts: Counts) -> Array:
        """From the last row on."""
        solution = right.copy()
        loops.call(
            "factor_weights",
            *self._process,
            self._rows,
            self._rows.shape[1],
            np.ascontiguousarray(counts),
            right.shape[1],
            solution,
            right.shape[2],
            np.empty(self._kernel.rank),
        )
        return solution


def _with_room(known: Array, count: int, room: int) -> Array:
    """The first ``count`` of the second axis of ``known``, with room for more after them."""
    found = np.empty((len(known), room, *known.shape[2:]))
    found[:, :count] = known[:, :count]
    return found
