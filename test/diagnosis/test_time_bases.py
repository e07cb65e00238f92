# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clocks that have no time in common: what relates them, by their sizes and by the motion."""

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.diagnosis.time_bases import offset_by_motion, time_base

SECOND = 1_000_000_000
UNIX = 1_403_638_128.0


def stamps(first, span=30.0, rate=20.0):
    return np.rint((first + np.arange(0.0, span, 1.0 / rate)) * 1e9).astype(np.int64)


@pytest.mark.parametrize(
    ("offset", "said"),
    [
        (18.0, "GPS time is 18 s ahead"),
        (-18.0, "GPS time is 18 s ahead"),
        (37.0, "TAI is 37 s ahead"),
        (3600.0, "a time zone, 1 h"),
        (-7 * 3600.0, "a time zone, 7 h"),
        (5.5 * 3600.0, "a time zone, 5.5 h"),
        (-315_964_800.0, "1980"),
        (-315_964_782.0, "1980 by GPS time"),
    ],
)
def test_offsets_that_clocks_are_known_for(offset, said):
    # As short as it has to be for a leap second to leave nothing in common.
    cause = time_base(stamps(UNIX, 12.0), stamps(UNIX + offset + 0.4, 12.0))
    assert cause is not None
    assert cause.code == "time_base"
    assert said in cause.text
    assert cause.advice == f"set estimate.time_offset={-offset:.10g}"


def test_an_offset_that_is_set_already_counts():
    cause = time_base(stamps(UNIX, 12.0), stamps(UNIX + 3600.0, 12.0), 100.0)
    assert cause is not None
    assert cause.advice == "set estimate.time_offset=-3500"


@pytest.mark.parametrize(
    ("factor", "unit", "short"), [(1e3, "milliseconds", "ms"), (1e6, "microseconds", "us")]
)
def test_units(factor, unit, short):
    truth = stamps(5.0)
    other = truth * int(factor)
    for pair, title in (((truth, other), "estimate"), ((other, truth), "ground truth")):
        cause = time_base(*pair)
        assert cause is not None
        assert cause.text == f"the {title}'s stamps are {unit}, by their size"
        assert f"[{short}]" in cause.advice


def test_frame_numbers():
    cause = time_base(stamps(UNIX), np.arange(600, dtype=np.int64) * SECOND)
    assert cause is not None
    assert cause.text == "the estimate's stamps look like frame numbers (0, 1, ...)"
    assert time_base(stamps(0.0, 60.0, 1.0), stamps(0.0, 60.0, 1.0)) is None


def test_seconds_since_a_start():
    cause = time_base(stamps(UNIX), stamps(812.0))
    assert cause is not None
    assert "the estimate's stamps count from a start" in cause.text
    assert cause.advice.endswith(f"estimate.time_offset={UNIX - 812.0:.3f}")
    cause = time_base(stamps(812.0), stamps(UNIX))
    assert cause is not None
    assert "the ground truth's stamps count from a start" in cause.text


def test_what_is_right_has_no_reason():
    assert time_base(stamps(UNIX), stamps(UNIX + 1.0)) is None
    assert time_base(stamps(UNIX), stamps(UNIX + 12_345.0)) is None


def motion(seconds, seed=0):
    """A smooth random walk, the same at the same seconds."""
    random = np.random.default_rng(seed)
    frequency, phase = random.uniform(0.05, 0.7, (12, 6)), random.uniform(0, 6, (12, 6))
    angle = 2 * np.pi * frequency * np.asarray(seconds)[:, None, None] + phase
    return se3.exp(0.15 * np.sin(angle).sum(axis=1))


@pytest.mark.parametrize("offset", [0.0, 1.4e9, -1.4e9, 7.3])
@pytest.mark.parametrize("part", [(0.0, 60.0), (13.0, 50.0), (-20.0, 45.0)])
def test_the_motion_tells_the_offset(offset, part):
    known, seconds = np.arange(0.0, 60.0, 0.01), np.arange(*part, 0.05)
    estimate = se3.compose(
        se3.compose(se3.exp(np.array([1.0, 2, 3, 0.4, 0.5, 2])), motion(seconds)),
        se3.exp(np.random.default_rng(1).normal(size=(len(seconds), 6)) * 0.003),
    )
    found = offset_by_motion(
        np.rint((known + 100.0) * 1e9).astype(np.int64),
        motion(known),
        np.rint((seconds + 100.0 - offset) * 1e9).astype(np.int64),
        estimate,
    )
    assert found is not None
    assert found.offset == pytest.approx(offset, abs=found.within)
    assert found.within == pytest.approx(0.15, abs=1e-6)


def test_where_no_offset_stands_out_none_is_given():
    seconds = np.arange(0.0, 60.0, 0.05)
    at = np.rint(seconds * 1e9).astype(np.int64)
    assert offset_by_motion(at, motion(seconds), at, motion(seconds, seed=5)) is None
    round_and_round = np.zeros((len(seconds), 6))
    round_and_round[:, 0] = np.sin(seconds)
    round_and_round[:, 5] = np.cos(seconds)
    again = se3.exp(round_and_round)
    assert offset_by_motion(at, again, at, again) is None
    still = np.tile(np.eye(4), (len(seconds), 1, 1))
    assert offset_by_motion(at, still, at, motion(seconds)) is None
    assert offset_by_motion(at[:50], motion(seconds)[:50], at, motion(seconds)) is None
