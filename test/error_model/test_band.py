# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The states integrated out by loops in C, held to NumPy."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_likelihood import PARAMETERS, problem

from trajeval_ros import loops
from trajeval_ros.error_model import band
from trajeval_ros.error_model.band import Band, regressed
from trajeval_ros.error_model.information import Information
from trajeval_ros.error_model.likelihood import Likelihood
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.system import inverse

pytestmark = pytest.mark.skipif(not loops.there(), reason="not built, or switched off")

KINDS = pytest.mark.parametrize("kind", list(Kind))


def likelihood(kind, count, seed, columns=9):
    data, gauge = problem(count, seed, columns)
    parameters = PARAMETERS[kind] + np.random.default_rng(seed).normal(size=(2, 1)) * 0.5
    return Likelihood(kind, parameters, data, gauge)


def same(found, expected):
    scale = np.abs(expected).max() + 1e-300
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)


@KINDS
@settings(max_examples=25, deadline=None)
@given(count=st.integers(3, 40), columns=st.integers(1, 20), seed=st.integers(0, 999))
def test_both_say_the_same(kind, count, columns, seed):
    here = likelihood(kind, count, seed, columns)
    system, slopes = here._system, here._steps.slopes
    found, expected = Band(system), Information(system)
    same(found.normal, expected.normal)
    assert found.log_det == pytest.approx(expected.log_det, rel=1e-11)
    rng = np.random.default_rng(seed)
    size = len(expected.normal) - 1
    theta, root = rng.normal(size=size), np.tril(rng.normal(size=(size, size)))
    told, known = found.told(theta, root), expected.told(theta, root)
    for one, other in zip(told, known, strict=True):
        same(one, other)
    for one, other in zip(
        found.average(told, slopes), expected.average(known, slopes), strict=True
    ):
        same(one, other)
    same(found.whitened(), expected.whitened())


@KINDS
def test_a_likelihood_is_the_same_by_both(kind):
    here = likelihood(kind, 300, 5)
    with loops.left_out():
        there = likelihood(kind, 300, 5)
        there.scores()
    assert here.value == pytest.approx(there.value, rel=1e-12)
    same(here.theta, there.theta)
    same(here.scores(), there.scores())
    same(here.average_information(), there.average_information())
    for one, other in zip(here.disturbances(), there.disturbances(), strict=True):
        same(one, other)
    for one, other in zip(here.whitened(), there.whitened(), strict=True):
        same(one, other)


@KINDS
def test_a_likelihood_is_the_same_by_both_over_many_poses(kind):
    """What round-off adds to a recursion does not grow."""
    data, gauge = problem(1500, 3)
    data = replace(data, times=0.05 * np.arange(1500))
    parameters = PARAMETERS[kind] + np.log([[1.0], [0.1]])
    here = Likelihood(kind, parameters, data, gauge)
    with loops.left_out():
        there = Likelihood(kind, parameters, data, gauge)
        there.scores()
    same(here.scores(), there.scores())
    same(here.average_information(), there.average_information())
    for one, other in zip(here.disturbances(), there.disturbances(), strict=True):
        same(one, other)


@KINDS
def test_of_many_poses_the_filter_is_run_anew_when_it_is_asked_for(kind, monkeypatch):
    usual = likelihood(kind, 30, 5)
    monkeypatch.setattr(band, "_FEW", 10)
    here = likelihood(kind, 30, 5)
    assert here.value == pytest.approx(usual.value, rel=1e-12)
    same(here.theta, usual.theta)
    same(here.scores(), usual.scores())
    same(here.average_information(), usual.average_information())


def with_entry(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@KINDS
@pytest.mark.parametrize(
    "spoil",
    [
        lambda d: replace(d, covariance=with_entry(d.covariance, (7, 2, 2), -1.0)),
        lambda d: replace(d, covariance=with_entry(d.covariance, (7, 2, 2), np.nan)),
        lambda d: replace(d, covariance=with_entry(d.covariance, (0, 0, 0), np.inf)),
        lambda d: replace(d, errors=with_entry(d.errors, (3, 1), np.nan)),
        lambda d: replace(d, errors=with_entry(d.errors, (3, 1), 1e200)),
        lambda d: replace(d, times=with_entry(d.times, 5, d.times[4])),
        lambda d: replace(d, nuisances=np.zeros_like(d.nuisances), precision=0.0 * d.precision),
    ],
)
@pytest.mark.parametrize("without", [nullcontext, loops.left_out])
def test_what_has_no_likelihood_has_none_by_both(kind, spoil, without):
    data, gauge = problem(20, 2)
    data = spoil(data)
    with without(), np.errstate(all="ignore"), pytest.raises(np.linalg.LinAlgError):
        Likelihood(kind, PARAMETERS[kind], data, gauge)


@KINDS
@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_units_do_not_matter(kind, size):
    """Errors, ground truth and parameters all ``size`` times as large."""
    data, gauge = problem(50, 8)
    larger = replace(
        data,
        errors=size * data.errors,
        covariance=size**2 * data.covariance,
        nuisances=size * data.nuisances,
    )
    parameters = PARAMETERS[kind] + np.log(size) * np.array(
        [not name.endswith("time") for name in kind.names]
    )
    usual = Likelihood(kind, PARAMETERS[kind], data, gauge)
    found = Likelihood(kind, parameters, larger, gauge)
    same(found.theta[:9], usual.theta[:9])
    same(found.gradient(), usual.gradient())


def test_of_more_columns_than_have_room_numpy_takes_care():
    assert isinstance(regressed(likelihood(Kind.DRIFT, 30, 1, 31)._system), Band)
    assert isinstance(regressed(likelihood(Kind.DRIFT, 30, 1, 32)._system), Information)


@settings(max_examples=20, deadline=None)
@given(k=st.integers(1, 2), seed=st.integers(0, 999))
def test_inverses_of_steps(k, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, 7, k, k))
    blocks = root @ np.swapaxes(root, 2, 3) + 0.1 * np.eye(k)
    found, log_det = inverse(np.moveaxis(blocks, 1, -1))
    np.testing.assert_allclose(np.moveaxis(found, -1, 1), np.linalg.inv(blocks), rtol=1e-9)
    assert log_det == pytest.approx(np.linalg.slogdet(blocks)[1].sum(), rel=1e-9, abs=1e-9)


def test_a_step_that_is_not_positive_definite_has_no_inverse():
    with pytest.raises(np.linalg.LinAlgError):
        inverse(np.moveaxis(np.array([[[1.0, 2.0], [2.0, 1.0]]]), 0, -1))
