# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every mistake is named, with what undoes it; inaccurate data are not mistaken for one."""

import numpy as np
import numpy.typing as npt
import pytest
from twins.real_pairs import real_pair

from trajeval_ros import se3
from trajeval_ros.commands.simulation import SECOND, motion
from trajeval_ros.diagnosis.cause import Cause
from trajeval_ros.diagnosis.causes import likely_causes

Array = npt.NDArray[np.float64]

WORLD = se3.exp(np.array([4.0, -2.0, 0.5, 0.4, -0.3, 2.1]))
SECONDS = np.arange(5.0, 65.0, 0.05)
STAMPS = 1_750_000_000 * SECOND + np.rint(SECONDS * SECOND).astype(np.int64)


def estimate(seconds: Array = SECONDS, noise: float = 0.01) -> Array:
    """An inaccurate estimate in a world of its own."""
    generator = np.random.default_rng(0)
    error = generator.normal(size=(len(seconds), 6)) * noise
    return np.asarray(se3.compose(WORLD, motion(seconds), se3.exp(error)))


def reread(poses: Array, order: list[int], signs: list[int]) -> Array:
    """The poses with their quaternions' numbers in another order and with other signs."""
    position, quaternion = se3.to_position_quaternion(poses)
    return se3.from_position_quaternion(position, quaternion[:, order] * signs)


def named(causes: tuple[Cause, ...]) -> list[str]:
    return [cause.code for cause in causes]


def check(truth: Array, other: Array, gauge: str = "se3") -> tuple[Cause, ...]:
    return likely_causes(STAMPS, truth, other, gauge)


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.02])
def test_an_inaccurate_estimate_has_no_cause(noise: float) -> None:
    assert check(motion(SECONDS), estimate(noise=noise)) == ()


@pytest.mark.parametrize("side", ["estimate", "ground truth"])
@pytest.mark.parametrize(
    ("code", "order", "signs"),
    [
        ("quaternion_order", [3, 0, 1, 2], [1, 1, 1, 1]),
        ("quaternion_conjugated", [0, 1, 2, 3], [-1, -1, -1, 1]),
    ],
)
def test_quaternions_read_wrongly(side: str, code: str, order: list[int], signs: list[int]) -> None:
    poses = {"estimate": estimate(), "ground truth": motion(SECONDS)}
    poses[side] = reread(poses[side], order, signs)
    (cause,) = check(poses["ground truth"], poses["estimate"])
    assert cause.code == code
    assert f"the {side}'s quaternions" in cause.text
    assert side in cause.advice


@pytest.mark.parametrize("degrees", [60, 90, 180])
def test_a_turned_body_frame_and_the_extrinsic_that_undoes_it(degrees: float) -> None:
    turn = se3.exp(np.array([0, 0, 0, np.radians(degrees), 0, 0]))
    turned = se3.compose(estimate(), turn)
    (cause,) = check(motion(SECONDS), turned)
    assert cause.code == "body_frame"
    assert f"turned by {degrees} degrees" in cause.text
    numbers = [float(n) for n in cause.advice.split("extrinsic=")[1].split(", ")[0].split(",")]
    extrinsic = se3.from_position_quaternion(numbers[:3], numbers[3:])
    # as the engine applies it
    assert check(motion(SECONDS), se3.compose(turned, se3.inverse(extrinsic))) == ()


def scaled(poses: Array, factor: float) -> Array:
    result = poses.copy()
    result[:, :3, 3] *= factor
    return result


@pytest.mark.parametrize(
    ("truth", "other", "code", "said"),
    [
        (1.0, 1000.0, "millimetres", "the estimate is in millimetres"),
        (1000.0, 1.0, "millimetres", "the ground truth is in millimetres"),
        (1.0, 100.0, "centimetres", "the estimate is in centimetres"),
        (100.0, 1.0, "centimetres", "the ground truth is in centimetres"),
        (1.0, 1.3, "scale", "scale 0.769"),
        (1.0, 0.02, "scale", "scale 50"),
    ],
)
def test_a_wrong_size(truth: float, other: float, code: str, said: str) -> None:
    poses = scaled(motion(SECONDS), truth), scaled(estimate(), other)
    (cause,) = check(*poses)
    assert cause.code == code
    assert said in cause.text
    assert check(*poses, gauge="sim3") == ()


def test_the_scale_of_a_short_run_wanders() -> None:
    poses = motion(SECONDS), scaled(estimate(), 1.2)
    assert named(check(*poses)) == ["scale"]
    short = SECONDS < 15.0
    assert likely_causes(STAMPS[short], poses[0][short], poses[1][short], "se3") == ()
    gross = motion(SECONDS)[short], scaled(estimate(), 2.0)[short]
    assert named(likely_causes(STAMPS[short], *gross, "se3")) == ["scale"]


@pytest.mark.parametrize("offset", [0.3, -0.3, 0.5, -1.7])
def test_a_clock_offset_and_the_parameter_that_undoes_it(offset: float) -> None:
    # stamped `offset` late: where it says t it means t - offset
    (cause,) = check(motion(SECONDS), estimate(SECONDS - offset, noise=0.002))
    assert cause.code == "clock_offset"
    assert float(cause.advice.split("=")[1]) == pytest.approx(-offset, abs=0.01)


def test_a_robot_at_rest_tells_nothing() -> None:
    still = np.full_like(SECONDS, 5.0)
    assert named(check(motion(still), estimate(still))) == []


def constant(poses: Array) -> Array:
    """The poses with the orientation that a converter writes which has none."""
    result = poses.copy()
    result[:, :3, :3] = np.eye(3)
    return result


@pytest.mark.parametrize("side", ["estimate", "ground truth"])
def test_an_orientation_that_never_changes(side: str) -> None:
    poses = {"estimate": estimate(), "ground truth": motion(SECONDS)}
    poses[side] = constant(poses[side])
    (cause,) = check(poses["ground truth"], poses["estimate"])
    assert cause.code == "constant_orientation"
    assert f"the {side}'s orientation never changes (x y z w is 0 0 0 1" in cause.text
    assert side in cause.advice


def test_a_constant_orientation_does_not_hide_the_scale() -> None:
    poses = motion(SECONDS), constant(scaled(estimate(), 1000.0))
    assert named(check(*poses)) == ["constant_orientation", "millimetres"]


def test_an_estimate_that_is_stuck() -> None:
    (cause,) = check(motion(SECONDS), np.tile(estimate()[:1], (len(SECONDS), 1, 1)))
    assert cause.code == "stuck"


def test_nothing_is_stuck_or_constant_beside_a_robot_at_rest() -> None:
    still = np.tile(motion(SECONDS)[:1], (len(SECONDS), 1, 1))
    assert check(still, still) == ()
    drift = np.zeros((len(SECONDS), 6))
    drift[:, 5] = np.linspace(0.0, 0.5, len(SECONDS))
    assert check(still, np.asarray(se3.compose(still, se3.exp(drift)))) == ()


def test_too_few_poses_tell_nothing() -> None:
    wrong = reread(estimate(), [3, 0, 1, 2], [1, 1, 1, 1])
    assert likely_causes(STAMPS[:20], motion(SECONDS)[:20], wrong[:20], "se3") == ()


def test_no_clock_offset_from_an_estimate_with_holes() -> None:
    kept = (SECONDS % 20) > 8
    assert likely_causes(STAMPS[kept], motion(SECONDS)[kept], estimate()[kept], "se3") == ()


@pytest.mark.parametrize(
    ("directory", "name", "expected"),
    [
        ("tum_fr1_xyz", "rgbdslam", []),
        ("tum_fr2_desk", "orb", []),
        ("euroc_v102", "estimate", []),
        ("euroc_mh04", "pl_vio", []),
        ("euroc_mh04", "vins_mono", []),
        ("kitti_00", "orb", []),
        ("kitti_00", "sptam", []),
        ("tum_fr1_xyz", "orb_kf_mono", ["scale"]),
        ("tum_fr2_desk", "orb_kf_mono", ["scale"]),
    ],
)
def test_no_false_alarm_on_real_pairs(directory: str, name: str, expected: list[str]) -> None:
    assert named(likely_causes(*real_pair(directory, name), "se3")) == expected


@pytest.mark.parametrize(
    ("directory", "name"),
    [
        ("tum_fr1_xyz", "rgbdslam"),
        ("tum_fr2_desk", "orb"),
        ("euroc_v102", "estimate"),
        ("euroc_mh04", "pl_vio"),
        ("euroc_mh04", "vins_mono"),
        ("kitti_00", "orb"),
    ],
)
def test_no_false_alarm_in_a_part_of_a_real_pair(directory: str, name: str) -> None:
    stamps, truth, other = real_pair(directory, name)
    for seconds in (2, 5, 8, 13, 16):
        for begin in range(int(stamps[0]), int(stamps[-1]), 5 * SECOND):
            part = (stamps >= begin) & (stamps < begin + seconds * SECOND)
            assert likely_causes(stamps[part], truth[part], other[part], "se3") == ()


@pytest.mark.parametrize("applied", [0.0, -0.2, 0.5, -1.0])
def test_the_advised_offset_is_the_value_to_set(applied: float) -> None:
    # 0.2 s are to be added to the estimate's stamps, of which `applied` has been.
    late = estimate(SECONDS + 0.2 - applied, noise=0.002)
    causes = likely_causes(STAMPS, motion(SECONDS), late, "se3", time_offset=applied)
    assert named(causes) == ["clock_offset"]
    assert float(causes[0].advice.partition("=")[2]) == pytest.approx(0.2, abs=0.01)


def body_turn(advice: str) -> Array:
    """The pose that an advice says to set as the extrinsic."""
    numbers = np.array([float(v) for v in advice.split("=")[1].split(", ")[0].split(",")])
    return se3.from_position_quaternion(numbers[:3], numbers[3:] / np.linalg.norm(numbers[3:]))


@pytest.mark.parametrize("applied", [np.zeros(3), np.array([0.0, 0.0, 1.0])])
def test_the_advised_extrinsic_is_the_value_to_set(applied: Array) -> None:
    turn, set_now = (
        se3.exp(np.concatenate([np.zeros(3), v])) for v in (np.array([0.3, 1.4, -0.2]), applied)
    )
    as_it_came = se3.compose(estimate(), turn)
    evaluated = se3.compose(as_it_came, se3.inverse(set_now))
    causes = likely_causes(STAMPS, motion(SECONDS), evaluated, "se3", extrinsic=set_now)
    assert named(causes) == ["body_frame"]
    left = se3.log(se3.compose(se3.inverse(turn), body_turn(causes[0].advice)))
    assert np.abs(left[3:]).max() < 0.02


def test_an_extrinsic_that_does_not_fit_is_named() -> None:
    wrong = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.5]))
    evaluated = se3.compose(estimate(), se3.inverse(wrong))
    causes = likely_causes(STAMPS, motion(SECONDS), evaluated, "se3", extrinsic=wrong)
    assert named(causes) == ["body_frame"]
    assert "set extrinsic=0,0,0,0,0,0,1" in causes[0].advice
    # The right one is not.
    turned = se3.compose(estimate(), wrong)
    right = se3.compose(turned, se3.inverse(wrong))
    assert likely_causes(STAMPS, motion(SECONDS), right, "se3", extrinsic=wrong) == ()
