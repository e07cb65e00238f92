# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth by itself: a pose with a covariance at any time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.blas import one_thread
from trajeval_ros.ground_truth.trajectory import Posterior
from trajeval_ros.library.settings import parameters_of
from trajeval_ros.library.trajectory import Trajectory, nanoseconds_of
from trajeval_ros.online.reference import Reference
from trajeval_ros.online.settings import settings_of


class GroundTruth:
    """A trajectory as a Gaussian process on SE(3) (``docs/method.md``, 2). Made by :meth:`fit`.

    >>> import numpy as np
    >>> import trajeval_ros as te
    >>> time = np.arange(0.0, 10.0, 0.05)
    >>> poses = np.tile(np.eye(4), (len(time), 1, 1))
    >>> poses[:, 0, 3] = np.sin(time)
    >>> at = te.GroundTruth.fit(te.Trajectory(time, poses)).at([5.02])
    >>> bool(abs(at.poses[0, 0, 3] - np.sin(5.02)) < 1e-3), at.covariances.shape
    (True, (1, 6, 6))
    """

    def __init__(self, reference: Reference) -> None:
        self._reference = reference

    @classmethod
    @one_thread()
    def fit(cls, trajectory: Trajectory, **settings: object) -> GroundTruth:
        """Screen the samples, learn the process and condition it on them.

        ``settings``: as of :func:`~trajeval_ros.evaluate`. Raises :class:`ValueError` for a setting
        that is unknown or out of range, and for too few usable samples.
        """
        reference = Reference(settings_of(parameters_of(settings)).ground_truth)
        reference.add(trajectory.samples)
        reference.conclude()
        if not reference.is_ready:
            raise ValueError(f"{trajectory.name}: too few usable samples to learn a process from")
        return cls(reference)

    @one_thread()
    def at(self, stamps: npt.ArrayLike) -> Posterior:
        """Return poses and covariances at ``stamps`` (q,): int64 ns or float s, in any order.

        ``.poses`` (q, 4, 4) T_world_body, ``.covariances`` (q, 6, 6) of their right perturbation
        (body frame, translation first, m and rad). Raises :class:`ValueError` for a stamp before
        the first sample or after the last.
        """
        asked = np.atleast_1d(nanoseconds_of(np.asarray(stamps)))
        truth = self._reference.ground_truth
        first, last = int(truth.stamps[0]), int(truth.stamps[-1])
        if len(asked) and (asked.min() < first or asked.max() > last):
            raise ValueError(
                f"the ground truth is known from {first * 1e-9:.9f} s to {last * 1e-9:.9f} s only"
            )
        return truth.posterior(asked, np.full(len(asked), last))
