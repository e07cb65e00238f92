# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What poses that are independent of each other say of their alignment, by a loop in C.

The same as `search.Problem` has of a `band.BandFactor`, without room for each pose.
"""

from __future__ import annotations

from typing import TypeGuard

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.alignment.gauge import Gauge, Similarity
from trajeval_ros.likelihood.gaussian import CovarianceError
from trajeval_ros.likelihood.information import Information
from trajeval_ros.likelihood.joint import FactorRows

Array = npt.NDArray[np.float64]


def absorbed(
    information: Information,
    poses: tuple[Array, Array, Array],
    alignment: Similarity,
    gauge: Gauge,
    centre: Array,
) -> Information:
    """``information`` on a perturbation of the alignment, and that of the poses' residuals.

    poses: ground truth (M, 4, 4), estimate (M, 4, 4) and covariances (M, 6, 6). centre: of the
    perturbations, (3,).

    Raises CovarianceError where a covariance is not positive definite, ValueError where a pose is
    not finite.
    """
    triangle = _triangle(information)
    free = np.array(gauge.free, dtype=np.int64)
    _, log_det = _through(poses, alignment, centre, free, triangle)
    return _grown(information, triangle, log_det, len(poses[0]))


def absorbed_columns(information: Information, covariance: Array, columns: Array) -> Information:
    """``information``, and that of the residuals ``J x + r``.

    covariance: of the residuals of each pose, (M, 6, 6). columns: ``[J r]``, (M, 6, d + 1), d < 8.

    Raises CovarianceError where a covariance is not positive definite.
    """
    triangle, log_det = _triangle(information), np.zeros(1)
    given = loops.doubles(covariance), loops.doubles(columns)
    wrong = loops.call("absorb_whitened", len(columns), len(triangle), *given, triangle, log_det)
    if wrong:
        raise CovarianceError(wrong - 1)
    return _grown(information, triangle, float(log_det[0]), len(columns))


def _triangle(information: Information) -> Array:
    """Its root and offset, with room for what no unknowns explain, (d + 1, d + 1)."""
    d = information.dimension
    triangle = np.zeros((d + 1, d + 1))
    triangle[:d, :d], triangle[:d, d] = information.root, information.offset
    return triangle


def _grown(information: Information, triangle: Array, log_det: float, poses: int) -> Information:
    """What has become of it by so many poses."""
    d = information.dimension
    return Information(
        triangle[:d, :d],
        triangle[:d, d],
        information.chi2 + float(triangle[d, d]) ** 2,
        information.log_det + log_det,
        information.count + 6 * poses,
    )


def is_for_loops(blocks: Array | FactorRows) -> TypeGuard[Array]:
    """Whether block rows are of poses independent of each other, and the loops are there."""
    return loops.there() and not isinstance(blocks, FactorRows) and blocks.shape[1] == 1


def chi2(poses: tuple[Array, Array, Array], alignment: Similarity) -> float:
    """``eps^T V^-1 eps`` of the poses' residuals; arguments and errors as of `absorbed`."""
    found, _ = _through(poses, alignment, np.zeros(3), None, np.empty(0))
    return found


def _through(
    poses: tuple[Array, Array, Array],
    alignment: Similarity,
    centre: Array,
    free: npt.NDArray[np.int64] | None,
    triangle: Array,
) -> tuple[float, float]:
    """Chi2 and log-determinant; the triangle takes the poses' rows in."""
    sums = np.zeros(2)
    wrong = loops.call(
        "absolute",
        len(poses[0]),
        *map(loops.doubles, poses),
        loops.doubles(alignment.pose),
        float(alignment.scale),
        loops.doubles(centre),
        np.empty(0, dtype=np.int64) if free is None else free,
        -1 if free is None else len(free),
        se3.LOGARITHM_TABLE,
        len(se3.LOGARITHM_TABLE),
        triangle,
        sums,
    )
    if wrong > 0:
        raise CovarianceError(wrong - 1)
    if wrong:
        raise ValueError("a pose is not finite")
    return float(sums[0]), float(sums[1])
