# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The log-likelihood of a Gaussian, kept in its parts (``docs/method.md``, section 5)."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops

Array = npt.NDArray[np.float64]

LOG_2PI = math.log(2.0 * math.pi)

# A symmetric n x n matrix of unit diagonal whose smallest eigenvalue exceeds about n (n + 1) units
# of round-off has a Cholesky factor in floating point too (Higham, Accuracy and Stability of
# Numerical Algorithms, theorem 10.7), in whatever order it is computed: 6 * 7 * 2**-53, and a half.
_CLEARLY_POSITIVE = 2.0**-47

# A covariance's smallest eigenvalue may be this far below zero, as a share of its size once scaled
# to a unit diagonal: what single-precision arithmetic and printed digits leave of a singular one.
_INDEFINITE_BELOW = -1e-6

# A variance (m², rad²) that stands for "not known" in arithmetic that must not overflow.
_TOO_LARGE = 1e100


@dataclass(frozen=True, slots=True)
class GaussianLogLikelihood:
    """``log N(e; 0, V)`` in parts, for ``dof`` residuals ``e``. Values add up with ``+``.

    chi2: ``e^T V^-1 e``.
    log_det: ``log |V|``.
    dof: how many residuals, less how many gauge freedoms were integrated out. It can be negative
    for a part of a sum, never for a whole.
    """

    chi2: float
    log_det: float
    dof: int

    @property
    def log_likelihood(self) -> float:
        """``-1/2 (chi2 + log_det + dof log 2 pi)``, nats."""
        return -0.5 * (self.chi2 + self.log_det + self.dof * LOG_2PI)

    def __add__(self, other: "GaussianLogLikelihood") -> "GaussianLogLikelihood":
        """The joint log-likelihood of two independent residuals."""
        return GaussianLogLikelihood(
            self.chi2 + other.chi2, self.log_det + other.log_det, self.dof + other.dof
        )


NOTHING = GaussianLogLikelihood(0.0, 0.0, 0)
"""The log-likelihood of no residuals at all."""


class CovarianceError(ValueError):
    """A covariance that is not positive definite, or not finite.

    index: of the pose where it was found, the first one, counted from 0 in the batch given.
    """

    def __init__(self, index: int) -> None:
        super().__init__(f"the covariance of pose {index} of the batch is not positive definite")
        self.index = index


def is_indefinite(covariance: Array) -> npt.NDArray[np.bool_]:
    """Which covariances, (M, 6, 6) and finite, are none: asymmetric, or with a negative eigenvalue.

    Or so large that sums and products of them are not finite. Returns (M,). Judged with the rows
    and columns scaled to a unit diagonal, so that metres and radians count alike.
    """
    diagonal = np.einsum("mii->mi", covariance)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    with np.errstate(over="ignore"):
        scaled = scale[:, :, None] * covariance * scale[:, None, :]
    # No correlation is that large, and eigenvalues of what is far larger need not converge.
    absurd = ~((np.abs(scaled) <= 2.0) & (np.abs(covariance) < _TOO_LARGE)).all(axis=(-1, -2))
    scaled[absurd] = 0.0
    asymmetry = np.abs(scaled - scaled.swapaxes(-1, -2)).max(axis=(-1, -2), initial=0.0)
    smallest = np.linalg.eigvalsh(0.5 * (scaled + scaled.swapaxes(-1, -2))).min(
        axis=-1, initial=0.0
    )
    indefinite = (smallest < _INDEFINITE_BELOW) | (asymmetry > -_INDEFINITE_BELOW)
    return np.asarray(absurd | indefinite)


def positive_definite(covariance: Array) -> npt.NDArray[np.bool_]:
    """Which covariances, (M, n, n), are positive definite so clearly that each factorisation works.

    Returns (M,); False for what is not finite.
    """
    if are_positive(covariance):
        return np.ones(len(covariance), dtype=np.bool_)
    diagonal = np.diagonal(covariance, axis1=-2, axis2=-1)
    finite = np.isfinite(covariance).all(axis=(-1, -2))
    good: npt.NDArray[np.bool_] = np.asarray(finite & (diagonal > 0.0).all(axis=-1))
    scale = 1.0 / np.sqrt(diagonal[good])
    scaled = scale[:, :, None] * covariance[good] * scale[:, None, :]
    scaled -= _CLEARLY_POSITIVE * np.eye(covariance.shape[-1])
    try:
        np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        good[good] = [_has_factor(matrix) for matrix in scaled]
    return good


def are_positive(covariance: Array) -> bool:
    """Whether a look in C finds all covariances, (M, 6, 6), clearly positive definite.

    False where it is not sure, or not there.
    """
    if not loops.there() or covariance.shape[1:] != (6, 6):
        return False
    # By more than any other order of the sums could take away.
    least = 2.0 * _CLEARLY_POSITIVE
    return bool(loops.call("all_positive", len(covariance), loops.doubles(covariance), least))


def _has_factor(matrix: Array) -> bool:
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True
