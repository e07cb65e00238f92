# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A joint covariance whose bandwidth the data tell, factored once for every figure."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import likelihood_twin as twin
from twins.trajectories import draw, walk

from trajeval_ros.likelihood.absolute import RunningAbsolute, absolute
from trajeval_ros.likelihood.first_order import FirstOrderAbsolute, absolute_first_order
from trajeval_ros.likelihood.gaussian import CovarianceError
from trajeval_ros.likelihood.joint import JointFactor
from trajeval_ros.likelihood.relative import RunningRelative, relative


@st.composite
def ragged(draw_value, most=120):
    """V (6 M, 6 M), and for each pose how many before it are correlated with it."""
    rng = np.random.default_rng(draw_value(st.integers(0, 2**32 - 1)))
    count = draw_value(st.integers(2, most))
    reach, reaches = 0, []
    for i in range(count):
        # Shared segments: the oldest pose in reach only moves on.
        reach = min(reach + 1, i)
        if rng.random() < 0.1:
            reach = int(rng.integers(0, reach + 1))
        reaches.append(reach)
    lower = np.zeros((6 * count, 6 * count))
    for i, p in enumerate(reaches):
        block = rng.normal(size=(6, 6 * (p + 1))) * (0.3 / (p + 1))
        lower[6 * i : 6 * i + 6, 6 * (i - p) : 6 * (i + 1)] = block
        lower[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += np.eye(6)
    lower *= 0.01
    return rng, lower @ lower.T, reaches


def rows_of(v, reaches):
    own = np.array([v[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(len(reaches))])
    cross = [
        v[6 * (i - p) : 6 * i, 6 * i : 6 * i + 6].reshape(p, 6, 6) for i, p in enumerate(reaches)
    ]
    return own, cross


@given(problem=ragged(), cuts=st.lists(st.integers(0, 120), max_size=5))
@settings(max_examples=25, deadline=None)
def test_is_cholesky_s_factor_however_the_poses_are_cut(problem, cuts):
    rng, v, reaches = problem
    own, cross = rows_of(v, reaches)
    columns = rng.normal(size=(len(own), 6, 3))
    factor, white, log_det = JointFactor(), np.zeros((0, 3)), 0.0
    edges = [0, *sorted(min(c, len(own)) for c in cuts), len(own)]
    for a, b in itertools.pairwise(edges):
        rows = factor.update(own[a:b], cross[a:b])
        white = np.concatenate([white, rows.whiten_after(white, columns[a:b])])
        log_det += rows.log_det
    expected = np.linalg.solve(np.linalg.cholesky(v), columns.reshape(-1, 3))
    np.testing.assert_allclose(white, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert log_det == pytest.approx(np.linalg.slogdet(v)[1], rel=1e-12)


@given(problem=ragged(most=90), cuts=st.lists(st.integers(0, 90), max_size=5))
@settings(max_examples=15, deadline=None)
def test_every_figure_is_the_dense_one_and_the_running_ones_do_not_depend_on_cuts(problem, cuts):
    rng, v, reaches = problem
    own, cross = rows_of(v, reaches)
    truth = walk(rng, len(own), 0.1, 0.1)
    estimate = draw(rng, truth, own)
    blocks = twin.block_rows(v, len(own) - 1)
    rows = JointFactor().update(own, cross)
    expected = twin.relative(truth, blocks, estimate)
    for found in (relative, absolute_first_order):
        likelihood = found(truth, rows, estimate)
        assert (likelihood.chi2, likelihood.log_det) == pytest.approx(expected, rel=1e-8)
    best, dense = absolute(truth, rows, estimate), absolute(truth, blocks, estimate)
    assert best.likelihood.chi2 == pytest.approx(dense.likelihood.chi2, rel=1e-8)
    figures = []
    for edges in ([0, len(own)], [0, *sorted(min(c, len(own)) for c in cuts), len(own)]):
        running = (RunningRelative(None), FirstOrderAbsolute(), RunningAbsolute())
        factor = JointFactor()
        for a, b in itertools.pairwise(edges):
            piece = factor.update(own[a:b], cross[a:b])
            for figure in running:
                figure.update(truth[a:b], piece, estimate[a:b])
        figures.append([figure.total.log_likelihood for figure in running])
    assert figures[0] == pytest.approx(figures[1], rel=1e-9)
    assert figures[0][0] == pytest.approx(figures[0][1], rel=1e-9)


def test_what_is_no_covariance_is_refused_and_leaves_no_trace():
    own = np.tile(np.eye(6), (200, 1, 1))
    cross = [np.tile(0.5 ** np.arange(i, 0, -1)[:, None, None] * np.eye(6), 1) for i in range(200)]
    factor, expected = JointFactor(), JointFactor()
    factor.update(own[:50], cross[:50])
    wrong = [c.copy() for c in cross[50:]]
    wrong[100][-1] *= 3.0
    with pytest.raises(CovarianceError) as error:
        factor.update(own[50:], wrong)
    assert error.value.index == 100
    with pytest.raises(CovarianceError):
        factor.update(np.full((1, 6, 6), np.nan), cross[50:51])
    with pytest.raises(ValueError, match="the pose before it"):
        factor.update(own[:1], cross[60:61])
    rows = factor.update(own[50:], cross[50:])
    expected.update(own[:50], cross[:50])
    known = expected.update(own[50:], cross[50:])
    np.testing.assert_allclose(rows.inverse, known.inverse, rtol=0, atol=1e-12)
