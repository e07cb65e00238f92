# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gauges: which motions of its world an estimate cannot be blamed for (``docs/method.md``, 4).

An alignment maps the estimate's world into the ground truth's. It is perturbed on the left, about
a centre c in the ground truth's world, by (rho, phi, lambda): ::

    g(delta) = h(delta) g,    h: x -> c + Exp(rho, phi) (1 + lambda) (x - c)

and a gauge is the subgroup that some of these seven span. The measure integrated over is
``d rho d phi d lambda`` of h at the identity: the right-invariant Haar measure, so that a change of
the estimate's world (its scale included, in the gauge sim3) changes nothing. Where c is does not
matter to the measure; it matters to the numbers, which are best with c amid the trajectory.
For se3, yaw_translation and none, the measure is the left-invariant one too. For sim3 it is
``dR dt d(log s)``, t in the ground truth's metres, and not left-invariant: that is a convention,
and only a change of the ground truth's unit of length would show it.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment import umeyama

Array = npt.NDArray[np.float64]


# The square of a smaller angle (rad) is less than round-off beside 1.
_SMALL_ANGLE = 1e-9


class Similarity(NamedTuple):
    """A similarity from the estimate's world to the ground truth's: ``x -> scale R x + t``.

    pose: (R, t) as a matrix, (4, 4), t in the ground truth's metres. scale: positive.
    """

    pose: Array
    scale: float

    def apply(self, estimate: Array) -> Array:
        """The estimate in the ground truth's world; its positions scaled, its rotations not.

        estimate: (..., 4, 4). Returns (..., 4, 4).
        """
        if self.scale == 1.0:
            return self.pose @ estimate
        scaled = estimate.copy()
        scaled[..., :3, 3] *= self.scale
        return self.pose @ scaled


def _about(centre: Array) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = centre
    return pose


class Gauge(NamedTuple):
    """A subgroup of the similarities, spanned by some of (rho_xyz, phi_xyz, lambda).

    name: as the parameter ``gauge`` has it.
    free: which of the seven it may change; their indices, ascending.
    """

    name: umeyama.Gauge
    free: tuple[int, ...]

    @property
    def dimension(self) -> int:
        """How many freedoms it has."""
        return len(self.free)

    @property
    def has_scale(self) -> bool:
        """Whether the estimate's scale is free."""
        return 6 in self.free

    def expand(self, delta: Array) -> Array:
        """(rho, phi, lambda), (7,), of the freedoms' values, (d,)."""
        full = np.zeros(7)
        full[list(self.free)] = delta
        return full

    def perturb(self, alignment: Similarity, centre: Array, delta: Array) -> Similarity:
        """``h(delta) g``. centre: (3,). delta: (d,), its scale above -1."""
        full = self.expand(delta)
        factor = 1.0 + float(full[6])
        pose = alignment.pose.copy()
        pose[:3, 3] = factor * (pose[:3, 3] - centre)
        pose = _about(centre) @ se3.exp(full[:6]) @ pose
        return Similarity(pose, factor * alignment.scale)

    def without_scale(self) -> "Gauge":
        """The same gauge with the scale held."""
        return SE3 if self.has_scale else self

    def jacobian(self, residual: Array, aligned: Array, centre: Array) -> Array:
        """The derivative of ``Log(T_gt^-1 h(delta) T)`` by delta, at zero.

        residual: ``Log(T_gt^-1 T)``, (M, 6). aligned: T, (M, 4, 4). centre: (3,).
        Returns (M, 6, d).

        ``h(delta) T = T Exp(Ad(T^-1) (rho, phi) + R^T (x - c) lambda)`` to first order, the adjoint
        being that of the world with its origin at c.
        """
        to_body = se3.inverse(aligned) @ _about(centre)
        motion = np.zeros((len(aligned), 6, 7))
        motion[..., :6] = se3.adjoint(to_body)
        motion[:, :3, 6] = -to_body[:, :3, 3]
        return se3.right_jacobian_inverse(residual) @ motion[..., list(self.free)]

    def rebase(self, delta: Array, shift: Array) -> Array:
        """The change of perturbation when g becomes ``h(delta) g`` and c moves by ``shift``.

        To first order ``h(delta) g`` perturbed about the new centre by d' is g perturbed about the
        old one by ``delta + matrix d'``. delta: (d,). shift: (3,). Returns the matrix, (d, d).
        """
        full = self.expand(delta)
        matrix = np.eye(7)
        matrix[:6, :6] = se3.left_jacobian_inverse(full[:6])
        matrix[:3, 6] = full[:3]
        matrix[6, 6] = 1.0 + full[6]
        # A point moves by rho + phi x (p - c) + lambda (p - c), about either centre.
        about = np.eye(7)
        about[:3, 3:6] = se3.hat(shift)
        about[:3, 6] = -shift
        free = list(self.free)
        return np.asarray((matrix @ about)[np.ix_(free, free)])

    def log_volume(self, delta: Array) -> float:
        """The logarithm of the determinant of `rebase`'s matrix for this ``delta``, (d,).

        Of the rotation's Jacobian it is in closed form; full rotations and translations have it
        each, and of a yaw only the translation.
        """
        full = self.expand(delta)
        half = 0.5 * math.sqrt(float(full[3:6] @ full[3:6]))
        of_rotation = 2.0 * math.log(abs(half / math.sin(half))) if half > _SMALL_ANGLE else 0.0
        jacobians = sum(axis in self.free for axis in (0, 3))
        return jacobians * of_rotation + math.log1p(float(full[6]))

    def covariance(self, alignment: Similarity, centre: Array, of_delta: Array) -> Array:
        """The covariance of an alignment, from that of its perturbation about a centre.

        of_delta: (d, d). Returns (7, 7): of the pose's right perturbation, (rho, phi), in the axes
        of the estimate's world and the ground truth's metres, then of the scale's logarithm.
        Freedoms that the gauge has not have zeros.
        """
        lever = alignment.pose[:3, 3] - centre
        transpose = alignment.pose[:3, :3].T
        matrix = np.zeros((7, 7))
        matrix[:3, :3] = matrix[3:6, 3:6] = transpose
        matrix[:3, 3:6] = -transpose @ se3.hat(lever)
        matrix[:3, 6] = transpose @ lever
        matrix[6, 6] = 1.0
        matrix = matrix[:, list(self.free)]
        return np.asarray(matrix @ of_delta @ matrix.T)


NONE = Gauge("none", ())
SE3 = Gauge("se3", (0, 1, 2, 3, 4, 5))
YAW_TRANSLATION = Gauge("yaw_translation", (0, 1, 2, 5))
SIM3 = Gauge("sim3", (0, 1, 2, 3, 4, 5, 6))

GAUGES = {gauge.name: gauge for gauge in (SE3, NONE, YAW_TRANSLATION, SIM3)}
"""The gauges by name."""
