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
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from trajeval_ros.ground_truth.kernel_sum import Cross, KernelSum

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]

# The posterior variance is a small difference of large numbers, so its last digits show how the
# arithmetic was ordered. To give the same digits however the samples and the queries were cut into
# batches, every BLAS and LAPACK call below has a shape that depends on the position in the segment
# alone: rows in blocks, queries in panels.
_BLOCK = 32
_PANEL = 8
_ROWS, _COLUMNS = np.tril_indices(_BLOCK)
_LOWER = _ROWS * _BLOCK + _COLUMNS


def rounded_up(count: int) -> int:
    """The smallest of 32, 64, 128, ... that holds ``count`` rows."""
    return _BLOCK << max(0, (max(count, 1) - 1) // _BLOCK).bit_length()


def _in_panels(count: int) -> int:
    """So many rows as whole panels have."""
    return -(-count // _PANEL) * _PANEL


class Factor(ABC):
    """Of G groups, with ``[g z] = L⁻¹ [1 x]`` of c coordinates each."""

    def __init__(self, kernel: KernelSum, coordinates: int) -> None:
        """Start without samples."""
        self._kernel = kernel
        self._groups = len(kernel.variance)
        self.count = 0
        """Number of samples."""
        self.times = np.empty(0)
        """Of the samples, in seconds, and zeros after them."""
        self.white = np.empty((self._groups, 0, 1 + coordinates))
        """``[g z]``, zeros after the samples; (G, rows, 1 + c)."""

    def extend(self, times: Array, values: Array, noise: Array) -> int:
        """Take all samples so far, those known already first; return the first row that changed.

        The arguments as in :meth:`Regression.extend`.
        """
        total, first = len(times), self.count // _BLOCK * _BLOCK
        more = rounded_up(total) - len(self.times)
        if more > 0:
            self.times = np.concatenate([self.times, np.zeros(more)])
            self.white = _longer(self.white, more)
            self._reserve(more)
        self.times[first:total] = times[first:]
        known, self.count = self.count, total
        begins = np.arange(first, total, _BLOCK)
        blocks = self._covariances(begins, noise)
        ones_and_values = np.zeros((self._groups, len(begins) * _BLOCK, self.white.shape[2]))
        ones_and_values[:, : total - first, 0] = 1.0
        ones_and_values[:, : total - first, 1:] = np.swapaxes(values[first:], 0, 1)
        right = ones_and_values.reshape(self._groups, len(begins), _BLOCK, -1)
        try:
            self._add(first // _BLOCK, blocks, right)
        except np.linalg.LinAlgError:
            self.count = known
            message = "the covariance of the samples is not positive definite"
            raise np.linalg.LinAlgError(message) from None
        return first

    def _covariances(self, begins: Counts, noise: Array) -> Array:
        """The lower triangles of ``K_b``; (G, b, 32, 32). Rows without a sample: the identity's."""
        first = int(begins[0])
        times = self.times[first : first + len(begins) * _BLOCK].reshape(-1, _BLOCK)
        apart = (times[:, _ROWS] - times[:, _COLUMNS]).reshape(1, -1)
        size = self.count - int(begins[-1])
        sampled = (len(begins) - 1) * len(_ROWS) + size * (size + 1) // 2  # row after row
        packed = np.zeros((self._groups, apart.size))
        packed[:, :sampled] = self._kernel(apart[:, :sampled])[:, 0]
        flat = np.zeros((self._groups, len(begins), _BLOCK * _BLOCK))
        flat[..., _LOWER] = packed.reshape(self._groups, len(begins), -1)
        blocks = flat.reshape(self._groups, len(begins), _BLOCK, _BLOCK)
        diagonal = np.ones((self._groups, times.size))
        diagonal[:, : self.count - first] = self._kernel.variance[:, None] + noise[first:].T
        np.einsum("gbii->gbi", blocks)[...] = diagonal.reshape(blocks.shape[:3])
        return blocks

    @property
    @abstractmethod
    def pivots(self) -> Array:
        """The diagonal of L; (G, rows), rows beyond the samples meaning nothing."""

    @abstractmethod
    def _reserve(self, more: int) -> None:
        """Make room for so many more rows."""

    @abstractmethod
    def _add(self, first: int, blocks: Array, right: Array) -> None:
        """Write the blocks from number ``first`` on; ``right`` (G, b, 32, 1 + c) is ``[1 x]``."""

    @abstractmethod
    def products(self, times: Array, counts: Counts, asked: Sequence[Cross]) -> tuple[Array, Array]:
        """Return ``vᵀ [g z]`` (G, k, q, 1 + c) and ``vᵀ v`` (G, k, q) of queries.

        ``times`` (q,); of each the first ``counts`` (q,) >= 1 samples. ``asked``: what is to be
        known there, by its covariance with the samples; k.
        """

    @abstractmethod
    def whitened(self, times: Array, counts: Counts) -> Array:
        """Return v of queries, zero from row ``counts`` on; (G, q, rows)."""

    @abstractmethod
    def weights(self, right: Array, counts: Counts) -> Array:
        """Return ``L⁻ᵀ right``, ``right`` (G, q, rows) being zero from row ``counts`` (q,) on."""


class MarkovFactor(Factor):
    """With Markov kernels: its size and the time it takes grow with the samples."""

    def __init__(self, kernel: KernelSum, coordinates: int) -> None:
        """Start without samples."""
        super().__init__(kernel, coordinates)
        groups, rank = self._groups, kernel.rank
        self._lower = np.empty((groups, 0, _BLOCK, _BLOCK))  # L_b
        self._future = np.empty((groups, 0, _BLOCK, rank))  # F
        self._past = np.empty((groups, 0, _BLOCK, rank))  # W_b
        self._step = np.empty((groups, 0, rank, rank))  # Φ
        self._sums = np.empty((groups, 0, rank, 1 + coordinates + rank))  # [N M] at its end

    @property
    def pivots(self) -> Array:
        """Block after block."""
        return np.asarray(np.einsum("gbii->gbi", self._lower).reshape(self._groups, -1))

    def _reserve(self, more: int) -> None:
        self._lower = _longer(self._lower, more // _BLOCK)

    def _add(self, first: int, blocks: Array, right: Array) -> None:
        until, columns = first + blocks.shape[1], right.shape[3]
        past = np.zeros((*blocks.shape[:3], self._kernel.rank))
        # The first block has no past, and while it is not whole, is none.
        if self.count >= _BLOCK:
            past = self._transitions(first, until)
        right = np.concatenate([right, past], axis=3)
        for b, block, unseen in zip(
            range(first, until), np.swapaxes(blocks, 0, 1), np.swapaxes(right, 0, 1), strict=True
        ):
            if b:
                future, sums = self._future[:, b], self._sums[:, b - 1]
                seen = sums[..., columns:]
                block = block - future @ seen @ np.swapaxes(future, 1, 2)
                ahead = np.concatenate([sums[..., :columns], seen @ self._step[:, b]], axis=2)
                unseen = unseen - future @ ahead
            self._lower[:, b] = np.linalg.cholesky(block)
            solved = _solved(self._lower[:, b], unseen)
            here = slice(b * _BLOCK, (b + 1) * _BLOCK)
            self.white[:, here] = solved[..., :columns]
            if here.stop > self.count:
                continue
            self._past[:, b] = solved[..., columns:]
            self._sums[:, b] = np.swapaxes(self._past[:, b], 1, 2) @ solved
            if b:
                self._sums[:, b] += np.swapaxes(self._step[:, b], 1, 2) @ ahead

    def _transitions(self, first: int, until: int) -> Array:
        """Write F and Φ of some blocks; return ``P_b`` (G, b, 32, r)."""
        more = self._lower.shape[1] - self._step.shape[1]
        if more:
            self._future, self._past, self._step, self._sums = (
                _longer(known, more) for known in (self._future, self._past, self._step, self._sums)
            )
        times = self.times[first * _BLOCK : until * _BLOCK].reshape(-1, _BLOCK)
        ends = times[:, -1:]
        begins = np.concatenate([self.times[max(first * _BLOCK - 1, 0), None], ends[:-1, 0]])
        # Rows without a sample have no time.
        future = self._kernel.future(np.maximum(times - begins[:, None], 0.0))
        future[:, -1, self.count - (until - 1) * _BLOCK :] = 0.0
        self._future[:, first:until] = future
        step = self._kernel.transition(np.maximum(ends - begins[:, None], 0.0))
        self._step[:, first:until] = step[:, :, 0]
        return self._kernel.past(np.maximum(ends - times, 0.0))

    def products(self, times: Array, counts: Counts, asked: Sequence[Cross]) -> tuple[Array, Array]:
        """Of the blocks that end before a query, by their sums."""
        last = (counts - 1) // _BLOCK
        ends = self.times[_BLOCK - 1 : self.count : _BLOCK]
        first = np.minimum(np.searchsorted(ends, times, side="right"), last)
        columns, kinds = self.white.shape[2], len(asked)
        found = np.zeros((self._groups, kinds, len(times), columns))
        explained = np.zeros((self._groups, kinds, len(times)))
        state = np.zeros((self._groups, kinds, len(times), self._kernel.rank))
        late = np.flatnonzero(first)
        if len(late):
            apart = (times[late] - ends[first[late] - 1])[:, None]
            future = np.stack([cross.future(apart) for cross in asked], axis=1)
            seen = (future @ self._sums[:, None, first[late] - 1])[..., 0, :]
            found[:, :, late], state[:, :, late] = seen[..., :columns], seen[..., columns:]
            explained[:, :, late] = (future[..., 0, :] * seen[..., columns:]).sum(axis=-1)
        for b, looking, white in self._forward(times, counts, first, state, asked):
            rows = kinds * len(looking)
            known = _by_panels(white, self.white[:, b * _BLOCK : (b + 1) * _BLOCK])[:, :rows]
            found[:, :, looking] += known.reshape(self._groups, kinds, -1, columns)
            squares = np.einsum("gqi,gqi->gq", white, white)[:, :rows]
            explained[:, :, looking] += squares.reshape(self._groups, kinds, -1)
        return found, explained

    def whitened(self, times: Array, counts: Counts) -> Array:
        """From the first block on."""
        state = np.zeros((self._groups, 1, len(times), self._kernel.rank))
        found = np.zeros((self._groups, len(times), rounded_up(int(counts.max(initial=0)))))
        for b, looking, white in self._forward(
            times, counts, np.zeros_like(counts), state, [self._kernel]
        ):
            found[:, looking, b * _BLOCK : (b + 1) * _BLOCK] = white[:, : len(looking)]
        return found

    def _forward(
        self, times: Array, counts: Counts, first: Counts, state: Array, asked: Sequence[Cross]
    ) -> Iterator[tuple[int, Counts, Array]]:
        """Yield each block's number, the queries that look at it, and their ``v_b``.

        v_b (G, panels, 32): of the first of what is ``asked`` (k) of all queries, of the second,
        and so on. ``first`` (q,): the block each query begins with; ``state`` (G, k, q, r) S there,
        overwritten.
        """
        if not len(times):
            return
        last = (counts - 1) // _BLOCK
        numbers = range(int(first.min()), int(last.max()) + 1)
        looks = [np.flatnonzero((first <= b) & (last >= b)) for b in numbers]
        query = np.concatenate(looks)
        place = np.repeat(numbers, [len(asked) for asked in looks])
        apart = times[query, None] - self.times.reshape(-1, _BLOCK)[place]
        covariances = np.stack([cross.cross(apart) for cross in asked], axis=1)
        kinds, end = len(asked), 0
        for b, looking in zip(numbers, looks, strict=True):
            if not len(looking):
                continue
            begin, end = end, end + len(looking)
            rows = kinds * len(looking)
            white = np.zeros((self._groups, _in_panels(rows), _BLOCK))
            white[:, :rows] = covariances[:, :, begin:end].reshape(self._groups, rows, _BLOCK)
            if b:
                seen = np.zeros((self._groups, white.shape[1], self._kernel.rank))
                seen[:, :rows] = state[:, :, looking].reshape(self._groups, rows, -1)
                white -= _by_panels(seen, np.swapaxes(self._future[:, b], 1, 2))
            _solve_rows(self._lower[:, b], white)
            known = np.arange(_BLOCK) < counts[looking, None] - b * _BLOCK
            white[:, :rows] *= np.tile(known, (kinds, 1))
            yield b, looking, white
            if b < numbers[-1]:
                onwards = _by_panels(white, self._past[:, b])
                if b:
                    onwards += _by_panels(seen, self._step[:, b])
                state[:, :, looking] = onwards[:, :rows].reshape(
                    self._groups, kinds, len(looking), -1
                )

    def weights(self, right: Array, counts: Counts) -> Array:
        """From the last block on."""
        count = right.shape[1]
        state = np.zeros((self._groups, _in_panels(count), self._kernel.rank))
        solution = np.zeros((self._groups, _in_panels(count), right.shape[2]))
        for b in range((int(counts.max(initial=0)) - 1) // _BLOCK, -1, -1):
            here = slice(b * _BLOCK, (b + 1) * _BLOCK)
            block = np.zeros((self._groups, _in_panels(count), _BLOCK))
            block[:, :count] = right[..., here]
            if here.stop < right.shape[2]:
                block -= _by_panels(state, np.swapaxes(self._past[:, b], 1, 2))
            _solve_rows(self._lower[:, b], block, transposed=True)
            solution[..., here] = block
            if b:
                state = _by_panels(block, self._future[:, b]) + _by_panels(
                    state, np.swapaxes(self._step[:, b], 1, 2)
                )
        return solution[:, :count]


class DenseFactor(Factor):
    """With any kernel."""

    def __init__(self, kernel: KernelSum, coordinates: int) -> None:
        """Start without samples."""
        super().__init__(kernel, coordinates)
        self._lower = np.empty((self._groups, 0, 0))

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

    def _add(self, first: int, blocks: Array, right: Array) -> None:
        for b, block, unseen in zip(
            range(first, first + blocks.shape[1]),
            np.swapaxes(blocks, 0, 1),
            np.swapaxes(right, 0, 1),
            strict=True,
        ):
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
                unseen = unseen - cross @ self.white[:, :start]
            self._lower[:, here, here] = np.linalg.cholesky(block)
            self.white[:, here] = _solved(self._lower[:, here, here], unseen)

    def products(self, times: Array, counts: Counts, asked: Sequence[Cross]) -> tuple[Array, Array]:
        """By all of v."""
        each = [self._products(times, counts, cross) for cross in asked]
        found, explained = zip(*each, strict=True)
        return np.stack(found, axis=1), np.stack(explained, axis=1)

    def _products(self, times: Array, counts: Counts, cross: Cross) -> tuple[Array, Array]:
        white = np.swapaxes(self._whitened(times, counts, cross), 1, 2)
        columns = np.swapaxes(self.white[:, : white.shape[1]], 1, 2)
        panels = np.zeros((*white.shape[:2], _in_panels(len(times))))
        panels[..., : len(times)] = white
        found = _row_sums(panels[:, None] * columns[..., None])[..., : len(times)]
        return np.swapaxes(found, 1, 2), _row_sums(panels * panels)[:, : len(times)]

    def whitened(self, times: Array, counts: Counts) -> Array:
        """By sizes."""
        return self._whitened(times, counts, self._kernel)

    def _whitened(self, times: Array, counts: Counts, cross: Cross) -> Array:
        rows = rounded_up(int(counts.max(initial=0)))
        white = np.zeros((self._groups, len(times), rows))
        for size, chosen in _by_size(counts):
            panel = np.zeros((self._groups, _in_panels(len(chosen)), size))
            panel[:, : len(chosen)] = cross.cross(times[chosen, None] - self.times[:size])
            _solve_rows(self._lower, panel)
            white[:, chosen, :size] = panel[:, : len(chosen)]
        white *= np.arange(rows) < counts[:, None]
        return white

    def weights(self, right: Array, counts: Counts) -> Array:
        """By sizes."""
        solution = np.zeros_like(right)
        for size, chosen in _by_size(counts):
            panel = np.zeros((self._groups, _in_panels(len(chosen)), size))
            panel[:, : len(chosen)] = right[:, chosen, :size]
            _solve_rows(self._lower, panel, transposed=True)
            solution[:, chosen, :size] = panel[:, : len(chosen)]
        return solution


def _by_size(counts: Counts) -> Iterator[tuple[int, Counts]]:
    """The sizes of `rounded_up`, and which of the counts (q,) need which."""
    if not len(counts):
        return
    size, largest = rounded_up(int(counts.min())), rounded_up(int(counts.max()))
    while size <= largest:
        least = size // 2 if size > _BLOCK else 0
        chosen = np.flatnonzero((counts <= size) & (counts > least))
        if len(chosen):
            yield size, chosen
        size *= 2


def _longer(known: Array, more: int) -> Array:
    """Append so many zeros along the second axis."""
    return np.concatenate([known, np.zeros((len(known), more, *known.shape[2:]))], axis=1)


def _by_panels(rows: Array, matrices: Array) -> Array:
    """``rows @ matrices`` of (G, whole panels, a) and (G, a, b), panel after panel."""
    groups, count, size = rows.shape
    product = rows.reshape(groups, -1, _PANEL, size) @ matrices[:, None]
    return product.reshape(groups, count, -1)


def _row_sums(values: Array) -> Array:
    """Sum over the rows (..., rows, whole panels) of a C-ordered array, one row after the other."""
    return np.asarray(np.add.reduce(values, axis=-2))


def _solve_rows(lower: Array, rows: Array, transposed: bool = False) -> None:
    """Let ``rows`` (G, m, n) be ``L⁻¹`` or ``L⁻ᵀ`` times them, of the leading n rows of L."""
    for factor, row in zip(lower, rows, strict=True):
        # As LAPACK has it, in columns, Lᵀ is in the upper triangle; nothing is copied.
        leading = factor[: row.shape[1]].T
        solution, _ = lapack.dtrtrs(leading, row.T, trans=int(not transposed), overwrite_b=1)
        row[...] = solution.T


def _solved(lower: Array, right: Array) -> Array:
    """``lower⁻¹ right`` of blocks (G, 32, 32) and (G, 32, m)."""
    solution = np.empty_like(right)
    for target, factor, columns in zip(solution, lower, right, strict=True):
        target[...], _ = lapack.dtrtrs(factor.T, columns, trans=1)
    return solution
