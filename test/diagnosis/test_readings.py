# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses written or read in another way: named, with what undoes it and the figures after it."""

import re
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation
from twins.real_pairs import real_pair

from trajeval_ros import se3
from trajeval_ros.commands.simulation import SECOND, motion
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.causes import likely_causes

Array = npt.NDArray[np.float64]

WORLD = se3.exp(np.array([4.0, -2.0, 0.5, 0.4, -0.3, 2.1]))
SECONDS = np.arange(5.0, 65.0, 0.05)
STAMPS = 1_750_000_000 * SECOND + np.rint(SECONDS * SECOND).astype(np.int64)


def drifting(poses: Array, world: Array = WORLD, size: float = 0.002) -> Array:
    """An estimate with drift and noise, in a world of its own."""
    random = np.random.default_rng(3)
    steps = se3.compose(se3.inverse(poses[:-1]), poses[1:])
    wrong = se3.compose(steps, se3.exp(size * random.normal(size=(len(steps), 6))))
    result = [se3.compose(world, poses[0])]
    for step in wrong:
        result.append(se3.compose(result[-1], step))
    return np.array(result)


def planar(seconds: Array = SECONDS) -> Array:
    """A vehicle on a plane."""
    heading = 0.8 * np.sin(0.21 * seconds) + 0.1 * seconds
    poses = se3.exp(np.stack([*np.zeros((5, len(seconds))), heading], axis=1))
    velocity = np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1)
    poses[:, :3, 3] = np.cumsum(0.05 * velocity, axis=0)
    return poses


def requaternion(poses: Array, order: list[int], signs: tuple[int, ...] = (1, 1, 1, 1)) -> Array:
    position, quaternion = se3.to_position_quaternion(poses)
    return se3.from_position_quaternion(position, quaternion[:, order] * signs)


def mirrored(axis: int) -> Callable[[Array], Array]:
    mirror = np.eye(4)
    mirror[axis, axis] = -1.0
    return lambda poses: mirror @ poses @ mirror


def moved(matrix: list[list[int]]) -> Callable[[Array], Array]:
    def move(poses: Array) -> Array:
        result = poses.copy()
        result[:, :3, 3] = poses[:, :3, 3] @ np.array(matrix).T
        return result

    return move


def turned(rotation: Rotation) -> Callable[[Array], Array]:
    turn = np.eye(4)
    turn[:3, :3] = rotation.as_matrix()
    return lambda poses: se3.compose(poses, turn)


def check(truth: Array, other: Array, **settings: object) -> tuple[Cause, ...]:
    return likely_causes(STAMPS, truth, other, "se3", **settings)  # type: ignore[arg-type]


def ate(text: str) -> list[tuple[float, float]]:
    """The two errors as they stand, and with the mistake undone."""
    found = re.findall(r"([\d.e+-]+) m and ([\d.e+-]+) deg", text)
    assert len(found) == 2, text
    return [(float(m), float(deg)) for m, deg in found]


MISTAKES = {
    "poses_inverted": (se3.inverse, "poses are inverted", "invert the {}'s poses"),
    "quaternion_conjugated": (
        lambda poses: requaternion(poses, [0, 1, 2, 3], (-1, -1, -1, 1)),
        "quaternions are conjugated",
        "invert the {}'s rotations",
    ),
    # A file with w x y z is read as x y z w, and the reverse.
    "quaternion_order": (
        lambda poses: requaternion(poses, [3, 0, 1, 2]),
        "quaternions are in the order w x y z",
        "write the {}'s quaternions as x y z w",
    ),
    "quaternion_order, of tum read as euroc": (
        lambda poses: requaternion(poses, [1, 2, 3, 0]),
        "quaternions are in the order x y z w, but were read as w x y z",
        "read the {} as tum",
    ),
    "mirrored, x": (mirrored(0), "is mirrored", "negate x, qy and qz of the {}"),
    "mirrored, y": (mirrored(1), "is mirrored", "negate y, qx and qz of the {}"),
    "mirrored, z": (mirrored(2), "is mirrored", "negate z, qx and qy of the {}"),
    "axes, cyclic": (
        moved([[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
        "positions and quaternions are in different axes",
        "write the {}'s positions as z, x, y",
    ),
    "axes, z negated": (
        moved([[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        "positions and quaternions are in different axes",
        "write the {}'s positions as x, y, -z",
    ),
    "axes, y and z swapped": (
        moved([[1, 0, 0], [0, 0, 1], [0, 1, 0]]),
        "positions and quaternions are in different axes",
        "write the {}'s positions as x, z, y",
    ),
    "axes, NED positions and ENU attitudes": (
        moved([[0, 1, 0], [1, 0, 0], [0, 0, -1]]),
        "positions and quaternions are in different axes",
        "write the {}'s positions as y, x, -z",
    ),
}


@pytest.mark.parametrize("side", ["estimate", "ground truth"])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_mistake_is_named_with_what_undoes_it(mistake: str, side: str) -> None:
    make, said, advice = MISTAKES[mistake]
    poses = {"ground truth": motion(SECONDS), "estimate": drifting(motion(SECONDS))}
    poses[side] = make(poses[side])
    causes = check(poses["ground truth"], poses["estimate"])
    assert [cause.code for cause in causes] == [mistake.partition(",")[0]]
    assert said in causes[0].text
    if mistake.startswith("mirrored"):
        # Of two mirror images neither is the right one by itself.
        sides = "estimate", "ground truth"
        assert causes[0].advice == "; or ".join(advice.format(each) for each in sides)
    else:
        assert causes[0].text.startswith(f"the {side}")
        assert causes[0].advice == advice.format(side)
    before, after = ate(causes[0].text)
    assert after[0] < 0.2
    assert after[1] < 5.0
    assert before[0] > 3 * after[0] or before[1] > 20 * after[1]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_where_two_readings_fit_equally_well_both_are_named(mistake: str) -> None:
    # In one world the mistake may be either's.
    truth, other = motion(SECONDS), drifting(motion(SECONDS), np.eye(4), 1e-4)
    (cause,) = check(truth, MISTAKES[mistake][0](other))
    assert "the estimate" in cause.text
    assert "Or, which fits equally well, the ground truth" in cause.text
    assert "; or " in cause.advice


@pytest.mark.parametrize("degrees", [40, 120, 180])
@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 0, 0), (1, 1, 1)])
@pytest.mark.parametrize("way", [motion, planar])
def test_the_turn_of_a_body_is_told_even_where_it_is_seen_about_one_axis(
    degrees: float, axis: tuple[float, ...], way: Callable[[Array], Array]
) -> None:
    rotation = Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis))
    (cause,) = check(way(SECONDS), turned(rotation)(drifting(way(SECONDS), size=0.0005)))
    assert cause.code == "body_frame"
    said = re.search(r"turned by (\d+) degrees", cause.text)
    assert said is not None
    assert float(said.group(1)) == pytest.approx(degrees, abs=3)
    numbers = cause.advice.split("=")[1].split(", ")[0].split(",")
    left = Rotation.from_quat([float(v) for v in numbers[3:]]) * rotation.inv()
    assert np.degrees(left.magnitude()) < 4


def test_a_turn_shows_on_a_recording_that_turns_slowly() -> None:
    seconds = 0.02 * (SECONDS - 5.0) + 5.0
    slow = motion(seconds)
    other = drifting(slow, size=1e-5)
    (cause,) = check(slow, turned(Rotation.from_euler("y", 180, degrees=True))(other))
    assert cause.code == "body_frame"
    assert "turned by 180 degrees" in cause.text


def test_a_plane_mirrored_is_a_plane_seen_from_below() -> None:
    (cause,) = check(planar(), mirrored(1)(drifting(planar(), np.eye(4), 1e-4)))
    assert "turned by 180 degrees" in cause.text
    assert "Or, which fits equally well, the estimate is mirrored" in cause.text


def test_wrong_quaternions_and_a_turned_body_together() -> None:
    turn = turned(Rotation.from_euler("xyz", [20, 100, -50], degrees=True))
    other = requaternion(turn(drifting(motion(SECONDS))), [3, 0, 1, 2])
    (cause,) = check(motion(SECONDS), other)
    assert cause.code == "quaternion_order"
    assert "and the estimate's body frame is turned" in cause.text
    assert "extrinsic=0,0,0," in cause.advice


def test_a_scale_is_looked_for_in_what_was_meant() -> None:
    other = drifting(motion(SECONDS))
    other[:, :3, 3] *= 100.0
    causes = check(motion(SECONDS), se3.inverse(other))
    assert [cause.code for cause in causes] == ["poses_inverted", "centimetres"]


@pytest.mark.parametrize("size", [0.0, 0.001, 0.01, 0.03])
@pytest.mark.parametrize("way", [motion, planar])
def test_drift_is_no_mistake(size: float, way: Callable[[Array], Array]) -> None:
    for world in (WORLD, np.eye(4)):
        causes = check(way(SECONDS), drifting(way(SECONDS), world, size))
        assert [c.code for c in causes if c.code != "scale"] == []


@pytest.mark.parametrize(
    ("directory", "name"),
    [("tum_fr1_xyz", "rgbdslam"), ("euroc_v102", "estimate"), ("euroc_mh04", "vins_mono")],
)
@pytest.mark.parametrize("side", ["estimate", "ground truth"])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_mistake_in_real_data(mistake: str, side: str, directory: str, name: str) -> None:
    stamps, truth, other = real_pair(directory, name)
    make, _, advice = MISTAKES[mistake]
    truth, other = (truth, make(other)) if side == "estimate" else (make(truth), other)
    causes = likely_causes(stamps, truth, other, "se3")
    assert causes[0].code == mistake.partition(",")[0]
    assert advice.format(side) in causes[0].advice
