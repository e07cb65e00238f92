# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses that were written, or read, in another way than is taken: each way is tried on the data.

A *reading* undoes one mistake in one of the two trajectories. With it applied the positions are
aligned, and the orientations are compared in that alignment, as they are and with the best turn of
the body: so each reading has figures, and only one that makes them better by far is named. Readings
that do equally well cannot be told apart by these data, and are named together.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import Moments, align
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.rotations import Array, quaternion

# Poses that are looked at, evenly over all.
_MOST = 200
# An error below which nothing is wrong, and how many times smaller a reading has to make it. It is
# the error of position as a share of the motion, and that of orientation in rad, added up.
_WRONG, _BETTER = 0.3, 3.0
# Equally good readings have errors within this factor, or this much; a simpler one is preferred
# where it is worse by no more than a body that is mounted askew by some degrees.
_ALIKE, _ALIKE_BY, _SIMPLER_BY = 1.3, 0.005, 0.05
# rad; a smaller turn of the body is no matter of how poses are written.
_TURN = 0.2
# The rotation of an alignment is uncertain by what is left over, as a share of the motion across
# (rad). It is known where that is at most this; a turn of the body has to be a multiple of it.
_UNCERTAIN, _BEYOND = 0.25, 3.0

AXES = "xyz"


class Figures(NamedTuple):
    """Two trajectories compared in the alignment of their positions.

    ``rmse`` (m) under the gauge, ``angle`` (rad), ``error`` (see `_WRONG`), and by how much the
    alignment's rotation is ``uncertain`` (rad); ``turn`` (3, 3): the estimate's body in the ground
    truth's that was taken, as an extrinsic's rotation, or None.
    """

    rmse: float
    angle: float
    error: float
    uncertain: float
    turn: Array | None = None

    def __str__(self) -> str:
        """The two errors."""
        return f"{self.rmse:.3g} m and {np.degrees(self.angle):.3g} deg"

    @property
    def wrong(self) -> bool:
        """Whether something may be wrong beyond inaccuracy."""
        return self.error >= _WRONG

    @property
    def known(self) -> bool:
        """Whether the alignment's rotation is."""
        return self.uncertain <= _UNCERTAIN

    def explains(self, standing: Figures) -> bool:
        """Whether it makes what stands better by far."""
        return self.known and _BETTER * self.error <= standing.error


class Reading(NamedTuple):
    """A mistake in one trajectory: what it is, what to do, and how it is undone, (N, 4, 4)."""

    of_estimate: bool
    code: str
    text: str
    advice: str
    undo: Callable[[Array], Array]

    def applied(self, ground_truth: Array, estimate: Array) -> tuple[Array, Array]:
        """Both trajectories, the one of them read this way."""
        if self.of_estimate:
            return ground_truth, self.undo(estimate)
        return self.undo(ground_truth), estimate


def compared(ground_truth: Array, estimate: Array, gauge: str) -> tuple[Figures, Figures]:
    """Figures of poses (N, 4, 4), as they are and with the body turned as it fits best."""
    step = -(-len(estimate) // _MOST)
    truth, other = ground_truth[::step], estimate[::step]
    moments = Moments.of(other[:, :3, 3], truth[:, :3, 3])
    similar = align(moments, "sim3")
    rmse = similar.rmse if gauge == "sim3" else align(moments, "se3").rmse
    extent = moments.target_extent
    motion = float(np.linalg.norm(extent))
    share = similar.rmse / motion if motion > 0.0 else 1.0
    uncertain = similar.rmse / float(extent[1]) if extent[1] > 0.0 else np.inf
    # The mean of R_gt^T W R_est: the nearest rotation is the estimate's body in the ground truth's.
    mean = np.einsum("nji,jk,nkl->il", truth[:, :3, :3], similar.rotation, other[:, :3, :3])
    mean = mean / len(truth)
    u, values, vt = np.linalg.svd(mean)
    sign = np.sign(np.linalg.det(u @ vt))
    turn = u @ np.diag([1.0, 1.0, sign]) @ vt
    plain = _angle(float(np.trace(mean)))
    turned = _angle(float(values[0] + values[1] + sign * values[2]))
    return (
        Figures(rmse, plain, share + plain, uncertain),
        Figures(rmse, turned, share + turned, uncertain, turn),
    )


def _angle(trace: float) -> float:
    """The root mean square angle (chordal) of rotations with that mean trace, rad."""
    return float(2.0 * np.arcsin(np.sqrt(np.clip((3.0 - trace) / 4.0, 0.0, 1.0))))


def best_reading(
    ground_truth: Array, estimate: Array, gauge: str, standing: Figures
) -> tuple[Cause, Reading | None] | None:
    """What is wrong with how poses (N, 4, 4) were written, and how it is undone.

    None where no reading explains it. ``gauge``: of the alignment whose error is shown;
    ``standing``: the figures as they stand.
    """
    step = -(-len(estimate) // _MOST)
    truth, other = ground_truth[::step], estimate[::step]
    found = [
        (_rank(reading, figures), figures.error, figures, reading)
        for reading in (None, *_readings())
        for figures in compared(*_applied(reading, truth, other), gauge)
        if figures.explains(standing) and _says_something(reading, figures)
    ]
    if not found:
        return None
    limit = _ALIKE * min(error for _, error, _, _ in found) + _SIMPLER_BY
    rank = min(rank for rank, error, _, _ in found if error <= limit)
    equal = sorted((one for one in found if one[0] == rank), key=lambda one: one[1])
    _, least, figures, reading = equal[0]
    # The same mistake in the other trajectory moves other positions, so its share is another one.
    same = [one for one in equal if _code(one[3]) == _code(reading) and one[1] <= limit]
    same.sort(key=lambda one: one[3] is not None and not one[3].of_estimate)
    alike = [one for one in equal if one[1] <= _ALIKE * least + _ALIKE_BY]
    # Of readings that differ by the axis alone the best stands for all.
    texts: dict[str, str] = {}
    for _, _, how, each in (*same, *alike):
        texts.setdefault(*_words(each, how))
    _, _, figures, reading = same[0]
    (text, advice), *others = texts.items()
    evidence = f"{text}: the ATE is {standing} as it stands, {figures} with that undone"
    for other_text, other_advice in others[:2]:
        evidence += f". Or, which fits equally well, {other_text}"
        advice += f"; or {other_advice}"
    return Cause(_code(reading), evidence, advice), reading


def _code(reading: Reading | None) -> str:
    return "body_frame" if reading is None else reading.code


def _applied(reading: Reading | None, ground_truth: Array, estimate: Array) -> tuple[Array, Array]:
    return (ground_truth, estimate) if reading is None else reading.applied(ground_truth, estimate)


def _says_something(reading: Reading | None, figures: Figures) -> bool:
    """Not that all is right, nor that the body is turned by next to nothing."""
    if figures.turn is None:
        return reading is not None
    least = max(_TURN, _BEYOND * figures.uncertain)
    return float(np.linalg.norm(se3.log_so3(figures.turn))) >= least


def _rank(reading: Reading | None, figures: Figures) -> int:
    """How much it takes: of equally good readings the simplest is named."""
    axes = reading is not None and reading.code == "axes"
    return (reading is not None) + axes + (figures.turn is not None)


def _words(reading: Reading | None, figures: Figures) -> tuple[str, str]:
    """What is wrong and what to do."""
    texts, advice = [], []
    if reading is not None:
        texts.append(reading.text)
        advice.append(reading.advice)
    if figures.turn is not None:
        degrees = float(np.degrees(np.linalg.norm(se3.log_so3(figures.turn))))
        numbers = ",".join(f"{value:.3g}" for value in quaternion(figures.turn))
        texts.append(
            f"the estimate's body frame is turned by {degrees:.0f} degrees against the ground"
            " truth's"
        )
        advice.append(f"set extrinsic=0,0,0,{numbers}, with the lever arm for the zeros")
    return ", and ".join(texts), " and ".join(advice)


def _readings() -> Iterator[Reading]:
    for of_estimate, title in ((True, "estimate"), (False, "ground truth")):
        yield Reading(
            of_estimate,
            "poses_inverted",
            f"the {title}'s poses are inverted, of the world in the body",
            f"invert the {title}'s poses",
            se3.inverse,
        )
        yield Reading(
            of_estimate,
            "quaternion_conjugated",
            f"the {title}'s quaternions are conjugated, of the world in the body",
            f"invert the {title}'s rotations",
            _conjugated,
        )
        yield Reading(
            of_estimate,
            "quaternion_order",
            f"the {title}'s quaternions are in the order w x y z",
            f"write the {title}'s quaternions as x y z w",
            lambda poses: _reordered(poses, [1, 2, 3, 0]),
        )
        yield Reading(
            of_estimate,
            "quaternion_order",
            f"the {title}'s quaternions are in the order x y z w, but were read as w x y z",
            f"read the {title} as tum",
            lambda poses: _reordered(poses, [3, 0, 1, 2]),
        )
        for axis in range(3):
            signs = [letter for i, letter in enumerate(AXES) if i != axis]
            yield Reading(
                of_estimate,
                "mirrored",
                f"the {title} is mirrored, positions and orientations, as in left-handed axes",
                f"negate {AXES[axis]}, q{signs[0]} and q{signs[1]} of the {title}",
                _mirror(axis),
            )
        for matrix in _signed_permutations():
            yield Reading(
                of_estimate,
                "axes",
                f"the {title}'s positions and quaternions are in different axes",
                f"write the {title}'s positions as {_listed(matrix)}",
                _moved(matrix),
            )


def _conjugated(poses: Array) -> Array:
    result = poses.copy()
    result[:, :3, :3] = poses[:, :3, :3].swapaxes(-1, -2)
    return result


def _reordered(poses: Array, order: list[int]) -> Array:
    """With x y z w of the quaternions taken from those places."""
    positions, quaternions = se3.to_position_quaternion(poses)
    return se3.from_position_quaternion(positions, quaternions[:, order])


def _mirror(axis: int) -> Callable[[Array], Array]:
    mirror = np.ones(4)
    mirror[axis] = -1.0
    return lambda poses: mirror[:, None] * poses * mirror


def _moved(matrix: Array) -> Callable[[Array], Array]:
    """Positions through (3, 3), orientations as they are."""

    def undo(poses: Array) -> Array:
        result = poses.copy()
        result[:, :3, 3] = poses[:, :3, 3] @ matrix.T
        return result

    return undo


def _signed_permutations() -> Iterator[Array]:
    """All (3, 3) with one 1 or -1 in each row and column, but the identity."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.array(signs)[:, None] * np.eye(3)[list(order)]
            if not (matrix == np.eye(3)).all():
                yield matrix


def _listed(matrix: Array) -> str:
    """The rows of a signed permutation, as ``z, -x, y``."""
    axes = np.argmax(np.abs(matrix), axis=1)
    return ", ".join(
        ("-" if row[axis] < 0 else "") + AXES[axis] for row, axis in zip(matrix, axes, strict=True)
    )
