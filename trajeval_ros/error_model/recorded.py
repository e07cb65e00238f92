# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth as it was answered at the poses of a stretch, and in between.

What was evaluated is there already: pose, covariance and twist. So a fit needs neither the process
nor its samples, which are long forgotten.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.error_model.nuisances import Truth

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# s. A cubic between two poses with their twists errs by a 384th of its fourth power: 0.1 mm of a
# hand that shakes by 10 cm, 1.5 times a second.
_WIDEST = 0.15


class Recorded(NamedTuple):
    """Answers at N instants: stamps (N,) ns, increasing; poses, covariances, twists as in `Truth`.

    Cubics in position and rotation vector that have the twists at both ends go from one to the
    next, where they are no further apart than 0.15 s.
    """

    stamps: Stamps
    poses: Array
    covariances: Array
    twists: Array

    def at(self, stamps: Stamps, near: float = 0.0) -> Truth:
        """The answers at ``stamps`` (n,).

        near: where there is no cubic, the nearest answer holds for so long, s, along its twist.
        """
        if np.array_equal(stamps, self.stamps):
            every = np.ones(len(stamps), dtype=np.bool_)
            return Truth(self.poses, self.covariances, self.twists, every)
        if loops.there():
            return self._at_in_c(stamps, near)
        last = len(self.stamps) - 1
        before = np.clip(
            np.searchsorted(self.stamps, stamps, side="right") - 1, 0, max(last - 1, 0)
        )
        after = np.minimum(before + 1, last)
        length = (self.stamps[after] - self.stamps[before]) * 1e-9
        since = (stamps - self.stamps[before]) * 1e-9
        share = np.clip(since / np.where(length > 0.0, length, 1.0), 0.0, 1.0)[:, None]
        exact = (stamps == self.stamps[before]) | (stamps == self.stamps[after])
        inside = (since >= 0.0) & (since <= length)
        start, end = self.poses[before], self.poses[after]
        first, second = self.twists[before], self.twists[after]
        span = length[:, None]
        poses = np.tile(np.eye(4), (len(stamps), 1, 1))
        poses[:, :3, 3] = _cubic(
            share,
            start[:, :3, 3],
            end[:, :3, 3],
            span * _turned(start, first[:, :3]),
            span * _turned(end, second[:, :3]),
        )
        turn = se3.log_so3(np.swapaxes(start[:, :3, :3], 1, 2) @ end[:, :3, :3])
        local = se3.right_jacobian_inverse(np.concatenate([np.zeros_like(turn), turn], axis=1))
        slope = (local[:, 3:, 3:] @ second[:, 3:, None])[..., 0]
        angle = _cubic(share, np.zeros_like(turn), turn, span * first[:, 3:], span * slope)
        poses[:, :3, :3] = start[:, :3, :3] @ se3.exp_so3(angle)
        mixed = share[..., None]
        covariances = (1.0 - mixed) * self.covariances[before] + mixed * self.covariances[after]
        twists = (1.0 - share) * first + share * second
        valid = exact | (inside & (length <= _WIDEST))
        if near > 0.0 and not valid.all():
            nearest = np.where(np.abs(since) < np.abs(since - length), before, after)
            shift = (stamps - self.stamps[nearest]) * 1e-9
            held = ~valid & (np.abs(shift) < near)
            nearest, valid = nearest[held], valid | held
            twists[held], covariances[held] = self.twists[nearest], self.covariances[nearest]
            poses[held] = self.poses[nearest] @ se3.exp(twists[held] * shift[held, None])
        return Truth(poses, covariances, twists, valid)

    def _at_in_c(self, stamps: Stamps, near: float) -> Truth:
        """As `at`."""
        n, m = len(self.stamps), len(stamps)
        poses, covariances, twists = np.empty((m, 4, 4)), np.empty((m, 6, 6)), np.empty((m, 6))
        valid = np.empty(m, dtype=np.bool_)
        exponential, logarithm = se3.EXPONENTIAL_TABLE, se3.LOGARITHM_TABLE
        loops.call(
            "recorded_at",
            n,
            m,
            np.ascontiguousarray(self.stamps),
            *map(loops.doubles, (self.poses, self.covariances, self.twists)),
            np.ascontiguousarray(stamps),
            _WIDEST,
            float(near),
            exponential,
            len(exponential),
            logarithm,
            len(logarithm),
            poses,
            covariances,
            twists,
            valid,
        )
        return Truth(poses, covariances, twists, valid)


def _turned(poses: Array, vectors: Array) -> Array:
    """Vectors (n, 3) of the body in the world."""
    return np.asarray((poses[:, :3, :3] @ vectors[..., None])[..., 0])


def _cubic(s: Array, p: Array, q: Array, u: Array, v: Array) -> Array:
    """From p with the slope u to q with the slope v, as s (n, 1) goes from 0 to 1."""
    a, b = s * s, s * s * s
    return np.asarray(
        p + (3.0 * a - 2.0 * b) * (q - p) + (s - 2.0 * a + b) * u + (b - a) * v, np.float64
    )
