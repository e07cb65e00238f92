# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quaternions that were read wrongly, or a body frame that is turned.

Rotations between two instants, seen in the body frame, are the same for estimate and ground
truth up to a constant turn of the body frame, ``phi_gt = B phi_est``, whatever the two worlds.
The best B is Wahba's problem. What no B explains is a quaternion that was read wrongly.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.readings import Figures, best_reading, compared
from trajeval_ros.diagnosis.rotations import (
    STEP,
    Array,
    Stamps,
    TurnFit,
    between,
    fit_turn,
    pairs,
    quaternion,
    turns,
)

# Unexplained shares of the rotation: what is wrong as it stands, what is explained by a cause.
# Real estimates leave 0.02 to 0.15 unexplained, a wrongly read quaternion 0.7 to 2.
_WRONG = 0.4
_EXPLAINED = 0.25


def as_written(
    stamps: Stamps, ground_truth: Array, estimate: Array, gauge: str, applied: Array
) -> tuple[tuple[Cause, ...], Array, Array]:
    """Poses written or read in another way, and both trajectories (N, 4, 4) as they were meant.

    As they were evaluated: the estimate moved by ``applied``, T_gtbody_estbody (4, 4), already;
    what is found is of the poses as they came. Where the positions tell no alignment, as along a
    line, the rotations alone are asked.
    """
    standing, _ = compared(ground_truth, estimate, gauge)
    if not standing.wrong:
        return (), ground_truth, estimate
    set_before = float(np.linalg.norm(se3.log_so3(applied[:3, :3]))) > 0.0
    came = se3.compose(estimate, applied) if set_before else estimate
    if set_before:
        without, _ = compared(ground_truth, came, gauge)
        if without.explains(standing):
            return (_needless_extrinsic(standing, without),), ground_truth, came
    found = best_reading(ground_truth, came, gauge, standing)
    if found is None:
        rotations = ground_truth[:, :3, :3], estimate[:, :3, :3]
        # Where the positions tell the alignment, they have said that no reading helps.
        turned = () if standing.known else misread_or_turned(stamps, *rotations, applied[:3, :3])
        return turned, ground_truth, estimate
    cause, reading = found
    if reading is None:
        return (cause,), ground_truth, estimate
    return (cause,), *reading.applied(ground_truth, came)


def _needless_extrinsic(standing: Figures, without: Figures) -> Cause:
    return Cause(
        "body_frame",
        f"the rotation of the extrinsic does not fit: the ATE is {standing} with it, {without}"
        " without",
        "set extrinsic=0,0,0,0,0,0,1, with the lever arm for the first three",
    )


def misread_or_turned(
    stamps: Stamps, ground_truth: Array, estimate: Array, applied: Array
) -> tuple[Cause, ...]:
    """Quaternions read wrongly, or a body frame that is turned.

    ``ground_truth`` and ``estimate`` (B, 3, 3), as they were evaluated: the estimate's body turned
    by ``applied`` (3, 3), R_gtbody_estbody, already. What is found is of the poses as they came.
    """
    first, second = pairs(stamps, STEP)
    if not turns(stamps, ground_truth):
        return ()
    fit = fit_turn(between(ground_truth, first, second), between(estimate, first, second))
    if fit.as_is < _WRONG:
        return ()
    set_before = float(np.linalg.norm(se3.log_so3(applied))) > 0.0
    if set_before:
        estimate = estimate @ applied
        raw = fit_turn(between(ground_truth, first, second), between(estimate, first, second))
        if raw.as_is < _WRONG:
            return (_needless_turn(fit, raw),)
        fit = raw._replace(as_is=fit.as_is)
    reread, cause = _misread(fit, first, second, ground_truth, estimate)
    # About one axis, a turn of the body by 180 degrees looks like conjugated quaternions.
    turned = fit.turned < _EXPLAINED and (fit.axes > 1 or fit.turned < reread.as_is)
    if turned:
        return (_turned_body(fit),)
    return (cause,) if reread.turned < _EXPLAINED else ()


def _misread(
    fit: TurnFit,
    first: npt.NDArray[np.intp],
    second: npt.NDArray[np.intp],
    ground_truth: Array,
    estimate: Array,
) -> tuple[TurnFit, Cause]:
    """The reading of the quaternions that explains the rotations best.

    Two readings that mirror each other differ by constant turns of world and body alone (both are
    orthogonal maps of R⁴ with determinant -1), so that each explains what the other does; the
    right one is the one that needs no turn of the body besides.
    """
    readings = []
    for title, poses, other in (
        ("estimate", estimate, ground_truth),
        ("ground truth", ground_truth, estimate),
    ):
        known = between(other, first, second)
        for code, reread, mistake, advice in _READINGS:
            again = fit_turn(known, between(reread(poses), first, second))
            text = (
                f"the {title}'s quaternions {mistake}: {100 * fit.turned:.0f} % of the rotation is"
                f" unexplained as it stands, {100 * again.turned:.0f} % otherwise"
            )
            readings.append((again, Cause(code, text, advice.format(title))))
    return min(readings, key=lambda reading: reading[0].as_is)


def _reordered(rotation: Array) -> Array:
    """The rotations as they are if w x y z was read as x y z w."""
    poses = np.tile(np.eye(4), (len(rotation), 1, 1))
    poses[:, :3, :3] = rotation
    x, y, z, w = np.moveaxis(se3.to_position_quaternion(poses)[1], -1, 0)
    again = np.stack([y, z, w, x], axis=-1)
    return se3.from_position_quaternion(np.zeros((len(rotation), 3)), again)[:, :3, :3]


def _inverted(rotation: Array) -> Array:
    return rotation.swapaxes(-1, -2)


_READINGS = (
    (
        "quaternion_order",
        _reordered,
        "are in the order w x y z",
        "write the {}'s quaternions as x y z w",
    ),
    (
        "quaternion_conjugated",
        _inverted,
        "are conjugated, of the world in the body",
        "invert the {}'s rotations",
    ),
)


def _needless_turn(fit: TurnFit, raw: TurnFit) -> Cause:
    """An extrinsic whose rotation the poses contradict."""
    return Cause(
        "body_frame",
        f"the rotation of the extrinsic does not fit: {100 * fit.as_is:.0f} % of the rotation is"
        f" unexplained with it, {100 * raw.as_is:.0f} % without",
        "set extrinsic=0,0,0,0,0,0,1, with the lever arm for the first three",
    )


def _turned_body(fit: TurnFit) -> Cause:
    """A constant turn between the two body frames."""
    degrees = float(np.degrees(np.linalg.norm(se3.log_so3(fit.turn))))
    text = (
        f"the estimate's body frame is turned by {degrees:.0f} degrees against the ground truth's:"
        f" {100 * fit.as_is:.0f} % of the rotation is unexplained as it stands,"
        f" {100 * fit.turned:.0f} % with that turn"
    )
    if fit.axes < 2:
        return Cause(
            "body_frame",
            f"{text} (seen about one axis only)",
            "set extrinsic to the estimate's body frame in the ground truth's",
        )
    numbers = ",".join(f"{value:.3g}" for value in quaternion(fit.turn))
    return Cause(
        "body_frame", text, f"set extrinsic=0,0,0,{numbers}, with the lever arm for the zeros"
    )
