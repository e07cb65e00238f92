# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Cholesky factor ``K = L Lᵀ`` of the samples' covariance, grown by blocks of rows.

With Markov kernels (`kernel_sum`) the covariance of the samples before a block with those in it is
``P Fᵀ``, of a rank r of a few, and so with ``W = L⁻¹ P`` the block's rows of L are ``F Wᵀ`` and
then its own lower triangle ``L_b``. All that is ever needed of W is ``M = Wᵀ W`` and ``N = Wᵀ [g
z]``, with ``P_b`` the ``past`` of the block's samples up to its end and Φ the transition from end
to end:

    L_b L_bᵀ = K_b - F M Fᵀ,   [g z]_b = L_b⁻¹ ([1 x]_b - F N),   W_b = L_b⁻¹ (P_b - F M Φ),
    M <- Φᵀ M Φ + W_bᵀ W_b,    N <- Φᵀ N + W_bᵀ [g z]_b.

A query's ``v = L⁻¹ k(t)`` is had block by block from ``S = Wᵀ v``; and up to a block's end before
t it is ``W f`` with its ``future`` f, so that only the blocks from there on need be looked at:

    v_b = L_b⁻¹ (k_b - F S),   S <- Φᵀ S + W_bᵀ v_b,   S = M f.

With any other kernel ``W = L⁻¹ k`` is solved for in each block, and F is the identity.
`recursion` does the same in C, in blocks of one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack
from trajeval_ros.ground_truth.kernel_sum import KernelSum, MarkovSum

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]

# The posterior variance is a small difference of large numbers, so its last digits show how the
# arithmetic was ordered. To give the same digits however the samples and the queries were cut into
# batches, BLAS and LAPACK see shapes that depend on the position in the segment alone.
_BLOCK = 32
_PANEL = 8
_ROWS, _COLUMNS = np.tril_indices(_BLOCK)
_LOWER = _ROWS * _BLOCK + _COLUMNS
# The times (s) of rows without a sample: so far from all others that no kernel knows of them.
_NOWHERE = 1e12 * np.arange(1.0, _BLOCK + 1.0)


def rounded_up(count: int) -> int:
    """The smallest of 32, 64, 128, ... that holds ``count`` rows."""
    return _BLOCK << max(0, (max(count, 1) - 1) // _BLOCK).bit_length()


class Observed(NamedTuple):
    """All samples so far: ``times`` (n,); ``values`` (n, G, c); variances ``noise`` (n, G)."""

    times: Array
    values: Array
    noise: Array


class Factor(ABC):
    """Of G groups, with ``[g z] = L⁻¹ [1 x]`` of c coordinates each.

    And with what is known of their mean, of an ``information`` before all samples (G,): see
    `regression`, whose letters these are.
    """

    def __init__(self, kernel: KernelSum, information: Array, coordinates: int) -> None:
        """Start without samples."""
        self._kernel = kernel
        self._information = information
        self._groups = len(information)
        self._columns = 1 + coordinates
        self.count = 0
        """Number of samples."""
        self.times = np.empty(0)
        """Of the samples, in seconds, and zeros after them."""

    @property
    @abstractmethod
    def white(self) -> Array:
        """``[g z]``; (G, rows, 1 + c), rows beyond the samples meaning nothing."""

    @property
    @abstractmethod
    def pivots(self) -> Array:
        """The diagonal of L; (G, rows), rows beyond the samples meaning nothing."""

    @property
    @abstractmethod
    def sums(self) -> Array:
        """A, ``gᵀ z`` and ``Σ q`` of the samples up to each; (G, rows, 2 + c), as `white`."""

    @abstractmethod
    def innovations(self, first: int) -> Array:
        """What samples from row ``first`` >= 1 on add to ``Σ q`` and ``log|K| + log A``.

        (G, n - first, 2).
        """

    @abstractmethod
    def extend(self, samples: Observed) -> None:
        """Take all samples so far, those known already first.

        Raises LinAlgError where their covariance is not positive definite; none is taken then.
        """

    def _note(self, times: Array) -> int:
        """Note the times of all samples so far; return how many were known, and room is made."""
        known, self.count = self.count, len(times)
        more = rounded_up(self.count) - len(self.times)
        if more > 0:
            self.times = np.concatenate([self.times, np.zeros(more)])
            self._reserve(more)
        self.times[known : self.count] = times[known:]
        return known

    def _refuse(self, known: int) -> np.linalg.LinAlgError:
        """Forget all but the first samples; what to raise."""
        self.count = known
        return np.linalg.LinAlgError("the covariance of the samples is not positive definite")

    @abstractmethod
    def _reserve(self, more: int) -> None:
        """Make room for so many more rows."""

    @abstractmethod
    def products(self, times: Array, counts: Counts, kinds: int) -> tuple[Array, Array]:
        """Return ``vᵀ [g z]`` (k, G, q, 1 + c) and ``vᵀ v`` (k, G, q) of queries.

        They are asked for at ``times`` (q,); of each the first ``counts`` (q,) >= 1 samples; k that
        are asked for (`KernelSum`).
        """

    @abstractmethod
    def whitened(self, times: Array, counts: Counts) -> Array:
        """Return v of queries, zero from row ``counts`` on; (G, q, rows)."""

    @abstractmethod
    def weights(self, right: Array, counts: Counts) -> Array:
        """Return ``L⁻ᵀ right``, ``right`` (G, q, rows) being zero from row ``counts`` (q,) on."""


class _Blocks(NamedTuple):
    """B blocks of rows to be factored.

    ``times`` (B, 32), of rows without a sample `_NOWHERE`; ``covariances`` (G, B, 32, 32): the
    lower triangles of ``K_b``, in such rows the identity's; ``right`` (G, B, 32, 1 + c): ``[1 x]``.
    """

    times: Array
    covariances: Array
    right: Array


class _SummedFactor(Factor):
    """One whose rows come in blocks, and whose sums are added up when they are there."""

    def __init__(self, kernel: KernelSum, information: Array, coordinates: int) -> None:
        """Start without samples."""
        super().__init__(kernel, information, coordinates)
        self._sums_up = np.empty((self._groups, 0, 3 + coordinates))  # with Σ zᵀ z

    @property
    def sums(self) -> Array:
        """Row after row."""
        return self._sums_up[..., :-1]

    def innovations(self, first: int) -> Array:
        """By the sums."""
        sums = self._sums_up[:, first - 1 : self.count]
        pivots = 2.0 * np.log(self.pivots[:, first : self.count])
        news = np.diff(sums[..., -2]), pivots + np.diff(np.log(sums[..., 0]))
        return np.stack(news, axis=-1)

    def extend(self, samples: Observed) -> None:
        """Block after block."""
        known = self._note(samples.times)
        first = known // _BLOCK
        try:
            self._add_blocks(first, self._blocks(samples, first))
        except np.linalg.LinAlgError:
            raise self._refuse(known) from None
        self._sum_up()

    @abstractmethod
    def _add_blocks(self, first: int, blocks: _Blocks) -> None:
        """Write them."""

    def _blocks(self, samples: Observed, first: int) -> _Blocks:
        """Those from the ``first`` on."""
        begin, size = _BLOCK * first, self.count - _BLOCK * first
        number = -(-size // _BLOCK)
        times = np.tile(_NOWHERE, number)
        times[:size] = samples.times[begin:]
        diagonal = np.ones((self._groups, len(times)))
        diagonal[:, :size] = self._kernel.variances[0] + samples.noise[begin:].T
        right = np.zeros((self._groups, len(times), self._columns))
        right[:, :size, 0] = 1.0
        right[:, :size, 1:] = np.swapaxes(samples.values[begin:], 0, 1)
        times = times.reshape(number, _BLOCK)
        flat = np.zeros((self._groups, number, _BLOCK * _BLOCK))
        apart = (times[:, _ROWS] - times[:, _COLUMNS]).reshape(1, -1)
        flat[:, :, _LOWER] = self._kernel(apart).reshape(self._groups, number, -1)
        flat[..., :: _BLOCK + 1] = diagonal.reshape(self._groups, number, _BLOCK)
        return _Blocks(
            times,
            flat.reshape(self._groups, number, _BLOCK, _BLOCK),
            right.reshape(self._groups, number, _BLOCK, -1),
        )

    def _sum_up(self) -> None:
        """Add up the sums of the new rows."""
        known = self._sums_up.shape[1]
        white = self.white[:, known : self.count]
        square = (white[..., 1:] ** 2).sum(axis=-1, keepdims=True)
        terms = np.concatenate([white[..., :1] * white, square, square], axis=-1)
        if known:
            terms[:, 0] += self._sums_up[:, known - 1]
        else:
            terms[:, 0, 0] += self._information
        further = np.cumsum(terms, axis=1)
        further[..., -2] = (
            further[..., -1] - (further[..., 1:-2] ** 2).sum(axis=-1) / further[..., 0]
        )
        self._sums_up = np.concatenate([self._sums_up, further], axis=1)


class MarkovFactor(_SummedFactor):
    """With Markov kernels: its size and the time it takes grow with the samples."""

    _kernel: MarkovSum

    def __init__(self, kernel: MarkovSum, information: Array, coordinates: int) -> None:
        """Start without samples."""
        super().__init__(kernel, information, coordinates)
        groups, rank = self._groups, kernel.rank
        self._lower = np.empty((groups, 0, _BLOCK, _BLOCK))  # L_b
        self._ahead = np.empty((groups, 0, _BLOCK + rank, rank))  # F and, below it, Φᵀ
        self._solved = np.empty((groups, 0, _BLOCK, self._columns + rank))  # [g z]_b and W_b
        self._sums = np.empty((groups, 0, rank, self._columns + rank))  # [N M] at the end

    @property
    def white(self) -> Array:
        """Block after block."""
        whole = self._solved.reshape(self._groups, -1, self._solved.shape[3])
        return whole[..., : self._columns]

    @property
    def pivots(self) -> Array:
        """Block after block."""
        return np.asarray(np.einsum("gbii->gbi", self._lower).reshape(self._groups, -1))

    def _reserve(self, more: int) -> None:
        self._lower, self._ahead, self._solved, self._sums = (
            np.concatenate(
                [known, np.zeros((len(known), more // _BLOCK, *known.shape[2:]))], axis=1
            )
            for known in (self._lower, self._ahead, self._solved, self._sums)
        )

    def _add_blocks(self, first: int, blocks: _Blocks) -> None:
        ahead, past = self._transitions(first, blocks.times)
        right = np.concatenate([blocks.right, past], axis=3)
        # Before the first block there is nothing, and F is zero.
        sums = self._sums[:, first - 1]
        for b, own in enumerate(np.swapaxes(blocks.covariances, 0, 1), start=first):
            i = b - first
            seen = ahead[:, i] @ sums
            explained = seen[..., self._columns :] @ np.swapaxes(ahead[:, i], 1, 2)
            onwards = np.concatenate([seen[..., : self._columns], explained[..., _BLOCK:]], axis=2)
            lower = np.linalg.cholesky(own - explained[:, :_BLOCK, :_BLOCK])
            solved = _solved(lower, right[:, i] - onwards[:, :_BLOCK])
            sums = np.swapaxes(solved[..., self._columns :], 1, 2) @ solved + onwards[:, _BLOCK:]
            self._ahead[:, b], self._lower[:, b] = ahead[:, i], lower
            self._solved[:, b], self._sums[:, b] = solved, sums

    def _transitions(self, first: int, times: Array) -> tuple[Array, Array]:
        """F with Φᵀ below it, (G, B, 32 + r, r), and ``P_b``, (G, B, 32, r), of blocks' times."""
        kernel, ends = self._kernel, times[:, -1:]
        begins = np.concatenate([self.times[[max(_BLOCK * first - 1, 0)]], ends[:-1, 0]])[:, None]
        apart = np.concatenate([times - begins, ends - times, ends - begins], axis=1)
        powers = kernel.powers(apart)
        future = kernel.future(powers[:, :, :_BLOCK])[0]
        step = np.swapaxes(kernel.transition(powers[:, :, 2 * _BLOCK :]), 2, 3)
        ahead = np.concatenate([future, step], axis=2)
        if first == 0:
            ahead[:, 0] = 0.0
        return ahead, np.asarray(kernel.past(powers[:, :, _BLOCK : 2 * _BLOCK])[0])

    def products(self, times: Array, counts: Counts, kinds: int) -> tuple[Array, Array]:
        """In panels, from the block on that each query lies in."""
        explained = np.empty((kinds, self._groups, len(times)))
        found = np.empty((*explained.shape, self._columns))
        ends = self.times[_BLOCK - 1 : self.count : _BLOCK]
        own = np.searchsorted(ends, times, side="right")
        for first, some, eight in _panels(np.minimum(own, (counts - 1) // _BLOCK)):
            both = self._products(times[eight], counts[eight], kinds, first)
            found[:, :, some], explained[:, :, some] = (each[:, :, : len(some)] for each in both)
        return found, explained

    def _products(
        self, times: Array, counts: Counts, kinds: int, first: int
    ) -> tuple[Array, Array]:
        """Of one panel, from the ``first`` block on."""
        state = np.zeros((kinds, self._groups, len(times), self._kernel.rank))
        found, explained = np.zeros((*state.shape[:3], self._columns)), np.zeros(state.shape[:3])
        if first:
            end = self.times[_BLOCK * first - 1]
            powers = self._kernel.powers((times - end)[None])
            future = self._kernel.future(powers, kinds)[:, :, 0]
            seen = future @ self._sums[:, first - 1]
            found, state = seen[..., : self._columns], seen[..., self._columns :]
            explained = (future * state).sum(axis=-1)
        for _, white, gain in self._walk(times, counts, state, first):
            found += gain
            explained += np.einsum("kgqi,kgqi->kgq", white, white)
        return found, explained

    def _walk(
        self, times: Array, counts: Counts, state: Array, first: int
    ) -> Iterator[tuple[int, Array, Array]]:
        """Yield the blocks from the ``first`` on, their ``v_b`` and ``v_bᵀ [g z]_b``.

        (k, G, q, 32) and (k, G, q, 1 + c). ``state`` (k, G, q, r): S before them.
        """
        kinds = len(state)
        for b in range(first, (int(counts.max(initial=0)) - 1) // _BLOCK + 1):
            here = self.times[_BLOCK * b : _BLOCK * (b + 1)]
            seen = state @ np.swapaxes(self._ahead[:, b], 1, 2)
            cross = self._kernel.cross((times[:, None] - here).reshape(1, -1), kinds)
            white = cross.reshape(*state.shape[:3], _BLOCK) - seen[..., :_BLOCK]
            for each in white:
                _solve_rows(self._lower[:, b], each)
            white *= np.arange(_BLOCK) < (counts - _BLOCK * b)[:, None]
            gain = white @ self._solved[:, b]
            state = gain[..., self._columns :] + seen[..., _BLOCK:]
            yield b, white, gain[..., : self._columns]

    def whitened(self, times: Array, counts: Counts) -> Array:
        """All blocks, in panels."""
        found = np.zeros((self._groups, len(times), rounded_up(int(counts.max(initial=0)))))
        state = np.zeros((1, self._groups, _PANEL, self._kernel.rank))
        for _, some, eight in _panels(np.zeros_like(counts)):
            for b, white, _ in self._walk(times[eight], counts[eight], state, 0):
                found[:, some, _BLOCK * b : _BLOCK * (b + 1)] = white[0, :, : len(some)]
        return found

    def weights(self, right: Array, counts: Counts) -> Array:
        """From the last block on, in panels."""
        solution = np.zeros_like(right)
        for _, some, eight in _panels(np.zeros_like(counts)):
            solution[:, some] = self._weights(right[:, eight], counts[eight])[:, : len(some)]
        return solution

    def _weights(self, right: Array, counts: Counts) -> Array:
        state = np.zeros((*right.shape[:2], self._kernel.rank))
        solution = np.zeros_like(right)
        for b in range((int(counts.max()) - 1) // _BLOCK, -1, -1):
            here = slice(b * _BLOCK, (b + 1) * _BLOCK)
            past = self._solved[:, b, :, self._columns :]
            block = right[..., here] - state @ np.swapaxes(past, 1, 2)
            _solve_rows(self._lower[:, b], block, transposed=True)
            solution[..., here] = block
            state = np.concatenate([block, state], axis=2) @ self._ahead[:, b]
        return solution


class DenseFactor(_SummedFactor):
    """With any kernel."""

    def __init__(self, kernel: KernelSum, information: Array, coordinates: int) -> None:
        """Start without samples."""
        super().__init__(kernel, information, coordinates)
        self._lower = np.empty((self._groups, 0, 0))
        self._white = np.empty((self._groups, 0, self._columns))

    @property
    def white(self) -> Array:
        """Of the one matrix."""
        return self._white

    @property
    def pivots(self) -> Array:
        """Of the one matrix."""
        return np.asarray(np.einsum("gii->gi", self._lower))

    def _reserve(self, more: int) -> None:
        old = self._lower.shape[1]
        lower = np.zeros((self._groups, old + more, old + more))
        lower[:, :old, :old] = self._lower
        np.einsum("gii->gi", lower)[:, old:] = 1.0
        self._lower = lower
        added = np.zeros((self._groups, more, self._columns))
        self._white = np.concatenate([self._white, added], axis=1)

    def _add_blocks(self, first: int, blocks: _Blocks) -> None:
        for b, block in enumerate(np.swapaxes(blocks.covariances, 0, 1), start=first):
            self._add_block(b, block, blocks.right[:, b - first])

    def _add_block(self, b: int, block: Array, unseen: Array) -> None:
        start = b * _BLOCK
        here = slice(start, start + _BLOCK)
        if b:
            size = min(_BLOCK, self.count - start)
            cross = np.zeros((self._groups, _BLOCK, start))
            apart = np.abs(self.times[start : start + size, None] - self.times[:start])
            cross[:, :size] = self._kernel(apart)
            _solve_rows(self._lower, cross)
            self._lower[:, here, :start] = cross
            block = block - cross @ np.swapaxes(cross, 1, 2)
            unseen = unseen - cross @ self._white[:, :start]
        lower = np.asarray(np.linalg.cholesky(block), dtype=np.float64)
        self._lower[:, here, here] = lower
        self._white[:, here] = _solved(lower, unseen)

    def products(self, times: Array, counts: Counts, kinds: int) -> tuple[Array, Array]:
        """By all of v."""
        explained = np.empty((kinds, self._groups, len(times)))
        found = np.empty((*explained.shape, self._columns))
        for size, some, white in self._whitened(times, counts, kinds):
            found[:, :, some] = (white @ self._white[:, :size])[:, :, : len(some)]
            squares = np.einsum("kgqi,kgqi->kgq", white, white)
            explained[:, :, some] = squares[:, :, : len(some)]
        return found, explained

    def whitened(self, times: Array, counts: Counts) -> Array:
        """By panels."""
        found = np.zeros((self._groups, len(times), rounded_up(int(counts.max(initial=0)))))
        for size, some, white in self._whitened(times, counts, 1):
            found[:, some, :size] = white[0, :, : len(some)]
        return found

    def _whitened(
        self, times: Array, counts: Counts, kinds: int
    ) -> Iterator[tuple[int, Counts, Array]]:
        """Of each panel the rows looked at, which queries these are, and v (k, G, 8, rows)."""
        for size, some, eight in _panels(_sizes(counts)):
            apart = (times[eight, None] - self.times[:size]).reshape(1, -1)
            white = self._kernel.cross(apart, kinds).reshape(kinds, self._groups, _PANEL, -1)
            for each in white:
                _solve_rows(self._lower, each)
            white *= np.arange(size) < counts[eight, None]
            yield size, some, white

    def weights(self, right: Array, counts: Counts) -> Array:
        """By panels."""
        solution = np.zeros_like(right)
        for size, some, eight in _panels(_sizes(counts)):
            panel = right[:, eight, :size]
            _solve_rows(self._lower, panel, transposed=True)
            solution[:, some, :size] = panel[:, : len(some)]
        return solution


def _sizes(counts: Counts) -> Counts:
    """As `rounded_up`."""
    return np.array([rounded_up(count) for count in counts.tolist()], dtype=np.intp)


def _panels(keys: Counts) -> Iterator[tuple[int, Counts, Counts]]:
    """Queries whose keys (q,) are the same, eight at a time: the key, which, and eight of these.

    Some stand there twice where there are fewer: the shapes that BLAS sees, and with them the order
    of its sums, do not depend on what else is asked.
    """
    for key in np.unique(keys).tolist():
        alike = np.flatnonzero(keys == key)
        for begin in range(0, len(alike), _PANEL):
            some = alike[begin : begin + _PANEL]
            yield key, some, np.resize(some, _PANEL)


def _solve_rows(lower: Array, rows: Array, transposed: bool = False) -> None:
    """Let ``rows`` (G, m, n) be ``L⁻¹`` or ``L⁻ᵀ`` times them, of the leading n rows of L."""
    for factor, row in zip(lower, rows, strict=True):
        # As LAPACK has it, in columns, Lᵀ is in the upper triangle; nothing is copied.
        leading = factor[: row.shape[1]].T
        solution, _ = lapack.dtrtrs(leading, row.T, trans=int(not transposed), overwrite_b=1)
        row[...] = solution.T


def _solved(lower: Array, right: Array) -> Array:
    """``lower⁻¹ right`` of blocks (..., 32, 32) and (..., 32, m)."""
    solution = np.empty_like(right)
    flat = (each.reshape(-1, *each.shape[-2:]) for each in (solution, lower, right))
    for target, factor, columns in zip(*flat, strict=True):
        target[...], _ = lapack.dtrtrs(factor.T, columns, trans=1)
    return solution
