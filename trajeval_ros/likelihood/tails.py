# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tails of the normal, the chi-squared and Student's distribution, to some 1e-11 of themselves.

A few numbers a run, for which SciPy's hundreds of functions take long to load. By series and
continued fractions (Abramowitz and Stegun, 6.5.29, 6.5.31, 26.5.8), which converge within a few
times the square root of the degrees of freedom.
"""

import math
from collections.abc import Iterator

_EPSILON = 2.0**-53
_TINY = 1e-300


def normal_tail(x: float) -> float:
    """How often a standard normal number is above x."""
    return 0.5 * math.erfc(x / math.sqrt(2.0))


def chi2_tails(chi2: float, dof: float) -> tuple[float, float]:
    """How often chi2 with ``dof`` > 0 degrees of freedom is below ``chi2`` >= 0, and above."""
    a, x = 0.5 * dof, 0.5 * chi2
    if x == 0.0:
        return 0.0, 1.0
    if math.isinf(x):
        return 1.0, 0.0
    density = math.exp(_log_gamma_density(a, x))
    if x < a + 1.0:
        term = total = 1.0 / a
        while term > _EPSILON * total:
            a += 1.0
            term *= x / a
            total += term
        below = min(density * total, 1.0)
        return below, 1.0 - below
    above = min(density / _fraction(x + 1.0 - a, _of_gamma(a, x)), 1.0)
    return 1.0 - above, above


def student_tail(t: float, dof: float) -> float:
    """How often Student's t with ``dof`` >= 1 degrees of freedom is above t >= 0."""
    square = t * t
    return 0.5 * _beta(0.5 * dof, 0.5, dof / (dof + square), square / (dof + square))


def student_quantile(tail: float, dof: float) -> float:
    """The t > 0 that Student's is above in so many cases, ``tail`` < 1/2.

    Newton's method on the tail's logarithm over that of t: concave, so that after the first step
    it goes one way.
    """
    log_t = 0.0
    scale = -_log_beta_of_half(0.5 * dof) - 0.5 * math.log(dof)
    for _ in range(100):
        t = math.exp(log_t)
        above = student_tail(t, dof)
        log_density = scale - 0.5 * (dof + 1.0) * math.log1p(t * t / dof)
        step = math.log(above / tail) * above / math.exp(log_density + log_t)
        # The first may lead to where the tail is zero to a double.
        log_t += min(step, 2.0)
        if abs(step) < 4.0 * _EPSILON:
            break
    return math.exp(log_t)


def _log_gamma_density(a: float, x: float) -> float:
    """``log(x^a exp(-x) / Gamma(a))``."""
    if a < 20.0:
        return a * math.log(x) - x - math.lgamma(a)
    # The difference of large numbers would keep few digits: by Stirling's series (6.1.41).
    away, y = x / a - 1.0, 1.0 / (a * a)
    log_ratio = math.log1p(away) if abs(away) < 0.5 else math.log(x / a)
    rest = (1.0 / 12.0 - (1.0 / 360.0 - (1.0 / 1260.0 - y / 1680.0) * y) * y) / a
    return a * (log_ratio - away) + 0.5 * math.log(a / (2.0 * math.pi)) - rest


def _log_beta_of_half(a: float) -> float:
    """``log B(a, 1/2)``."""
    if a < 20.0:
        ratio = math.lgamma(a + 0.5) - math.lgamma(a)
    else:
        # Of large ones the difference would keep few digits (6.1.47).
        x = 1.0 / (a * a)
        ratio = 0.5 * math.log(a) - (0.125 - (1.0 / 192.0 - (1.0 / 640.0 - x / 843.0) * x) * x) / a
    return 0.5 * math.log(math.pi) - ratio


def _beta(a: float, b: float, x: float, rest: float) -> float:
    """The regularized incomplete beta function of a and b, the smaller of which is 1/2, at x.

    ``rest`` = 1 - x.
    """
    if x == 0.0 or rest == 0.0:
        return float(rest == 0.0)
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - _beta(b, a, rest, x)
    log_density = a * _log(x, rest) + b * _log(rest, x) - _log_beta_of_half(max(a, b))
    return math.exp(log_density) / (a * _fraction(1.0, _of_beta(a, b, x)))


def _log(x: float, rest: float) -> float:
    """``log x`` to all digits, near 1 too, where ``rest`` = 1 - x has more of them."""
    return math.log(x) if x < 0.5 else math.log1p(-rest)


def _of_gamma(a: float, x: float) -> Iterator[tuple[float, float]]:
    n, below = 1.0, x + 3.0 - a
    while True:
        yield -n * (n - a), below
        n += 1.0
        below += 2.0


def _of_beta(a: float, b: float, x: float) -> Iterator[tuple[float, float]]:
    m = 0.0
    while True:
        yield -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0)), 1.0
        m += 1.0
        yield m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m)), 1.0


def _fraction(first: float, terms: Iterator[tuple[float, float]]) -> float:
    """``first + a1 / (b1 + a2 / (b2 + ...))`` of the (a, b), by Lentz's method."""
    value = first or _TINY
    up, down = value, 0.0
    for a, b in terms:
        down = 1.0 / ((b + a * down) or _TINY)
        up = (b + a / up) or _TINY
        value *= up * down
        if abs(up * down - 1.0) <= 2.0 * _EPSILON:
            break
    return value
