# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The log-likelihood of a Gaussian, kept in its parts (``docs/method.md``, section 5)."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LOG_2PI = math.log(2.0 * math.pi)


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
