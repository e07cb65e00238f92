# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A segment: consecutive ground-truth samples and the Gaussian process through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.ground_truth.hyperparameters import (
    LEAST_SCALE,
    GroupHyperparameters,
    Hyperparameters,
)
from trajeval_ros.ground_truth.kernels import Kernel
from trajeval_ros.ground_truth.regression import Regression, scale

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


@dataclass(frozen=True, slots=True)
class Process:
    """The Gaussian process of a segment: a sum of kernels and its hyperparameters.

    ``accuracy``: the instrument's, in translation (m) and rotation (rad); a segment's scale does
    not bring the noise below it.
    """

    kernels: tuple[Kernel, ...]
    hyperparameters: Hyperparameters
    accuracy: tuple[float, float]

    @property
    def groups(self) -> tuple[GroupHyperparameters, GroupHyperparameters]:
        """The hyperparameters of translation and rotation."""
        return self.hyperparameters.translation, self.hyperparameters.rotation

    @property
    def variances(self) -> tuple[Array, Array]:
        """``k(t, t)`` and the noise's standard deviation of each coordinate; (6,)."""
        signal = [sum(c.std**2 for c in group.components) for group in self.groups]
        return np.repeat(signal, 3), np.repeat([group.noise_std for group in self.groups], 3)

    @property
    def least_scales(self) -> tuple[float, ...]:
        """The least ``s²`` of translation and rotation."""
        noises = (group.noise_std for group in self.groups)
        return tuple(
            max(LEAST_SCALE, min((floor / noise) ** 2, 1.0))
            for floor, noise in zip(self.accuracy, noises, strict=True)
        )


@dataclass(frozen=True, slots=True)
class Answer:
    """What a segment says of q queries.

    ``poses`` (q, 4, 4) in the world; ``covariances`` ``Σ = B P Bᵀ`` (q, 6, 6) of their right
    perturbation, in the body frame; ``to_body`` B (q, 6, 6); ``variances`` P (q, 6) of the local
    coordinates, with the squares of ``scales`` s (q, 6).
    """

    poses: Array
    covariances: Array
    to_body: Array
    variances: Array
    scales: Array


class Segment:
    """Samples in local coordinates about the first one, and the Gaussian process through them.

    The coordinates are those of R³ x SO(3), ``x_k = (R_refᵀ (p_k - p_ref), Log(R_refᵀ R_k))``, and
    not of se(3): ``Log(T_ref⁻¹ T_k)`` has the translation part ``J_l(φ)⁻¹ R_refᵀ (p_k - p_ref)``,
    in which every roughness of the rotation becomes one of the translation (``docs/method.md``).

    It grows until it is closed, and does not change any more afterwards. The factorisation is made
    when it is first asked for, with the hyperparameters of that call, and kept.
    """

    def __init__(self, samples: Samples) -> None:
        """Open a segment with its first samples."""
        self._samples = samples
        self._coordinates = _continued(self._local(samples.poses))
        self._variances = self._sample_variances(samples, self._coordinates)
        self._regressions: tuple[tuple[Regression, ...], ...] = ()

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
    def variances(self) -> Array | None:
        """The samples' own variances in local coordinates; (n, 6), or None without any."""
        return self._variances

    @property
    def start(self) -> int:
        """Stamp of the first sample."""
        return int(self._samples.stamps[0])

    def _seconds(self, stamps: Stamps) -> Array:
        return np.asarray((stamps - self._samples.stamps[0]) * _NANO)

    def following(self, poses: Array) -> Array:
        """Return the coordinates of ``poses`` (n, 4, 4) that follow the last sample; (n, 6)."""
        last = self._coordinates[-1:]
        return _continued(np.concatenate([last, self._local(poses)]))[1:]

    def _local(self, poses: Array) -> Array:
        """Return ``x = (R_refᵀ (p - p_ref), Log(R_refᵀ R))``; (n, 6)."""
        reference = self._samples.poses[0]
        back = reference[:3, :3].T
        offset = poses[:, :3, 3] - reference[:3, 3]
        # Term by term, and not by BLAS, whose last digit depends on how many poses there are.
        position = (
            offset[:, :1] * back[:, 0] + offset[:, 1:2] * back[:, 1] + offset[:, 2:] * back[:, 2]
        )
        return np.concatenate([position, se3.log_so3(back @ poses[:, :3, :3])], axis=-1)

    def append(self, samples: Samples) -> None:
        """Add later samples."""
        coordinates = self.following(samples.poses)
        self._samples = self._samples + samples
        self._coordinates = np.concatenate([self._coordinates, coordinates])
        if self._variances is not None:
            more = self._sample_variances(samples, coordinates)
            assert more is not None
            self._variances = np.concatenate([self._variances, more])

    @staticmethod
    def _sample_variances(samples: Samples, coordinates: Array) -> Array | None:
        """Variances in local coordinates, ``diag(B⁻¹ Σ B⁻ᵀ)`` with B of `_to_body`; (n, 6)."""
        if samples.covariances is None:
            return None
        to_local = np.linalg.inv(_to_body(coordinates[:, 3:]))
        return np.asarray(np.einsum("nij,njk,nik->ni", to_local, samples.covariances, to_local))

    def _conditioned(self, process: Process, count: int) -> tuple[tuple[Regression, ...], ...]:
        """The regressions of translation and rotation, conditioned on at least ``count`` samples.

        One a group of coordinates, or one a coordinate where each sample has its own variances.
        """
        width = 3 if self._variances is None else 1
        if not self._regressions:
            self._regressions = tuple(
                tuple(Regression(process.kernels, group, width) for _ in range(0, 3, width))
                for group in process.groups
            )
        if self._regressions[0][0].count < count:
            times, coordinates = self.times, iter(range(0, 6, width))
            for regressions, group in zip(self._regressions, process.groups, strict=True):
                for regression, first in zip(regressions, coordinates, strict=False):
                    noise = np.full(len(self), group.noise_std**2)
                    if self._variances is not None:
                        noise = noise + self._variances[:, first]
                    regression.extend(times, self._coordinates[:, first : first + width], noise)
        return self._regressions

    def posterior(self, process: Process, stamps: Stamps, until: Stamps) -> Answer:
        """Return the poses at ``stamps`` (q,), given the samples stamped up to ``until`` (q,)."""
        counts = np.searchsorted(self._samples.stamps, until, side="right")
        times = self._seconds(stamps)
        means, variances, squared_scales = [], [], []
        conditioned = self._conditioned(process, int(counts.max(initial=0)))
        for regressions, least in zip(conditioned, process.least_scales, strict=True):
            answers = [regression.posterior(times, counts) for regression in regressions]
            squares = np.add.reduce([regression.squares(counts) for regression in regressions])
            factor = scale(squares, counts, 3, least)
            squared_scales += [factor] * 3
            for mean_part, variance_part in answers:
                means.append(mean_part)
                variances += [factor * variance_part] * mean_part.shape[1]
        mean, variance = np.concatenate(means, axis=-1), np.stack(variances, axis=-1)
        to_body = _to_body(mean[:, 3:])
        covariance = np.einsum("qij,qj,qkj->qik", to_body, variance, to_body)
        scales = np.sqrt(np.stack(squared_scales, axis=-1))
        return Answer(self._pose(mean), covariance, to_body, variance, scales)

    def cross_variances(
        self, process: Process, stamps: Stamps, known: int, until: Stamps
    ) -> list[Array]:
        """Return each query's covariances over ``s²`` with all the queries before it.

        ``stamps`` (k + q,), increasing, k = ``known``; ``until`` (q,) of the last q, not
        decreasing. Each (k + i, 6), i = 0 ... q - 1, by local coordinate, given the later query's
        samples.
        """
        counts = np.searchsorted(self._samples.stamps, until, side="right")
        times = self._seconds(stamps)
        columns = []
        for regressions in self._conditioned(process, int(counts.max(initial=0))):
            for regression in regressions:
                rows = regression.cross_variances(times, known, counts)
                columns.append([np.repeat(row[:, None], 3 // len(regressions), 1) for row in rows])
        return [np.concatenate(row, axis=1) for row in zip(*columns, strict=True)]

    def _pose(self, coordinates: Array) -> Array:
        """The pose with local coordinates (q, 6); (q, 4, 4)."""
        reference = self._samples.poses[0]
        pose = np.zeros((len(coordinates), 4, 4))
        pose[:, :3, :3] = reference[:3, :3] @ se3.exp_so3(coordinates[:, 3:])
        pose[:, :3, 3] = reference[:3, 3] + coordinates[:, :3] @ reference[:3, :3].T
        pose[:, 3, 3] = 1.0
        return pose


def _continued(coordinates: Array) -> Array:
    """The coordinates (n, 6) with each rotation vector on the branch nearest to the one before.

    ``Log`` jumps by 2π about its axis where a rotation passes π; ``Exp`` and ``J_r`` do not mind.
    """
    jumps = np.flatnonzero(np.linalg.norm(np.diff(coordinates[:, 3:], axis=0), axis=-1) > np.pi)
    if not len(jumps):
        return coordinates
    coordinates = coordinates.copy()
    phi = coordinates[:, 3:]
    for i in range(jumps[0] + 1, len(phi)):  # each from the one before; hardly ever, and not many
        angle = float(np.linalg.norm(phi[i]))
        if np.linalg.norm(phi[i] - phi[i - 1]) > np.pi and angle > 0.0:
            turns = np.rint((phi[i - 1] @ phi[i] / angle - angle) / (2.0 * np.pi))
            phi[i] *= 1.0 + 2.0 * np.pi * turns / angle
    return coordinates


def _to_body(phi: Array) -> Array:
    """``B = blkdiag(Exp(φ)ᵀ, J_r(φ))``, from local to right perturbations; (n, 6, 6)."""
    result = np.zeros((len(phi), 6, 6))
    result[:, :3, :3] = np.swapaxes(se3.exp_so3(phi), -1, -2)
    tangent = np.concatenate([np.zeros_like(phi), phi], axis=-1)
    result[:, 3:, 3:] = se3.right_jacobian(tangent)[:, 3:, 3:]
    return result
