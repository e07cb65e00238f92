# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tails of the normal, the chi-squared and Student's distribution.

SciPy's functions, loaded when the first is asked: to load them takes as long as a short evaluation.
What each report needs is a finite sum.
"""

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Poisson's numbers so many standard deviations below are not to be seen in a sum.
_FAR = 12.0
_NEWTON = 8


def normal_tail(x: float) -> float:
    """How often a standard normal number is above x."""
    return 0.5 * math.erfc(x / math.sqrt(2.0))


def chi2_tails(chi2: float, dof: float) -> tuple[float, float]:
    """How often chi2 with ``dof`` > 0 degrees of freedom is below ``chi2`` >= 0, and above."""
    from scipy.special import chdtr, chdtrc

    return float(chdtr(dof, chi2)), float(chdtrc(dof, chi2))


def even_chi2_quantile(dof: Array, normal: float) -> Array:
    """What chi2 is above as often as a standard normal number is above ``normal``; (N,).

    Of an even ``dof`` = 2 m (N,), where it needs none of SciPy's functions: chi2 / 2 is above a as
    often as Poisson's number with the mean a is below m. Newton's method on that sum, from Wilson's
    and Hilferty's cube.
    """
    above = normal_tail(normal)
    m, place = np.unique(0.5 * dof, return_inverse=True)
    spread = 1.0 / (9.0 * m)
    a = m * (1.0 - spread + normal * np.sqrt(spread)) ** 3
    log_factorial = np.array([math.lgamma(each) for each in m.tolist()])
    # Each of Poisson's probabilities, from that of m - 1 down, over the one before: j / a.
    most = float(m.max(initial=0.0))
    j = np.maximum(m[:, None] - 1.0 - np.arange(min(most, _FAR * (1.0 + most**0.5))), 0.0)
    for _ in range(_NEWTON):
        last = np.exp((m - 1.0) * np.log(a) - a - log_factorial)
        below_m = last * (1.0 + np.cumprod(j / a[:, None], axis=1).sum(axis=1))
        a = a + (below_m - above) / last
    return np.asarray(2.0 * a[place])


def student_tail(t: float, dof: float) -> float:
    """How often Student's t with ``dof`` degrees of freedom is above t."""
    from scipy.special import stdtr

    return float(stdtr(dof, -t))


def student_quantile(tail: float, dof: float) -> float:
    """The t that Student's is above in so many cases, 0 < ``tail`` < 1."""
    from scipy.special import stdtrit

    return -float(stdtrit(dof, tail))
