# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a log-likelihood says, in figures a person can use (``docs/method.md``, section 5)."""

import math
from typing import NamedTuple

from trajeval_ros.likelihood.gaussian import GaussianLogLikelihood
from trajeval_ros.likelihood.tails import chi2_tails

# The exponential of less than minus this is zero as a double.
_UNDERFLOW = 750.0


class Figures(NamedTuple):
    """A log-likelihood's figures; those without a meaning for it are None.

    chi2_per_dof: near 1 where the estimate cannot be told from the ground truth. None with no
    degree of freedom.
    deviations: its square root, how many standard deviations of the ground truth an error is worth.
    nats_per_pose: the log-likelihood divided by the number of poses. None without a pose.
    """

    chi2_per_dof: float | None
    deviations: float | None
    nats_per_pose: float | None


def p_value(chi2: float, dof: int) -> float:
    """The two-sided p-value of chi2 with ``dof`` > 0 degrees of freedom.

    How often a perfect estimate would have a chi2 as far out as this, on either side: twice the
    smaller tail, uniform on [0, 1] where the residuals are drawn from their covariance. Near zero
    for an estimate that is worse than the ground truth; but also where chi2 is too small: the
    covariance is then too large.
    """
    ratio = max(chi2, 0.0) / dof
    # Chernoff's bound of the smaller tail. Of most runs even that is below any double, and SciPy
    # need not be loaded to say so.
    if ratio == 0.0 or 0.5 * dof * (ratio - 1.0 - math.log(ratio)) > _UNDERFLOW:
        return 0.0
    return min(1.0, 2.0 * min(chi2_tails(chi2, dof)))


def p_value_of(likelihood: GaussianLogLikelihood | None) -> float | None:
    """The p-value of a log-likelihood's chi2; None with no degree of freedom."""
    if likelihood is None or likelihood.dof <= 0:
        return None
    return p_value(likelihood.chi2, likelihood.dof)


def figures(likelihood: GaussianLogLikelihood, poses: int) -> Figures:
    """The figures of the log-likelihood of so many poses."""
    # Round-off may leave a chi2 of zero below it.
    chi2, dof = max(likelihood.chi2, 0.0), likelihood.dof
    ratio = chi2 / dof if dof > 0 else None
    return Figures(
        chi2_per_dof=ratio,
        deviations=None if ratio is None else math.sqrt(ratio),
        nats_per_pose=likelihood.log_likelihood / poses if poses > 0 else None,
    )
