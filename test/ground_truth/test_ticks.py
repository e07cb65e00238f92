# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps that were rounded: found by their intervals, with the size of the ticks."""

import numpy as np
import pytest

from trajeval_ros.ground_truth import ticks
from trajeval_ros.ground_truth.ticks import SECOND, coarsest, resolutions, whole_seconds

START = 1_700_000_000 * SECOND + 98_386_526


def resolution(stamps):
    """Of one block."""
    (found,) = resolutions(stamps[None])
    return found


def quantised(stamps, tick):
    """The same."""
    (found,) = ticks.quantised(stamps[None], np.array([tick]))
    return found


def rounded(seconds, tick):
    """Stamps of ``seconds`` in whole ticks (s), each once."""
    return np.unique(START + np.floor(np.asarray(seconds) / tick).astype(int) * round(tick * 1e9))


@pytest.mark.parametrize(
    ("rate", "tick"),
    [(31.0, 0.01), (70.0, 0.01), (0.7, 1.0), (0.4, 1.0), (0.7407, 0.1), (19, 1 / 64)],
)
def test_rounded_stamps_show_their_ticks(rate, tick):
    stamps = rounded(np.arange(64) / rate + 0.004, tick)
    assert resolution(stamps) == round(tick * 1e9)
    assert quantised(stamps, resolution(stamps))
    # As seconds since 1970 in 64 bits have them.
    stamps = (stamps * 1e-9 * 1e9).astype(np.int64)
    assert resolution(stamps) == round(tick * 1e9)
    assert quantised(stamps, resolution(stamps))


def test_whole_ticks_apart_they_do_not_show():
    rng = np.random.default_rng(0)
    even = START + np.arange(64) * 10_000_000
    missing = (START + np.arange(90) * 10_000_000)[np.sort(rng.choice(90, 64, replace=False))]
    for stamps in (even, missing):
        assert resolution(stamps) == 10_000_000
        assert not quantised(stamps, resolution(stamps))


def test_fine_stamps_have_no_ticks():
    rng = np.random.default_rng(1)
    for rate in (0.5, 5.0, 100.0):
        seconds = np.cumsum(rng.uniform(0.5, 1.5, 64)) / rate
        assert resolution(START + (seconds * 1e9).astype(np.int64)) == 0
    milliseconds = rounded(np.cumsum(rng.uniform(0.009, 0.011, 64)), 0.001)
    assert resolution(milliseconds) == 0


def test_blocks_are_looked_at_each_by_itself():
    rng = np.random.default_rng(2)
    intervals = np.cumsum(rng.uniform(0.5, 1.5, (40, 64)) / rng.uniform(0.5, 200.0, (40, 1)), 1)
    sizes = rng.choice([1e-9, 0.004, 0.01, 1 / 64, 0.1, 1.0], (40, 1))
    blocks = START + np.rint(np.floor(intervals / sizes) * sizes * 1e9).astype(np.int64)
    found = resolutions(blocks)
    for block, tick in zip(blocks, found.tolist(), strict=True):
        assert tick == coarsest(block, float(np.median(np.diff(block))))
    flags = ticks.quantised(blocks, found)
    assert 5 < np.count_nonzero(flags) < np.count_nonzero(found) + 1 < 40
    assert flags.tolist() == [quantised(*each) for each in zip(blocks, found, strict=True)]


def test_whole_seconds_are_told():
    assert whole_seconds(np.arange(5) * SECOND)
    assert not whole_seconds(np.arange(5) * SECOND + 1)
