# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Instants as users give them, and trajectories cut between two."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.files.span import Instant, Span, SpanError, cut_all, span_of, words
from trajeval_ros.files.trajectory import Trajectory

EPOCH = 1_403_636_579_763_555_584


def trajectory(stamps: list[int], source: str = "file.txt") -> Trajectory:
    count = len(stamps)
    return Trajectory(
        stamps=np.array(stamps, dtype=np.int64),
        positions=np.arange(3.0 * count).reshape(-1, 3),
        quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        rows=np.arange(1, count + 1),
        source=source,
    )


@pytest.mark.parametrize(
    ("given", "nanoseconds", "is_stamp"),
    [
        ("0", 0, False),
        ("10.5", 10_500_000_000, False),
        (10.5, 10_500_000_000, False),
        ("1e3", 1_000_000_000_000, False),
        ("99999999", 99_999_999_000_000_000, False),
        ("100000000", 100_000_000_000_000_000, True),
        # Exact, where a double is not.
        ("1403636579.763555584", EPOCH, True),
        (str(EPOCH), EPOCH, True),
        (EPOCH, EPOCH, True),
    ],
)
def test_size_tells_seconds_from_stamps(
    given: str | float, nanoseconds: int, is_stamp: bool
) -> None:
    found = Instant.of(given)
    assert (found.nanoseconds, found.is_stamp) == (nanoseconds, is_stamp)


@pytest.mark.parametrize("given", ["-1", "nan", "inf", "ten", "", "1e12", "1e19"])
def test_what_is_no_instant(given: str) -> None:
    with pytest.raises(SpanError):
        Instant.of(given)


def test_seconds_count_from_the_ground_truth_and_not_from_a_stamp_that_was_not_set() -> None:
    for stamps in ([EPOCH, EPOCH + 10**9], [0, EPOCH, EPOCH + 10**9]):
        span = span_of(Instant.of("0.25"), None, trajectory(stamps))
        assert span is not None
        assert span.begin == EPOCH + 250_000_000
        assert span.end is None
        assert span.text == "from 0.25 s after the ground truth begins"
    assert span_of(None, None, trajectory([1])) is None
    with pytest.raises(SpanError, match="not after the start"):
        span_of(Instant.of("5"), Instant.of("5"), trajectory([EPOCH]))
    with pytest.raises(SpanError, match="no pose"):
        span_of(Instant.of("5"), None, trajectory([]))
    both = span_of(Instant.of("1403636580"), Instant.of("9"), trajectory([EPOCH]))
    assert both is not None
    assert both.text == "from the stamp 1403636580 to 9 s after the ground truth begins"


def test_every_pose_left_has_a_sample_on_either_side() -> None:
    truth = trajectory([0, 10, 20, 30, 40, 50])
    estimate = trajectory([3, 14, 25, 36, 47], "odom")
    left, cut = cut_all(Span(12, 38, "here"), truth, {"odom": estimate}, {"odom": 0})
    assert left.stamps.tolist() == [10, 20, 30, 40]
    assert cut["odom"].stamps.tolist() == [14, 25, 36]
    assert cut["odom"].rows.tolist() == [2, 3, 4]
    assert (left.cut, cut["odom"].cut) == (2, 2)
    said = words(Span(12, 38, "here"), left, [cut["odom"]])
    assert said == (
        "here; left out: 2 of 5 poses of odom, 2 of 6 samples of the ground truth;"
        " seconds below count from there"
    )
    # On the ground truth's clock.
    _, cut = cut_all(Span(12, 38, "here"), truth, {"odom": estimate}, {"odom": 10})
    assert cut["odom"].stamps.tolist() == [3, 14, 25]
    with pytest.raises(SpanError, match="odom: no pose of it lies here"):
        cut_all(Span(48, None, "here"), truth, {"odom": estimate}, {"odom": 0})


@given(st.lists(st.integers(0, 100), min_size=1, max_size=30), st.integers(0, 100), st.data())
def test_nothing_is_lost(stamps: list[int], begin: int, data: st.DataObject) -> None:
    end = data.draw(st.integers(begin + 1, 101))
    inside = [stamp for stamp in stamps if begin <= stamp <= end]
    whole, truth = trajectory(stamps), trajectory([0, 101])
    if not inside:
        with pytest.raises(SpanError):
            cut_all(Span(begin, end, "here"), truth, {"a": whole}, {"a": 0})
        return
    _, cut = cut_all(Span(begin, end, "here"), truth, {"a": whole}, {"a": 0})
    assert cut["a"].stamps.tolist() == inside
    assert cut["a"].cut == len(stamps) - len(inside)
