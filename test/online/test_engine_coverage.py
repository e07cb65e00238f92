# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much of a run an estimate is there for."""

import contextlib
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins.runs import START, assert_same_summary, motion, samples

from trajeval_ros import loops
from trajeval_ros.ground_truth.faults import Fault
from trajeval_ros.online.coverage import Odometer, Presence, coverage
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed

SECOND = 1_000_000_000


def circle(count=2000, rate=100.0):
    """Stamps and positions of ten seconds around a circle of a metre, after ten at rest."""
    time = np.arange(count) / rate
    angle = 0.6 * np.maximum(time - 10.0, 0.0)
    positions = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    return np.asarray(5 * SECOND + np.rint(time * SECOND), dtype=np.int64), positions


def test_a_robot_that_stands_goes_nowhere():
    stamps, positions = circle()
    noise = np.random.default_rng(1).normal(0.0, 5e-4, positions.shape)
    odometer = Odometer(5e-4)
    odometer.add(stamps, positions + noise)
    assert odometer.length == pytest.approx(6.0, rel=0.02)
    way = odometer.way()
    assert way.between(5 * SECOND, 15 * SECOND) < 0.05
    assert way.between(15 * SECOND, 20 * SECOND) == pytest.approx(3.0, rel=0.03)


@given(cuts=st.lists(st.integers(0, 2000), max_size=5), capacity=st.integers(8, 64))
def test_the_same_however_the_batches_are_cut(cuts, capacity):
    stamps, positions = circle()
    whole, parts = (Odometer(5e-4, capacity), Presence()), (Odometer(5e-4, capacity), Presence())
    whole[0].add(stamps, positions)
    whole[1].add(stamps[::7])
    edges = [0, *sorted(cuts), 2000]
    for begin, end in itertools.pairwise(edges):
        parts[0].add(stamps[begin:end], positions[begin:end])
        inside = np.arange(begin, end)
        parts[1].add(stamps[inside[inside % 7 == 0]])
    cut, expected = (coverage(each[0].way(), each[1]) for each in (parts, whole))
    assert_same_summary(cut, expected)
    np.testing.assert_array_equal(parts[0].way().positions, whole[0].way().positions)
    assert len(whole[0].way().stamps) <= capacity + 1


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
def test_the_same_without_loops():
    rng = np.random.default_rng(2)
    stamps, positions = circle()
    positions += rng.normal(0.0, 2e-3, positions.shape)
    ways = []
    for without in (contextlib.nullcontext, loops.left_out):
        odometer = Odometer(5e-4, 64)
        with without():
            for begin in range(0, len(stamps), 300):
                some = slice(begin, begin + 300)
                odometer.add(stamps[some], positions[some])
        ways.append(odometer.way())
    assert 32 <= len(ways[0].stamps) <= 65
    np.testing.assert_array_equal(ways[0].stamps, ways[1].stamps)
    np.testing.assert_array_equal(ways[0].positions, ways[1].positions)
    np.testing.assert_allclose(ways[0].lengths, ways[1].lengths, rtol=1e-12)


@pytest.mark.parametrize("without", [contextlib.nullcontext, loops.left_out])
def test_a_step_beyond_all_numbers_is_counted(without):
    odometer = Odometer(5e-4, 64)
    with without():
        odometer.add(
            np.arange(3), np.array([[0.0, 0.0, 0.0], [1e200, 0.0, 0.0], [1e200, 1.0, 0.0]])
        )
    assert odometer.length == np.inf
    assert list(odometer.way().stamps) == [0, 1, 2]


def found(keep):
    """The figures for an estimate at 20 Hz, of which those are there that `keep` says."""
    stamps, positions = circle()
    odometer, presence = Odometer(5e-4), Presence()
    odometer.add(stamps, positions)
    times = np.arange(0.0, 20.0, 0.05)
    presence.add(np.asarray(5 * SECOND + times[keep(times)] * SECOND, dtype=np.int64))
    return coverage(odometer.way(), presence)


def test_an_estimate_that_is_there_throughout_is_never_lost():
    figures = found(lambda times: times >= 0.0)
    assert (figures["time"], figures["distance"], figures["losses"]) == (1.0, 1.0, 0)
    assert figures["longest_loss"] is None


def test_an_estimate_that_dies_has_covered_what_it_saw():
    figures = found(lambda times: times <= 15.0)
    assert figures["time"] == pytest.approx(0.75, abs=0.002)
    assert figures["distance"] == pytest.approx(0.5, abs=0.01)
    assert figures["longest_loss"]["seconds_from_start"] == pytest.approx(15.0)


def test_a_late_start_and_a_loss_count_and_jitter_does_not():
    figures = found(lambda times: (times > 3.0) & (abs(times - 12.0) > 1.5) & (times % 0.3 < 0.2))
    assert figures["losses"] == 2
    assert figures["lost_time"] == pytest.approx(3.0 + 3.0, abs=0.5)


def test_without_an_estimate_all_is_lost():
    figures = found(lambda times: times < 0.0)
    assert (figures["time"], figures["distance"], figures["losses"]) == (0.0, 0.0, 1)


def test_without_ground_truth_nothing_is_known():
    figures = coverage(Odometer(5e-4).way(), Presence())
    assert figures["time"] is None
    assert figures["longest_loss"] is None


def test_keyframes_that_come_rarely_are_no_losses():
    stamps, positions = circle()
    odometer, presence = Odometer(5e-4), Presence()
    odometer.add(stamps, positions)
    presence.add(np.arange(5, 25, 2, dtype=np.int64) * SECOND)
    assert coverage(odometer.way(), presence)["losses"] == 0


@pytest.mark.parametrize(
    ("count", "code", "text"),
    [
        (1, "origin_jump", "1 jump no body makes, from"),
        (1, "frozen", "1 sample that repeats the one before"),
        (2, "frozen", "2 samples that repeat the one before"),
        (34, "outliers", "34 samples far from"),
    ],
)
def test_faults_are_counted_in_plain_words(count, code, text):
    assert Fault(code, 0, 0, count).text.startswith(text)


def codes(ground_truth_rate, estimate_rate, error):
    """What the engine has to say of an estimate that errs by so much, m."""
    data = []
    for rate, noise in ((ground_truth_rate, 2e-4), (estimate_rate, error)):
        time = np.arange(0.0, 30.0, 1.0 / rate)
        poses = motion(time)
        poses[:, :3, 3] += noise * np.random.default_rng(1).normal(size=(len(time), 3))
        data.append(samples(np.asarray(START + np.rint(time * SECOND), dtype=np.int64), poses))
    engine = Engine({})
    for _ in feed(engine, *data):
        pass
    return {notice.code for notice in engine.notices()}


def test_an_estimate_as_good_as_the_ground_truth_is_explained():
    assert "as_good_as_ground_truth" in codes(100, 100, 2e-4)
    assert "as_good_as_ground_truth" not in codes(100, 100, 5e-3)


def test_a_ground_truth_that_comes_rarely_gets_a_word():
    assert "sparse_ground_truth" in codes(10, 200, 5e-3)
    assert "sparse_ground_truth" not in codes(200, 10, 5e-3)
    assert "sparse_ground_truth" not in codes(20, 50, 5e-3)
