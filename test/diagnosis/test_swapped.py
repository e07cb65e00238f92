# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ground truth and an estimate in each other's place."""

from __future__ import annotations

import numpy as np
import pytest

from trajeval_ros.diagnosis.swapped import Given, swapped

AT_THE_ORIGIN, ELSEWHERE = (0.0, 0.0, 0.0), (1.0, 2.0, 0.5)


def given(source: str, rate: float = 100.0, begin: tuple[float, ...] = ELSEWHERE) -> Given:
    stamps = np.arange(20) * round(1e9 / rate)
    return Given(source, stamps, np.array(begin), np.array([0.0, 0.0, 0.0, 1.0]))


@pytest.mark.parametrize(
    ("source", "called"),
    [
        ("data/groundtruth.txt", True),
        ("MH_04_GT.csv", True),
        ("gt-00.tum", True),
        ("freiburg1_xyz-groundtruth.txt", True),
        ("/data/ground_truth/orb.txt", False),
        ("run.bag, topic /vicon/robot/pose", True),
        ("gt.bag, topic /odometry", False),
        ("gtsam.txt", False),
        ("lightgt.txt", False),
        ("aligned_to_gt_orb.txt", False),
        ("array", False),
    ],
)
def test_what_a_ground_truth_is_called(source: str, called: bool) -> None:
    assert given(source).is_called_ground_truth == called


def test_names_tell() -> None:
    truth, estimate = given("gt.txt"), given("orb.txt")
    assert swapped(truth, estimate) is None
    assert "is called as a ground truth is" in (swapped(estimate, truth) or "")
    # Against itself, and of no names, nothing is asked.
    assert swapped(truth, truth) is None
    assert swapped(estimate, estimate) is None


def test_how_an_estimator_begins_tells_with_its_rate() -> None:
    slow = given("a.txt", 30.0, AT_THE_ORIGIN)
    assert "begins at the identity" in (swapped(slow, given("b.txt")) or "")
    assert swapped(given("b.txt"), slow) is None
    # Neither alone: KITTI's ground truth begins there, and RTK is slow.
    assert swapped(slow, given("b.txt", 30.0)) is None
    assert swapped(slow, given("b.txt", 100.0, AT_THE_ORIGIN)) is None
    assert swapped(given("a.txt", 30.0), given("b.txt")) is None
    assert swapped(slow, Given("b.txt", slow.stamps[:1], slow.position, slow.quaternion)) is None
