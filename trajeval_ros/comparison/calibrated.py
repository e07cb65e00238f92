# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Displacements of an estimate, without what a calibration would put right.

Whatever two estimates of one sensor share of scale, axes, lever arm and clock is theirs and not the
ground truth's. To first order the ground truth's displacement d_g over a step, in its body's axes,
is linear in it:

    d_g = M (d + tau d') - (R_g - I) l,        d' = R rho_end - rho_begin - omega_begin x d

with d, R and the twists (rho, omega) the estimate's, M (3 x 3) its scale and the rotation of its
axes, R_g the ground truth's rotation over the step, l the lever arm and tau the clock. M in M d'
is the one that is found without a clock: the product is linear then. And it is solved so that a
wrong stretch does not bend it: the sum of the stretches' root mean squares is least, and not that
of squares.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.comparison.common import Evaluated, Indices

Array = npt.NDArray[np.float64]

_ITERATIONS = 10
# Of the median: what fits better than that weighs no more.
_FINEST = 1e-3
# Directions that the motion does not show to this, of the one that it shows best, stay at nothing.
_SHOWN = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Displacements:
    """An estimate's displacements against the ground truth's.

    Attributes:
        errors: (K, 3), m, the estimate's less the ground truth's, in the ground truth's body.
        evaluated: the poses, (M,).
        twists: (M, 6) of the estimate at the poses, m/s and rad/s.
        axes: (3, 3), M without a clock.
        solution: (13,): M by rows, -l and tau.
    """

    errors: Array
    evaluated: Evaluated
    twists: Array
    axes: Array
    solution: Array

    def leap(self, begin: int, end: int) -> Array:
        """By how much the ground truth moved more than the estimate, (3,), m, in its world."""
        at = np.array([begin], dtype=np.int64), np.array([end], dtype=np.int64)
        design, moved = _equations(self.evaluated, self.twists, self.axes, *at)
        difference: Array = moved[0] - design[0] @ self.solution
        return self.evaluated.ground_truth[begin, :3, :3] @ difference


def calibrated(
    evaluated: Evaluated, begin: Indices, end: Indices, parts: Sequence[Indices]
) -> Displacements:
    """Displacements from poses `begin` to `end`, (K,) each; `parts`: stretches of these steps."""
    twists = _twists(evaluated)

    def solved(axes: Array | None) -> tuple[Array, Array]:
        equations = [_equations(evaluated, twists, axes, begin[part], end[part]) for part in parts]
        solution = _solved(np.array([_squares(*each) for each in equations]))
        errors = [design @ solution - moved for design, moved in equations]
        return solution, np.concatenate(errors)

    axes = solved(None)[0][:9].reshape(3, 3)
    solution, errors = solved(axes)
    return Displacements(errors, evaluated, twists, axes, solution)


def _equations(
    evaluated: Evaluated, twists: Array, axes: Array | None, begin: Indices, end: Indices
) -> tuple[Array, Array]:
    """The design (K, 3, 13), or 12 without a clock, and the ground truth's displacements (K, 3)."""
    estimate, truth = (
        se3.compose(se3.inverse(poses[begin]), poses[end])
        for poses in (evaluated.estimate, evaluated.ground_truth)
    )
    moved = estimate[:, :3, 3]
    design = np.zeros((len(begin), 3, 12 if axes is None else 13))
    for axis in range(3):
        design[:, axis, 3 * axis : 3 * axis + 3] = moved
    design[:, :, 9:12] = truth[:, :3, :3] - np.eye(3)
    if axes is not None:
        first, last = twists[begin], twists[end]
        turned = (estimate[:, :3, :3] @ last[:, :3, None])[..., 0]
        rate = turned - first[:, :3] - np.cross(first[:, 3:], moved)
        design[:, :, 12] = rate @ axes.T
    return design, truth[:, :3, 3]


def _twists(evaluated: Evaluated) -> Array:
    """The estimate's, (M, 6), at each pose that of the step from it; of the last, that to it."""
    poses = evaluated.estimate
    seconds = np.diff(evaluated.stamps) * 1e-9
    twists = se3.log(se3.compose(se3.inverse(poses[:-1]), poses[1:])) / seconds[:, None]
    return np.concatenate((twists, twists[-1:]))


def _squares(design: Array, moved: Array) -> Array:
    """The mean of products of the design's columns and of what they are to give."""
    both = np.concatenate((design, moved[..., None]), axis=-1).reshape(-1, design.shape[-1] + 1)
    mean: Array = both.T @ both / len(moved)
    return mean


def _solved(squares: Array) -> Array:
    """The parameters (P,) by iteratively reweighted least squares.

    Args:
        squares: (K, P + 1, P + 1), `_squares` of each stretch.
    """
    # In columns of equal size, so that metres and seconds are shown alike.
    size = np.sqrt(np.diagonal(squares.mean(axis=0))[:-1])
    size = np.where(size > 0.0, size, 1.0)
    scale = np.append(1.0 / size, 1.0)
    scaled = squares * scale[:, None] * scale
    weights = np.ones(len(squares))
    for _ in range(_ITERATIONS):
        sums = np.tensordot(weights, scaled, 1)
        found = np.linalg.pinv(sums[:-1, :-1], rcond=_SHOWN, hermitian=True) @ sums[:-1, -1]
        full = np.append(found, -1.0)
        errors = np.maximum(np.einsum("i,kij,j->k", full, scaled, full), 0.0)
        least = _FINEST**2 * float(np.median(errors))
        weights = 1.0 / np.sqrt(np.maximum(errors, max(least, float(np.finfo(float).tiny))))
        weights /= weights.sum()
    parameters: Array = found / size
    return parameters
