# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is not the estimator's fault: clock, mounting, scale; and what they do to the error.

    T_corrected(t + τ(t)) = S(s) T_estimate(t) E⁻¹,    τ(t) = τ₀ + τ₁ (t - t_middle)

E is the estimate's body frame in the ground truth's, S scales positions. To first order, in the
world's axes and up to the alignment, the error of a pose at (R, p) with body twist v grows by

    blkdiag(R, R) v  a second of τ,   blkdiag(R, R)  by x in E ← Exp(x) E,   -(p, 0)  by log s.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.alignment.umeyama import nearest_rotation
from trajeval_ros.error_model.likelihood import Data

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

NAMES = ("clock_offset", "clock_rate", "x", "y", "z", "roll", "pitch", "yaw", "scale")
COUNT = len(NAMES)
# Standard deviations of a prior that is hardly informative: s, 1, m, rad, 1. So a direction that
# the motion does not show has a covariance, and it says so.
PRIOR_STD = np.array([10.0, 0.1, *[100.0] * 3, *[10.0] * 3, 10.0])
_PRECISION: Array = np.asarray(1.0 / PRIOR_STD**2, dtype=np.float64)
# A direction is observed when its standard deviation is below these together.
OBSERVED_STD = np.array([0.05, 2e-3, *[0.3] * 3, *[0.1] * 3, 0.1])

# m, rad, m/s, rad/s, and of a covariance's standard deviations: what a fit tells apart.
_RESOLUTION = 2.0**-30

# Where no error's angle exceeds this, errors are taken as they are, and otherwise as sums of steps:
# a heading that is off by φ takes φ²/2 off what of a step follows it, as if it were scale.
_SMALL_ANGLE = 0.02


class Truth(NamedTuple):
    """The ground truth at N instants.

    poses: (N, 4, 4). covariances: (N, 6, 6) of their right perturbation. twists: (N, 6), body
    frame, m/s and rad/s. valid: (N,), where there is an answer.
    """

    poses: Array
    covariances: Array
    twists: Array
    valid: Mask


Ask = Callable[[Stamps], Truth]


def rounded(truth: Truth) -> Truth:
    """The same to a nanometre, and its covariances to nine digits.

    Live and from a file the answers differ by round-off. Where the likelihood is flat, or has
    several maxima, a search makes of that what it likes; so they are made equal before it.
    """
    scale = np.sqrt(np.maximum(np.diagonal(truth.covariances, axis1=1, axis2=2), 1e-300))
    scale = np.exp2(np.rint(np.log2(scale)))
    unit = scale[:, :, None] * scale[:, None, :] * _RESOLUTION
    covariances = np.rint(truth.covariances / unit) * unit
    poses, twists = to_resolution(truth.poses), to_resolution(truth.twists)
    return Truth(poses, covariances, twists, truth.valid)


def to_resolution(values: Array) -> Array:
    """Poses or twists to a nanometre, a nanoradian, and that a second."""
    return np.asarray(np.rint(values / _RESOLUTION) * _RESOLUTION)


class Nuisances(NamedTuple):
    """clock_offset: τ₀, s. clock_rate: τ₁. extrinsic: E (4, 4). scale: s."""

    clock_offset: float
    clock_rate: float
    extrinsic: Array
    scale: float

    @staticmethod
    def none() -> Nuisances:
        """Nothing to correct."""
        return Nuisances(0.0, 0.0, np.eye(4), 1.0)

    @property
    def vector(self) -> Array:
        """What there is to correct, (9,), in the order of `NAMES`."""
        return np.array(
            [
                self.clock_offset,
                self.clock_rate,
                *se3.log(self.extrinsic),
                np.log(self.scale),
            ]
        )

    def moved(self, delta: Array) -> Nuisances:
        """With a step (9,) added, in the order of `NAMES`."""
        return Nuisances(
            self.clock_offset + float(delta[0]),
            self.clock_rate + float(delta[1]),
            se3.compose(se3.exp(delta[2:8]), self.extrinsic),
            self.scale * float(np.exp(delta[8])),
        )

    def stamps(self, stamps: Stamps) -> Stamps:
        """The estimate's stamps on the ground truth's clock; (N,) ns."""
        middle = (int(stamps[0]) + int(stamps[-1])) // 2
        shift = self.clock_offset * 1e9 + self.clock_rate * (stamps - middle)
        return np.asarray(stamps + np.rint(shift).astype(np.int64))

    def corrected(self, estimate: Array) -> Array:
        """The estimate (N, 4, 4) as poses of the ground truth's body, and of its size."""
        scaled = estimate.copy()
        scaled[:, :3, 3] *= self.scale
        return se3.compose(scaled, se3.inverse(self.extrinsic))


def errors(ground_truth: Array, estimate: Array) -> Array:
    """The z (N, 6): errors of positions and rotations in the world's axes, up to the alignment.

    ground_truth: (N, 4, 4), its positions about their mean. estimate: (N, 4, 4), in its own world.
    """
    rotation, position = ground_truth[:, :3, :3], ground_truth[:, :3, 3]
    align = nearest_rotation((rotation @ np.swapaxes(estimate[:, :3, :3], 1, 2)).sum(axis=0))
    phi = se3.log_so3(align @ estimate[:, :3, :3] @ np.swapaxes(rotation, 1, 2))
    if np.linalg.norm(phi, axis=1).max() < _SMALL_ANGLE:
        offset = estimate[:, :3, 3] @ align.T - position
        return np.concatenate([offset - offset.mean(axis=0), phi], axis=1)
    backwards = se3.inverse(ground_truth[1:]) @ ground_truth[:-1]
    step = se3.log(se3.compose(backwards, se3.inverse(estimate[:-1]), estimate[1:]))
    moved = (rotation[1:] @ step[:, :3, None])[..., 0]
    turned = (rotation[1:] @ step[:, 3:, None])[..., 0]
    moved += np.cross(position[1:], turned)
    total = np.zeros((len(estimate), 6))
    total[1:] = np.cumsum(np.concatenate([moved, turned], axis=1), axis=0)
    total[:, :3] -= np.cross(position, total[:, 3:])
    return total


def prepare(
    stamps: Stamps, estimate: Array, reference: Truth, nuisances: Nuisances
) -> tuple[Data, Array]:
    """What the likelihood takes, and the columns of the gauge (N, 6, 6).

    stamps: the estimate's own, (N,) ns; all of ``reference`` valid.
    """
    middle = (int(stamps[0]) + int(stamps[-1])) // 2
    times: Array = np.asarray((stamps - middle) * 1e-9, dtype=np.float64)
    if loops.there():
        return _prepared_in_c(times, estimate, reference, nuisances)
    truth = reference.poses.copy()
    truth[:, :3, 3] -= truth[:, :3, 3].mean(axis=0)
    rotation, position = truth[:, :3, :3], truth[:, :3, 3]
    axes = np.zeros((len(truth), 6, 6))
    axes[:, :3, :3] = axes[:, 3:, 3:] = rotation
    columns = np.zeros((len(truth), 6, COUNT))
    columns[:, :, 0] = (axes @ reference.twists[..., None])[..., 0]
    columns[:, :, 1] = columns[:, :, 0] * times[:, None]
    columns[:, :, 2:8] = axes
    columns[:, :3, 8] = -position
    gauge = np.zeros((len(truth), 6, 6))
    gauge[:, :3, :3] = gauge[:, 3:, 3:] = np.eye(3)
    gauge[:, :3, 3:] = -se3.hat(position)
    data = Data(
        times,
        errors(truth, nuisances.corrected(estimate)),
        axes @ reference.covariances @ np.swapaxes(axes, 1, 2),
        np.diff(position, axis=0),
        columns,
        _PRECISION,
        np.ones((len(truth), 2)),
        np.ones((len(truth) - 1, 2)),
    )
    return data, gauge


def _prepared_in_c(
    times: Array, estimate: Array, reference: Truth, nuisances: Nuisances
) -> tuple[Data, Array]:
    """As `prepare`; times: (N,), s."""
    count = len(times)
    poses, covariances, twists, estimate = map(
        loops.doubles, (reference.poses, reference.covariances, reference.twists, estimate)
    )
    back, sums = se3.inverse(nuisances.extrinsic), np.empty(12)
    loops.call("errors_about", count, poses, estimate, back, sums)
    align, mean = nearest_rotation(sums[:9].reshape(3, 3)), sums[9:] / count
    found, series = np.empty((count, 6)), se3.LOGARITHM_TABLE
    how = back, float(nuisances.scale), mean, align, _SMALL_ANGLE, series, len(series)
    loops.call("errors_of", count, poses, estimate, *how, found)
    columns, gauge = np.empty((count, 6, COUNT)), np.empty((count, 6, 6))
    turned, travel = np.empty((count, 6, 6)), np.empty((count - 1, 3))
    given = poses, covariances, twists, times, mean
    loops.call("errors_columns", count, *given, columns, gauge, turned, travel)
    weights = np.ones((count, 2)), np.ones((count - 1, 2))
    return Data(times, found, turned, travel, columns, _PRECISION, *weights), gauge
