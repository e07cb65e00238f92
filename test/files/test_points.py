# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes in metres about the first one, wherever on Earth; what is on no place of it is none."""

import math
from types import SimpleNamespace as Made

import numpy as np
import pytest

from trajeval_ros.files.fixes import FixCounts, Mode, known_covariance, mode_of
from trajeval_ros.files.points import Points

pytest.importorskip("pyproj")


def positions(*fixes: tuple[float, float, float]) -> np.ndarray:
    """What becomes of fixes (latitude, longitude, altitude) of one topic."""
    points, found = Points(), []
    for second, (latitude, longitude, altitude) in enumerate(fixes):
        point = points.read(
            Made(
                header=Made(stamp=Made(sec=second, nanosec=0), frame_id="gps"),
                status=Made(status=0),
                latitude=latitude,
                longitude=longitude,
                altitude=altitude,
                position_covariance=np.zeros(9),
                position_covariance_type=0,
            )
        )
        assert point is not None
        found.append(point.position)
    return np.array(found)


@pytest.mark.parametrize(
    "wrong",
    [
        (95.0, 8.0, 0.0),
        (-91.0, 8.0, 0.0),
        (47.0, 500.0, 0.0),
        (1e300, 8.0, 0.0),
        (47.0, 8.0, 1e300),
        (47.0, 8.0, math.nan),
        (math.inf, 8.0, 0.0),
        (0.0, 0.0, 0.0),
    ],
)
def test_what_is_on_no_place_of_the_earth_is_no_position_and_no_origin(wrong: tuple) -> None:
    found = positions(wrong, (47.0, 8.0, 400.0), wrong, (47.00001, 8.0, 400.0))
    assert np.isnan(found[[0, 2]]).all()
    np.testing.assert_allclose(found[[1, 3]], [[0, 0, 0], [0, 1.1117, 0]], atol=1e-3)


def test_where_the_equator_and_greenwich_meet_there_are_places() -> None:
    found = positions((0.0, 0.0, 1.0), (0.0, 0.0, 3.0))
    np.testing.assert_allclose(found, [[0, 0, 0], [0, 0, 2]], atol=1e-6)


def test_across_the_antimeridian_and_the_pole_metres_go_on() -> None:
    east = positions((10.0, 179.99999, 0.0), (10.0, -179.99999, 0.0), (10.0, 180.00001, 0.0))
    np.testing.assert_allclose(east[1:], [[2.1926, 0, 0]] * 2, atol=1e-3)
    pole = positions((89.99999, 0.0, 0.0), (90.0, 77.0, 0.0), (89.99999, 180.0, 0.0))
    np.testing.assert_allclose(pole, [[0, 0, 0], [0, 1.1169, 0], [0, 2.2339, 0]], atol=1e-3)


# As drivers fill them in: status, standard deviation east and north (m), or none.
DRIVERS = {
    "u-blox, fixed": (2, 0.014, Mode.FIXED),
    "u-blox, float": (0, 0.25, Mode.FLOAT),
    "u-blox, single": (0, 1.6, Mode.SINGLE),
    "u-blox, nothing": (-1, 1e3, Mode.NONE),
    "Septentrio and Swift, fixed": (2, 0.008, Mode.FIXED),
    "Septentrio and Swift, float": (2, 0.4, Mode.FLOAT),
    "Septentrio, SBAS": (1, 0.7, Mode.DIFFERENTIAL),
    "NMEA, quality 1": (0, 4.0 * 0.9, Mode.SINGLE),
    "NMEA, quality 2": (1, 0.1 * 0.9, Mode.DIFFERENTIAL),
    "NMEA, quality 4": (2, 0.02 * 0.9, Mode.FIXED),
    "NMEA, quality 5": (2, 4.0 * 0.9, Mode.FLOAT),
    "a status that nobody has set": (-2, 0.02, Mode.FIXED),
    "neither": (-2, None, Mode.SINGLE),
    "ground-based, without a covariance": (2, None, Mode.RTK),
    "satellite-based, without": (1, None, Mode.DIFFERENTIAL),
    "plain, without": (0, None, Mode.SINGLE),
}


@pytest.mark.parametrize("driver", DRIVERS)
def test_what_a_fix_is(driver: str) -> None:
    status, std, mode = DRIVERS[driver]
    covariance = None if std is None else np.diag([std**2, std**2, 4.0 * std**2])
    assert mode_of(status, covariance) is mode


@pytest.mark.parametrize(
    ("values", "kind", "known"),
    [
        (np.diag([1e-4, 1e-4, 4e-4]), 2, True),
        (np.diag([1e-4, 1e-4, 4e-4]), 0, False),
        (np.zeros((3, 3)), 3, False),
        (np.diag([-2e10, -2e10, -2e10]), 3, False),
        (np.diag([np.nan, 1.0, 1.0]), 3, False),
    ],
)
def test_a_covariance_of_nothing_is_not_known(values: np.ndarray, kind: int, known: bool) -> None:
    assert (known_covariance(values.ravel(), kind) is not None) == known


def fix(second: int, status: int, std: float | None) -> Made:
    return Made(
        header=Made(stamp=Made(sec=second, nanosec=0), frame_id="gps"),
        status=Made(status=status),
        latitude=47.0,
        longitude=8.0,
        altitude=400.0,
        position_covariance=np.zeros(9) if std is None else (std**2 * np.eye(3)).ravel(),
        position_covariance_type=0 if std is None else 2,
    )


def test_what_is_not_known_is_assumed_and_said() -> None:
    points = Points()
    made = [(2, 0.01), (2, 0.01), (2, 0.3), (0, 2.0), (0, None), (2, None), (-1, None)]
    found = [points.read(fix(second, *each)) for second, each in enumerate(made)]
    stds = [
        None if each is None or each.covariance is None else np.sqrt(each.covariance[0, 0])
        for each in found
    ]
    assert stds == [*[pytest.approx(std) for std in (0.01, 0.01, 0.3, 2.0, 3.0, 0.5)], None]
    counts = points.fixes
    assert counts is not None
    assert counts.named == {
        "fixed": 2,
        "float": 1,
        "rtk": 1,
        "differential": 0,
        "single": 2,
        "none": 1,
        "assumed": 2,
    }
    assert counts.sentence("ground truth", False) == (
        "ground truth: fixes are 2 RTK fixed, 1 RTK float, 1 RTK, fixed or float, 2 single,"
        " 1 none, and all count alike: with ground_truth.use_covariance=true each is as certain"
        " as it says"
    )
    assert "of 2 the covariance is unknown: assumed is 0.5 m (RTK, fixed or float), 3 m" in (
        counts.sentence("ground truth", True)
    )


def test_fixes_that_are_alike_are_no_trouble() -> None:
    counts = FixCounts({Mode.FIXED: 1200, Mode.NONE: 3})
    assert counts.sentence("ground truth", False) == (
        "ground truth: fixes are 1,200 RTK fixed, 3 none"
    )
    assert counts.kinds == 1
