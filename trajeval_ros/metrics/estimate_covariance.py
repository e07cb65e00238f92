# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimate's own covariance, taken into account (``docs/method.md``, section 5).

With the estimate's error eta (right perturbation, the same body frame) beside the ground truth's
xi, ``eps = Log(Exp(xi) Exp(eta)) = xi + eta`` to first order, and the two are independent: their
covariances add up. Then chi2/dof is the estimator's consistency (NEES), net of the ground truth's
uncertainty. An estimate's covariance says nothing of how its errors correlate in time: they are
taken for independent from pose to pose, which those of odometry are not.
"""

import enum

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# A covariance's smallest eigenvalue may be this far below zero, as a share of its size once scaled
# to a unit diagonal: what single-precision arithmetic and printed digits leave of a singular one.
_INDEFINITE_BELOW = -1e-6


class CovarianceFault(enum.StrEnum):
    """What is wrong with an estimate's covariances."""

    NOT_FINITE = "not_finite"
    ZERO = "zero"
    INDEFINITE = "indefinite"
    """It has a negative eigenvalue, or is not symmetric: it is no covariance."""
    CONSTANT = "constant"
    """Several poses, and all have the same one: a placeholder rather than an estimate."""


def add_estimate_covariance(covariance: Array, estimate_covariance: Array) -> Array:
    """The covariance of ``xi + eta``.

    covariance: the ground truth's, (M, 6, 6), or joint, in block rows (M, p + 1, 6, 6).
    estimate_covariance: (M, 6, 6), right perturbation, in the ground truth's body frame.
    """
    if covariance.ndim == 3:
        return covariance + estimate_covariance
    total = covariance.copy()
    total[:, 0] += estimate_covariance
    return total


def is_indefinite(covariance: Array) -> npt.NDArray[np.bool_]:
    """Which covariances, (M, 6, 6) and finite, are none: asymmetric, or with a negative eigenvalue.

    Returns (M,). Judged with the rows and columns scaled to a unit diagonal, so that metres and
    radians count alike.
    """
    diagonal = np.einsum("mii->mi", covariance)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaled = scale[:, :, None] * covariance * scale[:, None, :]
    asymmetry = np.abs(scaled - scaled.swapaxes(-1, -2)).max(axis=(-1, -2), initial=0.0)
    smallest = np.linalg.eigvalsh(0.5 * (scaled + scaled.swapaxes(-1, -2))).min(
        axis=-1, initial=0.0
    )
    return np.asarray((smallest < _INDEFINITE_BELOW) | (asymmetry > -_INDEFINITE_BELOW))


def covariance_faults(covariance: Array) -> dict[CovarianceFault, int]:
    """How many of an estimate's covariances have which fault. covariance: (M, 6, 6).

    Each counts once, under the first fault in the order of `CovarianceFault`; those without a fault
    not at all.
    """
    finite = np.isfinite(covariance).all(axis=(-1, -2))
    zero = (covariance == 0.0).all(axis=(-1, -2))
    indefinite = np.zeros(len(covariance), dtype=np.bool_)
    indefinite[finite] = is_indefinite(covariance[finite])
    usable = finite & ~zero & ~indefinite
    same = (
        int(usable.sum())
        if usable.sum() > 1 and (covariance[usable] == covariance[usable][0]).all()
        else 0
    )
    counts = {
        CovarianceFault.NOT_FINITE: int((~finite).sum()),
        CovarianceFault.ZERO: int(zero.sum()),
        CovarianceFault.INDEFINITE: int((indefinite & ~zero).sum()),
        CovarianceFault.CONSTANT: same,
    }
    return {fault: count for fault, count in counts.items() if count}
