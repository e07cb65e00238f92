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
`from_position_quaternion`, is checked. A map is a loop in C where that was built, in a
fifth of NumPy's time.
"""

import functools
import math
import operator
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops

Array = npt.NDArray[np.float64]
Map = Callable[[Array], Array]


# --------------------------------------------------------------------------------------------
# Coefficients
#
# With W = hat(phi), theta = |phi| and x = theta^2, W^3 = -x W, so every map on SO(3) is a
# quadratic in W:
#
#   Exp(phi)    = I + A W + B W^2      A = sin(theta) / theta
#   J_l(phi)    = I + B W + C W^2      B = (1 - cos(theta)) / theta^2
#                                      C = (theta - sin(theta)) / theta^3
#   J_l^-1(phi) = I - W/2 + D W^2      D = 1/theta^2 - (1 + cos(theta)) / (2 theta sin(theta))
#
# The maps on SE(3) are the same functions of ad_xi = [[W, hat(rho)], [0, W]]. Its upper right
# block is to W as a derivative is to its value, so theirs is the derivative along rho of the
# quadratic in W, and holds also B' = (dB/dtheta) / theta = 2 dB/dx, C' and D'. (Barfoot, State
# Estimation for Robotics, section 7.1.5, has it as a sum of four products, the block Q; his
# coefficients are C, (C - B') / 2 and -C' / 2, and it is the same matrix.)
#
# How they are computed, with u = 2^-53 = 1.1e-16. A and B have no cancellation, with
# B = (sin(theta/2) / (theta/2))^2 / 2. The others are, each from those before it,
#
#   C  = (1 - A) / x                   B' = (A - 2 B) / x
#   D  = (1 - r cos(theta/2)) / x      C' = (B - 3 C) / x
#                                      D' = ((r^2 - 1) / x - D) / x     r = (theta/2)/sin(theta/2)
#
# which is one division by x, where the textbook forms divide by theta^4 or theta^5. Rounding
# leaves a few u in each numerator of order one. Relative to the values at zero, which are 1/6,
# 1/12, -1/12, -1/60, 1/360, that is about 6 u/x in C, 12 u/x in B' and D, 60 u/x in C' and
# 360 u/x in D'. Below x = 4 the Taylor series serve instead. There, after 12 terms, those of A,
# B, C, B', C' alternate with a first omitted term below 4^12/25! = 1e-18 of A, and less of the
# others (after 11 terms: 2e-16 of A). Those of D and D' converge as (x / 4 pi^2)^k, for
# x = 4 as 0.10^k; after 18 terms the tail is less than 3e-17 of D' (after 17: 2e-16). So no
# truncation shows, and 360 u/4 = 1e-14 in D', whose term is the smallest of its sum, is the
# worst that cancellation does.
# --------------------------------------------------------------------------------------------
_SERIES_BELOW = 4.0  # [rad^2]
_EXPONENTIAL_TERMS = 12
_LOGARITHM_TERMS = 18


def _taylor_table(*columns: list[float]) -> Array:
    """Taylor coefficients in x, one function a column; (terms, columns)."""
    return np.array(columns, dtype=np.float64).T.copy()


def _double_derivative(series: list[float]) -> list[float]:
    """The Taylor coefficients of 2 df/dx."""
    return [2 * k * coefficient for k, coefficient in enumerate(series)][1:]


def _exponential_table() -> Array:
    """The Taylor coefficients of A, B, C, B', C'."""
    a, b, c = (
        [(-1) ** k / math.factorial(2 * k + n) for k in range(_EXPONENTIAL_TERMS + 1)]
        for n in (1, 2, 3)
    )
    return _taylor_table(a[:-1], b[:-1], c[:-1], _double_derivative(b), _double_derivative(c))


def cotangent_series(terms: int) -> list[float]:
    """The Taylor coefficients of D: ``1 - x D = (theta/2) cot(theta/2)`` with x = theta^2.

    That is ``1 - sum_k |b_2k| x^k / (2k)!``, with Bernoulli's numbers b. They come from the whole
    tangent numbers t (Knuth and Buckholtz, 1967): ``|b_2k| = 2k t_k / (4^k (4^k - 1))``.
    """
    tangent = [math.factorial(k) for k in range(terms)]
    for k in range(1, terms):
        for j in range(k, terms):
            tangent[j] = (j - k) * tangent[j - 1] + (j - k + 2) * tangent[j]
    return [
        2 * k * t / (4**k * (4**k - 1) * math.factorial(2 * k))
        for k, t in enumerate(tangent, start=1)
    ]


def _logarithm_table() -> Array:
    """The Taylor coefficients of D, D'."""
    d = cotangent_series(_LOGARITHM_TERMS + 1)
    return _taylor_table(d[:-1], _double_derivative(d))


LOGARITHM_TABLE = _logarithm_table()
"""The Taylor coefficients in |phi|^2 of D, D', of `log` and `left_jacobian_inverse`; (terms, 2)."""
EXPONENTIAL_TABLE = _exponential_table()
"""The same of A, B, C, B', C', of `exp` and `left_jacobian`; (terms, 5)."""


def _looped(
    name: str, given: tuple[int, ...], found: tuple[int, ...], table: Array | None = None
) -> Callable[[Map], Map]:
    """Where it was built, the loop of this name in place of a map (..., *given) -> (..., *found).

    table: of the series that it is given.
    """
    tables = () if table is None else (table, len(table))

    def replaced(by_numpy: Map) -> Map:
        @functools.wraps(by_numpy)
        def mapped(values: Array, /) -> Array:
            split = values.ndim - len(given)
            if not loops.there() or values.shape[split:] != given:
                return by_numpy(values)
            batch = values.shape[:split]
            result = np.empty(batch + found)
            values = np.ascontiguousarray(values, dtype=np.float64)
            loops.call(name, values, result, math.prod(batch), *tables)
            return result

        return mapped

    return replaced


def _taylor(x: Array, table: Array) -> Array:
    """The sums of the series in a table at x, (...); (..., columns)."""
    powers = np.ones((*x.shape, len(table)))
    powers[..., 1:] = x[..., None]
    return np.multiply.accumulate(powers, axis=-1) @ table


def _columns(values: Array) -> tuple[Array, ...]:
    """The columns of (..., n), each to multiply matrices by; n times (..., 1, 1)."""
    return tuple(values[..., k, None, None] for k in range(values.shape[-1]))


def _exponential_coefficients(x: Array) -> tuple[Array, ...]:
    """A, B, C, B', C' at x = |phi|^2, (...); each (..., 1, 1)."""
    small = x < _SERIES_BELOW
    series = _taylor(np.minimum(x, _SERIES_BELOW), EXPONENTIAL_TABLE)
    if small.all():
        return _columns(series)
    x = np.maximum(x, _SERIES_BELOW)
    theta = np.sqrt(x)
    half = 0.5 * theta
    a = np.sin(theta) / theta
    b = 0.5 * (np.sin(half) / half) ** 2
    c = (1.0 - a) / x
    closed = np.stack([a, b, c, (a - 2.0 * b) / x, (b - 3.0 * c) / x], axis=-1)
    return _columns(np.where(small[..., None], series, closed))


def _logarithm_coefficients(x: Array) -> tuple[Array, ...]:
    """D, D' at x = |phi|^2, (...); each (..., 1, 1)."""
    small = x < _SERIES_BELOW
    series = _taylor(np.minimum(x, _SERIES_BELOW), LOGARITHM_TABLE)
    if small.all():
        return _columns(series)
    x = np.maximum(x, _SERIES_BELOW)
    half = 0.5 * np.sqrt(x)
    ratio = half / np.sin(half)
    d = (1.0 - ratio * np.cos(half)) / x
    closed = np.stack([d, ((ratio * ratio - 1.0) / x - d) / x], axis=-1)
    return _columns(np.where(small[..., None], series, closed))


# --------------------------------------------------------------------------------------------
# Rotations
# --------------------------------------------------------------------------------------------
_IDENTITY_3 = np.eye(3)
_IDENTITY_4 = np.eye(4)
_TINY = float(np.finfo(np.float64).tiny)

# hat(v) is linear in v, and one product with a constant is the fastest way to many of them
_HAT = np.zeros((3, 9))
_HAT[[0, 1, 2], [7, 2, 3]] = 1.0
_HAT[[0, 1, 2], [5, 6, 1]] = -1.0


def hat(v: Array) -> Array:
    """The skew-symmetric matrix of a vector: ``hat(v) u = v x u``.

    v: (..., 3). Returns (..., 3, 3).
    """
    return np.asarray(v @ _HAT).reshape(*v.shape, 3)


def _squared_norm(v: Array) -> Array:
    # Column by column: NumPy's sum takes ten times as long over so short an axis.
    squares = v * v
    return functools.reduce(operator.add, (squares[..., i] for i in range(v.shape[-1])))


@_looped("so3_exp", (3,), (3, 3), EXPONENTIAL_TABLE)
def exp_so3(phi: Array) -> Array:
    """The rotation by the angle |phi| about the axis phi (Rodrigues).

    phi: rotation vector of any length, (..., 3), radians. Returns (..., 3, 3).
    """
    a, b, *_ = _exponential_coefficients(_squared_norm(phi))
    w = hat(phi)
    return np.asarray(_IDENTITY_3 + a * w + b * (w @ w))


def _quaternion_table() -> Array:
    """The linear map of a rotation R(q), as nine numbers, to 4 q q^T - I, as sixteen."""
    table = np.zeros((3, 3, 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        table[i, i, [i, j, k, 3], [i, j, k, 3]] = (1.0, -1.0, -1.0, 1.0)
        for sign, element in ((1.0, table[k, j]), (-1.0, table[j, k])):
            element[[j, k], [k, j]] = 1.0
            element[[i, 3], [3, i]] = sign
    return table.reshape(9, 16)


_QUATERNION_TABLE = _quaternion_table()


@_looped("so3_quaternion", (3, 3), (4,))
def _quaternion(rotation: Array) -> Array:
    """The unit quaternion (x, y, z, w), w >= 0, of the nearest rotation; (..., 4).

    Of a rotation, the matrix K = 4 q q^T has any of its columns along q; the one with the
    largest diagonal element is at least 2 long, so nothing cancels (Shepperd). Of a nearly
    orthonormal matrix, the nearest rotation's q is K's dominant eigenvector (Bar-Itzhack), and
    one more product with K takes that column from an error of the order of the deviation to
    its square.
    """
    batch = rotation.shape[:-2]
    k = rotation.reshape(*batch, 9) @ _QUATERNION_TABLE + _IDENTITY_4.ravel()
    largest = _IDENTITY_4[np.argmax(k[..., ::5], axis=-1)]
    k = k.reshape(*batch, 4, 4)
    q = (k @ (k @ largest[..., None]))[..., 0]
    return np.asarray(q / np.copysign(np.sqrt(_squared_norm(q)), q[..., 3])[..., None])


@_looped("so3_right_jacobian", (3,), (3, 3), EXPONENTIAL_TABLE)
def right_jacobian_so3(phi: Array) -> Array:
    """``J_r(phi)``, for which ``Exp(phi + d) = Exp(phi) Exp(J_r(phi) d)`` to first order in d.

    phi: (..., 3). Returns (..., 3, 3).
    """
    _, b, c, *_ = _exponential_coefficients(_squared_norm(phi))
    w = hat(phi)
    return np.asarray(_IDENTITY_3 - b * w + c * (w @ w))


@_looped("so3_log", (3, 3), (3,))
def log_so3(rotation: Array) -> Array:
    """The rotation vector, of length at most pi: the inverse of `exp_so3`.

    rotation: (..., 3, 3). Returns (..., 3), radians.

    At the angle pi itself, where phi and -phi are the same rotation, one of them. Of a matrix
    that is a rotation only up to a small deviation, as a file's decimals or a long product
    leave it, the logarithm of the nearest rotation (Frobenius), up to the square of that
    deviation: 1e-12 from one of 1e-6. A matrix near no rotation is not detected.
    """
    q = _quaternion(rotation)
    # A copy: where a strided argument's memory reaches into that of the result, NumPy computes the
    # arctangent by another loop, whose last digit differs.
    v, cosine = q[..., :3], np.array(q[..., 3])
    # of the half angle; the arctangent keeps its digits at both ends, as the arccosine does not.
    # The bound, below any v whose square is not zero, leaves the limit 2 / cosine at zero.
    sine = np.maximum(np.sqrt(_squared_norm(v)), _TINY)
    return np.asarray((2.0 * np.arctan2(sine, cosine) / sine)[..., None] * v)


# --------------------------------------------------------------------------------------------
# Poses
# --------------------------------------------------------------------------------------------
def _pose(rotation: Array, position: Array) -> Array:
    """[[rotation, position], [0, 1]]; (..., 4, 4)."""
    out = np.zeros((*position.shape[:-1], 4, 4))
    out[..., :3, :3] = rotation
    out[..., :3, 3] = position
    out[..., 3, 3] = 1.0
    return out


def _block_triangle(diagonal: Array, upper: Array | float) -> Array:
    """[[diagonal, upper], [0, diagonal]]; (..., 6, 6)."""
    out = np.zeros((*diagonal.shape[:-2], 6, 6))
    out[..., :3, :3] = diagonal
    out[..., :3, 3:] = upper
    out[..., 3:, 3:] = diagonal
    return out


@_looped("se3_exp", (6,), (4, 4), EXPONENTIAL_TABLE)
def exp(xi: Array) -> Array:
    """The pose ``Exp(xi) = [[Exp(phi), J_l(phi) rho], [0, 1]]``.

    xi: (..., 6), with a rotation of any angle. Returns (..., 4, 4).
    """
    rho, phi = xi[..., :3], xi[..., 3:]
    a, b, c, *_ = _exponential_coefficients(_squared_norm(phi))
    w = hat(phi)
    w2 = w @ w
    position = (_IDENTITY_3 + b * w + c * w2) @ rho[..., None]
    return _pose(np.asarray(_IDENTITY_3 + a * w + b * w2), position[..., 0])


@_looped("se3_log", (4, 4), (6,), LOGARITHM_TABLE)
def log(pose: Array) -> Array:
    """The tangent vector ``Log(T) = (J_l(phi)^-1 t, phi)``, |phi| <= pi: the inverse of `exp`.

    pose: (..., 4, 4); see `log_so3` for its rotation. Returns (..., 6).
    """
    phi = log_so3(pose[..., :3, :3])
    d, _ = _logarithm_coefficients(_squared_norm(phi))
    w = hat(phi)
    rho = (_IDENTITY_3 - 0.5 * w + d * (w @ w)) @ pose[..., :3, 3:]
    return np.concatenate([rho[..., 0], phi], axis=-1)


def compose(first: Array, *others: Array) -> Array:
    """The product of poses, from the left: ``T_a_b, T_b_c -> T_a_c``.

    Each (..., 4, 4). Returns (..., 4, 4). Nothing is renormalised: every product adds its
    rounding to the rotation, and `log` takes the nearest one.
    """
    return functools.reduce(operator.matmul, others, first)


@_looped("se3_inverse", (4, 4), (4, 4))
def inverse(pose: Array) -> Array:
    """The inverse ``T_b_a = [[R^T, -R^T t], [0, 1]]`` of T_a_b.

    pose: (..., 4, 4). Returns (..., 4, 4).
    """
    transpose = pose[..., :3, :3].swapaxes(-1, -2)
    return _pose(transpose, -(transpose @ pose[..., :3, 3:])[..., 0])


@_looped("se3_adjoint", (4, 4), (6, 6))
def adjoint(pose: Array) -> Array:
    """``Ad_T = [[R, hat(t) R], [0, R]]``, for which ``T Exp(xi) = Exp(Ad_T xi) T``.

    pose: (..., 4, 4). Returns (..., 6, 6).
    """
    rotation = pose[..., :3, :3]
    return _block_triangle(rotation, hat(pose[..., :3, 3]) @ rotation)


def _quadratic_in_ad(xi: Array, p: Array | float, q: Array, dp: Array | float, dq: Array) -> Array:
    """f(ad_xi) for f(W) = I + p W + q W^2, with p, q and dp = p', dq = q' of |phi|; (..., 6, 6).

    Along rho, theta^2 has the derivative 2 phi . rho, p therefore p' phi . rho.
    """
    rho, phi = xi[..., :3], xi[..., 3:]
    w, v = hat(phi), hat(rho)
    w2, wv = w @ w, w @ v
    dot = (rho * phi).sum(axis=-1)[..., None, None]
    upper = p * v + q * (wv + wv.swapaxes(-1, -2)) + dot * (dp * w + dq * w2)
    return _block_triangle(np.asarray(_IDENTITY_3 + p * w + q * w2), upper)


@_looped("se3_left_jacobian", (6,), (6, 6), EXPONENTIAL_TABLE)
def left_jacobian(xi: Array) -> Array:
    """``J_l(xi)``, for which ``Exp(xi + d) = Exp(J_l(xi) d) Exp(xi)`` to first order in d.

    xi: (..., 6). Returns (..., 6, 6): ``sum_k ad_xi^k / (k + 1)!``.
    """
    _, b, c, db, dc = _exponential_coefficients(_squared_norm(xi[..., 3:]))
    return _quadratic_in_ad(xi, b, c, db, dc)


def right_jacobian(xi: Array) -> Array:
    """``J_r(xi)``, for which ``Exp(xi + d) = Exp(xi) Exp(J_r(xi) d)`` to first order in d.

    xi: (..., 6). Returns (..., 6, 6): ``J_l(-xi)``.
    """
    return left_jacobian(-xi)


@_looped("se3_left_jacobian_inverse", (6,), (6, 6), LOGARITHM_TABLE)
def left_jacobian_inverse(xi: Array) -> Array:
    """``J_l(xi)^-1``, for which ``Log(Exp(d) Exp(xi)) = xi + J_l(xi)^-1 d`` to first order in d.

    xi: (..., 6), |phi| < 2 pi, where it is singular. Returns (..., 6, 6).
    """
    d, dd = _logarithm_coefficients(_squared_norm(xi[..., 3:]))
    return _quadratic_in_ad(xi, -0.5, d, 0.0, dd)


def right_jacobian_inverse(xi: Array) -> Array:
    """``J_r(xi)^-1``, for which ``Log(Exp(xi) Exp(d)) = xi + J_r(xi)^-1 d`` to first order in d.

    xi: (..., 6), |phi| < 2 pi, where it is singular. Returns (..., 6, 6): ``J_l(-xi)^-1``.
    """
    return left_jacobian_inverse(-xi)


def interpolate(pose_a: Array, pose_b: Array, weight: Array | float) -> Array:
    """The pose ``T_a Exp(w Log(T_a^-1 T_b))``: on the screw motion from a, w = 0, to b, w = 1.

    pose_a, pose_b: (..., 4, 4). weight: (...). Returns (..., 4, 4).
    """
    step = log(compose(inverse(pose_a), pose_b))
    return compose(pose_a, exp(np.asarray(weight)[..., None] * step))


# --------------------------------------------------------------------------------------------
# As ROS has them
# --------------------------------------------------------------------------------------------
def _require(good: npt.NDArray[np.bool_], problem: str) -> None:
    if not good.all():
        index = ", ".join(str(i) for i in np.argwhere(~good)[0])
        raise ValueError(f"{problem} (index {index})" if index else problem)


def from_position_quaternion(position: npt.ArrayLike, quaternion: npt.ArrayLike) -> Array:
    """The pose of a position and an orientation, whose quaternion is normalised.

    position: (..., 3), metres. quaternion: (..., 4), (x, y, z, w). Returns (..., 4, 4).

    Raises ValueError if a number is not finite or a quaternion is zero.
    """
    position = np.asarray(position, dtype=np.float64)
    quaternion = np.asarray(quaternion, dtype=np.float64)
    poses = _from_position_quaternion(position, quaternion)
    if poses is not None:
        return poses
    _require(np.isfinite(position).all(axis=-1), "a position is not finite")
    _require(np.isfinite(quaternion).all(axis=-1), "a quaternion is not finite")
    largest = np.abs(quaternion).max(axis=-1)
    _require(largest > 0.0, "a quaternion is zero, which is no orientation")
    # twice, so that neither squaring a tiny nor a huge number takes the norm away
    scaled = quaternion / largest[..., None]
    q = scaled / np.sqrt(_squared_norm(scaled))[..., None]
    w = hat(q[..., :3])
    rotation = _IDENTITY_3 + 2.0 * (q[..., 3, None, None] * w + w @ w)
    batch = np.broadcast_shapes(position.shape[:-1], q.shape[:-1])
    return _pose(rotation, np.broadcast_to(position, (*batch, 3)))


def _from_position_quaternion(position: Array, quaternion: Array) -> Array | None:
    """The same as a loop; None where that was not built, or something is not as it has to be."""
    if not loops.there() or (position.shape[-1:], quaternion.shape[-1:]) != ((3,), (4,)):
        return None
    batch = position.shape[:-1]
    if batch != quaternion.shape[:-1]:
        batch = np.broadcast_shapes(batch, quaternion.shape[:-1])
        position = np.broadcast_to(position, (*batch, 3))
        quaternion = np.broadcast_to(quaternion, (*batch, 4))
    given = np.ascontiguousarray(position), np.ascontiguousarray(quaternion)
    poses = np.empty((*batch, 4, 4))
    bad = loops.call("se3_from_position_quaternion", *given, poses, math.prod(batch))
    return None if bad else poses


def to_position_quaternion(pose: Array) -> tuple[Array, Array]:
    """The position and the unit quaternion (x, y, z, w), w >= 0, of a pose.

    pose: (..., 4, 4); see `log_so3` for its rotation. Returns (..., 3), metres, and (..., 4).
    """
    return pose[..., :3, 3].copy(), _quaternion(pose[..., :3, :3])


def _rotate_covariance(covariance: Array, rotation: Array) -> Array:
    both = _block_triangle(rotation, 0.0)
    return np.asarray(both @ covariance @ both.swapaxes(-1, -2))


def covariance_to_fixed_axes(covariance: Array, pose: Array) -> Array:
    """The covariance of a ROS PoseWithCovariance from the one in the body frame.

    ROS takes position and rotation each about the fixed axes of the parent frame:
    ``t + d_t, Exp(d_R) R``, with ``(d_t, d_R) = blkdiag(R, R) xi`` to first order.

    covariance: of ``xi`` in ``T Exp(xi)``, (..., 6, 6). pose: (..., 4, 4).
    Returns (..., 6, 6), symmetric to round-off.
    """
    return _rotate_covariance(covariance, pose[..., :3, :3])


def covariance_from_fixed_axes(covariance: Array, pose: Array) -> Array:
    """The covariance in the body frame from the one of a ROS PoseWithCovariance.

    The inverse of `covariance_to_fixed_axes`. covariance: (..., 6, 6). pose: (..., 4, 4).
    Returns (..., 6, 6), symmetric to round-off.
    """
    return _rotate_covariance(covariance, pose[..., :3, :3].swapaxes(-1, -2))
