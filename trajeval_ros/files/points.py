# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages with a position and no orientation: PointStamped, NavSatFix.

A fix becomes metres east, north and up of the first one, on the WGS 84 ellipsoid, by pyproj; its
covariance is the message's (REP 145: east, north, up), or what is assumed of its mode (`fixes`).
What has no fix, or is on no place of the Earth, is no position.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.fixes import (
    FixCounts,
    Mode,
    assumed_covariance,
    known_covariance,
    mode_of,
)

Array = npt.NDArray[np.float64]

POINT_TYPE = "geometry_msgs/msg/PointStamped"
FIX_TYPE = "sensor_msgs/msg/NavSatFix"
POINT_TYPES = (POINT_TYPE, FIX_TYPE)

PYPROJ_IS_MISSING = (
    "NavSatFix needs pyproj: apt install python3-pyproj, or python3 -m pip install pyproj"
)

# Longitude, latitude (degrees; longitudes to 360, too) and altitude (m; above all satellites).
_FURTHEST = (360.0, 90.0, 1e8)

_ToEastNorthUp = Callable[[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, slots=True)
class Point:
    """``stamp`` (ns), ``position`` (m; not a number where there is no fix), ``frame``.

    ``covariance``: (6, 6) of position, in the frame's axes, and of no orientation; None if it is
    not known.
    """

    stamp: int
    position: tuple[float, float, float]
    frame: str
    covariance: Array | None


class Points:
    """Reads the messages of one topic; of fixes the first is the origin."""

    def __init__(self) -> None:
        """Start without an origin."""
        self._to_metres: _ToEastNorthUp | None = None
        self.fixes: FixCounts | None = None
        """Of what modes the fixes were; None before the first."""
        self.is_without_pyproj = False
        """Whether a fix could not be read for lack of the library."""

    def read(self, message: Any) -> Point | None:
        """Return what a message holds; None for a fix that cannot be converted."""
        header = message.header
        stamp = int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
        if hasattr(message, "point"):
            position = (message.point.x, message.point.y, message.point.z)
            return Point(stamp, position, header.frame_id, None)
        values = (message.longitude, message.latitude, message.altitude)
        nothing = (math.nan, math.nan, math.nan)
        # Of one that is not a number this is not so either.
        is_on_earth = all(abs(each) <= most for each, most in zip(values, _FURTHEST, strict=True))
        # A message that nobody has filled in is all zero, in ROS 1 its status, that of a fix, too.
        given = known_covariance(message.position_covariance, message.position_covariance_type)
        mode = mode_of(int(message.status.status), given)
        if not is_on_earth or not any(values):
            mode = Mode.NONE
        counts = FixCounts() if self.fixes is None else self.fixes
        self.fixes = counts.with_fix(mode, assumed=given is None and mode is not Mode.NONE)
        if mode is Mode.NONE:
            return Point(stamp, nothing, header.frame_id, None)
        if self._to_metres is None:
            self._to_metres = _about(*values)
            if self._to_metres is None:
                self.is_without_pyproj = True
                return None
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = assumed_covariance(mode) if given is None else given
        return Point(stamp, self._to_metres(*values), header.frame_id, covariance)


def _about(longitude: float, latitude: float, altitude: float) -> _ToEastNorthUp | None:
    """Degrees and metres to metres east, north and up of a place; None without pyproj."""
    try:
        from pyproj import Transformer
    except ImportError:
        return None
    transformer = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad"
        " +step +proj=cart +ellps=WGS84"
        f" +step +proj=topocentric +ellps=WGS84 +lon_0={longitude!r} +lat_0={latitude!r}"
        f" +h_0={altitude!r}"
    )

    def metres(x: float, y: float, z: float) -> tuple[float, float, float]:
        east, north, up = transformer.transform(x, y, z)
        return float(east), float(north), float(up)

    return metres
