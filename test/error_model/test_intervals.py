# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals of parameters: where the profile of the likelihood has fallen by 1.92."""

import numpy as np
import pytest
from error_model.test_fit import DRIFT, ask, estimate
from error_model.test_search import PARAMETERS, alike, wandering
from scipy.optimize import minimize

from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.intervals import Profiles
from trajeval_ros.error_model.likelihood import Likelihood
from trajeval_ros.error_model.maximum import climb
from trajeval_ros.error_model.named import named
from trajeval_ros.error_model.process import GROUPS, Kind
from trajeval_ros.error_model.search import bounds, chains
from trajeval_ros.report.answers import leading


def at_its_maximum(kind, count=200, jitter=2e-3):
    data, gauge = alike(count, 3, wandering(count, 10.0, 1e-2, 0.6, jitter, 3), 10.0)
    low, high = (each.ravel() for each in bounds(kind, data))
    here = Likelihood(kind, PARAMETERS[kind], data, gauge)
    return climb(here, low, high, 1e-4, 60, weighted=False)


def fallen(here, group, number, value):
    """By how much the profile has fallen there, by a search that knows no derivatives."""
    chain = chains(here)[group]
    low, high = (each[group] for each in bounds(here.kind, here.data))
    others = [i for i in range(len(low)) if i != number]

    def lacking(free, held):
        parameters = chain.parameters.copy()
        parameters[others], parameters[number] = free, held
        return -chain.at(parameters, chain.weights).value

    limits = [(low[i], high[i]) for i in others]
    ends = [
        minimize(
            lacking,
            chain.parameters[others] + start,
            (np.log(value),),
            "Nelder-Mead",
            bounds=limits,
            tol=1e-6,
        ).fun
        for start in (-0.5, 0.0, 0.5)
    ]
    return chain.value + min(ends)


@pytest.mark.parametrize(
    ("kind", "number"), [(Kind.DRIFT, 0), (Kind.DRIFT, 1), (Kind.WANDER, 1), (Kind.WANDER, 2)]
)
def test_ends_are_where_the_profile_has_fallen(kind, number):
    here = at_its_maximum(kind)
    for ratio in (1.0, 1.5):
        for end in Profiles(here, 0).interval(number, 0.2, ratio):
            assert fallen(here, 0, number, end) == pytest.approx(1.92 * ratio**2, rel=0.25)


class Walled(Profiles):
    """Without a likelihood where a logarithm is beyond the wall."""

    wall = 0.0

    def _held(self, here, number, at):
        if at > self.wall:
            raise np.linalg.LinAlgError
        return super()._held(here, number, at)


@pytest.mark.parametrize("first", [0.2, 1.0, 5.0])
def test_where_there_is_no_likelihood_the_end_is_nearer(first):
    """Errors of exactly nothing left no digits far off, and cost the whole model."""
    here = at_its_maximum(Kind.DRIFT)
    _, expected = Profiles(here, 0).interval(1, 0.2, 1.0)
    profiles = Walled(here, 0)
    profiles.wall = np.log(expected) + 0.1
    _, high = profiles.interval(1, first, 1.0)
    assert high <= np.exp(profiles.wall)
    assert fallen(here, 0, 1, high) == pytest.approx(1.92, rel=0.25)


def test_what_may_be_nothing_has_an_interval_from_zero():
    here = at_its_maximum(Kind.WANDER, jitter=0.0)
    low, high = Profiles(here, 0).interval(0, 1.0, 1.0)
    assert low == 0.0
    assert fallen(here, 0, 0, high) == pytest.approx(1.92, rel=0.25)


def test_a_fit_says_the_interval_of_what_is_near_nothing_and_no_standard_deviation():
    parameters = DRIFT.copy()
    parameters[0, 0] = np.log(1e-5)
    model = named(fit(*estimate(Kind.DRIFT, parameters), ask))
    jitter = model["translation"]["jitter_std"]
    assert jitter["std"] is None
    low, high = jitter["interval"]
    assert low == 0.0
    assert 1e-5 < high < 1e-3
    assert "interval" not in model["translation"]["drift_std"]
    said = dict(leading(model))["Kind of error"]
    assert said.startswith("jitter < 0.")


def test_intervals_cover_what_is_there():
    covered = []
    for seed in range(12):
        parameters = DRIFT.copy()
        parameters[:, 0] = np.log(2e-4)
        found = fit(*estimate(Kind.DRIFT, parameters, seed=seed, count=200), ask)
        for group, values in zip(GROUPS, np.exp(parameters), strict=True):
            figure = found.groups[group]["jitter_std"]
            if figure.interval is not None:
                covered.append(figure.interval[0] <= values[0] <= figure.interval[1])
    assert len(covered) > 15
    assert np.mean(covered) > 0.85
