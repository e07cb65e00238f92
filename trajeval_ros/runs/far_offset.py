# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A clock that is off by seconds, where the two trajectories have time in common all the same.

A fit finds offsets of a part of the motion; one that is larger looks like any bad estimate, and
figures, fits and advice of it are of poses that do not belong together.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.diagnosis.cause import Cause, too_early
from trajeval_ros.diagnosis.time_bases import Found, offsets_by_motion, usual_name
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.intake import LARGEST_COORDINATE

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

_SECOND = 1e9
# An ATE of so much of the motion's extent is worth a search; what is found makes it this smaller.
_LARGE, _BETTER = 0.1, 0.5
# s; nearer ones are found by what is left of the errors.
_LEAST = 0.3
_APART = 1.0
_ENOUGH = 20


def far_offset(
    truth: Trajectory, estimate: Trajectory, applied: float, ate: float | None
) -> tuple[Cause, ...]:
    """Return what the motion says of the clocks, where the ATE (m) is large and it explains that.

    ``applied`` (s) is added to the estimate's stamps already.
    """
    if ate is None or not ate > _LARGE * _extent(truth.positions):
        return ()
    known, other = posed(truth), posed(estimate)
    if min(len(known[0]), len(other[0])) < _ENOUGH:
        return ()
    before = _rmse(known, other, applied)
    tried = _tried(known, other)
    if not tried:
        return ()
    after, found = tried[0]
    if abs(found.offset - applied) < max(_LEAST, 3.0 * found.within):
        return ()
    # Better than what is, and than what else would do.
    others = [rmse for rmse, each in tried if abs(each.offset - found.offset) > _APART]
    if any(after > _BETTER * rmse for rmse in (*others, *([] if before is None else [before]))):
        return ()
    name = usual_name(found.offset)
    stands = "" if before is None else f"{before:.3g} m as it stands, "
    return (
        Cause(
            "time_base",
            f"{too_early(found.offset, 2)}{name and f' ({name})'}:"
            f" the two move alike with {found.offset:+.2f} s added to them (correlation"
            f" {found.correlation:.2f}); the ATE is {stands}{after:.3g} m with that",
            f"set estimate.time_offset={found.offset:.3f}",
        ),
    )


def _tried(known: tuple[Stamps, Array], other: tuple[Stamps, Array]) -> list[tuple[float, Found]]:
    """Offsets at which the two move alike, with the error of the positions, the least first."""
    with np.errstate(over="ignore", invalid="ignore"):
        found = offsets_by_motion(*known, *other)
    errors = [(_rmse(known, other, each.offset), each) for each in found]
    tried = [(error, each) for error, each in errors if error is not None]
    return sorted(tried, key=lambda one: one[0])


def posed(trajectory: Trajectory) -> tuple[Stamps, Array]:
    """Increasing stamps (N,) and poses (N, 4, 4) of what is one."""
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(trajectory.quaternions, axis=1)
    good = _near(trajectory.positions) & (np.abs(norms - 1.0) < 1e-2)
    good[1:] &= trajectory.stamps[1:] > np.maximum.accumulate(trajectory.stamps)[:-1]
    positions, quaternions = trajectory.positions[good], trajectory.quaternions[good]
    return trajectory.stamps[good], se3.from_position_quaternion(positions, quaternions)


def _extent(positions: Array) -> float:
    """How far positions (N, 3) are from their mean, root mean square, m; infinite of none."""
    near = _near(positions)
    if np.count_nonzero(near) < 2:
        return float("inf")
    # One axis after the other: a run may be long.
    return float(np.sqrt(sum(positions[near, axis].var() for axis in range(3))))


def _near(positions: Array) -> Mask:
    """Which positions (N, 3) are finite and no farther off than any."""
    near = np.ones(len(positions), dtype=np.bool_)
    for axis in range(3):
        near &= np.abs(positions[:, axis]) <= LARGEST_COORDINATE
    return near


def _rmse(known: tuple[Stamps, Array], other: tuple[Stamps, Array], offset: float) -> float | None:
    """The positions' error after alignment with an offset (s); None of too few in common."""
    begin = known[0][0]
    seconds = (known[0] - begin) / _SECOND
    asked = (other[0] - begin) / _SECOND + offset
    inside = (asked >= seconds[0]) & (asked <= seconds[-1])
    if int(inside.sum()) < _ENOUGH:
        return None
    truth = np.stack(
        [np.interp(asked[inside], seconds, known[1][:, axis, 3]) for axis in range(3)], axis=1
    )
    return float(align_positions(other[1][inside, :3, 3], truth, "se3").rmse)
