# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import gp_twin

from trajeval_ros import loops
from trajeval_ros.ground_truth.hyperparameters import DEGREES_OF_FREEDOM, Component
from trajeval_ros.ground_truth.learning import Posterior, climbed, learn, maximum
from trajeval_ros.ground_truth.likelihood import Likelihood, Record
from trajeval_ros.ground_truth.models import MODELS, Grid
from trajeval_ros.ground_truth.regimes import USUAL, Regime

NAMES = {
    "matern52": ("Matern52", "Matern72", "Matern32", "Exponential"),
    "matern32": ("Matern32",),
    "squared_exponential": ("SquaredExponential",),
}


def records(seed=0, segments=4, count=25, interval=0.1):
    rng = np.random.default_rng(seed)
    found = []
    for segment in range(segments):
        samples = count - segment  # of different lengths
        times = np.cumsum(rng.uniform(0.5, 1.5, samples)) * interval
        phase = rng.uniform(0.0, 6.0, 3)
        values = np.sin(times[:, None] * [1.0, 1.7, 2.3] + phase) + rng.normal(
            0, 2e-3, (samples, 3)
        )
        found.append(Record(times - times[0], values - values[0], rng.uniform(0, 1e-6, samples)))
    return found


def grid_of(data):
    return Grid.of([r.times for r in data], [r.values for r in data], 1e-5, 2e-3)


@pytest.mark.parametrize("name", MODELS)
def test_likelihood_is_the_dense_one(name):
    model, data = MODELS[name], records()
    kernels = len(model.kernels)
    rng = np.random.default_rng(1)
    natural = np.concatenate([rng.normal(-1.0, 0.5, 2 * kernels), [np.log(3e-3)]])
    components = [Component(*np.exp(natural[2 * i : 2 * i + 2])) for i in range(kernels)]
    expected = sum(
        gp_twin.log_likelihood(NAMES[name], components, 3e-3, r.times, r.values, r.variances)
        for r in data
    )
    assert Likelihood(model.kernels, data)(natural).value == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", range(3))
def test_gradient_is_the_finite_difference(name, seed):
    model, data = MODELS[name], records(seed)
    grid = grid_of(data)
    theta = model.starts(grid)[seed] + np.random.default_rng(seed).normal(
        0.0, 0.3, len(model.starts(grid)[0])
    )
    posterior = Posterior(model, grid, data)
    for i, slope in enumerate(posterior(theta).gradient):
        step = np.zeros_like(theta)
        step[i] = 1e-5
        high, low = posterior(theta + step).value, posterior(theta - step).value
        assert slope == pytest.approx((high - low) / 2e-5, rel=2e-5, abs=2e-3)


@pytest.mark.parametrize("name", MODELS)
def test_information_is_the_mean_square_of_the_gradient(name):
    model, template = MODELS[name], records(segments=1, count=14)[0]
    natural = np.log([0.3, 0.7] * len(model.kernels) + [0.1])
    components = [Component(0.3, 0.7)] * len(model.kernels)
    covariance = gp_twin.kernel(NAMES[name], components, template.times, template.times)
    covariance += np.diag(0.1**2 + template.variances)
    rng = np.random.default_rng(2)
    shape = (4000, *template.values.shape)
    drawn = np.linalg.cholesky(covariance) @ rng.normal(size=shape)
    scale = DEGREES_OF_FREEDOM / rng.chisquare(DEGREES_OF_FREEDOM, size=(len(drawn), 1, 1))
    fits = [
        Likelihood(model.kernels, [Record(template.times, x, template.variances)])(natural)
        for x in np.sqrt(scale) * drawn
    ]
    gradients = np.array([fit.gradient for fit in fits])
    mean_square = gradients.T @ gradients / len(gradients)
    mean = np.mean([fit.information for fit in fits], axis=0)
    unit = np.sqrt(np.outer(np.diag(mean), np.diag(mean)))
    np.testing.assert_allclose(mean_square / unit, mean / unit, atol=0.1)


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@given(
    name=st.sampled_from(["matern52", "matern32"]),
    start=st.integers(0, 99),
    regimes=st.lists(st.builds(Regime, st.integers(-3, 3), st.integers(-1, 2)), max_size=3),
    steps=st.integers(0, 4),
    narrow=st.booleans(),
    seed=st.integers(0, 99),
)
def test_the_loop_climbs_as_numpy_does(name, start, regimes, steps, narrow, seed):
    model, data = MODELS[name], records(seed)
    grid = grid_of(data)
    starts = model.starts(grid)
    begin = starts[start % len(starts)]
    bounds = np.array(model.bounds(grid))
    if narrow:  # at some bounds, off others
        bounds = begin[:, None] + np.linspace([-0.3, 0.0], [0.0, 0.3], len(begin))
    posterior = Posterior(model, grid, data, [*regimes, *[USUAL] * (len(data) - len(regimes))])
    looped = posterior.climbed(begin, bounds, steps)
    expected = climbed(posterior, begin, bounds, steps)
    # What does not show in the data is where the last digits take it: of 2,000 examples as many as
    # one ends 3e-5 nats off.
    np.testing.assert_allclose(looped.value, expected.value, atol=1e-3)
    np.testing.assert_allclose(looped.theta, expected.theta, atol=1e-3)
    assert posterior.value(looped.theta) == pytest.approx(looped.value, rel=1e-9)
    assert posterior.value(expected.theta) == pytest.approx(expected.value, rel=1e-9)


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@pytest.mark.parametrize("name", ["matern52", "matern32"])
@pytest.mark.parametrize("seed", range(3))
def test_the_loop_ends_where_numpy_does(name, seed):
    model, data = MODELS[name], records(seed)
    grid = grid_of(data)
    bounds = np.array(model.bounds(grid))
    posterior = Posterior(model, grid, data)
    begin = np.clip(model.starts(grid)[seed], *bounds.T)
    found, expected = maximum(posterior, begin, bounds), climbed(posterior, begin, bounds)
    assert found.value == pytest.approx(expected.value, abs=2e-3)
    assert np.isfinite(found.value)


def test_learns_what_the_data_were_drawn_from():
    rng = np.random.default_rng(5)
    components = (Component(0.3, 0.8),)
    data = []
    for _ in range(12):
        times = np.arange(60) * 0.05
        covariance = gp_twin.kernel(("Matern32",), components, times, times)
        values = np.linalg.cholesky(covariance + 1e-12 * np.eye(60)) @ rng.normal(size=(60, 3))
        values += rng.normal(0.0, 5e-3, values.shape)
        data.append(Record(times, values, np.zeros(60)))
    found = learn(MODELS["matern32"], data, 1e-5, 2e-3)
    assert found is not None
    group = found.under(USUAL)
    assert group.noise_std == pytest.approx(5e-3, rel=0.15)
    # σ and l are known through σ²/l³, the strength of the driving noise, far better than alone.
    assert group.components[0].std ** 2 / group.components[0].length_scale ** 3 == pytest.approx(
        0.3**2 / 0.8**3, rel=0.3
    )


def test_the_instrument_is_the_floor_of_the_noise():
    clean = [Record(r.times, np.sin(r.times[:, None] * [1, 2, 3]), 0 * r.times) for r in records()]
    for name, model in MODELS.items():
        found = learn(model, clean, 1e-3, 4e-3)
        assert found is not None, name
        assert found.under(USUAL).noise_std >= 1e-3, name


def test_one_wild_segment_does_not_carry_the_others_away():
    data = records(segments=6)
    wild = [*data, Record(data[0].times, 30.0 * data[0].values, data[0].variances)]
    usual, found = (learn(MODELS["matern52"], d, 1e-5, 2e-3) for d in (data, wild))
    assert usual is not None
    assert found is not None
    ratio = found.under(USUAL).noise_std / usual.under(USUAL).noise_std
    assert 0.3 < ratio < 3.0


def test_search_near_the_last_answer_finds_no_worse_one():
    data = records(segments=6)
    model, grid = MODELS["matern52"], grid_of(data)
    first = learn(model, data[:3], 1e-5, 2e-3)
    assert first is not None
    again = learn(model, data, 1e-5, 2e-3, before=first.theta)
    assert again is not None
    floored = [Record(r.times, r.values, r.variances + 1e-10) for r in data]
    posterior = Posterior(model, grid, floored)
    # What is learned is rounded, so that the highest may be missed by so much.
    assert posterior(again.theta).value >= posterior(first.theta).value - 1e-2


def test_three_samples_teach_nothing():
    short = [Record(r.times[:3], r.values[:3], r.variances[:3]) for r in records()]
    assert learn(MODELS["matern52"], short, 1e-5, 2e-3) is None


@pytest.mark.parametrize("seed", range(3))
def test_search_ends_where_the_slope_vanishes(seed):
    model, data = MODELS["matern52"], records(seed, segments=6)
    grid = grid_of(data)
    bounds = np.array(model.bounds(grid))
    posterior = Posterior(model, grid, data)
    start = np.clip(model.starts(grid)[0], *bounds.T)
    found = posterior(maximum(posterior, start, bounds).theta)
    inside = (found.theta > bounds[:, 0]) & (found.theta < bounds[:, 1])
    # Half of gᵀ C⁻¹ g is what the next step could gain, nats; but for what makes no difference.
    curvature = found.curvature[np.ix_(inside, inside)]
    curvature += 1e-3 * np.eye(len(curvature))
    gradient = found.gradient[inside]
    assert 0.5 * gradient @ np.linalg.solve(curvature, gradient) < 1e-2
    assert (found.gradient[found.theta <= bounds[:, 0]] <= 0.0).all()
    assert (found.gradient[found.theta >= bounds[:, 1]] >= 0.0).all()


def drawn(length_scale, noise, segments=8, count=40, interval=0.1):
    rng = np.random.default_rng(3)
    times = np.arange(count) * interval
    covariance = gp_twin.kernel(("Matern32",), (Component(0.1, length_scale),), times, times)
    lower = np.linalg.cholesky(covariance + 1e-14 * np.eye(count))
    shape = (segments, count, 3)
    values = lower @ rng.normal(size=shape) + noise * rng.normal(size=shape)
    return [Record(times, v, np.zeros(count)) for v in values]


@pytest.mark.parametrize("soft_limit", [5e-4, 2e-3])
def test_samples_that_do_not_show_their_noise_are_taken_to_have_the_usual(soft_limit):
    found = learn(MODELS["matern52"], drawn(0.3, noise=1e-6), 1e-5, soft_limit)
    assert found is not None
    assert 0.15 * soft_limit < np.exp(found.theta[-1]) < 1.1 * soft_limit


@pytest.mark.parametrize("noise", [3e-5, 1e-3])
def test_samples_that_show_their_noise_are_believed(noise):
    found = learn(MODELS["matern52"], drawn(30.0, noise, count=60), 1e-6, 5e-3)
    assert found is not None
    assert 0.5 * noise < np.exp(found.theta[-1]) < 3.0 * noise


@pytest.mark.parametrize("accuracy", [1e-5, 1e-4])
def test_round_off_brings_no_noise_that_the_instrument_does_not_have(accuracy):
    times = 0.025 * np.arange(48)
    found = []
    for phase in np.arange(8.0):
        values = 8.0 * np.sin(times[:, None] * [0.9, 1.1, 1.3] + phase).round(7)
        found.append(Record(times, values - values[0], np.zeros(len(times))))
    learned = learn(MODELS["matern52"], found, accuracy, 2e-3)
    noise = learned.under(USUAL).noise_std
    assert noise < 1.5 * accuracy


def boat(noise, seed=2):
    """Thirteen segments of a boat in a swell of ten seconds, at 5 Hz, in three coordinates."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(13):
        times = np.arange(14) * 0.2
        phase, size = rng.uniform(0.0, 6.3, 3), rng.uniform(0.4, 1.0, 3)
        moved = times[:, None] * [5.0, 0.3, 0.0] + size * np.sin(0.63 * times[:, None] + phase)
        values = moved + rng.normal(0.0, noise, moved.shape)
        found.append(Record(times, values - values[0], np.zeros(len(times))))
    return found


@pytest.mark.parametrize("noise", [2e-2, 5e-4])
def test_noise_that_was_taken_for_rough_motion_is_found_again(noise):
    model, data = MODELS["matern52"], boat(noise)
    grid = grid_of(data)
    rough = max(  # the noise as usual
        (np.array([*start[:-1], np.log(2e-3)]) for start in model.starts(grid)),
        key=Posterior(model, grid, data).value,
    )
    bounds = np.array(model.bounds(grid))
    bounds[-1, 1] = np.log(2.5e-3)
    before = maximum(Posterior(model, grid, data), np.clip(rough, *bounds.T), bounds).theta
    learned = learn(model, data, 1e-5, 2e-3, before)
    found = np.exp(learned.theta[-1])
    assert (0.7 * noise < found < 1.4 * noise) if noise > 2e-3 else (found < 2.1e-3)
