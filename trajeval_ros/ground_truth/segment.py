# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A segment: consecutive ground-truth samples and the Gaussian process through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.ground_truth.hyperparameters import Hyperparameters
from trajeval_ros.ground_truth.kernels import Kernel
from trajeval_ros.ground_truth.regression import Regression

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Counts = npt.NDArray[np.intp]

_NANO = 1e-9


@dataclass(frozen=True, slots=True)
class Samples:
    """Ground-truth samples: ``stamps`` (n,) ns, increasing; ``poses`` (n, 4, 4) T_world_body.

    ``covariances`` (n, 6, 6) of the samples' errors, right perturbation, body frame; or None.
    """

    stamps: Stamps
    poses: Array
    covariances: Array | None = None

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.stamps)

    def __getitem__(self, index: slice) -> Samples:
        """Return consecutive samples."""
        covariances = None if self.covariances is None else self.covariances[index]
        return Samples(self.stamps[index], self.poses[index], covariances)

    def __add__(self, later: Samples) -> Samples:
        """Return these samples and the ``later`` ones."""
        covariances = None
        if self.covariances is not None and later.covariances is not None:
            covariances = np.concatenate([self.covariances, later.covariances])
        return Samples(
            np.concatenate([self.stamps, later.stamps]),
            np.concatenate([self.poses, later.poses]),
            covariances,
        )


class Segment:
    """Samples in local coordinates ``x_k = Log(T_ref⁻¹ T_k)`` about the first, and their process.

    It grows until it is closed, and does not change any more afterwards. The factorisation is made
    when it is first asked for, with the hyperparameters of that call, and kept.
    """

    def __init__(self, samples: Samples) -> None:
        """Open a segment with its first samples."""
        self._samples = samples
        self._coordinates = self.local(samples.poses)
        self._variances = self._sample_variances(samples, self._coordinates)
        self._regressions: tuple[tuple[slice, Regression], ...] = ()

    def __len__(self) -> int:
        """Number of samples."""
        return len(self._samples)

    @property
    def samples(self) -> Samples:
        """The samples so far."""
        return self._samples

    @property
    def times(self) -> Array:
        """Seconds since the first sample; (n,)."""
        return self._seconds(self._samples.stamps)

    @property
    def coordinates(self) -> Array:
        """``x_k``; (n, 6)."""
        return self._coordinates

    @property
    def start(self) -> int:
        """Stamp of the first sample."""
        return int(self._samples.stamps[0])

    def _seconds(self, stamps: Stamps) -> Array:
        return np.asarray((stamps - self._samples.stamps[0]) * _NANO)

    def local(self, poses: Array) -> Array:
        """Return ``Log(T_ref⁻¹ T)``; (n, 6)."""
        return se3.log(se3.compose(se3.inverse(self._samples.poses[0]), poses))

    def append(self, samples: Samples) -> None:
        """Add later samples."""
        coordinates = self.local(samples.poses)
        self._samples = self._samples + samples
        self._coordinates = np.concatenate([self._coordinates, coordinates])
        if self._variances is not None:
            more = self._sample_variances(samples, coordinates)
            assert more is not None
            self._variances = np.concatenate([self._variances, more])

    @staticmethod
    def _sample_variances(samples: Samples, coordinates: Array) -> Array | None:
        """Variances in local coordinates, ``diag(J_r⁻¹ Σ J_r⁻ᵀ)``; (n, 6) or None."""
        if samples.covariances is None:
            return None
        jacobian = se3.right_jacobian_inverse(coordinates)
        return np.asarray(np.einsum("nij,njk,nik->ni", jacobian, samples.covariances, jacobian))

    def _conditioned(
        self, kernel: Kernel, hyperparameters: Hyperparameters, count: int
    ) -> tuple[tuple[slice, Regression], ...]:
        """The regressions, conditioned on at least ``count`` samples.

        One a group of coordinates, or one a coordinate where each sample has its own variances.
        """
        groups = (
            (slice(0, 3), hyperparameters.translation),
            (slice(3, 6), hyperparameters.rotation),
        )
        if not self._regressions:
            width = 3 if self._variances is None else 1
            self._regressions = tuple(
                (slice(i, i + width), Regression(kernel, group, width))
                for columns, group in groups
                for i in range(columns.start, columns.stop, width)
            )
        if self._regressions[0][1].count < count:
            times = self.times
            for columns, regression in self._regressions:
                group = groups[columns.start // 3][1]
                noise = np.full(len(self), group.noise_std**2)
                if self._variances is not None:
                    noise = noise + self._variances[:, columns.start]
                regression.extend(times, self._coordinates[:, columns], noise)
        return self._regressions

    def posterior(
        self, kernel: Kernel, hyperparameters: Hyperparameters, stamps: Stamps, until: Stamps
    ) -> tuple[Array, Array]:
        """Return the poses at ``stamps`` (q,), given the samples stamped up to ``until`` (q,).

        The pose ``T_ref Exp(m)`` (q, 4, 4) in the world, and ``Σ = J_r(m) P J_r(m)ᵀ`` (q, 6, 6) of
        its right perturbation, in the body frame.
        """
        counts = np.searchsorted(self._samples.stamps, until, side="right")
        times = self._seconds(stamps)
        mean, variance = np.empty((len(stamps), 6)), np.empty((len(stamps), 6))
        for columns, regression in self._conditioned(
            kernel, hyperparameters, int(counts.max(initial=0))
        ):
            mean[:, columns], group = regression.posterior(times, counts)
            variance[:, columns] = group[:, None]
        jacobian = se3.right_jacobian(mean)
        covariance = np.einsum("qij,qj,qkj->qik", jacobian, variance, jacobian)
        return se3.compose(self._samples.poses[0], se3.exp(mean)), covariance
