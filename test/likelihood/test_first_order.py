# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first-order absolute likelihood against the paper's formula in dense matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import likelihood_twin as twin
from twins.trajectories import problems, real_pair

from trajeval_ros.likelihood.first_order import FirstOrderAbsolute, absolute_first_order
from trajeval_ros.likelihood.relative import RunningRelative, relative

FEW = settings(max_examples=40)


@FEW
@given(problems(most=30))
def test_is_the_papers_sum(problem):
    chi2, log_det = twin.first_order(*problem)
    found = absolute_first_order(*problem)
    assert found.dof == 6 * len(problem[0]) - 6
    assert found.chi2 == pytest.approx(chi2, rel=1e-9, abs=1e-9)
    assert found.log_det == pytest.approx(log_det, rel=1e-9, abs=1e-7)


@FEW
@given(st.integers(1, 5).flatmap(lambda p: problems(most=25, bandwidth=p)))
def test_joint_is_the_papers_sum_and_the_relative(problem):
    chi2, log_det = twin.first_order(*problem)
    found = absolute_first_order(*problem)
    assert found.chi2 == pytest.approx(chi2, rel=1e-8, abs=1e-8)
    assert found.log_det == pytest.approx(log_det, rel=1e-8, abs=1e-6)
    expected = relative(*problem).log_likelihood
    assert found.log_likelihood == pytest.approx(expected, rel=1e-7, abs=1e-6)


@FEW
@given(st.integers(0, 4), st.data())
def test_cuts_do_not_matter(bandwidth, data):
    problem = data.draw(problems(bandwidth=bandwidth))
    cuts = sorted(data.draw(st.sets(st.integers(0, len(problem[0])), max_size=20)))
    run = FirstOrderAbsolute(bandwidth)
    for piece in zip(*(np.split(values, cuts) for values in problem), strict=True):
        run.update(*piece)
    expected = absolute_first_order(*problem).log_likelihood
    assert run.total.log_likelihood == pytest.approx(expected, rel=1e-11, abs=1e-9)


@FEW
@given(st.data())
def test_the_steps_errors_may_be_given(data):
    problem = data.draw(problems(most=200, bandwidth=0))
    cuts = sorted(data.draw(st.sets(st.integers(0, len(problem[0])), max_size=5)))
    own, given, steps = FirstOrderAbsolute(), FirstOrderAbsolute(), RunningRelative(0)
    for piece in zip(*(np.split(values, cuts) for values in problem), strict=True):
        own.update(*piece)
        given.update(*piece, steps.update(*piece).error)
    assert given.total == own.total


def test_one_pose_at_a_time_over_kilometres():
    problem = real_pair("kitti_00", "orb")
    run = FirstOrderAbsolute()
    for i in range(1000):
        run.update(*(values[i : i + 1] for values in problem))
    expected = absolute_first_order(*(values[:1000] for values in problem)).log_likelihood
    assert run.total.log_likelihood == pytest.approx(expected, rel=1e-12)
