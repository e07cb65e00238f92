# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes in metres about the first one, wherever on Earth; what is on no place of it is none."""

import math
from types import SimpleNamespace as Made

import numpy as np
import pytest

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
