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

In the blocks after its own ``k_b = F p`` with the query's ``past`` p up to the end before them, so
that ``S - p`` goes on as S does.

With any other kernel ``W = L⁻¹ k`` is solved for in each block, and F is the identity.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack
from trajeval_ros.ground_truth.kernel_sum import KernelSum, MarkovSum

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]

# The posterior variance is a small difference of large numbers, so its last digits show how the
# arithmetic was ordered. To give the same digits however the samples and the queries were cut into
# batches, every BLAS and LAPACK call below has a shape that depends on the position in the segment
# alone: rows in blocks, queries in panels.
_BLOCK = 32
_PANEL = 8
# So many panels at a time, and covariances of so many blocks: their arrays stay in the cache, and
# the memory they need is not handed back to the system, and asked for anew, each time.
_PANELS = 64
_BLOCKS = 16
_ROWS, _COLUMNS = np.tril_indices(_BLOCK)
_LOWER = _ROWS * _BLOCK + _COLUMNS
# The times (s) of rows without a sample: so far from all others that no kernel knows of them.
_NOWHERE = 1e12 * np.arange(1.0, _BLOCK + 1.0)


def rounded_up(count: int) -> int:
    """The smallest of 32, 64, 128, ... that holds ``count`` rows."""
    return _BLOCK << max(0, (max(count, 1) - 1) // _BLOCK).bit_length()


def _in_panels(count: int) -> int:
    """So many rows as whole panels have."""
    return -(-count // _PANEL) * _PANEL


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
    def innovations(self, first: int) -> tuple[Array, Array]:
        """What samples from row ``first`` >= 1 on add to ``Σ q`` and ``log|K| + log A``.

        (G, n - first) both.
        """

    def take(self, times: Array) -> None:
        """Take the times of all samples so far."""
        known, self.count = self.count, len(times)
        more = rounded_up(self.count) - len(self.times)
        if more > 0:
            self.times = np.concatenate([self.times, np.zeros(more)])
            self._reserve(more)
        self.times[known : self.count] = times[known:]

    @abstractmethod
    def _reserve(self, more: int) -> None:
        """Make room for so many more rows."""

    @classmethod
    @abstractmethod
    def _add(
        cls, factors: Sequence[Factor], samples: Sequence[Observed], known: Sequence[int]
    ) -> None:
        """Write the rows from those of each that are ``known`` on.

        Raises LinAlgError where a covariance is not positive definite.
        """

    @classmethod
    @abstractmethod
    def products(
        cls, asked: Sequence[tuple[Factor, Array, Counts]], kinds: int
    ) -> tuple[Array, Array]:
        """Return ``vᵀ [g z]`` (k, G, q, 1 + c) and ``vᵀ v`` (k, G, q) of all queries in turn.

        ``asked``: factors with the same kernels and number of groups, and of each at what times
        (q,), with the first so many samples, one at least. Of k that are asked for (`KernelSum`).
        """

    @abstractmethod
    def whitened(self, times: Array, counts: Counts) -> Array:
        """Return v of queries, zero from row ``counts`` on; (G, q, rows).

        ``times`` (q,); of each the first ``counts`` (q,) >= 1 samples.
        """

    @abstractmethod
    def weights(self, right: Array, counts: Counts) -> Array:
        """Return ``L⁻ᵀ right``, ``right`` (G, q, rows) being zero from row ``counts`` (q,) on."""


@dataclass(frozen=True, slots=True)
class Observed:
    """All samples so far: ``times`` (n,); ``values`` (n, G, c); variances ``noise`` (n, G)."""

    times: Array
    values: Array
    noise: Array


def extend(factors: Sequence[Factor], samples: Sequence[Observed]) -> None:
    """Take all samples so far of each, those known already first.

    Of factors of one kind with the same kernel and number of groups, side by side: what it costs is
    the number of calls. Raises LinAlgError where the covariance of one is not positive definite;
    none has taken any then.
    """
    known = [factor.count for factor in factors]
    for factor, each in zip(factors, samples, strict=True):
        factor.take(each.times)
    try:
        type(factors[0])._add(factors, samples, known)
    except np.linalg.LinAlgError:
        for factor, count in zip(factors, known, strict=True):
            factor.count = count
        message = "the covariance of the samples is not positive definite"
        raise np.linalg.LinAlgError(message) from None


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Blocks of rows to be factored: the first of each factor, then the second, and so on; B.

    ``factors`` F, those with the most blocks first; ``widths``: how many there are of the first
    blocks, of the second, ...; ``numbers`` (B,): of each block within its factor. ``times`` (B,
    32), of rows without a sample `_NOWHERE`; ``covariances`` (G, B, 32, 32): the lower triangles of
    ``K_b``, in such rows the identity's; ``right`` (G, B, 32, 1 + c): ``[1 x]``.
    """

    factors: Sequence[Factor]
    widths: Counts
    numbers: Counts
    times: Array
    covariances: Array
    right: Array

    @staticmethod
    def of(factors: Sequence[Factor], samples: Sequence[Observed], known: Sequence[int]) -> _Blocks:
        """Those from that of the first row of each that is not ``known`` on."""
        first = [count // _BLOCK for count in known]
        sizes = [-(-each.count // _BLOCK) - b for each, b in zip(factors, first, strict=True)]
        ranked = sorted(range(len(factors)), key=lambda i: -sizes[i])
        kernel, count = factors[0]._kernel, sum(sizes)
        groups, coordinates = samples[0].values.shape[1:]
        times = np.tile(_NOWHERE, count)
        diagonal = np.ones((groups, len(times)))
        right = np.zeros((groups, len(times), 1 + coordinates))
        further: list[int] = []
        numbers: list[int] = []
        row = 0
        for i in ranked:
            begin, size = _BLOCK * first[i], factors[i].count - _BLOCK * first[i]
            here = slice(row, row + size)
            times[here] = samples[i].times[begin:]
            diagonal[:, here] = kernel.variances[0] + samples[i].noise[begin:].T
            right[:, here, 0] = 1.0
            right[:, here, 1:] = np.swapaxes(samples[i].values[begin:], 0, 1)
            further += range(sizes[i])
            numbers += range(first[i], first[i] + sizes[i])
            row += _BLOCK * sizes[i]
        order = np.argsort(further, kind="stable")
        times = times.reshape(count, _BLOCK)[order]
        flat = np.zeros((groups, count, _BLOCK * _BLOCK))
        for begin in range(0, count, _BLOCKS):
            some = times[begin : begin + _BLOCKS]
            apart = (some[:, _ROWS] - some[:, _COLUMNS]).reshape(1, -1)
            lower = kernel(apart).reshape(groups, len(some), -1)
            flat[:, begin : begin + _BLOCKS, _LOWER] = lower
        flat[..., :: _BLOCK + 1] = diagonal.reshape(groups, count, _BLOCK)[:, order]
        return _Blocks(
            [factors[i] for i in ranked],
            np.bincount(further),
            np.array(numbers)[order],
            times,
            flat.reshape(groups, count, _BLOCK, _BLOCK),
            right.reshape(groups, count, _BLOCK, -1)[:, order],
        )

    @property
    def owners(self) -> list[tuple[Factor, int]]:
        """The factor and the number of each block."""
        factors = [factor for width in self.widths.tolist() for factor in self.factors[:width]]
        return [*zip(factors, self.numbers.tolist(), strict=True)]


class _SummedFactor(Factor):
    """One whose sums are added up when its rows are there."""

    def __init__(self, kernel: KernelSum, information: Array, coordinates: int) -> None:
        """Start without samples."""
        super().__init__(kernel, information, coordinates)
        self._sums_up = np.empty((self._groups, 0, 3 + coordinates))  # with Σ zᵀ z

    @property
    def sums(self) -> Array:
        """Row after row."""
        return self._sums_up[..., :-1]

    def innovations(self, first: int) -> tuple[Array, Array]:
        """By the sums."""
        sums = self._sums_up[:, first - 1 : self.count]
        pivots = 2.0 * np.log(self.pivots[:, first : self.count])
        return np.diff(sums[..., -2]), pivots + np.diff(np.log(sums[..., 0]))

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

    @classmethod
    def _add(
        cls, factors: Sequence[Factor], samples: Sequence[Observed], known: Sequence[int]
    ) -> None:
        """The first block of each factor, the second, and so on."""
        blocks = _Blocks.of(factors, samples, known)
        places = [(f, b) for f, b in blocks.owners if isinstance(f, MarkovFactor)]
        firsts = places[: blocks.widths[0]]
        columns = firsts[0][0]._columns
        ahead, past = cls._transitions(firsts, blocks)
        right = np.concatenate([blocks.right, past], axis=3)
        # Of a factor's first block they mean nothing, and F is zero.
        sums = np.stack([factor._sums[:, b - 1] for factor, b in firsts], axis=1)
        begin = 0
        for width in blocks.widths.tolist():
            here = slice(begin, begin + width)
            begin += width
            seen = ahead[:, here] @ sums[:, :width]
            explained = seen[..., columns:] @ np.swapaxes(ahead[:, here], 2, 3)
            onwards = np.concatenate([seen[..., :columns], explained[..., _BLOCK:]], axis=3)
            own = blocks.covariances[:, here] - explained[:, :, :_BLOCK, :_BLOCK]
            lower = np.asarray(np.linalg.cholesky(own), dtype=np.float64)
            solved = _solved(lower, right[:, here] - onwards[:, :, :_BLOCK])
            sums = np.swapaxes(solved[..., columns:], 2, 3) @ solved + onwards[:, :, _BLOCK:]
            for i, (factor, b) in enumerate(places[here]):
                factor._ahead[:, b] = ahead[:, here][:, i]
                factor._lower[:, b] = lower[:, i]
                factor._solved[:, b] = solved[:, i]
                factor._sums[:, b] = sums[:, i]
        for factor, _ in firsts:
            factor._sum_up()

    @classmethod
    def _transitions(
        cls, firsts: Sequence[tuple[MarkovFactor, int]], blocks: _Blocks
    ) -> tuple[Array, Array]:
        """F with Φᵀ below it, (G, B, 32 + r, r), and ``P_b``, (G, B, 32, r), of the blocks."""
        kernel, times, widths = firsts[0][0]._kernel, blocks.times, blocks.widths.tolist()
        # The first block has none before it, and while it is not whole, is none.
        if max(factor.count for factor, _ in firsts) < _BLOCK:
            shape = (*blocks.right.shape[:2], _BLOCK + kernel.rank, kernel.rank)
            return np.zeros(shape), np.zeros(shape)[:, :, :_BLOCK]
        ends = times[:, -1:]
        before = [factor.times[max(_BLOCK * b - 1, 0)] for factor, b in firsts]
        begins, start = [np.array(before)[:, None]], 0
        for width, after in pairwise(widths):
            begins.append(ends[start : start + after])
            start += width
        begin = np.concatenate(begins)
        powers = kernel.powers(np.concatenate([times - begin, ends - times, ends - begin], axis=1))
        future = kernel.future(powers[:, :, :_BLOCK])[0]
        step = np.swapaxes(kernel.transition(powers[:, :, 2 * _BLOCK :]), 2, 3)
        ahead = np.concatenate([future, step], axis=2)
        ahead[:, blocks.numbers == 0] = 0.0
        return ahead, np.asarray(kernel.past(powers[:, :, _BLOCK : 2 * _BLOCK])[0])

    def first_blocks(self, times: Array, counts: Counts) -> Counts:
        """The block that each query must begin with: those before it end before it; (q,)."""
        ends = self.times[_BLOCK - 1 : self.count : _BLOCK]
        return np.minimum(np.searchsorted(ends, times, side="right"), (counts - 1) // _BLOCK)

    @classmethod
    def products(
        cls, asked: Sequence[tuple[Factor, Array, Counts]], kinds: int
    ) -> tuple[Array, Array]:
        """In panels of queries."""
        ours = [(f, times, counts) for f, times, counts in asked if isinstance(f, MarkovFactor)]
        first = [factor.first_blocks(times, counts) for factor, times, counts in ours]
        panels = _Panels.of(ours, np.concatenate(first))
        if not len(panels.block):
            factor, _, _ = ours[0]
            shape = (kinds, factor._groups, 0)
            return np.empty((*shape, factor._columns)), np.empty(shape)
        size = _PANELS // kinds
        parts = [
            _of_panels(panels[begin : begin + size], kinds)
            for begin in range(0, len(panels.block), size)
        ]
        found, explained = (np.concatenate(each, axis=2) for each in zip(*parts, strict=True))
        flat = (kinds, found.shape[1], -1)
        found, explained = found.reshape(*flat, found.shape[4]), explained.reshape(flat)
        return found[:, :, panels.slots], explained[:, :, panels.slots]

    def whitened(self, times: Array, counts: Counts) -> Array:
        """Before a query's own block by its ``future``, from there on as `products`."""
        size = rounded_up(int(counts.max(initial=0)))
        found = np.zeros((self._groups, len(times), size // _BLOCK, _BLOCK))
        if not len(times):
            return found.reshape(self._groups, 0, size)
        first = self.first_blocks(times, counts)
        for b in range(int(first.max())):
            late = np.flatnonzero(first > b)
            apart = np.zeros((1, _in_panels(len(late))))
            apart[0, : len(late)] = times[late] - self.times[_BLOCK * (b + 1) - 1]
            powers = self._kernel.powers(apart.reshape(-1, _PANEL))
            past = np.swapaxes(self._solved[:, b, None, :, self._columns :], 2, 3)
            rows = self._kernel.future(powers)[0] @ past
            found[:, late, b] = rows.reshape(self._groups, -1, _BLOCK)[:, : len(late)]
        panels = _Panels.of([(self, times, counts)], first)
        panel = panels.slots // _PANEL
        for further, (here, white, _) in enumerate(_walk(panels, _begun(panels, 1)[0])):
            rows = np.zeros((self._groups, len(panels.block), _PANEL, _BLOCK))
            rows[:, here] = white[0]
            asked = np.flatnonzero(np.isin(panel, here))
            place = rows.reshape(self._groups, -1, _BLOCK)[:, panels.slots[asked]]
            known = first[asked] + further < size // _BLOCK
            found[:, asked[known], (first[asked] + further)[known]] = place[:, known]
        return found.reshape(self._groups, len(times), size)

    def weights(self, right: Array, counts: Counts) -> Array:
        """From the last block on."""
        count = right.shape[1]
        state = np.zeros((self._groups, _in_panels(count), self._kernel.rank))
        solution = np.zeros((self._groups, _in_panels(count), right.shape[2]))
        for b in range((int(counts.max(initial=0)) - 1) // _BLOCK, -1, -1):
            here = slice(b * _BLOCK, (b + 1) * _BLOCK)
            block = np.zeros((self._groups, _in_panels(count), _BLOCK))
            block[:, :count] = right[..., here]
            past = self._solved[:, b, :, self._columns :]
            block -= _by_panels(state, np.swapaxes(past, 1, 2))
            _solve_rows(self._lower[:, b], block, transposed=True)
            solution[..., here] = block
            state = _by_panels(np.concatenate([block, state], axis=2), self._ahead[:, b])
        return solution[:, :count]


@dataclass(frozen=True, slots=True)
class _Panels:
    """Queries in panels of those that begin with the same block.

    ``factors`` of P panels and the numbers of the blocks (P,); ``times`` (P, 8) and ``counts``
    (P, 8) of samples from that block on, zeros where there is no query; ``slots`` (q,): each
    query's place.
    """

    factors: list[MarkovFactor]
    block: Counts
    times: Array
    counts: Counts
    slots: Counts

    @staticmethod
    def of(asked: Sequence[tuple[MarkovFactor, Array, Counts]], first: Counts) -> _Panels:
        """Panels of all queries; ``first`` (q,): the block that each begins with."""
        owner = np.repeat(np.arange(len(asked)), [len(times) for _, times, _ in asked])
        most = int(first.max(initial=0)) + 1
        key = owner * most + first
        order = np.argsort(key, kind="stable")
        key = key[order]
        begins = np.flatnonzero(np.diff(key, prepend=-1))
        sizes = np.diff(begins, append=len(key))
        panels = -(-sizes // _PANEL)
        offsets = np.cumsum(panels) - panels
        slots = np.empty(len(key), dtype=np.intp)
        slots[order] = np.repeat(_PANEL * offsets - begins, sizes) + np.arange(len(key))
        times = np.zeros(_PANEL * int(panels.sum()))
        counts = np.zeros(len(times), dtype=np.intp)
        times[slots] = np.concatenate([each for _, each, _ in asked])
        counts[slots] = np.concatenate([each for _, _, each in asked]) - _BLOCK * first
        of = np.repeat(key[begins], panels)
        factors = [asked[number][0] for number in (of // most).tolist()]
        shape = (-1, _PANEL)
        return _Panels(factors, of % most, times.reshape(shape), counts.reshape(shape), slots)

    def __getitem__(self, index: slice) -> _Panels:
        """Some of them."""
        return _Panels(
            self.factors[index],
            self.block[index],
            self.times[index],
            self.counts[index],
            self.slots,
        )

    def where(self, chosen: Counts, further: int = 0) -> list[tuple[MarkovFactor, int]]:
        """The factors and the blocks, so many ``further`` ones, of the panels ``chosen``."""
        return [(self.factors[i], int(self.block[i]) + further) for i in chosen.tolist()]


def _kernel(blocks: list[tuple[MarkovFactor, int]]) -> MarkovSum:
    """The factors' kernels side by side."""
    kernels = [factor._kernel for factor, _ in blocks]
    if all(kernel is kernels[0] for kernel in kernels):
        return kernels[0]
    return MarkovSum.beside(kernels)


def _of_panels(panels: _Panels, kinds: int) -> tuple[Array, Array]:
    """The `products` of queries, (k, G, P, 8, 1 + c) and (k, G, P, 8)."""
    state, found, explained = _begun(panels, kinds)
    for here, white, gain in _walk(panels, state):
        found[:, :, here] += gain
        explained[:, :, here] += np.einsum("kgpqi,kgpqi->kgpq", white, white)
    return found, explained


def _begun(panels: _Panels, kinds: int) -> tuple[Array, Array, Array]:
    """S (k, G, P, 8, r) at the begin of each query's own block, and the `products` up to there."""
    factor = panels.factors[0]
    shape, columns = (kinds, factor._groups, len(panels.block), _PANEL), factor._columns
    found, explained = np.zeros((*shape, columns)), np.zeros(shape)
    state = np.zeros((*shape, factor._kernel.rank))
    late = np.flatnonzero(panels.block)
    if len(late):
        blocks = panels.where(late, -1)
        ends = np.array([each.times[_BLOCK * (b + 1) - 1] for each, b in blocks])
        kernel = _kernel(blocks)
        apart = np.maximum(panels.times[late] - ends[:, None], 0.0)
        future = kernel.future(kernel.powers(apart), kinds)
        seen = future @ np.stack([each._sums[:, b] for each, b in blocks], axis=1)
        found[:, :, late], state[:, :, late] = seen[..., :columns], seen[..., columns:]
        explained[:, :, late] = (future * seen[..., columns:]).sum(axis=-1)
    return state, found, explained


def _walk(panels: _Panels, state: Array) -> Iterator[tuple[Counts, Array, Array]]:
    """Yield, block after block from their own on, the panels, their ``v_b`` and ``v_bᵀ [g z]_b``.

    (k, G, P, 8, 32) and (k, G, P, 8, 1 + c). ``state`` (k, G, P, 8, r): S there, overwritten.
    """
    here, further = np.arange(len(panels.block)), 0
    while True:
        left = panels.counts[here] - _BLOCK * further
        here, left = here[(left > 0).any(axis=1)], left[(left > 0).any(axis=1)]
        if not len(here):
            return
        blocks = panels.where(here, further)
        ahead = np.stack([f._ahead[:, b] for f, b in blocks], axis=1)
        solved = np.stack([f._solved[:, b] for f, b in blocks], axis=1)
        known = state[:, :, here] @ np.swapaxes(ahead, 2, 3)
        white = -known[..., :_BLOCK]
        onwards = known[..., _BLOCK:]
        if not further:
            times = np.stack([f.times[b * _BLOCK : (b + 1) * _BLOCK] for f, b in blocks])
            kernel = _kernel(blocks)
            apart = (panels.times[here][:, :, None] - times[:, None]).reshape(len(here), -1)
            white += kernel.cross(apart, len(state)).reshape(white.shape)
            if (panels.counts > _BLOCK).any():
                until = np.maximum(times[:, -1:] - panels.times[here], 0.0)
                onwards = onwards - kernel.past(kernel.powers(until), len(state))
        by_group = np.ascontiguousarray(np.moveaxis(white, 0, 2))
        for p, (factor, b) in enumerate(blocks):
            _solve_rows(factor._lower[:, b], by_group[:, p].reshape(len(by_group), -1, _BLOCK))
        white = np.moveaxis(by_group, 2, 0)
        white *= np.arange(_BLOCK) < left[:, :, None]
        gain = white @ solved
        columns = gain.shape[-1] - state.shape[-1]
        state[:, :, here] = gain[..., columns:] + onwards
        yield here, white, gain[..., :columns]
        further += 1


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

    @classmethod
    def _add(
        cls, factors: Sequence[Factor], samples: Sequence[Observed], known: Sequence[int]
    ) -> None:
        """One after the other."""
        blocks = _Blocks.of(factors, samples, known)
        for i, (factor, b) in enumerate(blocks.owners):
            assert isinstance(factor, DenseFactor)
            factor._add_block(b, blocks.covariances[:, i], blocks.right[:, i])
        for factor in factors:
            assert isinstance(factor, DenseFactor)
            factor._sum_up()

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

    @classmethod
    def products(
        cls, asked: Sequence[tuple[Factor, Array, Counts]], kinds: int
    ) -> tuple[Array, Array]:
        """By all of v."""
        each = [
            factor._products(times, counts, kinds)
            for factor, times, counts in asked
            if isinstance(factor, DenseFactor)
        ]
        found, explained = zip(*each, strict=True)
        return np.concatenate(found, axis=2), np.concatenate(explained, axis=2)

    def _products(self, times: Array, counts: Counts, kinds: int) -> tuple[Array, Array]:
        each = [self._products_of(white) for white in self._whitened(times, counts, kinds)]
        found, explained = zip(*each, strict=True)
        return np.stack(found), np.stack(explained)

    def _products_of(self, white: Array) -> tuple[Array, Array]:
        white = np.swapaxes(white, 1, 2)
        columns = np.swapaxes(self._white[:, : white.shape[1]], 1, 2)
        panels = np.zeros((*white.shape[:2], _in_panels(white.shape[2])))
        panels[..., : white.shape[2]] = white
        found = _row_sums(panels[:, None] * columns[..., None])[..., : white.shape[2]]
        return np.swapaxes(found, 1, 2), _row_sums(panels * panels)[:, : white.shape[2]]

    def whitened(self, times: Array, counts: Counts) -> Array:
        """By sizes."""
        return np.asarray(self._whitened(times, counts, 1)[0])

    def _whitened(self, times: Array, counts: Counts, kinds: int) -> Array:
        rows = rounded_up(int(counts.max(initial=0)))
        white = np.zeros((kinds, self._groups, len(times), rows))
        for size, chosen in _by_size(counts):
            crosses = self._kernel.cross(times[chosen, None] - self.times[:size], kinds)
            for target, cross in zip(white, crosses, strict=True):
                panel = np.zeros((self._groups, _in_panels(len(chosen)), size))
                panel[:, : len(chosen)] = cross
                _solve_rows(self._lower, panel)
                target[:, chosen, :size] = panel[:, : len(chosen)]
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
    """``lower⁻¹ right`` of blocks (..., 32, 32) and (..., 32, m)."""
    solution = np.empty_like(right)
    flat = (each.reshape(-1, *each.shape[-2:]) for each in (solution, lower, right))
    for target, factor, columns in zip(*flat, strict=True):
        target[...], _ = lapack.dtrtrs(factor.T, columns, trans=1)
    return solution
