# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model where the ground truth is sampled more rarely than the estimate comes.

A fit takes the ground truth's errors for independent from pose to pose. Those of poses between the
same two samples are nearly one: counted as many, they are known too well, and what they have in
common is taken for a clock or a lever arm. So the fit is of the ground truth's samples, and the
estimate, which comes more often, is what is interpolated there; what a clock offset does goes by
the estimate's own twist, too, as the ground truth's between rare samples may be anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.error_model.fit import ENOUGH, fit
from trajeval_ros.error_model.independent import independent
from trajeval_ros.error_model.model import ErrorModel
from trajeval_ros.error_model.nuisances import Ask, Nuisances, Truth
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

# The estimate is interpolated anew at the clock found until that moves by less than this share of
# its standard deviation; so often at most.
_CONVERGED = 0.1
_PASSES = 6
# The poses on each side by which it is interpolated, and by which its twist is found: the latter
# within this share of the interval between samples.
_SIDE = 2
_LEAST_SIDE, _LONG_SIDE = 3, 8
_SHARE = 0.125
# Poses on both sides of a sample are no further apart than this share of that interval.
_APART = 0.5
# Where two poses are so near in time that a cubic through four would make more than this of their
# noise's variance, there is none.
_MOST_NOISE = 2.0
# Of stamps that scatter by more than this share of the interval between poses, an interpolated pose
# does not err in proportion.
_SCATTER = 0.1


def fit_independent(
    stamps: Stamps,
    estimate: Array,
    nearest: Stamps,
    ask: Ask,
    known: Truth | None = None,
    most: int | None = None,
    *,
    parts: bool = True,
) -> ErrorModel | None:
    """Fit the error model, where errors are independent; as `trajeval_ros.error_model.fit.fit`.

    stamps: (N,) ns, as evaluated, on the ground truth's clock. nearest: of its sample nearest to
    each pose, (N,) ns. most: no more poses count than so many, evenly.
    """
    chosen = independent(stamps, nearest)
    every = 1 if most is None else -(-len(chosen) // most)
    if len(chosen) == len(stamps):
        if every > 1 and known is not None:
            known = Truth(
                known.poses[::every],
                known.covariances[::every],
                known.twists[::every],
                known.valid[::every],
            )
        return fit(stamps[::every], estimate[::every], ask, known, parts=parts)
    found = _at_samples(_Between(stamps, estimate), np.unique(nearest)[::every], ask, parts)
    if found is not None:
        return found
    return fit(stamps[chosen][::every], estimate[chosen][::every], ask, parts=parts)


def _at_samples(between: _Between, samples: Stamps, ask: Ask, parts: bool) -> ErrorModel | None:
    """Fit at the ground truth's samples (n,), ns; None where too few can be asked."""
    answered = ask(samples)
    samples = samples[answered.valid]
    if len(samples) < ENOUGH:
        return None
    interval = int(median(np.diff(samples)))
    most_scatter = _SCATTER * 1e-9 * median(np.diff(between.stamps))
    poses, covariances = answered.poses[answered.valid], answered.covariances[answered.valid]
    found: ErrorModel | None = None
    middle = 0
    for _ in range(_PASSES):
        before = Nuisances.none() if found is None else found.nuisances
        shift = before.clock_offset * 1e9 + before.clock_rate * (samples - middle)
        stamps = samples - np.rint(shift).astype(np.int64)
        inside = between.reaches(stamps, round(_APART * interval))
        stamps = stamps[inside]
        if len(stamps) < ENOUGH:
            return None
        estimate, averaged = between.poses(stamps)
        if found is not None:
            twists = between.twists(stamps, round(_SHARE * interval))
            twists[:, :3] *= before.scale
            twists = twists @ se3.adjoint(before.extrinsic).T
            ask = _Moved(samples[inside], poses[inside], covariances[inside], twists)
        first, found = (
            found is None,
            fit(stamps, estimate, ask, most_scatter=most_scatter, parts=parts),
        )
        if found is None:
            return None
        middle = (int(stamps[0]) + int(stamps[-1])) // 2
        step = found.nuisances.vector[:2] - before.vector[:2]
        if not first and (np.abs(step) < _CONVERGED * found.std[:2]).all():
            break
    return None if found is None else _with_whole_jitter(found, averaged)


def _with_whole_jitter(model: ErrorModel, averaged: float) -> ErrorModel:
    """With the jitter of poses and stamps; interpolated ones have ``averaged`` of its variance."""
    name = "jitter_std"
    factor = float(np.sqrt(averaged))
    groups = {
        group: {**figures, name: figures[name].divided(factor)}
        for group, figures in model.groups.items()
    }
    stamps = model.stamps and model.stamps.larger(1.0 / factor)
    return model._replace(groups=groups, stamps=stamps)


@dataclass(frozen=True, slots=True)
class _Moved:
    """A ground truth at its samples (n,), which near each goes on with the ``twists`` given."""

    samples: Stamps
    poses: Array
    covariances: Array
    twists: Array

    def __call__(self, stamps: Stamps) -> Truth:
        """The poses at ``stamps`` (n,), one near each sample."""
        since = (stamps - self.samples) * 1e-9
        poses = self.poses @ se3.exp(self.twists * since[:, None])
        every = np.ones(len(stamps), dtype=np.bool_)
        return Truth(poses, self.covariances, self.twists, every)


class _Between(NamedTuple):
    """An estimate between its poses (N, 4, 4) at ``stamps`` (N,) ns, increasing."""

    stamps: Stamps
    estimate: Array

    def reaches(self, stamps: Stamps, longest: int) -> Mask:
        """Where there are enough poses on both sides of ``stamps`` (n,), no gap between them."""
        after = np.searchsorted(self.stamps, stamps)
        inside = (after >= _LEAST_SIDE) & (after <= len(self.stamps) - _LEAST_SIDE)
        if not inside.any():
            return inside
        place = np.where(inside, after, _LEAST_SIDE)
        inside &= self.stamps[place] - self.stamps[place - 1] <= longest
        if inside.any():
            _, weights = self._cubics(stamps[inside])
            inside[inside] = (weights**2).sum(axis=1) <= _MOST_NOISE
        return np.asarray(inside)

    def poses(self, stamps: Stamps) -> tuple[Array, float]:
        """Poses (n, 4, 4) by cubics through four, and what of white noise's variance they have."""
        index, weights = self._cubics(stamps)
        base, local = self._local(index, _SIDE - 1)
        step = np.einsum("nk,nkx->nx", weights, local)
        found = base.copy()
        found[:, :3, 3] += (base[:, :3, :3] @ step[:, :3, None])[..., 0]
        found[:, :3, :3] = base[:, :3, :3] @ se3.exp_so3(step[:, 3:])
        return found, float((weights**2).sum(axis=1).mean())

    def _cubics(self, stamps: Stamps) -> tuple[Indices, Array]:
        """The four poses around each of ``stamps`` (n,), and their weights; (n, 4) each."""
        index = np.searchsorted(self.stamps, stamps)[:, None] + np.arange(-_SIDE, _SIDE)
        times = (self.stamps[index] - stamps[:, None]) * 1e-9
        weights = np.ones_like(times)
        for i in range(2 * _SIDE):
            for j in range(2 * _SIDE):
                if i != j:  # Lagrange's polynomials at 0
                    weights[:, i] *= times[:, j] / (times[:, j] - times[:, i])
        return index, weights

    def twists(self, stamps: Stamps, half: int) -> Array:
        """Body twists (n, 6) by parabolas through the poses within ``half`` (ns).

        With the weights of `poses` as another column their white noise has nothing to do with that
        of the poses: together the two would look like a clock offset.
        """
        after = np.searchsorted(self.stamps, stamps)
        first = np.minimum(np.searchsorted(self.stamps, stamps - half), after - _LEAST_SIDE)
        last = np.searchsorted(self.stamps, stamps + half, side="right")
        last = np.maximum(last, after + _LEAST_SIDE)
        first, last = np.maximum(first, after - _LONG_SIDE), np.minimum(last, after + _LONG_SIDE)
        index = after[:, None] + np.arange(-_LONG_SIDE, _LONG_SIDE)
        counted = (index >= first[:, None]) & (index < last[:, None])
        index = np.clip(index, 0, len(self.stamps) - 1)
        times = (self.stamps[index] - stamps[:, None]) * 1e-9
        weights = np.zeros_like(times)
        weights[:, _LONG_SIDE - _SIDE : _LONG_SIDE + _SIDE] = self._cubics(stamps)[1]
        columns = np.stack([np.ones_like(times), times, times**2, weights], axis=2)
        columns *= counted[..., None]
        _, local = self._local(index, _LONG_SIDE - 1)
        right = np.einsum("nka,nkx->nax", columns, local)
        return np.asarray(np.linalg.solve(columns.swapaxes(1, 2) @ columns, right)[:, 1])

    def _local(self, index: Indices, place: int) -> tuple[Array, Array]:
        """Poses of each row of ``index`` (n, k) in the axes of its one at ``place``; (n, k, 6)."""
        base, several = self.estimate[index[:, place]], self.estimate[index]
        back = np.swapaxes(base[:, :3, :3], 1, 2)[:, None]
        moved = back @ (several[..., :3, 3] - base[:, None, :3, 3])[..., None]
        turned = se3.log_so3(back @ several[..., :3, :3])
        return base, np.concatenate([moved[..., 0], turned], axis=2)
