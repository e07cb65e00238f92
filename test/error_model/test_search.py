# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Chains of one axis are the likelihood where axes are alike, and end near its maximum else."""

from dataclasses import replace

import numpy as np
import pytest

from trajeval_ros import loops, se3
from trajeval_ros.error_model.axes import Axes
from trajeval_ros.error_model.likelihood import Data, Likelihood
from trajeval_ros.error_model.maximum import climb
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.search import Guess, bounds, elsewhere, search
from trajeval_ros.error_model.series import Series
from trajeval_ros.error_model.structure import starts

PARAMETERS = {
    Kind.DRIFT: np.log([[2e-3, 1e-2], [1e-3, 5e-3]]),
    Kind.VELOCITY: np.log([[2e-3, 1e-2, 0.03, 0.5], [1e-3, 5e-3, 0.02, 0.3]]),
    Kind.WANDER: np.log([[2e-3, 1e-2, 0.5], [1e-3, 5e-3, 0.8]]),
}


def alike(count, seed, errors=None, rate=None):
    """Poses that do not move, of a ground truth whose axes are alike; no nuisances to speak of."""
    rng = np.random.default_rng(seed)
    variance = rng.uniform(1e-7, 1e-6, (count, 2))
    covariance = np.zeros((count, 6, 6))
    np.einsum("nii->ni", covariance)[...] = np.repeat(variance, 3, axis=1)
    gauge = np.tile(np.eye(6), (count, 1, 1))
    times = np.cumsum(rng.uniform(0.01, 0.2, count)) if rate is None else np.arange(count) / rate
    weights = (rng.uniform(0.5, 2.0, (count, 2)), rng.uniform(0.5, 2.0, (count - 1, 2)))
    if errors is not None:
        weights = np.ones((count, 2)), np.ones((count - 1, 2))
    z = rng.normal(size=(count, 6)) * 1e-2 if errors is None else errors
    data = Data(
        times,
        z,
        covariance,
        np.zeros((count - 1, 3)),
        np.zeros((count, 6, 1)),
        np.ones(1),
        *weights,
    )
    return data, gauge


def series(data, group):
    part = slice(3 * group, 3 * group + 3)
    return Series(
        np.diff(data.times),
        np.ascontiguousarray(data.errors[:, part].T),
        data.covariance[:, 3 * group, 3 * group],
        data.measured[:, group],
        data.moved[:, group],
    )


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("count", [3, 60])
def test_alike_axes_are_the_whole_likelihood(kind, count):
    data, gauge = alike(count, 5)
    whole = Likelihood(kind, PARAMETERS[kind], data, gauge)
    gradient, information = whole.gradient(), whole.average_information()
    disturbances = whole.disturbances()
    size = len(kind.names)
    values = []
    for moved in (0.0, 0.1):
        there = Likelihood(kind, PARAMETERS[kind] + moved, data, gauge)
        axes = [Axes(kind, PARAMETERS[kind][g] + moved, series(data, g)) for g in range(2)]
        values.append(there.value - sum(each.value for each in axes))
    # But for what does not depend on the parameters.
    assert values[0] == pytest.approx(values[1], abs=1e-8 * abs(whole.value))
    for g in range(2):
        found = Axes(kind, PARAMETERS[kind][g], series(data, g))
        part = slice(g * size, (g + 1) * size)
        scale = np.abs(gradient).max()
        np.testing.assert_allclose(found.gradient(), gradient[g], atol=1e-9 * scale)
        scale = np.abs(information).max()
        np.testing.assert_allclose(
            found.average_information(), information[part, part], atol=1e-9 * scale
        )
        for one, other in zip(found.disturbances(), disturbances, strict=True):
            np.testing.assert_allclose(one, other[:, g], rtol=1e-6, atol=1e-9 * np.abs(other).max())


def wandering(count, rate, std, time, jitter, seed):
    rng = np.random.default_rng(seed)
    decay = np.exp(-1.0 / (rate * time))
    errors = np.zeros((count, 6))
    errors[0] = std * rng.normal(size=6)
    for i in range(1, count):
        errors[i] = decay * errors[i - 1] + std * np.sqrt(1.0 - decay**2) * rng.normal(size=6)
    return errors + jitter * rng.normal(size=(count, 6))


@pytest.mark.parametrize("rate", [5.0, 20.0, 100.0])
def test_the_structure_function_tells_where_to_begin(rate):
    errors = wandering(2000, rate, 2e-2, 40.0 / rate, 2e-3, 1)
    data, _ = alike(2000, 1, errors, rate)
    begin = starts(Kind.WANDER, series(data, 0))[0]
    np.testing.assert_allclose(begin, np.log([2e-3, 2e-2, 40.0 / rate]), atol=0.5)


def test_lost_tracks_do_not_rule_where_to_begin():
    errors = wandering(1000, 20.0, 2e-2, 2.0, 2e-3, 1)
    errors[300:310] += 5.0
    data, _ = alike(1000, 1, errors, 20.0)
    begin = starts(Kind.WANDER, series(data, 0))[0]
    np.testing.assert_allclose(begin, np.log([2e-3, 2e-2, 2.0]), atol=1.0)


def wandering_and_moving(count):
    """Moving, so that headings count."""
    errors = wandering(count, 20.0, 1e-2, 1.0, 1e-3, 4)
    data, gauge = alike(count, 4, errors, 20.0)
    position = np.stack([np.sin(data.times), np.cos(0.7 * data.times), 0.1 * data.times], axis=1)
    gauge[:, :3, 3:] = -se3.hat(position)
    return replace(data, travel=np.diff(position, axis=0)), gauge


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("count", [200, 1500])
def test_the_search_ends_near_the_maximum(kind, count):
    # The second is more than is searched at once.
    moving, gauge = wandering_and_moving(count)
    guess = search(kind, moving, gauge, 0.02)
    here = Likelihood(kind, guess.parameters, moving, gauge).at(guess.parameters, guess.weights)
    low, high = (each.ravel() for each in bounds(kind, moving))
    best = climb(here, low, high, 1e-5, 50, weighted=False)
    assert best.value - here.value < 1.0


def heavy_tailed(count):
    """With outliers, and two nuisances that the motion shows."""
    rng = np.random.default_rng(7)
    moving, gauge = wandering_and_moving(count)
    columns = np.zeros((count, 6, 2))
    columns[:-1, :3, 0], columns[:, 3, 1] = moving.travel * 20.0, np.sin(3.0 * moving.times)
    errors = moving.errors + columns @ np.array([3e-3, 0.02])
    errors += 1e-3 * rng.standard_t(1.5, (count, 6))
    return replace(moving, errors=errors, nuisances=columns, precision=np.full(2, 1e-4)), gauge


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("begin", [None, "of the same poses", "of others", "of its kind"])
def test_numpy_alone_ends_at_the_same_place(kind, begin):
    data, gauge = heavy_tailed(200)
    if begin is not None:
        begin_kind = kind if begin == "of its kind" else Kind.DRIFT
        of = heavy_tailed(150) if begin == "of others" else (data, gauge)
        begin = search(begin_kind, *of, 0.5)
        assert (begin.measured > 1.0).any()
    guess = search(kind, data, gauge, 0.02, begin)
    with loops.left_out():
        expected = search(kind, data, gauge, 0.02, begin)
    np.testing.assert_allclose(guess.parameters, expected.parameters, atol=1e-6)
    std = np.sqrt(np.diag(expected.theta_covariance))
    np.testing.assert_allclose(guess.theta / std, expected.theta / std, atol=1e-6)
    np.testing.assert_allclose(
        guess.theta_covariance / std / std[:, None],
        expected.theta_covariance / std / std[:, None],
        atol=1e-6,
    )
    for one, other in zip(guess.weights, expected.weights, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


def test_what_was_taken_for_outliers_is_found_elsewhere():
    data, gauge = alike(300, 5, wandering(300, 20.0, 2e-2, 0.8, 5e-3, 3), 20.0)
    end = search(Kind.DRIFT, data, gauge, 0.05)
    assert elsewhere(end, data, gauge, 0.5) is None
    # No jitter, and each third step an outlier instead.
    parameters = end.parameters.copy()
    parameters[0, 0] = bounds(Kind.DRIFT, data)[0][0, 0]
    moved = end.moved.copy()
    moved[::3, 0] = 20.0
    lesser = Guess(end.kind, parameters, end.measured, moved, end.theta, end.theta_covariance)
    found = elsewhere(lesser, data, gauge, 0.5)
    assert found is not None
    np.testing.assert_allclose(found.parameters, end.parameters, atol=0.1)
    assert (found.moved == 1.0).mean() > 0.99
