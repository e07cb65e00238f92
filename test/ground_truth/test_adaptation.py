# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.ground_truth.adaptation import (
    Adaptation,
    Prediction,
    Values,
    Watch,
    best_regime,
)
from trajeval_ros.ground_truth.hyperparameters import LEAST_NOISE
from trajeval_ros.ground_truth.models import MODELS, Grid
from trajeval_ros.ground_truth.process import AS_LEARNED, Process
from trajeval_ros.ground_truth.regimes import USUAL, Learned, Regime

LEAST = np.zeros(2)


def news_of(squares, telling, parallel=1):
    """Rows whose squares, of so many lanes a group, sum up to these, with others between."""
    shares = np.array([0.5, 0.25, 0.25] if parallel == 3 else [1.0])
    lanes = np.concatenate([shares[:, None] * group for group in squares])
    spreads = np.where(telling, 1.0, -1.0).repeat(parallel, axis=0)
    rows = np.full((*lanes.shape, 5), np.nan)
    rows[..., 2], rows[..., 3] = lanes, spreads
    return rows[..., 2:4]


def looked(squares, telling, cuts, parallel=1):
    """What a watch says of each batch; what it says is looked into at once."""
    watch, said = Watch(), []
    news = news_of(squares, telling, parallel)
    for end in [*cuts, squares.shape[1]]:
        while watch.looked <= end:
            begin = watch.looked - 1
            found = watch.look(news[:, begin:end], LEAST)
            said += found
            if not found:
                break
            row, _, group = min(found)
            watch.restart(group, row + 1)
    return said, watch.looked


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@given(
    count=st.integers(0, 120),
    before=st.floats(0.001, 30.0),
    after=st.floats(0.001, 100.0),
    share=st.floats(0.0, 1.0),
    cuts=st.sets(st.integers(0, 120), max_size=3),
    parallel=st.sampled_from([1, 3]),
    seed=st.integers(0, 999),
)
def test_the_loop_raises_where_numpy_does(count, before, after, share, cuts, parallel, seed):
    rng = np.random.default_rng(seed)
    scale = np.where(np.arange(count) < count // 2, before, after)
    squares = np.stack([scale, np.flip(scale)]) * rng.chisquare(3, (2, count))
    telling = rng.uniform(size=(2, count)) < share
    cuts = sorted(cut for cut in cuts if cut <= count)
    found = looked(squares, telling, cuts, parallel)
    with loops.left_out():
        assert looked(squares, telling, cuts, parallel) == found
    if not found[0]:
        assert looked(squares, telling, [], parallel) == found


def test_a_change_is_raised_at_the_row_that_shows_it_with_the_one_it_began_at():
    quiet, none = np.full(200, 1e-3), np.zeros((2, 200), dtype=bool)
    loud = np.where(np.arange(200) < 20, 0.0, 200.0)
    assert Watch().look(news_of(np.stack([quiet, loud]), none), LEAST) == [(21, 21, 1)]
    found = Watch().look(news_of(np.stack([loud, quiet]), ~none), LEAST)
    assert [group for *_, group in found] == [0, 1]
    # What does not tell is no sign of a process that promises too little.
    assert Watch().look(news_of(np.stack([quiet, quiet]), none), LEAST) == []


def test_it_looks_on_from_where_it_was_and_is_more_patient_after_it_has_raised():
    loud = np.full((2, 3), 20.0)
    watch, telling = Watch(), np.ones((2, 3), dtype=bool)
    loud[1] = 3.0
    ((row, since, group),) = watch.look(news_of(loud, telling), LEAST)
    assert (row, since, group) == (3, 1, 0)
    watch.restart(0, row + 1)
    assert watch.looked == 4
    assert watch.look(news_of(loud, telling), LEAST) == []
    assert watch.look(news_of(loud, telling), LEAST) == [(9, 4, 0)]


def learned_and_values(kernel, parallel, count, seed):
    """What was learned of a group, and samples of it: (n, G, c), c = 3 / G."""
    rng, model = np.random.default_rng(seed), MODELS[kernel]
    grid = Grid(0.1, 1.0, 1e-4, 2e-3)
    theta = model.starts(grid)[seed % len(model.starts(grid))] + rng.normal(0.0, 0.2)
    times = np.cumsum(rng.uniform(0.5, 1.5, count)) * 0.1
    values = np.sin(times[:, None] * rng.uniform(1.0, 3.0, 3)) + rng.normal(0.0, 2e-3, (count, 3))
    variances = rng.uniform(0.0, 1e-6, (count, parallel))
    return Learned(model, grid, theta, 1e-3), Values(
        times, values.reshape(count, parallel, -1), variances
    )


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@given(
    kernel=st.sampled_from(["matern52", "matern32"]),
    parallel=st.sampled_from([1, 3]),
    count=st.integers(2, 60),
    since=st.integers(1, 59),
    start=st.builds(Regime, st.integers(-6, 3), st.integers(-1, 3)),
    size=st.floats(-2.0, 2.0),
    ratio=st.none() | st.floats(1e-3, 1e3),
    seed=st.integers(0, 999),
)
def test_the_loop_finds_the_regime_that_numpy_finds(
    kernel, parallel, count, since, start, size, ratio, seed
):
    learned, values = learned_and_values(kernel, parallel, count, seed)
    values = Values(values.times, 10.0**size * values.values, values.variances)
    since = min(since, count - 1)
    looped = best_regime(learned, start, values, since, ratio)
    with loops.left_out():
        expected = best_regime(learned, start, values, since, ratio)
        if looped != expected:  # as probable: with less noise NumPy's factor loses digits
            both = looped, expected
            squares, log_dets = Prediction(learned, values, since)(both)
            scores = -0.5 * (squares + values.values.shape[2] * log_dets)
            scores += [regime.log_prior for regime in both]
            np.testing.assert_allclose(scores[0], scores[1], rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize("kernel", ["matern52", "matern32"])
@pytest.mark.parametrize("regime", [USUAL, Regime(-3, 2), Regime(5, -1), Regime(-40, 40)])
def test_the_parts_of_what_was_learned_are_its_numbers_in_every_regime(kernel, regime):
    learned, _ = learned_and_values(kernel, 1, 4, 3)
    *pairs, noise = learned.numbers(regime)
    rates, parts = learned.parts()
    *variances, white = parts @ [4.0**regime.motion, 4.0**regime.noise]
    np.testing.assert_allclose(np.sqrt(variances), pairs[::2], rtol=1e-12)
    kernels = learned.model.kernels
    np.testing.assert_allclose([k.rate for k in kernels] / rates, pairs[1::2], rtol=1e-12)
    least = (LEAST_NOISE * max(pairs[::2])) ** 2
    np.testing.assert_allclose(max(white + learned.accuracy**2, least), noise**2, rtol=1e-12)


@pytest.mark.parametrize("change", [0.01, 100.0])
def test_the_regime_that_is_found_is_the_one_that_the_motion_is_in(change):
    learned, values = learned_and_values("matern52", 1, 60, 0)
    first = Prediction(learned, values, 20)
    usual = best_regime(learned, USUAL, values, 20)
    moved = Values(values.times, change * values.values, 0.0 * values.variances)
    found = best_regime(learned, usual, moved, 20)
    assert (found.motion > usual.motion) == (change > 1.0)
    squares, _ = first([usual])
    ratio = float(squares[0]) / values.values[20:].size
    assert best_regime(learned, usual, values, 20, ratio) == usual


@pytest.mark.parametrize("start", [Regime(0, 2), Regime(-1, 4)])
@pytest.mark.parametrize("loop", [True, False])
def test_motion_far_below_the_noise_is_found_where_more_noise_is_refuted(start, loop):
    """Learned at rest, where the motion is a hundredth of the noise: twice it changes nothing."""
    rng, model = np.random.default_rng(2), MODELS["matern52"]
    grid = Grid(0.1, 1.0, 1e-4, 2e-2)
    theta = np.log([2e-4, 60.0, 1e-4, 1.2, 2e-4, 60.0, 1e-2])
    times = 0.1 * np.arange(30)
    drive = 0.5 * np.maximum(times - 2.0, 0.0) ** 2
    values = drive[:, None] * [1.0, 0.5, 0.2] + rng.normal(0.0, 1e-2, (30, 3))
    learned = Learned(model, grid, theta, 1e-3)
    asked = Values(times, values.reshape(30, 1, 3), np.zeros((30, 1)))
    with contextlib.nullcontext() if loop else loops.left_out():
        found = best_regime(learned, start, asked, 22, 8.0)
    assert found.motion >= 4
    assert found.noise <= 1


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@pytest.mark.parametrize("kernel", ["matern52", "matern32"])
@pytest.mark.parametrize("parallel", [2, 6])
@pytest.mark.parametrize("seed", range(4))
def test_the_loop_holds_a_segment_to_its_samples_as_numpy_does(kernel, parallel, seed):
    """Motion that becomes lively, and noise that comes and goes, however the samples are cut."""
    rng, count = np.random.default_rng(seed), 160
    learned, _ = learned_and_values(kernel, 1, 4, 0)
    process = Process.of((learned, learned))
    times = np.cumsum(rng.uniform(0.5, 1.5, count)) * 0.1
    size = np.where(times < 5.0, 0.02, 3.0)[:, None] * np.repeat([1.0, 0.1], 3)
    noise = np.where((times > 8.0) & (times < 12.0), 0.1, 1e-3)[:, None]
    values = size * np.sin(times[:, None] * rng.uniform(1.0, 3.0, 6))
    values += noise * rng.normal(size=(count, 6))
    variances = rng.uniform(0.0, 1e-7, (count, parallel))
    all_values = Values(times, values.reshape(count, parallel, -1), variances)

    def held(cuts):
        adaptation = Adaptation(process, AS_LEARNED)
        for end in [*cuts, count]:
            adaptation.take(all_values[:end])
        return adaptation

    looped = held([])
    with loops.left_out():
        expected = held([])
    assert len(expected.epochs) > 2
    for found in (looped, held([1, 17, 90, 91])):
        assert found.count == count
        for one, other in zip(found.epochs, expected.epochs, strict=True):
            assert (one.first, one.since, one.regimes) == (other.first, other.since, other.regimes)
            np.testing.assert_allclose(one.before, other.before, rtol=1e-9, atol=1e-9)
            last = min(one.regression.count, other.regression.count)
            news = one.regression.innovations(1)[:, : last - 1]
            np.testing.assert_allclose(
                news, other.regression.innovations(1)[:, : last - 1], rtol=1e-9, atol=1e-9
            )
