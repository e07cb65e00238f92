# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps that scatter are told from the estimate's errors, and errors are not taken for them."""

from dataclasses import replace

import numpy as np
import pytest
from error_model.test_fit import DRIFT, WANDER, ask, estimate
from error_model.test_running import poses, running
from twins.runs import motion

from trajeval_ros import se3
from trajeval_ros.diagnosis.fitted import fitted_causes, is_misread
from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.likelihood import Likelihood
from trajeval_ros.error_model.named import named
from trajeval_ros.error_model.nuisances import Nuisances, prepare
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.stamping import (
    Scatter,
    Scatters,
    likeliest_scatter,
    shared_scatter,
    with_scatter,
)
from trajeval_ros.report.answers import leading


def scattered(stamps, poses, std, seed=7):
    """As stamped by a driver that is late or early by chance; in the order of their stamps."""
    off = np.random.default_rng(seed).normal(0.0, std, len(stamps))
    late = stamps + np.rint(1e9 * off).astype(np.int64)
    order = np.argsort(late, kind="stable")
    return late[order], poses[order], float(off.std())


@pytest.mark.parametrize(("kind", "parameters"), [(Kind.DRIFT, DRIFT), (Kind.WANDER, WANDER)])
@pytest.mark.parametrize("std", [0.005, 0.02])
def test_stamps_that_scatter_come_out_beside_the_estimates_own_errors(kind, parameters, std):
    late, errs, there = scattered(*estimate(kind, parameters, count=600), std)
    found = fit(late, errs, ask)
    assert abs(found.stamps.value - there) < 4.0 * found.stamps.std
    assert found.stamps.std < 0.1 * std
    if kind is Kind.DRIFT:  # a wander of centimetres hides a jitter of a millimetre
        for group in ("translation", "rotation"):
            # What bends between a stamp and the next is of second order.
            assert found.groups[group]["jitter_std"].value == pytest.approx(1e-3, abs=5e-4)
    speed = np.linalg.norm(ask(late).twists[:, :3], axis=1)
    assert found.stamps.translation == pytest.approx(
        found.stamps.value * np.sqrt(np.mean(speed**2)), rel=1e-2
    )
    assert np.abs(found.nuisances.clock_offset) < 4.0 * found.std[0]


def about_another_point(rng, count):
    error = rng.normal(0.0, 1e-2, (count, 6))
    error[:, :3] = np.cross([0.4, -0.3, 0.2], error[:, 3:])
    return error


def along_its_way(rng, count):
    """As the depth that a camera sees, and larger where it moves faster."""
    seconds, step = np.arange(count) / 20.0 + 1.0, 1e-4
    twist = se3.log(se3.inverse(motion(seconds - step)) @ motion(seconds + step)) / (2 * step)
    error = rng.normal(0.0, 1e-3, (count, 6))
    error[:, :3] += 5e-3 * rng.normal(size=(count, 1)) * twist[:, :3]
    return error


def where_it_is_fast(rng, count):
    seconds = np.arange(count) / 20.0
    return rng.normal(0.0, 3e-3, (count, 6)) * (1.0 + 2.0 * np.sin(seconds) ** 2)[:, None]


def nothing(rng, count):
    return np.zeros((count, 6))


@pytest.mark.parametrize(
    "more",
    [nothing, about_another_point, along_its_way, where_it_is_fast],
    ids=lambda f: f.__name__,
)
def test_other_errors_are_not_taken_for_stamps(more):
    for seed in range(5):
        stamps, errs = estimate(Kind.DRIFT, DRIFT, seed=seed, count=600)
        errs = errs @ se3.exp(more(np.random.default_rng(seed), 600))
        assert fit(stamps, errs, ask).stamps is None


def test_a_scatter_too_small_to_be_told_is_none():
    late, errs, _ = scattered(*estimate(Kind.DRIFT, DRIFT, count=600), 1e-4)
    assert fit(late, errs, ask).stamps is None


def test_its_variance_is_along_the_twist_of_each_pose():
    stamps, errs = estimate(Kind.DRIFT, DRIFT, count=60)
    truth = ask(stamps)
    data, _ = prepare(stamps, errs, truth, Nuisances.none())
    twist = truth.twists
    wider = truth.covariances + 4e-6 * twist[:, :, None] * twist[:, None, :]
    expected, _ = prepare(stamps, errs, truth._replace(covariances=wider), Nuisances.none())
    found = with_scatter(data, 4e-6)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-12, atol=1e-18)
    back = with_scatter(found, -4e-6).covariance
    np.testing.assert_allclose(back, data.covariance, rtol=0.0, atol=1e-16)


def test_the_likeliest_is_where_the_likelihood_is_largest():
    late, errs, _ = scattered(*estimate(Kind.DRIFT, DRIFT, count=400), 0.01)
    data, gauge = prepare(late, errs, ask(late), Nuisances.none())
    begin = 0.02**2
    low, high = np.full(4, np.log(1e-7)), np.full(4, np.log(1.0))
    here = Likelihood(Kind.DRIFT, DRIFT, with_scatter(data, begin), gauge)
    best, value, std = likeliest_scatter(here, begin, low, high)
    for there in (value - 2.0 * std, value + 2.0 * std):
        moved = replace(best.data, covariance=with_scatter(data, there**2).covariance)
        fallen = best.value - Likelihood(Kind.DRIFT, best.parameters, moved, gauge).value
        assert fallen > 1.0  # two standard deviations: two nats, or more with all else held


def test_one_scatter_of_several_stretches():
    one, other = Scatter(0.01, 1e-3, 30.0, 0.1, 0.2), Scatter(0.02, 2e-3, 50.0, 0.3, 0.4)
    assert Scatters().together() is None
    assert Scatters().with_one(None, 100).with_one(one, 100).together() is None
    most = Scatters().with_one(None, 100).with_one(one, 101).together()
    assert most == pytest.approx(one, rel=1e-9)
    both = Scatters().with_one(one, 100).with_one(other, 300).together()
    assert both.value == pytest.approx(np.sqrt((1e-4 + 3 * 4e-4) / 4))
    assert both.nats == 80.0
    assert both.std == pytest.approx(np.hypot(0.25e-3, 1.5e-3))


def test_blocks_of_a_run_tell_it_together():
    late, errs, there = scattered(*estimate(Kind.DRIFT, DRIFT, count=1700), 0.01)
    found = running(poses(late, errs), [800]).run.stamps
    assert abs(found.value - there) < 4.0 * found.std


def test_it_is_a_cause_and_said_as_not_its_fault():
    late, errs, _ = scattered(*estimate(Kind.DRIFT, DRIFT, count=600), 0.01)
    model = named(fit(late, errs, ask))
    (cause,) = fitted_causes(model, "se3", 0.0, np.eye(4))
    assert cause.code == "stamp_jitter"
    assert "the estimate's stamps scatter by " in cause.text
    assert not is_misread([cause.code])
    said = dict(leading(model))["Not its fault"]
    assert said.startswith("its stamps scatter by ")
    assert " ms: " in said
    # Below what anybody would mend it is in the figures alone.
    model["stamp_std"]["value"] = 3e-4
    assert fitted_causes(model, "se3", 0.0, np.eye(4)) == ()


def test_nothing_is_told_of_a_scatter_where_nothing_moves():
    stamps, errs = estimate(Kind.DRIFT, DRIFT, count=100)
    data, gauge = prepare(stamps, errs, ask(stamps), Nuisances.none())
    still = replace(data, nuisances=np.where(np.arange(9) < 2, 0.0, data.nuisances))
    assert shared_scatter(Likelihood(Kind.DRIFT, DRIFT, still, gauge)) is None
