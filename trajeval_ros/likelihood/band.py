# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whitening by the Cholesky factor of a banded covariance, over a stream of blocks.

A covariance of a sequence of 6-vectors whose (i, j) blocks vanish for ``|i - j| > bandwidth`` is
given by block rows, ``blocks[i, k]`` being its block (i, i - k), for k = 0 ... bandwidth. Blocks
that lie before the first row are not read.

With ``V = L L^T``, ``L^-1 e`` is white, ``e^T V^-1 e = |L^-1 e|^2``, ``log|V| = 2 sum log L_jj``.
Row i of L needs only the rows i - bandwidth ... i, so a stream takes constant time and memory for
one more block, and LAPACK's banded routines take as many blocks at a time as there are.
"""

import copy
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack, loops
from trajeval_ros.likelihood.gaussian import CovarianceError
from trajeval_ros.likelihood.joint import FactorRows

Array = npt.NDArray[np.float64]

BLOCK = 6


def lower_band(blocks: Array) -> Array:
    """A banded symmetric matrix in LAPACK's lower band storage.

    blocks: (n, b + 1, 6, 6), block rows as in the module's description.
    Returns (6 (b + 1), 6 n) in Fortran order: element (j + k, j) of the matrix at [k, j].
    """
    band = empty_band(len(blocks), blocks.shape[1] - 1)
    fill_band(band, blocks, 0)
    return band


def empty_band(count: int, bandwidth: int) -> Array:
    """A band of so many zero blocks, in the storage of `lower_band`."""
    return np.zeros((count * BLOCK, (bandwidth + 1) * BLOCK)).T


def fill_band(band: Array, blocks: Array, first: int) -> None:
    """Write block rows, from row ``first`` on, into a band made by `empty_band`."""
    n, width = blocks.shape[:2]
    height = width * BLOCK
    columns = band.T.reshape(-1, BLOCK, height)
    for c in range(BLOCK):
        columns[first : first + n, c, : BLOCK - c] = blocks[:, 0, c:, c]
    # Element (r, c) of block (j + k, j) belongs at columns[j, c, 6 k + r - c]: for k > 0, where
    # r - c + 6 k > 0 all through, that is one regular stride.
    for k in range(1, width):
        skip = max(k - first, 0)
        if skip >= n:
            break
        start = (first + skip - k) * BLOCK * height + k * BLOCK
        target = np.lib.stride_tricks.as_strided(
            columns.reshape(-1)[start:],
            (n - skip, BLOCK, BLOCK),
            (8 * BLOCK * height, 8, 8 * (height - 1)),
        )
        target[...] = blocks[skip:, k]


def factorize(band: Array) -> Array:
    """The lower Cholesky factor of a matrix in band storage, in the same storage.

    Raises CovarianceError, its index counting blocks, where there is none. Overwrites ``band``.
    """
    factor, info = lapack.dpbtrf(band, lower=1, overwrite_ab=1)
    if info != 0:
        raise CovarianceError((info - 1) // BLOCK)
    # LAPACK lets NaN through.
    if not np.isfinite(factor[0]).all():
        raise CovarianceError(int(np.argmin(np.isfinite(factor[0]))) // BLOCK)
    return np.asarray(factor)


def solve_factor(factor: Array, rhs: Array) -> Array:
    """``L^-1 X``. factor: L in band storage. rhs: X, (6 n, c)."""
    white, _ = lapack.dtbtrs(factor, rhs, uplo="L")
    return np.asarray(white)


class BandFactor(NamedTuple):
    """The Cholesky factor L of the banded covariance V of a whole sequence, for many uses.

    band: in LAPACK's lower band storage.
    """

    band: Array

    @staticmethod
    def of(blocks: Array) -> "BandFactor":
        """The factor. blocks: (n, b + 1, 6, 6), block rows.

        Raises CovarianceError where V is not positive definite.
        """
        return BandFactor(factorize(lower_band(blocks)))

    def pieces(self, size: int) -> Iterator[tuple[slice, "BandFactor"]]:
        """So many poses at a time, and their factor: all at once where they are not independent."""
        count = self.band.shape[1] // BLOCK
        if len(self.band) > BLOCK or count <= size:
            yield slice(count), self
            return
        for begin in range(0, count, size):
            end = begin + size
            yield slice(begin, end), BandFactor(self.band[:, BLOCK * begin : BLOCK * end])

    @property
    def log_det(self) -> float:
        """``log |V|``."""
        return 2.0 * float(np.log(self.band[0]).sum())

    def whiten(self, columns: Array) -> Array:
        """``L^-1 X``. columns: X, (n, 6, c). Returns (6 n, c)."""
        return solve_factor(self.band, columns.reshape(self.band.shape[1], -1))

    def solve(self, column: Array) -> Array:
        """``V^-1 e``. column: e, (n, 6). Returns (n, 6)."""
        solution, _ = lapack.dpbtrs(self.band, column.reshape(-1), lower=1)
        return np.asarray(solution).reshape(column.shape)


def _trailing_triangle(band: Array, blocks: int) -> Array:
    """The last rows and columns of a lower band factor, dense: (6 blocks, 6 blocks)."""
    size = blocks * BLOCK
    tail = band[:, band.shape[1] - size :]
    triangle = np.zeros((size, size))
    for k in range(min(size, band.shape[0])):
        np.fill_diagonal(triangle[k:], tail[k, : size - k])
    return triangle


def _whitened(covariance: Array, columns: Array) -> tuple[Array, Array]:
    """`BandWhitener.update` of blocks that are independent of each other, (n, 6, 6), in C."""
    white, log_det = np.array(columns, dtype=np.float64, order="C"), np.empty(len(columns))
    given = loops.doubles(covariance)
    wrong = loops.call("sums_whitened", len(columns), columns.shape[-1], given, white, log_det)
    if wrong:
        raise CovarianceError(wrong - 1)
    return white, log_det


class BandWhitener:
    """``L^-1 X`` for a covariance ``V = L L^T`` and columns ``X`` that arrive block by block.

    It owns the state of the recursion: the factor's last ``bandwidth`` block rows, as far as the
    rows to come refer to them, and the columns whitened there. However a sequence is cut into
    batches, the numbers are the same but for round-off.
    """

    def __init__(self, bandwidth: int, columns: int) -> None:
        self._bandwidth = bandwidth
        self._factor = np.zeros((0, 0))
        self._white = np.zeros((0, columns))

    def update(self, blocks: Array | FactorRows, columns: Array) -> tuple[Array, Array]:
        """Whiten the next block rows.

        blocks: (n, bandwidth + 1, 6, 6); [i, k] is the covariance of row i and the row k before,
        which is of an earlier batch where k > i. Or, all through, the factor's rows themselves.
        columns: X, (n, 6, c).

        Returns ``L^-1 X``, (n, 6, c), and each block row's share of the log-determinant, (n,).

        Raises CovarianceError, and leaves the state as it was, where the covariance is not
        positive definite or not finite.
        """
        n = len(blocks)
        if n == 0:
            return np.zeros(columns.shape), np.zeros(0)
        if isinstance(blocks, FactorRows):
            whitened = blocks.whiten_after(self._white, columns)
            white = np.concatenate([self._white, whitened])
            self._white = white[max(len(white) - blocks.kept * BLOCK, 0) :]
            return whitened.reshape(columns.shape), blocks.log_dets
        if loops.there() and not self._bandwidth:
            return _whitened(blocks[:, 0], columns)
        rhs = columns.reshape(n * BLOCK, -1)
        band = lower_band(blocks)
        before = self._factor.shape[0] // BLOCK
        if before:
            across = self._across(blocks, before)
            band, rhs = self._given_the_past(band, rhs, across)
        factor = factorize(band)
        white = solve_factor(factor, rhs)
        log_det = 2.0 * np.log(factor[0]).reshape(n, BLOCK).sum(axis=-1)
        if self._bandwidth:
            self._remember(factor, white, across if before else np.zeros((0, 0)))
        return np.ascontiguousarray(white).reshape(columns.shape), log_det

    def copy(self) -> "BandWhitener":
        """Another one in the same state."""
        # No array is written to after it has become the state.
        return copy.copy(self)

    def transform(self, matrix: Array) -> None:
        """Let the columns be ``X matrix`` instead, also those whitened already.

        matrix: (c, c).
        """
        self._white = self._white @ matrix

    def _across(self, blocks: Array, before: int) -> Array:
        """``L^-1`` times the covariance of the remembered rows with the first of the new ones."""
        n, width = blocks.shape[:2]
        reach = min(n, width - 1)
        covariance = np.zeros((reach, BLOCK, before, BLOCK))
        for i in range(reach):
            for k in range(i + 1, min(width, i + before + 1)):
                covariance[i, :, before + i - k] = blocks[i, k]
        dense = covariance.reshape(reach * BLOCK, before * BLOCK)
        across, _ = lapack.dtrtrs(self._factor, dense.T, lower=1)
        return np.asarray(across)

    def _given_the_past(self, band: Array, rhs: Array, across: Array) -> tuple[Array, Array]:
        """The new rows' covariance and columns, conditioned on the remembered rows."""
        size = across.shape[1]
        explained = across.T @ across
        for k in range(min(size, band.shape[0])):
            band[k, : size - k] -= np.diagonal(explained, -k)
        rhs = rhs.copy()
        rhs[:size] -= across.T @ self._white
        return band, rhs

    def _remember(self, factor: Array, white: Array, across: Array) -> None:
        n = white.shape[0] // BLOCK
        fresh = min(n, self._bandwidth)
        old = min(self._factor.shape[0] // BLOCK, self._bandwidth - fresh) * BLOCK
        triangle = np.zeros((old + fresh * BLOCK, old + fresh * BLOCK))
        triangle[old:, old:] = _trailing_triangle(factor, fresh)
        if old:
            start = self._factor.shape[0] - old
            triangle[:old, :old] = self._factor[start:, start:]
            # Rows are remembered from before only where all the new ones are remembered too.
            triangle[old:, :old] = across[start:].T
        past = self._white[self._white.shape[0] - old :]
        self._white = np.concatenate([past, white[white.shape[0] - fresh * BLOCK :]])
        self._factor = triangle
