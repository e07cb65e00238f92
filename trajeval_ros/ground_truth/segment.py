# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A segment: consecutive ground-truth samples and the Gaussian process through them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth.adaptation import (
    Adaptation,
    Epoch,
    Values,
    epoch_scales,
)
from trajeval_ros.ground_truth.kernels import Matern
from trajeval_ros.ground_truth.process import AS_LEARNED, Process, Regimes
from trajeval_ros.ground_truth.regression import posteriors
from trajeval_ros.ground_truth.stamps import HISTORY, slopes

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


class Twists(NamedTuple):
    """Body twists ``means`` (q, 6), m/s and rad/s, and their ``covariances`` (q, 6, 6).

    The process's own derivative: of its motion, not of its correlated noise.
    """

    means: Array
    covariances: Array


@dataclass(frozen=True, slots=True)
class Answer:
    """What segments say of q queries.

    ``poses`` (q, 4, 4) in the world; ``covariances`` ``Σ = B P Bᵀ`` (q, 6, 6) of their right
    perturbation, in the body frame; ``to_body`` B (q, 6, 6); ``variances`` P (q, 6) of the local
    coordinates, with the squares of ``scales`` s (q, 6); ``twists``, where they were asked for: of
    the local coordinates' derivative ``ẋ`` they are ``B ẋ``.
    """

    poses: Array
    covariances: Array
    to_body: Array
    variances: Array
    scales: Array
    twists: Twists | None = None

    def __getitem__(self, index: slice) -> Answer:
        """Return consecutive answers."""
        return Answer(
            self.poses[index],
            self.covariances[index],
            self.to_body[index],
            self.variances[index],
            self.scales[index],
        )


class Asked(NamedTuple):
    """What an epoch of a segment is asked: at ``stamps`` (q,), given the samples ``until`` (q,)."""

    segment: Segment
    epoch: Epoch
    stamps: Stamps
    until: Stamps


def answers(asked: Sequence[Asked], twists: bool = False) -> Answer:
    """What segments say, one after the other."""
    kinds = 2 if twists else 1
    nothing = np.empty((kinds, 0, 6)), np.empty((kinds, 0, 6)), np.empty((0, 6))
    local = [nothing] + [
        _local_answers(list(some), kinds)
        for _, some in groupby(asked, key=lambda each: each.epoch.regression.groups)
    ]
    means, variances, factor = (np.concatenate(each, axis=-2) for each in zip(*local, strict=True))
    references = [each.segment.samples.poses[:1] for each in asked]
    sizes = [len(each.stamps) for each in asked]
    reference = np.concatenate([np.empty((0, 4, 4)), *references]).repeat(sizes, axis=0)
    return _in_world(reference, means, factor * variances, np.sqrt(factor))


def _local_answers(asked: Sequence[Asked], kinds: int) -> tuple[Array, Array, Array]:
    """Means (k, q, 6) and variances over ``s²`` (k, q, 6) of the local coordinates, and ``s²``.

    With k = 2 of their derivative, too; ``s²`` (q, 6).
    """
    counts = [each.segment.counts(each.until) for each in asked]
    means, variances, squares = posteriors(
        [
            (each.epoch.regression, each.segment.seconds(each.stamps), number)
            for each, number in zip(asked, counts, strict=True)
        ],
        kinds,
    )
    scales = epoch_scales([each.epoch for each in asked], counts, squares)
    return (
        means.reshape(kinds, -1, 6),
        np.repeat(variances, means.shape[3], axis=2),
        np.repeat(scales, 3, axis=1),
    )


def _in_world(references: Array, means: Array, variances: Array, scales: Array) -> Answer:
    """Of local coordinates about ``references`` (q, 4, 4); the others as in `_local_answers`."""
    mean = means[0]
    rotation = se3.exp_so3(mean[:, 3:])
    poses = references.copy()
    poses[:, :3, :3] = references[:, :3, :3] @ rotation
    poses[:, :3, 3] += (references[:, :3, :3] @ mean[:, :3, None])[..., 0]
    to_body = _to_body(mean[:, 3:], rotation)
    covariances = (to_body * variances[:, :, None]) @ np.swapaxes(to_body, 1, 2)
    twists = None
    if len(means) > 1:
        twists = Twists((to_body @ means[1, :, :, None])[..., 0], covariances[1])
    return Answer(poses, covariances[0], to_body, variances[0], scales, twists)


class Segment:
    """Samples in local coordinates about the first one, and the Gaussian process through them.

    The coordinates are those of R³ x SO(3), ``x_k = (R_refᵀ (p_k - p_ref), Log(R_refᵀ R_k))``, and
    not of se(3): ``Log(T_ref⁻¹ T_k)`` has the translation part ``J_l(φ)⁻¹ R_refᵀ (p_k - p_ref)``,
    in which every roughness of the rotation becomes one of the translation (``docs/method.md``).

    It grows until it is closed, and does not change any more afterwards. The factorisation is made
    when its process is known, and kept.
    """

    def __init__(self, samples: Samples, before: Samples | None = None) -> None:
        """Open a segment with its first samples; ``before``: some that came before them."""
        self._samples = samples
        self.before = samples[:0] if before is None else before
        # Of the first samples, as far as they were asked for.
        self._coordinates = np.empty((0, 6))
        self._variances = np.empty((0, 6))
        self._slopes = np.empty((0, 6))
        self._adaptation: Adaptation | None = None
        self._lying: tuple[Stamps, Array, tuple[int, int, int]] | None = None

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
        return self.seconds(self._samples.stamps)

    @property
    def coordinates(self) -> Array:
        """``x_k``; (n, 6)."""
        if len(self._coordinates) < len(self):
            self.following(np.empty((0, 4, 4)))
        return self._coordinates

    @property
    def variances(self) -> Array | None:
        """The samples' own variances in local coordinates, or None without any; (n, 6).

        They are ``diag(B⁻¹ Σ B⁻ᵀ)`` with B of `_to_body`.
        """
        if self._samples.covariances is None:
            return None
        known = len(self._variances)
        if known < len(self):
            phi = self.coordinates[known:, 3:]
            to_local = np.linalg.inv(_to_body(phi, se3.exp_so3(phi)))
            covariances = self._samples.covariances[known:]
            further = np.einsum("nij,njk,nik->ni", to_local, covariances, to_local)
            self._variances = np.concatenate([self._variances, further])
        return self._variances

    @property
    def slopes(self) -> Array:
        """``ẋ_k`` from the samples up to the k-th, of local coordinates; (n, 6), m/s and rad/s."""
        known, earlier = len(self._slopes), len(self.before)
        if known < len(self):
            times = np.concatenate([self.seconds(self.before.stamps), self.times])
            x = np.concatenate([self._local(self.before.poses), self.coordinates])
            first = max(earlier + known - HISTORY, 0)
            further = slopes(times[first:], x[first:], earlier + known - first)
            self._slopes = np.concatenate([self._slopes, further])
        return self._slopes

    def known_variances(self, stamp_std: float) -> Array | None:
        """The samples' own variances, and those of stamps with a ``stamp_std`` (s); (n, 6).

        None without any.
        """
        own = self.variances
        if not stamp_std:
            return own
        along = (stamp_std * self.slopes) ** 2
        return along if own is None else own + along

    @property
    def start(self) -> int:
        """Stamp of the first sample."""
        return int(self._samples.stamps[0])

    def seconds(self, stamps: Stamps) -> Array:
        """Seconds since the first sample; (q,)."""
        return np.asarray((stamps - self._samples.stamps[0]) * _NANO)

    def following(self, poses: Array) -> Array:
        """Return the coordinates of ``poses`` (n, 4, 4) that follow the last sample; (n, 6)."""
        known = self._coordinates
        missing = len(self) - len(known)
        if missing:
            poses = np.concatenate([self._samples.poses[len(known) :], poses])
        further = self._further(known[-1:], poses)
        if missing:
            self._coordinates = np.concatenate([known, further[:missing]])
        return further[missing:]

    @property
    def reference(self) -> Array:
        """The first sample's pose; (4, 4)."""
        return loops.doubles(self._samples.poses[0])

    @property
    def addresses(self) -> tuple[int, int, int]:
        """How many samples it has, and where their stamps and the reference lie until more come."""
        if self._lying is None:
            stamps, reference = np.ascontiguousarray(self._samples.stamps), self.reference
            places = loops.address(stamps), loops.address(reference)
            self._lying = stamps, reference, (len(stamps), *places)
        return self._lying[2]

    def room_after(self, count: int) -> Array:
        """Room for the coordinates of so many samples after the last one's; (1 + count, 6)."""
        room = np.empty((1 + count, 6))
        room[0] = self.coordinates[-1]
        return room

    def _further(self, before: Array, poses: Array) -> Array:
        """The coordinates of ``poses`` (n, 4, 4), after the one ``before``, if there is; (n, 6)."""
        if not loops.there():
            return _continued(np.concatenate([before, self._local(poses)]))[len(before) :]
        coordinates = np.empty((len(before) + len(poses), 6))
        coordinates[: len(before)] = before
        loops.call(
            "local_coordinates",
            loops.doubles(self._samples.poses[0]),
            loops.doubles(poses),
            len(poses),
            len(before),
            coordinates,
        )
        return coordinates[len(before) :]

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

    def append(self, samples: Samples, coordinates: Array | None = None) -> None:
        """Add later samples, with their coordinates where these are known from `following`."""
        self._samples, self._lying = self._samples + samples, None
        if coordinates is not None:
            self._coordinates = np.concatenate([self._coordinates, coordinates])

    def values(self, process: Process) -> Values:
        """The samples as a regression under ``process`` takes them.

        Its groups are translation and rotation, or each coordinate where each sample has its own
        variances.
        """
        variances = self.known_variances(process.stamp_std)
        size = 2 if variances is None else 6
        values = self.coordinates.reshape(len(self), size, -1)
        if variances is None:
            variances = np.zeros((len(self), size))
        return Values(self.times, values, variances)

    @property
    def unconditioned(self) -> Segment:
        """The samples alone, without what is known of the process: a tenth of the memory."""
        alone = copy.copy(self)
        alone._adaptation = None
        return alone

    @property
    def begun(self) -> bool:
        """Whether its process is known."""
        return self._adaptation is not None

    def begin(self, process: Process, regimes: Regimes = AS_LEARNED) -> None:
        """Let ``process`` be the segment's, at first in ``regimes``."""
        self._adaptation = Adaptation(process, regimes)

    @property
    def rests(self) -> bool:
        """Whether it answers only once it is made to `advance`, its process being known."""
        return self._adaptation is not None and self._adaptation.count < len(self)

    @property
    def is_asked_in_c(self) -> bool:
        """Whether it is factored in C, or will be: then `at_once` asks it."""
        known = self._known
        if known.epochs:
            return known.epochs[0].regression.is_in_c
        return loops.there() and all(isinstance(each, Matern) for each in known.process.kernels)

    def advance(self) -> None:
        """Condition it on all its samples so far, its process being known."""
        if self._known.count < len(self):
            self._known.take(self.values(self._known.process))

    def rest(self) -> None:
        """Drop the factorisation, most of the memory; `advance` makes the same again."""
        self._adaptation = self._known.anew()

    @property
    def _known(self) -> Adaptation:
        if self._adaptation is None:
            raise ValueError("the segment's process is not known yet")
        return self._adaptation

    @property
    def epochs(self) -> list[Epoch]:
        """The stretches that `advance` has seen."""
        return self._known.epochs

    def regimes(self, process: Process, until: int) -> Regimes:
        """The regimes that a segment with ``process`` begins in after the samples up to ``until``.

        They are those this segment is in; under another process, those that predict its samples
        best.
        """
        known, count = self._known, int(self.counts(np.array([until]))[0])
        return known.regimes(process, count, lambda: self.values(known.process))

    def counts(self, until: Stamps) -> Counts:
        """Number of samples stamped up to each of ``until`` (q,)."""
        return np.searchsorted(self._samples.stamps, until, side="right")

    def cross_variances(
        self, epoch: Epoch, stamps: Stamps, known: int, until: Stamps
    ) -> list[Array]:
        """Return each query's covariances over ``s²`` with all the queries before it.

        ``stamps`` (k + q,), increasing, k = ``known``; ``until`` (q,) of the last q, not
        decreasing. Each (k + i, 6), i = 0 ... q - 1, by local coordinate, given the later query's
        samples.
        """
        counts = self.counts(until)
        rows = epoch.regression.cross_variances(self.seconds(stamps), known, counts)
        return [np.repeat(row, 6 // row.shape[1], axis=1) for row in rows]


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


def _to_body(phi: Array, rotation: Array) -> Array:
    """``B = blkdiag(Exp(φ)ᵀ, J_r(φ))``, from local to right perturbations; (n, 6, 6).

    ``rotation``: ``Exp(φ)`` (n, 3, 3).
    """
    result = np.zeros((len(phi), 6, 6))
    result[:, :3, :3] = np.swapaxes(rotation, -1, -2)
    result[:, 3:, 3:] = se3.right_jacobian_so3(phi)
    return result
