# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which freedoms of a gauge a trajectory determines, and by what (``docs/method.md``, section 4).

Positions determine a rotation as far as they are spread out: not at all at rest, not about the line
on a straight one. The orientations determine every rotation, whatever the motion, so that the
likelihoods of the gauges without scale always exist; but an alignment of positions alone, such as
the conventional ATE's, does not. A scale is determined by spread alone.
"""

import enum
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.gauge import Gauge

Array = npt.NDArray[np.float64]

# A trajectory extends in a direction where its standard deviation is more than this many of the
# ground truth's own: less is not told from rest.
_TOLD_FROM_REST = 3.0
# A scale is determined where its logarithm's standard deviation is below one, a factor of e.
_LARGEST_LOG_SCALE_STD = 1.0


class Motion(enum.StrEnum):
    """In how many directions the positions extend, beyond the ground truth's uncertainty."""

    STATIC = "static"
    STRAIGHT = "straight"
    PLANAR = "planar"
    SPATIAL = "spatial"


class Status(enum.StrEnum):
    """How far a gauge's freedoms are determined."""

    NO_POSES = "no_poses"
    OBSERVED = "observed"
    """By the positions alone, and by the orientations besides."""
    BY_ORIENTATIONS_ONLY = "by_orientations_only"
    """Some rotation is determined by the orientations alone."""
    SCALE_NOT_OBSERVED = "scale_not_observed"
    """The scale is not determined: there is no likelihood in this gauge, and the scale is held."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Where a set of positions is, and how uncertain they are.

    count: of the positions. mean: (3,), m. scatter: ``sum (x - mean)(x - mean)^T``, (3, 3), m^2.
    variance: the sum of the positions' variances, each the mean over its three axes, m^2.
    """

    count: int
    mean: Array
    scatter: Array
    variance: float

    @staticmethod
    def none() -> "Spread":
        """No positions."""
        return Spread(0, np.zeros(3), np.zeros((3, 3)), 0.0)

    def absorb(self, position: Array, covariance: Array) -> "Spread":
        """The spread with more positions. position: (n, 3). covariance: (n, 6, 6)."""
        if len(position) == 0:
            return self
        count = self.count + len(position)
        mean = position.mean(axis=0)
        centred = position - mean
        shift = mean - self.mean
        between = np.outer(shift, shift) * (self.count * len(position) / count)
        return Spread(
            count,
            self.mean + shift * (len(position) / count),
            self.scatter + centred.T @ centred + between,
            self.variance + float(np.trace(covariance[:, :3, :3], axis1=1, axis2=2).sum()) / 3.0,
        )

    @property
    def least(self) -> float:
        """The standard deviation beyond which a direction is told from rest, m."""
        # A ground truth without uncertainty still has round-off.
        round_off = float(np.abs(self.mean).max()) * 1e-12
        return max(_TOLD_FROM_REST * float(np.sqrt(self.variance / max(self.count, 1))), round_off)

    def extents(self) -> tuple[Array, Array]:
        """Standard deviations along the principal axes, descending, (3,), and the axes' rows."""
        values, vectors = np.linalg.eigh(self.scatter / max(self.count, 1))
        return np.sqrt(np.maximum(values[::-1], 0.0)), vectors[:, ::-1].T

    def horizontal_extent(self) -> float:
        """The largest standard deviation in the plane of x and y, m."""
        values = np.linalg.eigvalsh(self.scatter[:2, :2] / max(self.count, 1))
        return float(np.sqrt(max(values[-1], 0.0)))


class Observability(NamedTuple):
    """What of a gauge is determined.

    status, motion: see there.
    extent: standard deviations of the positions along their principal axes, (3,), m, descending.
    unobserved_axes: (K, 3), unit vectors in the ground truth's world: the positions do not tell a
    rotation about these.
    scale_observed: whether the scale is determined; True where it is not free.
    """

    status: Status
    motion: Motion
    extent: Array
    unobserved_axes: Array
    scale_observed: bool


def observability(gauge: Gauge, spread: Spread, log_scale_std: float = 0.0) -> Observability:
    """What of a gauge a trajectory determines.

    spread: of the ground truth's positions. log_scale_std: of the alignment found, with every
    other freedom unknown too.
    """
    extent, axes = spread.extents()
    extends = extent > spread.least
    motion = list(Motion)[int(extends.sum())]
    unobserved = np.zeros((0, 3))
    if gauge.name == "yaw_translation":
        if spread.horizontal_extent() <= spread.least:
            unobserved = np.array([[0.0, 0.0, 1.0]])
    elif gauge.dimension:
        if motion is Motion.STATIC:
            unobserved = np.eye(3)
        elif motion is Motion.STRAIGHT:
            unobserved = axes[:1]
    scale_observed = not gauge.has_scale or bool(
        motion is not Motion.STATIC and log_scale_std < _LARGEST_LOG_SCALE_STD
    )
    if spread.count == 0:
        status = Status.NO_POSES
    elif not scale_observed:
        status = Status.SCALE_NOT_OBSERVED
    elif len(unobserved):
        status = Status.BY_ORIENTATIONS_ONLY
    else:
        status = Status.OBSERVED
    return Observability(status, motion, extent, unobserved, scale_observed)
