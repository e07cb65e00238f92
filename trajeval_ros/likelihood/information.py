# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gaussian residuals that are affine in a few unknowns, summed in square-root information form."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.likelihood.gaussian import GaussianLogLikelihood

Array = npt.NDArray[np.float64]

# Columns that the loop in C takes.
_WIDEST = 8


@dataclass(frozen=True, slots=True)
class Information:
    """What the residuals ``J x + r ~ N(0, V)`` say about d unknowns x.

    ``(J x + r)^T V^-1 (J x + r) = |root x + offset|^2 + chi2``.

    root: (d, d), upper triangular; ``root^T root = J^T V^-1 J`` is the information on x.
    offset: (d,).
    chi2: what no x explains, ``min_x (J x + r)^T V^-1 (J x + r)``.
    log_det: ``log |V|``.
    count: the number of residuals.

    It is built by orthogonal transformations alone: no difference of large numbers is ever taken.
    """

    root: Array
    offset: Array
    chi2: float
    log_det: float
    count: int

    @staticmethod
    def none(dimension: int) -> "Information":
        """No residuals, on so many unknowns."""
        return Information(np.zeros((dimension, dimension)), np.zeros(dimension), 0.0, 0.0, 0)

    @property
    def dimension(self) -> int:
        """The number of unknowns."""
        return len(self.offset)

    def leading(self, dimension: int) -> "Information":
        """The same on the first unknowns, the others being held at zero."""
        held = self.offset[dimension:]
        return Information(
            self.root[:dimension, :dimension],
            self.offset[:dimension],
            self.chi2 + float(held @ held),
            self.log_det,
            self.count,
        )

    def absorb(self, columns: Array, log_det: float) -> "Information":
        """The sum with more residuals, whitened.

        columns: ``L^-1 [J r]`` with ``V = L L^T``, (m, d + 1). log_det: ``log |V|`` of these.
        """
        dimension = len(self.offset)
        stacked = np.zeros((dimension + max(len(columns), 1), dimension + 1))
        stacked[:dimension, :dimension], stacked[:dimension, dimension] = self.root, self.offset
        stacked[dimension : dimension + len(columns)] = columns
        triangle = _triangle(stacked)
        return Information(
            triangle[:dimension, :dimension],
            triangle[:dimension, dimension],
            self.chi2 + float(triangle[dimension, dimension]) ** 2,
            self.log_det + log_det,
            self.count + len(columns),
        )

    def change(self, matrix: Array, shift: Array) -> "Information":
        """The same in other unknowns x', where ``x = matrix x' + shift``.

        matrix: (d, d). shift: (d,).
        """
        dimension = len(self.offset)
        columns = np.concatenate(
            [self.root @ matrix, (self.root @ shift + self.offset)[:, None]], axis=1
        )
        changed = Information.none(dimension).absorb(columns, self.log_det)
        return Information(
            changed.root, changed.offset, self.chi2 + changed.chi2, self.log_det, self.count
        )

    def optimum(self) -> Array:
        """The x that explains the residuals best, (d,).

        Raises LinAlgError where it is not unique.
        """
        if not np.diagonal(self.root).all():
            raise np.linalg.LinAlgError("the residuals do not determine the unknowns")
        if len(self.offset) == 0:
            return np.zeros(0)
        # Of a triangle it is the substitution alone.
        return -np.asarray(np.linalg.solve(self.root, self.offset))

    def covariance(self) -> Array:
        """The covariance of x, (d, d). Raises LinAlgError where the information is singular."""
        inverse = np.linalg.inv(self.root)
        return inverse @ inverse.T

    def integral(self) -> GaussianLogLikelihood:
        """``log of the integral over x of N(J x + r; 0, V)``: d degrees of freedom fewer.

        Raises LinAlgError where it diverges, the residuals not determining x.
        """
        diagonal = np.abs(np.diagonal(self.root))
        if not diagonal.all():
            raise np.linalg.LinAlgError("the residuals do not determine the unknowns")
        return GaussianLogLikelihood(
            self.chi2,
            self.log_det + 2.0 * float(np.log(diagonal).sum()),
            self.count - len(self.offset),
        )


def _triangle(stacked: Array) -> Array:
    """The upper triangle R with ``R^T R = A^T A``. stacked: A, (m, n), which may be overwritten."""
    wide = stacked.shape[1]
    if loops.there() and wide <= _WIDEST:
        loops.call("sums_triangle", len(stacked), wide, stacked)
        return stacked[:wide].copy()
    # NumPy's annotation leaves out that mode="r" returns an array alone.
    return np.asarray(np.linalg.qr(stacked, mode="r"))
