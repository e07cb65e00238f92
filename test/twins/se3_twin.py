# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The maps of `trajeval_ros.se3` as their definitions, one pose at a time, in 60 decimal digits.

Power series of 4x4 and 6x6 matrices of Decimals, summed until nothing changes: no closed form,
no cut-off, no special case, and no rounding that a comparison with float64 could see.
"""

import decimal
import math
from decimal import Decimal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Exact = npt.NDArray[np.object_]

_DIGITS = 60


def exact(values: Array) -> Exact:
    """The same numbers, as Decimals."""
    return np.asarray(np.vectorize(Decimal, otypes=[object])(values))


def _hat(v: Array) -> Array:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def wedge(xi: Array) -> Array:
    """The matrix whose exponential is the pose; (4, 4)."""
    out = np.zeros((4, 4))
    out[:3, :3] = _hat(xi[3:])
    out[:3, 3] = xi[:3]
    return out


def ad(xi: Array) -> Array:
    """The matrix whose exponential is the adjoint of the pose; (6, 6)."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = _hat(xi[3:])
    out[:3, 3:] = _hat(xi[:3])
    return out


def _power_series(matrix: Array, first: int) -> Exact:
    """sum_k matrix^k / (k + first)!, for first = 0 (the exponential) or 1."""
    with decimal.localcontext(prec=_DIGITS):
        m = exact(matrix)
        term = exact(np.eye(len(matrix)))
        total = term
        for k in range(1, 1000):
            term = m @ term / Decimal(k + first)
            previous, total = total, total + term
            if np.array_equal(previous, total):
                return np.asarray(total)
    raise AssertionError("the series does not converge")


def exp(xi: Array) -> Exact:
    """Exp(xi); (4, 4)."""
    return _power_series(wedge(xi), 0)


def left_jacobian(xi: Array) -> Exact:
    """J_l(xi) = sum_k ad^k / (k + 1)!; (6, 6)."""
    return _power_series(ad(xi), 1)


def coefficients(x: float) -> Exact:
    """A, B, C, B', C', D, D' of `trajeval_ros.se3` at the squared angle x > 0; (7,)."""
    # those of D and D' lose their digits as x and x^2 fall, to 1e-48 at an angle of 1e-12
    with decimal.localcontext(prec=2 * _DIGITS):
        square, zero = Decimal(x), Decimal(0)
        values, slopes = [], []
        for n in (1, 2, 3):
            terms = [Decimal((-1) ** k) / math.factorial(2 * k + n) for k in range(60)]
            values.append(sum((c * square**k for k, c in enumerate(terms)), zero))
            derivative = (2 * k * c * square ** (k - 1) for k, c in enumerate(terms) if k)
            slopes.append(sum(derivative, zero))
        a, b, _ = values
        d = (1 - a / (2 * b)) / square
        slope = ((1 / (2 * b) - 1) / square - d) / square
        return np.array([*values, *slopes[1:], d, slope])


def matrix_inverse(matrix: Exact) -> Exact:
    """The inverse, from the float64 one by Newton's iteration, which doubles its digits."""
    with decimal.localcontext(prec=_DIGITS):
        two = exact(2.0 * np.eye(len(matrix)))
        out = exact(np.linalg.inv(matrix.astype(np.float64)))
        for _ in range(4):
            out = out @ (two - matrix @ out)
    return out


def distance(actual: Array, expected: Exact) -> Array:
    """|actual - expected|, each element rounded only in the end."""
    with decimal.localcontext(prec=_DIGITS):
        return np.asarray(abs(exact(actual) - expected).astype(np.float64))
