# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A block-tridiagonal information matrix: its factor, and the covariances beside it.

Λ has m rows a pose; its blocks beside the diagonal join neighbouring poses. With ``Λ = L Lᵀ`` the
blocks of ``S = Λ⁻¹`` that are where Λ has some are what is known of a pose from both sides, less
what is counted twice, with L' the factor of the poses in reverse order:

    S_ii = (L_ii L_iiᵀ + L'_ii L'_iiᵀ - Λ_ii)⁻¹,   S_(i+1,i) = -S_(i+1,i+1) L_(i+1,i) L_ii⁻¹.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Factor:
    """L of n poses with m rows each, in LAPACK's lower band storage."""

    band: Array
    size: int

    @staticmethod
    def of(diagonal: Array, below: Array) -> Factor:
        """The factor. diagonal: (n, m, m); below: blocks (i + 1, i), (n - 1, m, m).

        Raises numpy.linalg.LinAlgError where the matrix is not positive definite.
        """
        band = _banded(diagonal, below)
        factor, info = lapack.dpbtrf(band, lower=1, overwrite_ab=1)
        if info != 0 or not np.isfinite(factor[0]).all():
            raise np.linalg.LinAlgError("the information matrix is not positive definite")
        return Factor(np.asarray(factor), diagonal.shape[1])

    @property
    def log_det(self) -> float:
        """``log |Λ|``."""
        return 2.0 * float(np.log(self.band[0]).sum())

    def forward(self, columns: Array) -> Array:
        """``L⁻¹ X`` of X (n, m, c)."""
        flat = columns.reshape(-1, columns.shape[-1])
        solution, _ = lapack.dtbtrs(self.band, flat, uplo="L")
        return np.ascontiguousarray(solution).reshape(columns.shape)

    def backward(self, columns: Array) -> Array:
        """``L⁻ᵀ X`` of X (n, m, c)."""
        flat = columns.reshape(-1, columns.shape[-1])
        solution, _ = lapack.dtbtrs(self.band, flat, uplo="L", trans="T")
        return np.ascontiguousarray(solution).reshape(columns.shape)

    def blocks(self) -> tuple[Array, Array]:
        """``L_ii`` (n, m, m) and ``L_(i+1,i)`` (n - 1, m, m)."""
        size, height = self.size, 2 * self.size
        columns = np.ascontiguousarray(self.band.T).reshape(-1, size, height)
        own, below = np.zeros((len(columns), size, size)), np.zeros((len(columns), size, size))
        for c in range(size):
            own[:, c:, c] = columns[:, c, : size - c]
            below[:, :, c] = columns[:, c, size - c : height - c]
        return own, below[:-1]

    def covariances(self, diagonal: Array, below: Array) -> tuple[Array, Array]:
        """``S_ii`` (n, m, m) and ``S_(i+1,i)`` (n - 1, m, m), of what this is the factor of."""
        own, beside = self.blocks()
        reverse, _ = Factor.of(diagonal[::-1], np.swapaxes(below, 1, 2)[::-1]).blocks()
        known = own @ np.swapaxes(own, 1, 2) - diagonal
        known += (reverse @ np.swapaxes(reverse, 1, 2))[::-1]
        found: Array = np.asarray(np.linalg.inv(known), np.float64)
        gains = np.asarray(beside @ np.linalg.inv(own[:-1]), np.float64)
        return found, np.asarray(-found[1:] @ gains)


def _banded(diagonal: Array, below: Array) -> Array:
    """Blocks (n, m, m) and those below them, (n - 1, m, m), in LAPACK's lower band storage."""
    count, size = diagonal.shape[:2]
    height = 2 * size
    columns = np.zeros((count, size, height))
    for c in range(size):
        columns[:, c, : size - c] = diagonal[:, c:, c]
        columns[:-1, c, size - c : height - c] = below[:, :, c]
    return columns.reshape(-1, height).T
