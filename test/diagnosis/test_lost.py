# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A lost tracker is named with its rows; a robot that stands is none."""

import numpy as np
import numpy.typing as npt
import pytest

from trajeval_ros.diagnosis.lost import lost

Array = npt.NDArray[np.float64]

SECOND = 1_000_000_000
AT = np.arange(0, 60 * SECOND, SECOND // 20)
TRUTH_AT = np.arange(0, 60 * SECOND, SECOND // 100)


def positions(stamps: npt.NDArray[np.int64], still: tuple[float, float] = (0.0, 0.0)) -> Array:
    """A circle of 2 m at 0.5 m/s, but for a stretch (s) at rest."""
    seconds = stamps / SECOND
    moving = seconds - np.clip(seconds - still[0], 0.0, still[1] - still[0])
    angle = 0.25 * moving
    return np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0 * angle], axis=1)


def written(still: tuple[float, float] = (0.0, 0.0)) -> Array:
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(AT), 1))
    return np.concatenate([positions(AT, still), quaternions], axis=1)


def found(poses: Array, still: tuple[float, float] = (0.0, 0.0)) -> list[str]:
    causes = lost(AT, poses, TRUTH_AT, positions(TRUTH_AT, still), lambda place: place + 2)
    return [cause.text for cause in causes]


def test_the_last_pose_again_and_again() -> None:
    poses = written()
    poses[400:440] = poses[399]
    (text,) = found(poses)
    assert "writes one pose again and again" in text
    assert "41 of 1,200 poses, rows 401 to 441; for up to 2 s" in text


def test_the_identity() -> None:
    poses = written()
    for begin in (100, 300, 500, 700):
        poses[begin : begin + 30] = [0, 0, 0, 0, 0, 0, 1]
    (text,) = found(poses)
    assert "writes the identity" in text
    assert "120 of 1,200 poses, rows 102 to 131, 302 to 331, 502 to 531 and 1 stretch more" in text


@pytest.mark.parametrize("still", [(10.0, 20.0), (0.0, 5.0)])
def test_a_robot_that_stands_is_not_lost(still: tuple[float, float]) -> None:
    assert found(written(still), still) == []


def test_a_pose_that_is_repeated_once_is_no_loss() -> None:
    poses = written()
    poses[1::2] = poses[::2]
    assert found(poses) == []


def test_what_is_published_more_often_than_it_is_estimated_is_no_loss() -> None:
    poses = written()
    assert found(poses[np.arange(len(poses)) // 20 * 20]) == []
