# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import loops
from trajeval_ros.ground_truth.adaptation import Prediction, Values, Watch, best_regime
from trajeval_ros.ground_truth.models import MODELS, Grid
from trajeval_ros.ground_truth.regimes import USUAL, Learned, Regime


def looked(squares, telling, cuts):
    """What a watch says of each batch; what it says is looked into at once."""
    watch, said = Watch(), []
    for end in [*cuts, squares.shape[1]]:
        while watch.looked <= end:
            begin = watch.looked - 1
            found = watch.look(squares[:, begin:end], telling[:, begin:end])
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
    seed=st.integers(0, 999),
)
def test_the_loop_raises_where_numpy_does(count, before, after, share, cuts, seed):
    rng = np.random.default_rng(seed)
    scale = np.where(np.arange(count) < count // 2, before, after)
    squares = np.stack([scale, np.flip(scale)]) * rng.chisquare(3, (2, count))
    telling = rng.uniform(size=(2, count)) < share
    cuts = sorted(cut for cut in cuts if cut <= count)
    found = looked(squares, telling, cuts)
    with loops.left_out():
        assert looked(squares, telling, cuts) == found
    if not found[0]:
        assert looked(squares, telling, []) == found


def test_a_change_is_raised_at_the_row_that_shows_it_with_the_one_it_began_at():
    quiet, none = np.full(200, 1e-3), np.zeros((2, 200), dtype=bool)
    loud = np.where(np.arange(200) < 20, 0.0, 200.0)
    assert Watch().look(np.stack([quiet, loud]), none) == [(21, 21, 1)]
    assert [group for *_, group in Watch().look(np.stack([loud, quiet]), ~none)] == [0, 1]
    # What does not tell is no sign of a process that promises too little.
    assert Watch().look(np.stack([quiet, quiet]), none) == []


def test_it_looks_on_from_where_it_was_and_is_more_patient_after_it_has_raised():
    loud = np.full((2, 3), 20.0)
    watch, telling = Watch(), np.ones((2, 3), dtype=bool)
    loud[1] = 3.0
    ((row, since, group),) = watch.look(loud, telling)
    assert (row, since, group) == (3, 1, 0)
    watch.restart(0, row + 1)
    assert watch.looked == 4
    assert watch.look(loud, telling) == []
    assert watch.look(loud, telling) == [(9, 4, 0)]


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
    first=st.integers(1, 59),
    regimes=st.lists(
        st.builds(Regime, st.integers(-6, 1), st.integers(0, 4)), min_size=1, max_size=8
    ),
    seed=st.integers(0, 999),
)
def test_the_loop_predicts_as_the_regressions_do(kernel, parallel, count, first, regimes, seed):
    learned, values = learned_and_values(kernel, parallel, count, seed)
    first = min(first, count - 1)
    found = Prediction(learned, values, first)(regimes)
    with loops.left_out():
        expected = Prediction(learned, values, first)(regimes)
    # With less noise beside more motion NumPy's factor loses digits.
    for looped, known in zip(found, expected, strict=True):
        np.testing.assert_allclose(looped, known, rtol=1e-8, atol=1e-7)
    alone = [Prediction(learned, values, first)([regime]) for regime in regimes]
    assert np.ravel(found[0]).tolist() == [float(squares[0]) for squares, _ in alone]


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
