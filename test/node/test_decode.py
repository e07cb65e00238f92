# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Raw CDR read by NumPy, against rclpy's own deserialisation."""

from __future__ import annotations

import struct
from itertools import groupby
from typing import Any

import data
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy
from rclpy.serialization import deserialize_message, serialize_message

from trajeval_ros.node.decode import POSE_TYPES, PoseType, decode

KINDS = list(POSE_TYPES.values())

any_float = st.floats(allow_nan=True, allow_infinity=True, width=64)
names = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=9)


@st.composite
def messages(draw: st.DrawFn, kind: PoseType) -> Any:
    made = data.message(
        kind.message,
        0,
        draw(st.lists(any_float, min_size=3, max_size=3)),
        draw(st.lists(any_float, min_size=4, max_size=4)),
        draw(names),
    )
    made.header.stamp.sec = draw(st.integers(-(2**31), 2**31 - 1))
    made.header.stamp.nanosec = draw(st.integers(0, 10**9 - 1))
    if kind.has_child_frame:
        made.child_frame_id = draw(names)
    if kind.has_covariance:
        made.pose.covariance = draw(st_numpy.arrays(np.float64, 36, elements=any_float))
    return made


def twin(kind: PoseType, raw: list[bytes]) -> list[tuple[Any, ...]]:
    """The obvious way: message by message."""
    rows = []
    for each in raw:
        message = deserialize_message(each, kind.message)
        at, turned = data._parts(message)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        row = [at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w]
        if kind.has_covariance:
            row += list(message.pose.covariance)
        rows.append((stamp, row))
    return rows


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@given(chosen=st.data())
def test_as_rclpy_reads_it(kind: PoseType, chosen: st.DataObject) -> None:
    batch = chosen.draw(st.lists(messages(kind), max_size=6))
    raw = [serialize_message(message) for message in batch]
    decoded = decode(kind, raw)
    expected = twin(kind, raw)
    assert decoded.samples.stamps.tolist() == [stamp for stamp, _ in expected]
    values = np.concatenate([decoded.samples.positions, decoded.samples.quaternions], axis=1)
    if kind.has_covariance:
        assert decoded.samples.covariances is not None
        values = np.concatenate([values, decoded.samples.covariances.reshape(-1, 36)], axis=1)
    rows = np.array([row for _, row in expected]).reshape(values.shape)
    np.testing.assert_array_equal(values, rows)
    assert decoded.undecodable == 0
    if batch:
        frames = [message.header.frame_id for message in batch]
        assert list(decoded.frames) == [frame for frame, _ in groupby(frames)]
    if batch and kind.has_child_frame:
        assert decoded.child_frame == batch[-1].child_frame_id


def test_a_covariance_is_row_major() -> None:
    kind = POSE_TYPES["Odometry"]
    made = data.message(kind.message, 0, (0, 0, 0), (0, 0, 0, 1), "map")
    made.pose.covariance[1] = 5.0
    covariances = decode(kind, [serialize_message(made)]).samples.covariances
    assert covariances is not None
    assert covariances[0, 0, 1] == 5.0


def test_big_endian() -> None:
    kind = POSE_TYPES["PoseStamped"]
    values = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]
    # "ab" and its zero end at offset 15 behind the encapsulation; doubles begin at 16.
    raw = b"\0\0\0\0" + struct.pack(">iII3sx7d", 5, 6, 3, b"ab\0", *values)
    decoded = decode(kind, [raw])
    assert decoded.samples.stamps.tolist() == [5_000_000_006]
    assert decoded.samples.positions.tolist() == [[1.0, 2.0, 3.0]]
    assert decoded.frames == ("ab",)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_what_is_no_message_is_counted(kind: PoseType) -> None:
    good = serialize_message(data.message(kind.message, 7, (1, 2, 3), (0, 0, 0, 1), "map"))
    huge_string = good[:12] + b"\xff\xff\xff\x7f" + good[16:]
    decoded = decode(kind, [good, b"", b"\0", good[:40], b"\0\7junk", huge_string, good])
    assert len(decoded.samples) == 2
    assert decoded.undecodable == 5


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_message_that_is_cut_short_is_none(kind: PoseType) -> None:
    """Behind what we take of it, too: an Odometry's twist."""
    good = serialize_message(data.message(kind.message, 7, (1, 2, 3), (0, 0, 0, 1), "map"))
    cut = [good[:end] for end in range(0, len(good), 7)]
    assert decode(kind, [*cut, good]).undecodable == len(cut)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@given(chosen=st.data())
def test_many_at_a_time_as_one_by_one(kind: PoseType, chosen: st.DataObject) -> None:
    """Wherever the bytes are damaged."""
    made = data.message(kind.message, 7, (1, 2, 3), (0, 0, 0, 1), "map")
    batch = [bytearray(serialize_message(made)) for _ in range(chosen.draw(st.integers(1, 5)))]
    for message in batch:
        for place in chosen.draw(st.lists(st.integers(0, 60), max_size=2)):
            message[place] = chosen.draw(st.integers(0, 255))
    raw = [bytes(message[: chosen.draw(st.sampled_from([-8, None]))]) for message in batch]
    together, alone = decode(kind, raw), [decode(kind, [each]) for each in raw]
    assert together.undecodable == sum(each.undecodable for each in alone)
    for part in ("stamps", "positions", "quaternions"):
        expected = np.concatenate([getattr(each.samples, part) for each in alone])
        np.testing.assert_array_equal(getattr(together.samples, part), expected)
    frames = [frame for each in alone for frame in each.frames]
    assert list(together.frames) == [frame for frame, _ in groupby(frames)]


def test_nothing() -> None:
    decoded = decode(KINDS[0], [])
    assert len(decoded.samples) == 0
