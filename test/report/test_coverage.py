# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts over time and gaps, against the obvious way."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.report.coverage import SECOND, Coverage
from trajeval_ros.report.series import rate_of


@given(
    seconds=st.lists(st.floats(-500, 500), min_size=1, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=5),
)
def test_every_stamp_is_in_its_bin(seconds: list[float], cuts: list[int]) -> None:
    stamps = (1_700_000_000 * SECOND + np.array(seconds) * 1e9).astype(np.int64)
    coverage = Coverage(capacity=16)
    for part in np.split(stamps, sorted(cut % len(stamps) for cut in cuts)):
        coverage.add(part)
    edges, rate = coverage.rate()
    assert len(rate) <= 16
    expected, _ = np.histogram(stamps, edges)
    # histogram closes its last bin on both sides; ours are all half open
    assert stamps.max() < edges[-1]
    np.testing.assert_allclose(rate * np.diff(edges) / SECOND, expected)
    assert coverage.total == len(stamps)
    assert (coverage.earliest, coverage.latest) == (stamps.min(), stamps.max())


@given(
    steps=st.lists(st.integers(1, 30), min_size=1, max_size=50),
    cuts=st.lists(st.integers(0, 50), max_size=5),
)
def test_gaps_are_the_long_steps(steps: list[int], cuts: list[int]) -> None:
    stamps = np.cumsum(np.array(steps, np.int64)) * SECOND
    coverage = Coverage()
    for part in np.split(stamps, sorted(cut % len(stamps) for cut in cuts)):
        coverage.add(part)
    expected = [(int(a), int(b)) for a, b in itertools.pairwise(stamps) if (b - a) / SECOND > 10]
    assert [(gap.start, gap.end) for gap in coverage.gaps(longer_than=10)] == expected


def test_one_wild_stamp_does_not_stretch_the_axis() -> None:
    stamps = np.arange(1000, dtype=np.int64) * SECOND // 10 + 1_700_000_000 * SECOND
    coverage = Coverage()
    coverage.add(np.insert(stamps, 500, 0))
    edges, _ = coverage.rate()
    assert coverage.total == 1000
    assert edges[-1] - edges[0] < 101 * SECOND
    assert coverage.gaps(longer_than=1) == []


def test_a_leap_that_lasts_is_believed() -> None:
    coverage = Coverage()
    coverage.add(np.arange(10, dtype=np.int64) * SECOND)
    for stamp in range(10):
        coverage.add(np.array([(1_000_000 + stamp) * SECOND], np.int64))
    assert coverage.total == 19
    assert coverage.latest == 1_000_009 * SECOND


def test_most_gaps_are_bounded_and_the_longest_stay() -> None:
    generator = np.random.default_rng(0)
    steps = generator.integers(1, 1000, 5000) * (SECOND // 1000)
    coverage = Coverage(gaps=8)
    for part in np.array_split(np.cumsum(steps), 50):
        coverage.add(part)
    found = sorted(gap.seconds for gap in coverage.gaps(longer_than=0))
    np.testing.assert_allclose(found, np.sort(steps[1:])[-8:] / SECOND)


def test_a_rate_takes_no_more_bins_than_there_are() -> None:
    coverage = Coverage()
    coverage.add(np.arange(0, 10 * SECOND, SECOND // 20))
    # The other topic's stamps make the run last for 240 years.
    edges, rate = rate_of(coverage, 0, 7.5e9, 0)
    assert len(rate) == 1
    np.testing.assert_allclose(rate, 20.0, rtol=0.02)
    np.testing.assert_allclose(edges, [0.0, 10.0], atol=0.1)
