# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The group SE(3) of rigid motions, over batches of poses.

Conventions (``docs/method.md``, section 1):

- A pose ``T_target_source`` is a (..., 4, 4) matrix, the pose of ``source`` in ``target``.
- A tangent vector ``xi = (rho, phi)``, (..., 6), has the translation first: metres, radians.
- A perturbation stands on the right, ``T Exp(xi)``; a covariance, (..., 6, 6), is that of
  ``xi``, in the body frame, with its rows and columns in the same order.
- A quaternion is (x, y, z, w).

``...`` is any batch shape, also () and (0,). Batch shapes of several arguments broadcast.
Every map is accurate to round-off at the identity, at pure translation, for rotation angles
from zero to pi, and at pi itself. NaN in gives NaN out; only what comes from outside, in
`from_position_quaternion`, is checked.
"""

import functools
import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


# --------------------------------------------------------------------------------------------
# Coefficients
#
# With W = hat(phi), V = hat(rho), theta = |phi|, x = theta^2, every map below is a polynomial
# of degree two in W, because W^3 = -x W:
#
#   Exp(phi)        = I + A W + B W^2       A = sin(theta) / theta
#   J_l(phi)        = I + B W + C W^2       B = (1 - cos(theta)) / theta^2
#                                           C = (theta - sin(theta)) / theta^3
#   J_l(phi)^-1     = I - W/2 + D W^2       D = 1/theta^2 - (1 + cos(theta)) / (2 theta sin(theta))
#
# The SE(3) Jacobian has the derivative of the SO(3) one along rho beside it (see
# `left_jacobian`), which brings in the derivatives B' = (dB/dtheta) / theta = 2 dB/dx,
# likewise C' and D'.
# --------------------------------------------------------------------------------------------
_SERIES_BELOW = 4.0  # [rad^2]
_TERMS = 20


def _with_derivative(series: list[Fraction]) -> tuple[list[Fraction], list[Fraction]]:
    """The coefficients in x of f, and of 2 df/dx."""
    return series[:-1], [2 * k * c for k, c in enumerate(series)][1:]


def _exponential_table() -> Array:
    """The Taylor coefficients in x of A, B, C, B', C'; (_TERMS, 5)."""
    a, b, c = (
        [Fraction((-1) ** k, math.factorial(2 * k + n)) for k in range(_TERMS + 1)]
        for n in (1, 2, 3)
    )
    (b, db), (c, dc) = _with_derivative(b), _with_derivative(c)
    return np.array([a[:-1], b, c, db, dc], dtype=np.float64).T.copy()


def _logarithm_table() -> Array:
    """The Taylor coefficients in x of D, D'; (_TERMS, 2).

    (theta/2) cot(theta/2) = 1 - sum_k |b_2k| x^k / (2k)!, with the Bernoulli numbers b.
    """
    bernoulli = [Fraction(1)]
    for n in range(1, 2 * _TERMS + 3):
        total = sum((math.comb(n + 1, k) * b for k, b in enumerate(bernoulli)), Fraction(0))
        bernoulli.append(-total / (n + 1))
    d = [abs(bernoulli[2 * k + 2]) / math.factorial(2 * k + 2) for k in range(_TERMS + 1)]
    return np.array(_with_derivative(d), dtype=np.float64).T.copy()


_EXPONENTIAL_TABLE = _exponential_table()
_LOGARITHM_TABLE = _logarithm_table()


def _series(x: Array, table: Array) -> Array:
    """The power series in x, (...), of each of the table's columns; (..., columns)."""
    powers = np.ones((*x.shape, table.shape[0]))
    powers[..., 1:] = x[..., None]
    return np.multiply.accumulate(powers, axis=-1) @ table


def _exponential_coefficients(x: Array) -> Array:
    """A, B, C, B', C' at x = theta^2, (...); (..., 5)."""
    small = x < _SERIES_BELOW
    series = _series(np.minimum(x, _SERIES_BELOW), _EXPONENTIAL_TABLE)
    if small.all():
        return series
    x = np.maximum(x, _SERIES_BELOW)
    theta = np.sqrt(x)
    half = 0.5 * theta
    a = np.sin(theta) / theta
    b = 0.5 * (np.sin(half) / half) ** 2
    c = (1.0 - a) / x
    closed = np.stack([a, b, c, (a - 2.0 * b) / x, (b - 3.0 * c) / x], axis=-1)
    return np.where(small[..., None], series, closed)


def _logarithm_coefficients(x: Array) -> Array:
    """D, D' at x = theta^2, (...); (..., 2)."""
    small = x < _SERIES_BELOW
    series = _series(np.minimum(x, _SERIES_BELOW), _LOGARITHM_TABLE)
    if small.all():
        return series
    x = np.maximum(x, _SERIES_BELOW)
    half = 0.5 * np.sqrt(x)
    ratio = half / np.sin(half)
    d = (1.0 - ratio * np.cos(half)) / x
    closed = np.stack([d, ((ratio * ratio - 1.0) / x - d) / x], axis=-1)
    return np.where(small[..., None], series, closed)


# --------------------------------------------------------------------------------------------
# SO(3)
# --------------------------------------------------------------------------------------------
_IDENTITY_3 = np.eye(3)
_IDENTITY_4 = np.eye(4)

# hat(v) = v @ _HAT, reshaped
_HAT = np.zeros((3, 9))
_HAT[[0, 1, 2], [7, 2, 3]] = 1.0
_HAT[[0, 1, 2], [5, 6, 1]] = -1.0


def hat(v: Array) -> Array:
    """The skew-symmetric matrix of a vector: ``hat(v) u = v x u``.

    v: (..., 3). Returns (..., 3, 3).
    """
    return (v @ _HAT).reshape(*v.shape, 3)


def _squared_norm(v: Array) -> Array:
    return np.asarray((v * v).sum(axis=-1))


def exp_so3(phi: Array) -> Array:
    """The rotation by the angle |phi| about phi (Rodrigues' formula).

    phi: rotation vector, (..., 3), radians, any length. Returns (..., 3, 3).
    """
    coefficients = _exponential_coefficients(_squared_norm(phi))
    w = hat(phi)
    a, b = (coefficients[..., k, None, None] for k in (0, 1))
    return _IDENTITY_3 + a * w + b * (w @ w)


def _quaternion_table() -> Array:
    """The linear map from a rotation matrix, as nine numbers, to 4 q q^T - I, as sixteen."""
    table = np.zeros((3, 3, 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        table[i, i, [i, j, k, 3], [i, j, k, 3]] = (1.0, -1.0, -1.0, 1.0)
        table[i, j, [i, j], [j, i]] = 1.0
        table[j, i, [i, j], [j, i]] = 1.0
        table[k, j, [i, 3], [3, i]] = 1.0
        table[j, k, [i, 3], [3, i]] = -1.0
    return table.reshape(9, 16)


_QUATERNION_TABLE = _quaternion_table()


def _quaternion(rotation: Array) -> Array:
    """The unit quaternion (x, y, z, w), w >= 0, of the nearest rotation; (..., 4)."""
    batch = rotation.shape[:-2]
    outer = (rotation.reshape(*batch, 9) @ _QUATERNION_TABLE).reshape(*batch, 4, 4) + _IDENTITY_4
    start = _IDENTITY_4[np.argmax(np.einsum("...ii->...i", outer), axis=-1)]
    q = (outer @ (outer @ start[..., None]))[..., 0]
    norm = np.sqrt(_squared_norm(q))
    return np.asarray(q / np.copysign(norm, q[..., 3])[..., None])


def log_so3(rotation: Array) -> Array:
    """The rotation vector of a rotation, of length at most pi: the inverse of `exp_so3`.

    rotation: (..., 3, 3). Returns (..., 3), radians.
    """
    q = _quaternion(rotation)
    v, w = q[..., :3], q[..., 3]
    sine = np.sqrt(_squared_norm(v))
    zero = sine == 0.0
    factor = np.where(zero, 2.0, 2.0 * np.arctan2(sine, w) / np.where(zero, 1.0, sine))
    return np.asarray(factor[..., None] * v)


# --------------------------------------------------------------------------------------------
# SE(3)
# --------------------------------------------------------------------------------------------
def _pose(rotation: Array, position: Array) -> Array:
    pose = np.zeros((*position.shape[:-1], 4, 4))
    pose[..., :3, :3] = rotation
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1.0
    return pose


def _blocks(diagonal: Array, upper: Array) -> Array:
    """[[diagonal, upper], [0, diagonal]]; (..., 6, 6)."""
    out = np.zeros((*diagonal.shape[:-2], 6, 6))
    out[..., :3, :3] = diagonal
    out[..., :3, 3:] = upper
    out[..., 3:, 3:] = diagonal
    return out


def exp(xi: Array) -> Array:
    """The pose ``Exp(xi)``: ``[[Exp(phi), J_l(phi) rho], [0, 1]]``.

    xi: (..., 6). Returns (..., 4, 4).
    """
    rho, phi = xi[..., :3], xi[..., 3:]
    coefficients = _exponential_coefficients(_squared_norm(phi))
    a, b, c = (coefficients[..., k, None, None] for k in (0, 1, 2))
    w = hat(phi)
    w2 = w @ w
    jacobian = _IDENTITY_3 + b * w + c * w2
    return _pose(_IDENTITY_3 + a * w + b * w2, (jacobian @ rho[..., None])[..., 0])


def log(pose: Array) -> Array:
    """The tangent vector of a pose, with |phi| <= pi: the inverse of `exp`.

    pose: (..., 4, 4). Returns (..., 6).
    """
    phi = log_so3(pose[..., :3, :3])
    d = _logarithm_coefficients(_squared_norm(phi))[..., 0, None, None]
    w = hat(phi)
    inverse_jacobian = _IDENTITY_3 - 0.5 * w + d * (w @ w)
    return np.concatenate([(inverse_jacobian @ pose[..., :3, 3:])[..., 0], phi], axis=-1)


def compose(first: Array, *others: Array) -> Array:
    """The product of poses: ``compose(T_a_b, T_b_c)`` is T_a_c.

    Each: (..., 4, 4). Returns (..., 4, 4).
    """
    return functools.reduce(np.matmul, others, first)


def inverse(pose: Array) -> Array:
    """The inverse ``[[R^T, -R^T t], [0, 1]]``: of T_a_b, T_b_a.

    pose: (..., 4, 4). Returns (..., 4, 4).
    """
    transpose = pose[..., :3, :3].swapaxes(-1, -2)
    return _pose(transpose, -(transpose @ pose[..., :3, 3:])[..., 0])


def adjoint(pose: Array) -> Array:
    """``Ad_T = [[R, hat(t) R], [0, R]]``, for which ``T Exp(xi) = Exp(Ad_T xi) T``.

    pose: (..., 4, 4). Returns (..., 6, 6).
    """
    rotation = pose[..., :3, :3]
    return _blocks(rotation, hat(pose[..., :3, 3]) @ rotation)


def left_jacobian(xi: Array) -> Array:
    """``J_l(xi)``, for which ``Exp(xi + d) = Exp(J_l(xi) d) Exp(xi)`` to first order in d.

    xi: (..., 6). Returns (..., 6, 6).
    """
    rho, phi = xi[..., :3], xi[..., 3:]
    coefficients = _exponential_coefficients(_squared_norm(phi))
    b, c, db, dc = (coefficients[..., k, None, None] for k in (1, 2, 3, 4))
    dot = (rho * phi).sum(axis=-1)[..., None, None]
    w, v = hat(phi), hat(rho)
    w2, wv = w @ w, w @ v
    upper = b * v + c * (wv + wv.swapaxes(-1, -2)) + dot * (db * w + dc * w2)
    return _blocks(_IDENTITY_3 + b * w + c * w2, upper)


def right_jacobian(xi: Array) -> Array:
    """``J_r(xi)``, for which ``Exp(xi + d) = Exp(xi) Exp(J_r(xi) d)`` to first order in d.

    xi: (..., 6). Returns (..., 6, 6).
    """
    return left_jacobian(-xi)


def left_jacobian_inverse(xi: Array) -> Array:
    """``J_l(xi)^-1``, for which ``Log(Exp(d) Exp(xi)) = xi + J_l(xi)^-1 d`` to first order.

    xi: (..., 6). Returns (..., 6, 6).
    """
    rho, phi = xi[..., :3], xi[..., 3:]
    coefficients = _logarithm_coefficients(_squared_norm(phi))
    d, dd = (coefficients[..., k, None, None] for k in (0, 1))
    dot = (rho * phi).sum(axis=-1)[..., None, None]
    w, v = hat(phi), hat(rho)
    w2, wv = w @ w, w @ v
    upper = -0.5 * v + d * (wv + wv.swapaxes(-1, -2)) + dot * dd * w2
    return _blocks(_IDENTITY_3 - 0.5 * w + d * w2, upper)


def right_jacobian_inverse(xi: Array) -> Array:
    """``J_r(xi)^-1``, for which ``Log(Exp(xi) Exp(d)) = xi + J_r(xi)^-1 d`` to first order.

    xi: (..., 6). Returns (..., 6, 6).
    """
    return left_jacobian_inverse(-xi)


def interpolate(pose_a: Array, pose_b: Array, weight: Array | float) -> Array:
    """The pose at ``weight`` on the geodesic from a to b: ``T_a Exp(w Log(T_a^-1 T_b))``.

    pose_a, pose_b: (..., 4, 4). weight: (...), 0 at a and 1 at b. Returns (..., 4, 4).
    """
    step = log(inverse(pose_a) @ pose_b)
    return pose_a @ exp(np.asarray(weight)[..., None] * step)


# --------------------------------------------------------------------------------------------
# ROS
# --------------------------------------------------------------------------------------------
def from_position_quaternion(position: Array, quaternion: Array) -> Array:
    """The pose with a position and an orientation; the quaternion is normalised.

    position: (..., 3), metres. quaternion: (..., 4), (x, y, z, w). Returns (..., 4, 4).

    Raises ValueError where a number is not finite, or a quaternion is zero.
    """
    if not np.isfinite(position).all():
        raise ValueError("a position is not finite")
    if not np.isfinite(quaternion).all():
        raise ValueError("a quaternion is not finite")
    largest = np.abs(quaternion).max(axis=-1, keepdims=True)
    if not (largest > 0.0).all():
        raise ValueError("a quaternion is zero, so it is no orientation")
    scaled = quaternion / largest
    q = scaled / np.sqrt(_squared_norm(scaled))[..., None]
    w = hat(q[..., :3])
    rotation = _IDENTITY_3 + 2.0 * (q[..., 3, None, None] * w + w @ w)
    batch = np.broadcast_shapes(position.shape[:-1], q.shape[:-1])
    return _pose(rotation, np.broadcast_to(position, (*batch, 3)))


def to_position_quaternion(pose: Array) -> tuple[Array, Array]:
    """The position and the unit quaternion (x, y, z, w), w >= 0, of a pose.

    pose: (..., 4, 4). Returns (..., 3) and (..., 4).
    """
    return pose[..., :3, 3].copy(), _quaternion(pose[..., :3, :3])


def _rotate_covariance(covariance: Array, rotation: Array) -> Array:
    both = _blocks(rotation, np.zeros(()))
    return both @ covariance @ both.swapaxes(-1, -2)


def covariance_to_fixed_axes(covariance: Array, pose: Array) -> Array:
    """A covariance of the body frame, as ROS has it: about the fixed axes of the parent frame.

    covariance: (..., 6, 6). pose: (..., 4, 4). Returns ``B covariance B^T``, (..., 6, 6), with
    ``B = blkdiag(R, R)``.
    """
    return _rotate_covariance(covariance, pose[..., :3, :3])


def covariance_from_fixed_axes(covariance: Array, pose: Array) -> Array:
    """A covariance as ROS has it, in the body frame: the inverse of `covariance_to_fixed_axes`.

    covariance: (..., 6, 6). pose: (..., 4, 4). Returns (..., 6, 6).
    """
    return _rotate_covariance(covariance, pose[..., :3, :3].swapaxes(-1, -2))
