# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth.lessons import Lesson, Lessons, spread_and_noise
from trajeval_ros.ground_truth.models import MODELS
from trajeval_ros.ground_truth.segment import Samples, Segment

ACCURACY = (5e-4, 9e-4)


def segment(start, moving, seed):
    """Two seconds at 20 Hz from ``start`` (s) on."""
    rng = np.random.default_rng(seed)
    times = start + 0.05 * np.arange(40)
    waves = np.sin(times[:, None] * [0.9, 1.7, 2.3, 0.8, 1.3, 2.1] + rng.uniform(0.0, 6.0, 6))
    xi = moving * waves * [0.5, 0.4, 0.1, 0.3, 0.2, 0.2] + rng.normal(0.0, 2e-4, waves.shape)
    return Segment(Samples((times * 1e9).astype(np.int64), se3.exp(xi)))


def taught(lessons, segments):
    found = []
    for each in segments:
        lesson = lessons.add(each)
        if lesson is not None:
            found.append(lesson.learned())
            lessons.take(lesson, found[-1])
    return found


@pytest.mark.parametrize("name", MODELS)
def test_rest_at_first_does_not_spoil_what_motion_teaches(name):
    still = [segment(2.0 * i, False, i) for i in range(18)]
    moving = [segment(36.0 + 2.0 * i, True, 100 + i) for i in range(9)]
    rested = taught(Lessons(MODELS[name], ACCURACY), [*still, *moving])
    assert len(rested) == 3  # from rest, then from 8 s and from 16 s of motion
    fresh = Lessons(MODELS[name], ACCURACY).learn(moving[:9])
    assert fresh is not None
    for group, alone in zip(rested[-1].groups, fresh.groups, strict=True):
        assert 0.5 < group.noise_std / alone.noise_std < 2.0
        # What the motion does within a sample interval, by the roughest part.
        strengths = [max(c.std / c.length_scale for c in g.components[:3]) for g in (group, alone)]
        assert 0.4 < strengths[0] / strengths[1] < 2.5


def test_lessons_come_at_sums_of_moving_segments():
    lessons = Lessons(MODELS["matern32"], ACCURACY)
    at = [i for i in range(40) if taught(lessons, [segment(2.0 * i, True, i)])]
    covered = np.cumsum(np.full(40, 39 * 0.05))
    assert at == [int(np.argmax(covered >= seconds)) for seconds in (8.0, 16.0, 32.0, 64.0)]


def test_what_turns_moves_however_rare_its_samples_are():
    """Of a hand-held camera at 1 Hz neighbours differ as much as all samples do."""
    lessons, rng = Lessons(MODELS["matern52"], ACCURACY), np.random.default_rng(5)
    at, learned = [], []
    for i in range(9):
        xi = rng.normal(0.0, 1.0, (8, 6)) * [0.3, 0.3, 0.3, 0.4, 0.4, 0.4]
        stamps = ((8 * i + np.arange(8)) * 1e9).astype(np.int64)
        found = taught(lessons, [Segment(Samples(stamps, se3.exp(xi)))])
        at += [i] * len(found)
        learned += found
    # At 8, 16 and 32 s of segments of 7 s.
    assert at == [1, 2, 4]
    assert all(each is not None for each in learned)


def test_rest_alone_teaches_its_noise():
    still = [segment(2.0 * i, False, i) for i in range(18)]
    (process,) = taught(Lessons(MODELS["matern52"], (1e-5, 1e-5)), still)
    for learned in process.learned:
        total = np.exp(learned.theta[-1])
        assert 1.6e-4 < total < 2.6e-4


def shaken(start, seed, noise, late=0.0):
    """Two seconds at 200 Hz from ``start`` (s) on, of motion up to 10 Hz; stamps up to so ``late``.

    It is too fast for the samples at 25 Hz that lessons learn motion from.
    """
    rng = np.random.default_rng(seed)
    times = start + 0.005 * np.arange(400)
    xi = rng.normal(0.0, noise, (400, 6))
    for overtone in range(1, 25):
        phases = times[:, None] * overtone * [1.2, 2.2, 3.0, 1.0, 1.7, 2.7] + rng.uniform(0, 6, 6)
        xi += np.sin(phases) * [0.5, 0.4, 0.1, 0.3, 0.2, 0.2] / overtone**2
    times += rng.uniform(0.0, late, len(times))
    return Segment(Samples((times * 1e9).astype(np.int64), se3.exp(xi)))


def learned_twice(monkeypatch, model, noise, late=0.0):
    """What is learned of shaken segments, and without what neighbours show."""
    segments = [shaken(2.0 * i, i, noise, late) for i in range(8)]
    close = Lessons(model, (1e-6, 1e-6)).learn(segments).learned
    monkeypatch.setattr(Lesson, "_neighbours", lambda self, columns: [])
    return close, Lessons(model, (1e-6, 1e-6)).learn(segments).learned


@pytest.mark.parametrize("noise", [2e-5, 1e-4])
def test_neighbours_show_noise_that_is_less_than_usual(monkeypatch, noise):
    for close, apart in zip(*learned_twice(monkeypatch, MODELS["matern52"], noise), strict=True):
        assert 0.8 < np.exp(close.theta[-1]) / noise < 1.7 < np.exp(apart.theta[-1]) / noise
        np.testing.assert_allclose(close.theta[:-1], apart.theta[:-1], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("model", "noise", "late"),
    [("matern52", 1e-3, 0.0), ("matern52", 2e-5, 2e-3), ("matern32", 2e-5, 0.0)],
    ids=["usual noise", "stamps off by more than it", "no noise is usual"],
)
def test_neighbours_count_only_where_they_show_less_than_usual(monkeypatch, model, noise, late):
    close, apart = learned_twice(monkeypatch, MODELS[model], noise, late)
    for one, other in zip(close, apart, strict=True):
        np.testing.assert_allclose(one.theta, other.theta, rtol=0, atol=1e-6)


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@given(count=st.integers(2, 300), offset=st.floats(-3.0, 6.0), seed=st.integers(0, 999))
def test_the_loop_sees_the_spread_that_numpy_sees(count, offset, seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, 2.0, 6) * rng.normal(size=(count, 6)) + 10.0**offset
    found = spread_and_noise(x)
    with loops.left_out():
        expected = spread_and_noise(x)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15 * 10.0**offset)
