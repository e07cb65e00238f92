# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Cholesky factor of a joint covariance whose bandwidth only the data tell.

The covariance V of a sequence of 6-vectors is given pose by pose: its own block, and its blocks
with the p poses just before it, oldest first, with which alone it is correlated. p differs from
pose to pose, and grows by one at the most, so the row of the factor L, ``V = L L^T``, reaches as
far back as that of V, and the rows further back can be forgotten.

It is factored once, and the rows of L serve every figure. Each row is computed on its own, by
calls whose shapes depend on p alone: the digits do not depend on how the sequence is cut into
batches, however nearly singular V is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack
from trajeval_ros.likelihood.gaussian import CovarianceError

Array = npt.NDArray[np.float64]

_BLOCK = 6


@dataclass(frozen=True, slots=True)
class FactorRows:
    """Consecutive block rows of V's Cholesky factor L.

    own: V_ii, (n, 6, 6).
    across: for each row L's blocks before the diagonal one, oldest first, transposed, (6 p, 6).
    inverse: ``L_ii^-1``, (n, 6, 6).
    log_dets: each row's share of ``log |V|``, (n,).
    """

    own: Array
    across: tuple[Array, ...]
    inverse: Array
    log_dets: Array

    @staticmethod
    def none() -> FactorRows:
        """No rows."""
        return FactorRows(np.zeros((0, 6, 6)), (), np.zeros((0, 6, 6)), np.zeros(0))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.own)

    def __getitem__(self, index: slice) -> FactorRows:
        """Return consecutive rows."""
        return FactorRows(
            self.own[index], self.across[index], self.inverse[index], self.log_dets[index]
        )

    def __add__(self, later: FactorRows) -> FactorRows:
        """Return these rows and the ``later`` ones."""
        return FactorRows(
            np.concatenate([self.own, later.own]),
            self.across + later.across,
            np.concatenate([self.inverse, later.inverse]),
            np.concatenate([self.log_dets, later.log_dets]),
        )

    @property
    def log_det(self) -> float:
        """``log |V|``, given what is before these rows."""
        return float(self.log_dets.sum())

    def whiten(self, columns: Array) -> Array:
        """``L^-1 X`` of a whole sequence. columns: X, (n, 6, c) or (n, 6). Returns (6 n, c)."""
        columns = columns.reshape(len(self), _BLOCK, -1)
        return self.whiten_after(np.zeros((0, columns.shape[-1])), columns)

    def whiten_after(self, before: Array, columns: Array) -> Array:
        """``L^-1 X`` of these rows. before: that of the rows they reach back to, (6 m, c).

        columns: X, (n, 6, c). Returns (6 n, c).
        """
        start = len(before)
        white = np.concatenate([before, np.empty((_BLOCK * len(self), columns.shape[-1]))])
        # Each row needs those before: inherently sequential.
        for across, inverse, column in zip(self.across, self.inverse, columns, strict=True):
            end = start + _BLOCK
            white[start:end] = inverse @ (column - across.T @ white[start - len(across) : start])
            start = end
        return np.asarray(white[len(before) :])

    @property
    def kept(self) -> int:
        """How many of these rows and of those before the next row may reach back to."""
        return len(self.across[-1]) // _BLOCK + 1 if self.across else 0


class JointFactor:
    """Factors a joint covariance that arrives batch by batch; owns the rows the next may need."""

    def __init__(self) -> None:
        """Start without rows."""
        # The triangle, in a buffer with room to grow: of its columns [start, end) are remembered.
        self._buffer = np.zeros((1, 0)).T
        self._start = self._end = 0

    def update(self, covariance: Array, cross: Sequence[Array]) -> FactorRows:
        """The next rows.

        covariance: of each pose, (n, 6, 6).
        cross: for each pose, (p, 6, 6), the covariance ``E[xi_j xi_i^T]`` of each of the p poses j
        just before with it, pose i, oldest first.

        Raises CovarianceError where V is not positive definite or not finite, and ValueError where
        a pose is correlated with one that the pose before it was not; the state then stays as it
        was.
        """
        n = len(covariance)
        before = self._buffer, self._start, self._end
        across: list[Array] = []
        inverse = np.empty((n, _BLOCK, _BLOCK))
        try:
            for i, (own, blocks) in enumerate(zip(covariance, cross, strict=True)):
                row, lower = self._factor_row(own, blocks.reshape(-1, _BLOCK), i)
                across.append(row)
                inverse[i], _ = lapack.dtrtri(lower, lower=1)
        except ValueError:
            # Nothing is written over what was remembered before.
            self._buffer, self._start, self._end = before
            raise
        log_dets = -2.0 * np.log(np.diagonal(inverse, axis1=1, axis2=2)).sum(axis=-1)
        return FactorRows(covariance, tuple(across), inverse, log_dets)

    def _factor_row(self, own: Array, blocks: Array, index: int) -> tuple[Array, Array]:
        """Add the row of the factor: return its (6 p, 6) across, and its diagonal block."""
        size = len(blocks)
        if size > self._end - self._start:
            raise ValueError("a pose is correlated with one that the pose before it was not")
        start = self._end - size
        row = blocks
        if size:
            row, _ = lapack.dtrtrs(self._triangle(start), blocks, lower=1)
        lower, wrong = lapack.dpotrf(own - row.T @ row, lower=1)
        # LAPACK lets NaN through.
        if wrong or not np.isfinite(lower[5, 5]):
            raise CovarianceError(index)
        self._start = start
        self._append(row, lower)
        return row, lower

    def _triangle(self, start: int) -> Array:
        """The factor from row ``start`` on, in place: LAPACK is told the buffer's own stride."""
        height = len(self._buffer)
        columns = self._end - start
        flat = self._buffer.T.reshape(-1)
        first = start * (height + 1)
        return flat[first : first + height * columns].reshape(columns, height).T

    def _append(self, row: Array, lower: Array) -> None:
        size, height = len(row), len(self._buffer)
        if self._end + _BLOCK > height:
            # A quarter more than is remembered: moving it is rare, and the buffer small. One more
            # column, as `_triangle` reads whole columns.
            room = max(64 * _BLOCK, (size + size // 4) // _BLOCK * _BLOCK + 16 * _BLOCK)
            buffer = np.zeros((room + 1, room)).T
            here = slice(self._start, self._end)
            buffer[:size, :size] = self._buffer[here, here]
            self._buffer, self._start, self._end = buffer, 0, size
        stop = self._end + _BLOCK
        self._buffer[self._end : stop, self._start : self._end] = row.T
        self._buffer[self._end : stop, self._end : stop] = lower
        self._end = stop
