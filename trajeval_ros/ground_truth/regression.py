# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gaussian-process regression of a few coordinates over time, grown sample by sample.

The model of each coordinate is ``x(t) = β + f(t) + noise``, an unknown mean β under a nearly flat
prior, and ``f ~ GP(0, k)``; the covariance of all is known up to a scale ``s²`` near one, with a
prior of ν degrees of freedom. With the Cholesky factor ``K = L Lᵀ`` of the samples' covariance, ``z
= L⁻¹ x``, ``g = L⁻¹ 1`` and ``v = L⁻¹ k(t)``, all truncated to the first n rows,

    A = p + gᵀ g,   β = gᵀ z / A,   r = 1 - gᵀ v,   q = zᵀ z - (gᵀ z)² / A,
    m(t) = vᵀ z + r β,   s² = (ν + Σ q) / (ν + c (n - 1)),   P(t) = s² (k(t,t) - vᵀ v + r² / A)

is the posterior given the first n samples, c coordinates together giving the scale
(``docs/method.md``, Ground truth): the leading block of a Cholesky factor is the factor of the
leading block, so a truncated answer costs no new factorisation.

The factor is made in blocks of rows. With Markov kernels (`kernel_sum`) the covariance of the
samples before a block with those in it is ``P Fᵀ``, of a rank r of a few, so ``W = L⁻¹ P`` is
carried from block to block, and the block's rows of L are ``F Wᵀ``: there is nothing to solve for.
With any other kernel ``W = L⁻¹ k`` is solved for in each block, and F is the identity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from trajeval_ros.ground_truth.hyperparameters import DEGREES_OF_FREEDOM, GroupHyperparameters
from trajeval_ros.ground_truth.kernel_sum import KernelSum
from trajeval_ros.ground_truth.kernels import Kernel

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]

# The posterior variance is a small difference of large numbers, so its last digits show how the
# arithmetic was ordered. To give the same digits however the samples and the queries were cut into
# batches, every BLAS and LAPACK call below has a shape that depends on the position in the segment
# alone: rows in blocks, queries in panels.
_BLOCK = 32
_PANEL = 8

# Standard deviation of the mean in units of the signal's: flat beside the data.
_FLAT = 1e3
# The variance is known to this many units of round-off of k(t, t), and is never less than that.
_ROUND_OFF = 64.0 * np.finfo(np.float64).eps


def _rounded_up(count: int) -> int:
    """The smallest of 32, 64, 128, ... that holds ``count`` rows."""
    return _BLOCK << max(0, (max(count, 1) - 1) // _BLOCK).bit_length()


def _blocks(count: int) -> int:
    """So many blocks hold ``count`` rows."""
    return -(-count // _BLOCK)


def _in_panels(count: int) -> int:
    """So many columns as whole panels have."""
    return -(-count // _PANEL) * _PANEL


def _by_size(counts: Counts) -> Iterator[tuple[int, Counts]]:
    """The sizes of `_rounded_up`, and which of the counts (q,) need which."""
    if not len(counts):
        return
    size, largest = _rounded_up(int(counts.min())), _rounded_up(int(counts.max()))
    while size <= largest:
        least = size // 2 if size > _BLOCK else 0
        chosen = np.flatnonzero((counts <= size) & (counts > least))
        if len(chosen):
            yield size, chosen
        size *= 2


class Regression:
    """The posterior of G groups of c coordinates.

    Those of a group share hyperparameters and noise, all share the kernels.
    """

    def __init__(
        self,
        kernels: tuple[Kernel, ...],
        groups: tuple[GroupHyperparameters, ...],
        coordinates: int,
    ) -> None:
        """Start without samples."""
        self._kernel = KernelSum(kernels, groups)
        self._variance = self._kernel.variance
        self._count = 0
        self._times = np.empty(0)
        size = len(groups)
        self._factor = np.empty((size, 0, 0))
        self._white = np.empty((size, 0, 1 + coordinates))  # g, z
        self._past = np.empty((size, 0, self._kernel.rank))  # W, of the whole blocks
        self._sums = np.empty((size, 0, 2 + coordinates))  # A, gᵀ z, Σ zᵀ z, row after row

    @property
    def count(self) -> int:
        """Number of samples conditioned on."""
        return self._count

    def extend(self, times: Array, values: Array, noise: Array) -> None:
        """Condition on all samples so far; those known already must lead.

        ``times`` (n,) seconds, increasing; ``values`` (n, G, c); ``noise`` (n, G) variances.
        """
        total, first = len(times), self._count // _BLOCK * _BLOCK
        if total == self._count:
            return
        self._reserve(_rounded_up(total))
        self._times[first:total] = times[first:]
        # The first block has no past, and while it is not whole, is none.
        is_markov = self._kernel.is_markov and total >= _BLOCK
        markov = self._markov(first, total) if is_markov else None
        for b, start in enumerate(range(first, total, _BLOCK)):
            new = slice(start, min(start + _BLOCK, total))
            if markov is None:
                past, future = self._solved_past(new), np.eye(_BLOCK)
            else:
                past, future = self._past[:, :start], markov.future[:, b]
            lower = self._factor_block(times[new], values[new], noise[new], past, future)
            if markov is not None and start + _BLOCK <= total:
                self._move_on(start, lower, future, markov.past[:, b], markov.step[:, b])
        self._count = total
        self._sum_up(first)

    def _reserve(self, rows: int) -> None:
        old = len(self._times)
        if rows <= old:
            return
        factor = np.zeros((len(self._factor), rows, rows))
        factor[:, :old, :old] = self._factor
        np.einsum("gii->gi", factor)[:, old:] = 1.0
        self._factor = factor
        self._times = np.concatenate([self._times, np.zeros(rows - old)])
        self._white, self._past, self._sums = (
            np.concatenate([known, np.zeros((len(known), rows - old, known.shape[2]))], axis=1)
            for known in (self._white, self._past, self._sums)
        )

    def _markov(self, first: int, total: int) -> _Markov:
        """The Markov factors of the blocks from row ``first`` on."""
        count = _blocks(total - first)
        times = self._times[first : first + count * _BLOCK].reshape(count, _BLOCK)
        ends = times[:, -1:]
        begins = np.concatenate([self._times[max(first - 1, 0), None], ends[:-1, 0]])[:, None]
        # Rows without a sample have no time.
        future = self._kernel.future(np.maximum(times - begins, 0.0))
        future[:, -1, total - first - (count - 1) * _BLOCK :] = 0.0
        past = self._kernel.past(np.maximum(ends - times, 0.0))
        step = self._kernel.transition(np.maximum(ends - begins, 0.0))[:, :, 0]
        return _Markov(future, past, step)

    def _solved_past(self, new: slice) -> Array:
        """``W = L⁻¹ k`` of the rows before a block and its ``new`` samples; (G, start, 32)."""
        start, times = new.start, self._times[new]
        cross = np.zeros((len(self._factor), _BLOCK, start))
        if not start:
            return np.swapaxes(cross, 1, 2)
        cross[:, : len(times)] = self._kernel(np.abs(times[:, None] - self._times[:start]))
        return self._solve(start, cross)

    def _factor_block(
        self, times: Array, values: Array, noise: Array, past: Array, future: Array
    ) -> Array:
        """Write 32 rows of L, g and z; return the block of L, (G, 32, 32).

        The arguments of `extend`, of the block's samples; ``past`` W (G, start, r) and ``future`` F
        (G, 32, r) or (32, 32). Rows without a sample are rows of the identity.
        """
        groups, start, size = len(past), past.shape[1], len(times)
        here, seen = slice(start, start + _BLOCK), np.swapaxes(past, 1, 2)
        block = np.zeros((groups, _BLOCK, _BLOCK))
        block[:, :size, :size] = self._kernel(np.abs(times[:, None] - times))
        diagonal = np.einsum("gii->gi", block)
        diagonal[:, :size] += noise.T
        diagonal[:, size:] = 1.0
        right = np.zeros((groups, _BLOCK, self._white.shape[2]))
        right[:, :size, 0] = 1.0
        right[:, :size, 1:] = np.swapaxes(values, 0, 1)
        if start:
            block -= future @ (seen @ past) @ np.swapaxes(future, -1, -2)
            right -= future @ (seen @ self._white[:, :start])
            self._factor[:, here, :start] = future @ seen
        try:
            lower = np.asarray(np.linalg.cholesky(block), dtype=np.float64)
        except np.linalg.LinAlgError:
            message = "the covariance of the samples is not positive definite"
            raise np.linalg.LinAlgError(message) from None
        self._factor[:, here, here] = lower
        self._white[:, here] = _solved(lower, right)
        return lower

    def _move_on(self, start: int, lower: Array, future: Array, past: Array, step: Array) -> None:
        """Let W be that of the block after the one at ``start``, which is whole."""
        before = self._past[:, :start] @ step
        seen = np.swapaxes(self._past[:, :start], 1, 2)
        self._past[:, start : start + _BLOCK] = _solved(lower, past - future @ (seen @ before))
        self._past[:, :start] = before

    def _sum_up(self, first: int) -> None:
        """Add up the sums from row ``first`` on."""
        white = self._white[:, first : self._count]
        square = (white[..., 1:] ** 2).sum(axis=-1, keepdims=True)
        terms = np.concatenate([white[..., :1] * white, square], axis=-1)
        if first:
            terms[:, 0] += self._sums[:, first - 1]
        else:
            terms[:, 0, 0] += 1.0 / (_FLAT**2 * self._variance)
        self._sums[:, first : self._count] = np.cumsum(terms, axis=1)

    def posterior(self, times: Array, counts: Counts) -> tuple[Array, Array]:
        """Return mean (q, G, c) and ``P / s²`` (q, G), given the first ``counts`` (q,) samples.

        There is at least one.
        """
        white, r, mean = self._whitened(times, counts)
        sums = self._sums[:, counts - 1]
        information = sums[..., 0]
        mean = mean + (r / information)[..., None] * sums[..., 1:-1]
        explained = _row_sums(white * white)[:, : len(times)]
        variance = self._variance[:, None] - explained + r * r / information
        least = _ROUND_OFF * self._variance
        return np.swapaxes(mean, 0, 1), np.maximum(variance.T, least)

    def squares(self, counts: Counts) -> Array:
        """``Σ q`` over a group's coordinates, given the first ``counts`` (q,) samples; (q, G)."""
        sums = self._sums[:, counts - 1]
        return np.asarray(sums[..., -1] - (sums[..., 1:-1] ** 2).sum(axis=-1) / sums[..., 0]).T

    def cross_variances(self, times: Array, known: int, counts: Counts) -> list[Array]:
        """Return the posterior covariances over ``s²`` of each time with all those before it.

        ``times`` (k + q,), k = ``known``; ``counts`` (q,) >= 1 of the last q. Each (k + i, G), i =
        0 ... q - 1, given the later one's first ``counts`` samples, its set being the larger: the
        later error is orthogonal to all that the earlier answer knew, so that is the covariance
        of the errors. With ``u = L⁻ᵀ (v_j + g r_j / A)`` it is ``k(t_i, t_j) + r_j / A - k(t_i)ᵀ
        u``, for any number of t_i.
        """
        white, r, _ = self._whitened(times[known:], counts)
        drawn = r / self._sums[:, counts - 1, 0]
        rows = white.shape[1]
        right = white[..., : len(counts)] + self._white[:, :rows, :1] * drawn[:, None]
        right[:, np.arange(rows)[:, None] >= counts] = 0.0
        samples = self._kernel(np.abs(times[:, None] - self._times[:rows]))
        prior = self._kernel(np.abs(times[:, None] - times[known:]))
        found = []
        for size, chosen in _by_size(counts):
            panel = np.zeros((len(right), _in_panels(len(chosen)), size))
            panel[:, : len(chosen)] = np.swapaxes(right[:, :size, chosen], 1, 2)
            weights = self._solve(size, panel, transposed=True)
            for place, j in enumerate(chosen):
                weight = weights[:, :, place, None]
                explained = (samples[:, : known + j, :size] @ weight)[..., 0]
                row = prior[:, : known + j, j] + drawn[:, j, None] - explained
                found.append((j, row.T))
        return [row for _, row in sorted(found, key=lambda entry: int(entry[0]))]

    def _whitened(self, times: Array, counts: Counts) -> tuple[Array, Array, Array]:
        """``v`` (G, rows, panels of q), zero from row ``counts`` on; ``r`` (G, q); ``vᵀ z``.

        The last is (G, q, c).
        """
        groups, rows = len(self._factor), _rounded_up(int(counts.max(initial=0)))
        white = np.zeros((groups, rows, _in_panels(len(times))))
        for size, chosen in _by_size(counts):
            panel = np.zeros((groups, _in_panels(len(chosen)), size))
            apart = np.abs(times[chosen, None] - self._times[:size])
            panel[:, : len(chosen)] = self._kernel(apart)
            white[:, :size, chosen] = self._solve(size, panel)[..., : len(chosen)]
        white[:, :, : len(times)] *= np.arange(rows)[:, None] < counts
        columns = np.swapaxes(self._white[:, :rows], 1, 2)
        products = _row_sums(white[:, None] * columns[..., None])[..., : len(times)]
        return white, 1.0 - products[:, 0], np.swapaxes(products[:, 1:], 1, 2)

    def _solve(self, size: int, rows: Array, transposed: bool = False) -> Array:
        """``L⁻¹`` or ``L⁻ᵀ`` of the leading ``size`` rows times ``rowsᵀ``; (G, size, m).

        ``rows`` (G, m, size), which it overwrites.
        """
        solution = np.empty((len(rows), size, rows.shape[1]))
        for target, factor, row in zip(solution, self._factor, rows, strict=True):
            # As LAPACK has it, in columns, Lᵀ is in the upper triangle; nothing is copied.
            target[...], info = lapack.dtrtrs(
                factor[:size].T, row.T, trans=int(not transposed), overwrite_b=1
            )
            if info:
                raise np.linalg.LinAlgError("singular Cholesky factor")
        return solution


@dataclass(frozen=True, slots=True)
class _Markov:
    """Of b blocks: ``future`` F and ``past`` P (G, b, 32, r), and the ``step`` (G, b, r, r).

    F counts from the end of the block before, P to the end of its own, the step between these.
    """

    future: Array
    past: Array
    step: Array


def scale(squares: Array, counts: Counts, coordinates: int, least: npt.ArrayLike) -> Array:
    """``s²`` of so many coordinates with ``Σ q = squares`` (...), ``least`` or more; (...)."""
    freedom = coordinates * (counts - 1)
    return np.asarray(
        np.maximum((DEGREES_OF_FREEDOM + squares) / (DEGREES_OF_FREEDOM + freedom), least)
    )


def _row_sums(values: Array) -> Array:
    """Sum over the rows (..., rows, whole panels) of a C-ordered array, one row after the other."""
    return np.asarray(np.add.reduce(values, axis=-2))


def _solved(lower: Array, right: Array) -> Array:
    """``lower⁻¹ right`` of blocks (G, 32, 32) and (G, 32, m)."""
    solution = np.empty_like(right)
    for target, factor, columns in zip(solution, lower, right, strict=True):
        target[...], _ = lapack.dtrtrs(factor.T, columns, trans=1)
    return solution
