# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Closed-form alignment of positions, from sums that need constant memory.

Source: S. Umeyama, "Least-squares estimation of transformation parameters between two point
patterns", IEEE PAMI 13(4), 1991. Given positions ``x_i`` in a source world and ``y_i`` in a
target world, both (M, 3) in metres, find the ``g = (R, t, s)`` of the gauge that minimises

    sum_i |y_i - (s R x_i + t)|^2.

All that the minimiser and the minimum depend on are the count, the two means and the centred
second moments, so both are closed forms of running sums. `Moments` keeps the second moments as
a triangular factor instead of as sums of squares: ``rmse`` is then the norm of a product with
that factor, and accurate to ``eps * extent``. The difference of the sums of squares would leave
``sqrt(eps) * extent``, 0.05 mm on a trajectory of 3 km.
"""

import dataclasses
import enum
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3

Array = npt.NDArray[np.float64]
Gauge = Literal["none", "se3", "yaw_translation", "sim3"]

GAUGES: tuple[Gauge, ...] = ("none", "se3", "yaw_translation", "sim3")

# A direction of rotation is unobserved where the curvature of the cost is below this share of
# the largest. The curvature goes with the square of the extent, so it means an extent across
# of less than a millionth of the extent along: 1 mm in 1 km. The cross-covariance has a
# relative error of some eps = 2e-16, a safe factor below.
_UNOBSERVED_BELOW = 1e-12
# Points are coincident where their standard deviation could be the round-off of their mean.
_COINCIDENT_BELOW = 64 * np.finfo(np.float64).eps
# So many pairs are summed together.
_TOGETHER = 4096


class Degeneracy(enum.StrEnum):
    """Why an alignment is not unique; `NONE` where it is."""

    NONE = "none"
    TOO_FEW_POINTS = "too_few_points"
    """Fewer than 3 points (`yaw_translation`: 2)."""
    COINCIDENT = "coincident"
    """All the points of one side are one point: no rotation and no scale is observed."""
    COLLINEAR = "collinear"
    """One side lies on a straight line: the rotation about it is not observed."""
    VERTICAL = "vertical"
    """`yaw_translation`: one side has no horizontal extent, yaw is not observed."""
    AMBIGUOUS = "ambiguous"
    """Several rotations fit equally well, as between a shape and its mirror image."""


@dataclasses.dataclass(frozen=True)
class Moments:
    """Running first and second moments of corresponding positions. A value: updates are new.

    Attributes:
        count: number of pairs n.
        mean_source: (3,), m. Zero while `count` is 0.
        mean_target: (3,), m.
        factor: (6, 6), m, upper triangular up to signs, with
            ``factor.T @ factor = sum_i z_i z_i^T`` and ``z_i = (x_i - mean x, y_i - mean y)``.
    """

    count: int
    mean_source: Array
    mean_target: Array
    factor: Array

    @classmethod
    def empty(cls) -> Self:
        """The moments of no points."""
        return cls(0, np.zeros(3), np.zeros(3), np.zeros((6, 6)))

    @classmethod
    def of(cls, source: Array, target: Array) -> Self:
        """The moments of the pairs ``source`` (M, 3), ``target`` (M, 3), M >= 0.

        Raises:
            ValueError: shapes other than (M, 3), or a value that is not finite.
        """
        if source.ndim != 2 or source.shape[1] != 3 or source.shape != target.shape:
            raise ValueError(
                f"source and target must both be (M, 3), got {source.shape} and {target.shape}"
            )
        if len(source) > _TOGETHER:
            # A whole run, a part at a time, so as not to be there several times.
            found = cls.empty()
            for begin in range(0, len(source), _TOGETHER):
                here = slice(begin, begin + _TOGETHER)
                found = found.merged(cls.of(source[here], target[here]))
            return found
        points = np.concatenate((source, target), axis=1)
        if not np.isfinite(points).all():
            raise ValueError("source and target must be finite")
        if len(points) == 0:
            return cls.empty()
        mean = points.mean(axis=0)
        # Six rows of zeros make the factor square for fewer than six points too.
        rows = np.concatenate((np.zeros((6, 6)), points - mean))
        return cls(len(points), mean[:3], mean[3:], _triangle(rows))

    def merged(self, other: Self) -> Self:
        """The moments of both sets of points together.

        Chan, Golub and LeVeque's update of means and centred sums (1979), in square-root form:
        the two factors and the row of the difference of the means are stacked and
        triangularised, which is stable whatever the counts and the distance from the origin.
        """
        if self.count == 0:
            return other
        if other.count == 0:
            return self
        count = self.count + other.count
        share = other.count / count
        shift_source = other.mean_source - self.mean_source
        shift_target = other.mean_target - self.mean_target
        shift = np.concatenate((shift_source, shift_target)) * np.sqrt(self.count * share)
        rows = np.concatenate((self.factor, other.factor, shift[np.newaxis]))
        return dataclasses.replace(
            self,
            count=count,
            mean_source=self.mean_source + share * shift_source,
            mean_target=self.mean_target + share * shift_target,
            factor=_triangle(rows),
        )

    def updated(self, source: Array, target: Array) -> Self:
        """The moments with the pairs ``source`` (M, 3), ``target`` (M, 3) added."""
        return self.merged(type(self).of(source, target))

    @property
    def cross_covariance(self) -> Array:
        """``1/n sum_i (y_i - mean y)(x_i - mean x)^T``, (3, 3), m^2; Umeyama's eq. 38."""
        return self.factor[:, 3:].T @ self.factor[:, :3] / max(self.count, 1)

    @property
    def source_extent(self) -> Array:
        """Standard deviations of the source along its principal axes, (3,), m, descending."""
        return self._extent(self.factor[:, :3])

    @property
    def target_extent(self) -> Array:
        """Standard deviations of the target along its principal axes, (3,), m, descending."""
        return self._extent(self.factor[:, 3:])

    def _extent(self, half: Array) -> Array:
        extent: Array = np.linalg.svd(half, compute_uv=False) / np.sqrt(max(self.count, 1))
        return extent


def _triangle(rows: Array) -> Array:
    """The triangular factor F of rows (N, 6), ``F.T @ F = rows.T @ rows``."""
    # NumPy's annotation leaves out that mode="r" returns an array alone.
    return np.asarray(np.linalg.qr(rows, mode="r"))


@dataclasses.dataclass(frozen=True)
class Alignment:
    """The best ``g = (R, t, s)`` of a gauge: ``y = s R x + t`` from source to target world.

    Where the minimiser is not unique, `degeneracy` says why, `unobserved_axes` about which
    axes the rotation is free, and the rotation given is, of the equally good ones about such
    an axis, the one of the smallest angle. `rmse` holds all the same: the minimum is unique
    even where the minimiser is not.

    Attributes:
        gauge: what was free.
        count: number of pairs.
        rotation: (3, 3).
        translation: (3,), m.
        scale: 1 in every gauge but `sim3`.
        rmse: root mean square of ``|y_i - (s R x_i + t)|``, m.
        degeneracy: `Degeneracy.NONE` if and only if the minimiser is unique.
        unobserved_axes: (K, 3) unit vectors in the target world, K = 0 to 3.
        scale_observed: False only where `sim3` had nothing to find the scale from.
    """

    gauge: Gauge
    count: int
    rotation: Array
    translation: Array
    scale: float
    rmse: float
    degeneracy: Degeneracy
    unobserved_axes: Array
    scale_observed: bool

    def transform_positions(self, positions: Array) -> Array:
        """``s R x + t`` of positions (..., 3), m."""
        return self.scale * positions @ self.rotation.T + self.translation


def align(moments: Moments, gauge: Gauge) -> Alignment:
    """The alignment that minimises ``sum_i |y_i - (s R x_i + t)|^2`` over the gauge.

    `se3`: rotation and translation, `sim3`: scale too, `yaw_translation`: rotation about the
    target's z only, `none`: the identity, as asked for. Equations 39 to 43 of Umeyama 1991.

    Raises:
        ValueError: no points, or an unknown gauge.
    """
    if moments.count == 0:
        raise ValueError("there are no points to align")
    rotation: Array
    scale = 1.0
    unobserved = np.zeros((0, 3))
    scale_observed = True
    if gauge == "none":
        rotation = np.eye(3)
    elif gauge == "yaw_translation":
        rotation, unobserved = _best_yaw(moments)
    elif gauge in ("se3", "sim3"):
        rotation, unobserved = _best_rotation(moments)
        if gauge == "sim3":
            scale, scale_observed = _best_scale(moments, rotation)
    else:
        raise ValueError(f"unknown gauge {gauge!r}: one of {', '.join(GAUGES)}")
    if gauge == "none":
        translation = np.zeros(3)
    else:
        translation = moments.mean_target - scale * rotation @ moments.mean_source
    return Alignment(
        gauge=gauge,
        count=moments.count,
        rotation=rotation,
        translation=translation,
        scale=scale,
        rmse=_rmse(moments, gauge, rotation, scale),
        degeneracy=_degeneracy(moments, gauge, len(unobserved) > 0 or not scale_observed),
        unobserved_axes=unobserved,
        scale_observed=scale_observed,
    )


def align_positions(source: Array, target: Array, gauge: Gauge) -> Alignment:
    """`align` of the positions ``source`` (M, 3) to ``target`` (M, 3).

    Raises:
        ValueError: as `Moments.of` and `align`.
    """
    return align(Moments.of(source, target), gauge)


def _best_rotation(moments: Moments) -> tuple[Array, Array]:
    """The rotation that maximises ``tr(R^T C)``, and the axes (K, 3) about which it is free."""
    u, d, vt = np.linalg.svd(moments.cross_covariance)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation: Array = (u * (1.0, 1.0, sign)) @ vt
    # With R = U S V^T, C R^T = U diag(d) S U^T. The cost of turning by a about the axis u_k
    # is a^2 times the sum of the other two entries of diag(d) S.
    signed = d * (1.0, 1.0, sign)
    curvature = signed.sum() - signed
    if _coincident(moments):
        return np.eye(3), np.eye(3)
    free = curvature <= _UNOBSERVED_BELOW * curvature.max()
    axes: Array = u.T[free]
    if len(axes) == 1:
        rotation = largest_trace_about(axes[0], rotation, np.eye(3))
    return rotation, axes


def largest_trace_about(axis: Array, rotation: Array, turns: Array) -> Array:
    """Of ``Q = Exp(a axis) R``, all a, the one with the largest ``tr(turns^T Q)``.

    axis: (3,), a unit vector. rotation: R, (3, 3). turns: (3, 3); of the identity, the Q of the
    smallest angle; of a sum of rotations, the nearest to them.

    ``tr(B Exp(a axis)) = cos(a) (tr B - axis^T B axis) + sin(a) tr(hat(axis) B) + const``,
    ``B = R turns^T``.
    """
    both = rotation @ turns.T
    a = np.arctan2(np.trace(se3.hat(axis) @ both), np.trace(both) - axis @ both @ axis)
    turned: Array = se3.exp_so3(a * axis) @ rotation
    return turned


def nearest_rotation(matrix: Array) -> Array:
    """The rotation (3, 3) that is nearest to a matrix, or to a positive multiple of it."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def _best_yaw(moments: Moments) -> tuple[Array, Array]:
    """The rotation about z that maximises ``tr(R^T C)``; its axis too where it is free."""
    c = moments.cross_covariance
    cosine, sine = c[0, 0] + c[1, 1], c[1, 0] - c[0, 1]
    z = np.array([0.0, 0.0, 1.0])
    largest = moments.source_extent[0] * moments.target_extent[0]
    if _coincident(moments) or np.hypot(cosine, sine) <= _UNOBSERVED_BELOW * largest:
        return np.eye(3), z[np.newaxis]
    return se3.exp_so3(np.arctan2(sine, cosine) * z), np.zeros((0, 3))


def _best_scale(moments: Moments, rotation: Array) -> tuple[float, bool]:
    """Umeyama's eq. 42, ``tr(D S) / var(x)``, and whether the points determine it."""
    if _coincident(moments):
        return 1.0, False
    gain = float(np.sum(moments.cross_covariance * rotation))
    variance = float(np.sum(moments.factor[:, :3] ** 2)) / moments.count
    spread = np.sqrt(variance) * np.linalg.norm(moments.factor[:, 3:]) / np.sqrt(moments.count)
    # Positions of 1e-160 m have no square.
    if variance < np.finfo(np.float64).tiny or gain <= _UNOBSERVED_BELOW * spread:
        return 1.0, False
    return gain / variance, True


def _rmse(moments: Moments, gauge: Gauge, rotation: Array, scale: float) -> float:
    """Of the residuals, from the factor: ``sum_i |r_i|^2 = |Y - s X R^T|_F^2``.

    Only in the gauge `none` do the means leave a residual of their own.
    """
    squares = np.sum((moments.factor[:, 3:] - scale * moments.factor[:, :3] @ rotation.T) ** 2)
    mean_square = squares / moments.count
    if gauge == "none":
        mean_square += np.sum((moments.mean_target - moments.mean_source) ** 2)
    return float(np.sqrt(mean_square))


def _coincident(moments: Moments) -> bool:
    return any(
        bool(extent[0] <= _COINCIDENT_BELOW * np.abs(mean).max())
        for extent, mean in (
            (moments.source_extent, moments.mean_source),
            (moments.target_extent, moments.mean_target),
        )
    )


def _degeneracy(moments: Moments, gauge: Gauge, unobserved: bool) -> Degeneracy:
    """The reason in the user's words, where something is unobserved."""
    if gauge == "none":
        return Degeneracy.NONE
    if moments.count < (2 if gauge == "yaw_translation" else 3):
        return Degeneracy.TOO_FEW_POINTS
    if not unobserved:
        return Degeneracy.NONE
    if _coincident(moments):
        return Degeneracy.COINCIDENT
    if gauge == "yaw_translation":
        vertical = any(
            np.sum(half[:, :2] ** 2) <= _UNOBSERVED_BELOW * np.sum(half**2)
            for half in (moments.factor[:, :3], moments.factor[:, 3:])
        )
        return Degeneracy.VERTICAL if vertical else Degeneracy.AMBIGUOUS
    collinear = any(
        extent[1] <= np.sqrt(_UNOBSERVED_BELOW) * extent[0]
        for extent in (moments.source_extent, moments.target_extent)
    )
    return Degeneracy.COLLINEAR if collinear else Degeneracy.AMBIGUOUS
