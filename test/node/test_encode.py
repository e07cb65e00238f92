# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Serialised messages made by NumPy, against rclpy's own deserialisation."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64

from trajeval_ros.node import encode

SECOND = 1_000_000_000
any_float = st.floats(allow_nan=True, allow_infinity=True, width=64)
names = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=9)
stamps = st.lists(st.integers(0, 2**31 * SECOND - 1), max_size=4)


def rows(chosen: st.DataObject, count: int, width: int) -> np.ndarray:
    one = st.lists(any_float, min_size=width, max_size=width)
    return np.array([chosen.draw(one) for _ in range(count)]).reshape(count, width)


@given(stamps, names, st.data())
def test_vectors(when: list[int], frame: str, chosen: st.DataObject) -> None:
    values = rows(chosen, len(when), 3)
    messages = encode.stamped(np.array(when, dtype=np.int64), frame, values)
    assert len(messages) == len(when)
    for stamp, raw, row in zip(when, messages, values, strict=True):
        made = deserialize_message(raw, Vector3Stamped)
        assert made.header.frame_id == frame
        assert made.header.stamp.sec * SECOND + made.header.stamp.nanosec == stamp
        np.testing.assert_array_equal([made.vector.x, made.vector.y, made.vector.z], row)


@given(stamps, names, st.data())
def test_poses(when: list[int], frame: str, chosen: st.DataObject) -> None:
    values = rows(chosen, len(when), 43)
    messages = encode.stamped(np.array(when, dtype=np.int64), frame, values)
    for stamp, raw, row in zip(when, messages, values, strict=True):
        made = deserialize_message(raw, PoseWithCovarianceStamped)
        at, turned = made.pose.pose.position, made.pose.pose.orientation
        assert made.header.frame_id == frame
        assert made.header.stamp.sec * SECOND + made.header.stamp.nanosec == stamp
        np.testing.assert_array_equal([at.x, at.y, at.z], row[:3])
        np.testing.assert_array_equal([turned.x, turned.y, turned.z, turned.w], row[3:7])
        np.testing.assert_array_equal(made.pose.covariance, row[7:])


@given(st.lists(any_float, max_size=5))
def test_numbers(values: list[float]) -> None:
    messages = encode.numbers(np.array(values))
    read = [deserialize_message(raw, Float64).data for raw in messages]
    np.testing.assert_array_equal(read, values)
