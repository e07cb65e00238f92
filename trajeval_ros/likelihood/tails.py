# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tails of the normal, the chi-squared and Student's distribution.

SciPy's functions, loaded when the first is asked: to load them takes as long as a short evaluation.
"""

import math


def normal_tail(x: float) -> float:
    """How often a standard normal number is above x."""
    return 0.5 * math.erfc(x / math.sqrt(2.0))


def chi2_tails(chi2: float, dof: float) -> tuple[float, float]:
    """How often chi2 with ``dof`` > 0 degrees of freedom is below ``chi2`` >= 0, and above."""
    from scipy.special import chdtr, chdtrc

    return float(chdtr(dof, chi2)), float(chdtrc(dof, chi2))


def student_tail(t: float, dof: float) -> float:
    """How often Student's t with ``dof`` degrees of freedom is above t."""
    from scipy.special import stdtr

    return float(stdtr(dof, -t))


def student_quantile(tail: float, dof: float) -> float:
    """The t that Student's is above in so many cases, 0 < ``tail`` < 1."""
    from scipy.special import stdtrit

    return -float(stdtrit(dof, tail))
