# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The regular clock behind late stamps: found where there is one, followed, and only there."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros.ground_truth.clock import (
    LOOK_AHEAD,
    Line,
    RegularClock,
    under,
)

START = 1_700_000_000_000_000_000


def to_stamps(seconds):
    stamps = START + np.rint(np.asarray(seconds) * 1e9).astype(np.int64)
    return np.maximum.accumulate(stamps - np.arange(len(stamps))) + np.arange(len(stamps))


def seen_late(rng, ticks, delay, drops=0.0, queue=0.0):
    """Ticks (n,) s and their stamps: some are missing, some stretches wait in a queue."""
    ticks = ticks[rng.random(len(ticks)) >= drops]
    delays = rng.exponential(delay, len(ticks))
    if queue:
        for begin in np.flatnonzero(rng.random(len(ticks)) < 0.01):
            until = ticks[begin] + queue * rng.random()
            waiting = (ticks >= ticks[begin]) & (ticks < until)
            delays[waiting] = until - ticks[waiting] + rng.exponential(1e-4, waiting.sum())
    return ticks, np.maximum.accumulate(ticks + delays)


def followed(stamps, chunk=None):
    """The clock, and the stamps (n,) that it gives, s."""
    clock, found = RegularClock(), []
    for begin in range(0, len(stamps), chunk or len(stamps)):
        found.append(clock.accept(stamps[begin : begin + (chunk or len(stamps))]))
    found.append(clock.conclude())
    np.testing.assert_array_equal(np.concatenate([f.measured for f in found]), stamps)
    return clock, np.concatenate([f.regular for f in found])


def off(regular, ticks):
    """How far the stamps are from the ticks, but for the same lag of all, s."""
    error = (regular - START) * 1e-9 - ticks
    return error - np.median(error)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_no_sample_is_early_and_none_could_be_less_late(seed):
    rng = np.random.default_rng(seed)
    seconds = np.sort(rng.uniform(0.0, 2.0, rng.integers(1, 40)))
    line = Line(float(rng.uniform(-1.0, 0.0)), float(rng.uniform(0.01, 0.3)))
    found = line.assigned(seconds, len(seconds))
    reach = min(1.0, 8.0 * line.period)
    ends = np.searchsorted(seconds, seconds + reach, side="right")
    for i, end in enumerate(ends):
        latest = np.floor((seconds[i:end] - line.origin) / line.period + line.early)
        assert found[i] == min(latest - np.arange(end - i))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_the_line_under_the_points_is_the_nearest_one(seed):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.integers(1, 4, rng.integers(2, 30))).astype(float)
    y = 0.02 * x + rng.exponential(0.01, len(x))
    line = under((x, y))
    above = y - line.origin - line.period * x
    assert above.min() > -1e-12
    pairs = [(i, j) for i in range(len(x)) for j in range(i)]
    slopes = [(y[i] - y[j]) / (x[i] - x[j]) for i, j in pairs]
    lines = [(float((y - slope * x).min()), slope) for slope in slopes]
    best = min(float((y - a - b * x).sum()) for a, b in lines)
    assert above.sum() == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("rate", [5, 50, 200])
@pytest.mark.parametrize(("drops", "queue"), [(0.0, 0.0), (0.02, 0.0), (0.0, 0.1), (0.01, 0.1)])
def test_the_ticks_come_back(rate, drops, queue):
    rng = np.random.default_rng(rate)
    ticks, seconds = seen_late(rng, np.arange(3000) / rate, 0.3 / rate, drops, queue)
    clock, regular = followed(to_stamps(seconds))
    assert clock.period == pytest.approx(1.0 / rate, rel=2e-4)
    assert clock.sums.tells(clock.period)
    assert (np.diff(regular) > 0).all()
    before = np.sqrt(np.mean(off(to_stamps(seconds), ticks) ** 2))
    after = np.abs(off(regular, ticks))
    assert np.percentile(after, 90) < 0.06 / rate
    assert np.sqrt(np.mean(after**2)) < 0.7 * before


def test_ticks_of_a_polling_loop_are_a_late_clock():
    rng = np.random.default_rng(2)
    ticks = 0.0037 + np.arange(3000) / 30.0 * (1.0 + 2e-5)
    polled = np.ceil(ticks / 0.01) * 0.01 + rng.normal(0.0, 1e-4, len(ticks))
    _, regular = followed(to_stamps(polled))
    assert np.std(off(to_stamps(polled), ticks)) > 2e-3
    assert np.std(off(regular, ticks)[200:]) < 1e-3


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_batches_do_not_matter(chunk):
    rng = np.random.default_rng(3)
    _, seconds = seen_late(rng, np.arange(1500) / 50.0, 0.01, 0.02, 0.2)
    stamps = to_stamps(seconds)
    first, whole = followed(stamps)
    second, cut = followed(stamps, chunk)
    np.testing.assert_array_equal(cut, whole)
    assert first.sums == second.sums


def test_a_stamp_is_decided_on_by_those_up_to_the_look_ahead():
    rng = np.random.default_rng(4)
    _, seconds = seen_late(rng, np.arange(1000) / 50.0, 0.01)
    stamps = to_stamps(seconds)
    _, whole = followed(stamps)
    clock, count = RegularClock(), 0
    for stamp in stamps:
        count += len(clock.accept(np.array([stamp])))
        if count:
            assert stamps[count - 1] + LOOK_AHEAD < stamp <= stamps[count] + LOOK_AHEAD
    # Those after it may be anything.
    decided = followed(np.append(stamps[:700], stamps[700:] + 5_000_000_000))[1]
    early = int(np.searchsorted(stamps, stamps[699] - LOOK_AHEAD))
    np.testing.assert_array_equal(decided[:early], whole[:early])
    confirmed = RegularClock()
    confirmed.accept(stamps[:500])
    assert len(confirmed.confirm(int(stamps[499]))) > 0


def test_a_change_of_the_period_is_followed():
    rng = np.random.default_rng(5)
    ends = [40.0, 80.0, 120.0]
    begins, rates = [0.0, 40.0, 80.0], [50, 100, 30]
    phases = list(zip(begins, ends, strict=True))
    parts = [np.arange(a, b, 1.0 / r) for (a, b), r in zip(phases, rates, strict=True)]
    ticks = np.concatenate(parts)
    _, seconds = seen_late(rng, ticks, 0.004)
    _, regular = followed(to_stamps(seconds))
    error = (regular - START) * 1e-9 - ticks
    for begin, end in phases:
        inside = (ticks > begin + 8.0) & (ticks < end - 1.0)
        assert np.std(error[inside]) < 1.5e-3
    assert np.abs(error).max() < 0.2


def wandering(rng):
    """A scanner: each turn takes a little more or less, and the next one makes up for nothing."""
    return np.cumsum(0.1036 + rng.normal(0.0, 2e-3, 3000))


def at_random(rng):
    return np.cumsum(rng.exponential(0.02, 3000))


def exact(rng):
    return np.arange(3000) * 0.01


def exact_with_gaps(rng):
    seconds = exact(rng)[rng.random(3000) > 0.1]
    return seconds + (seconds > 15.0) * 12.0


@pytest.mark.parametrize("sampled", [wandering, at_random, exact, exact_with_gaps])
@pytest.mark.parametrize("seed", range(3))
def test_other_stamps_stay_as_they_are(sampled, seed):
    stamps = to_stamps(sampled(np.random.default_rng(seed)))
    clock, regular = followed(stamps)
    np.testing.assert_array_equal(regular, stamps)
    assert clock.period is None


def test_few_stamps_stay_as_they_are():
    for count in (0, 1, 2, 15):
        stamps = to_stamps(np.arange(count) * 0.1)
        np.testing.assert_array_equal(followed(stamps)[1] if count else stamps, stamps)


def test_memory_is_bounded():
    rng = np.random.default_rng(6)
    _, seconds = seen_late(rng, np.arange(20000) / 100.0, 0.005)
    clock = RegularClock()
    for part in np.array_split(to_stamps(seconds), 200):
        clock.accept(part)
        assert len(clock._pending) < 200
        assert len(clock._corners) <= 32
        assert len(clock._recent) <= 128


@pytest.mark.parametrize("pause", [2.0, 30.0, 600.0])
@pytest.mark.parametrize("phase", [-0.3, 0.5])
@pytest.mark.parametrize("chunk", [1000, 7])
def test_an_instrument_that_was_started_again_has_other_ticks(pause, phase, chunk):
    rng = np.random.default_rng(4)
    ticks = 0.1 * np.arange(600)
    again = ticks[-1] + pause + 0.1 * (1.0 + phase) + ticks
    ticks, seconds = seen_late(rng, np.concatenate([ticks, again]), 0.01)
    clock, regular = followed(to_stamps(seconds), chunk)
    assert clock.period == pytest.approx(0.1, rel=1e-4)
    early = (regular - START) * 1e-9 - ticks
    # Those of the ticks before would be 20 to 80 ms early, for many seconds.
    assert early[600:].min() > -0.015
    assert np.abs(early[-200:]).max() < 0.005


@pytest.mark.parametrize("pause", [2.0, 30.0, 600.0])
def test_after_a_pause_the_ticks_go_on(pause):
    rng = np.random.default_rng(4)
    ticks = 0.1 * np.arange(600)
    ticks, seconds = seen_late(rng, np.concatenate([ticks, ticks[-1] + pause + ticks]), 0.01)
    _, regular = followed(to_stamps(seconds))
    assert np.abs(off(regular, ticks)[600:]).max() < 0.008
