# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tails of distributions, beside SciPy's."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from trajeval_ros.likelihood.tails import chi2_tails, normal_tail, student_quantile, student_tail

# Of degrees of freedom, from one to a million.
_DIGITS = st.floats(0.0, 6.0)


@given(_DIGITS, st.floats(-6.0, 6.0))
def test_of_chi2(digits, away):
    dof = round(10.0**digits)
    chi2 = dof * math.exp(away * min(math.sqrt(2.0 / dof), 0.5))
    below, above = chi2_tails(chi2, dof)
    assert below == pytest.approx(special.chdtr(dof, chi2), rel=1e-10, abs=1e-15)
    assert above == pytest.approx(special.chdtrc(dof, chi2), rel=1e-10, abs=1e-15)


@pytest.mark.parametrize(
    ("chi2", "expected"), [(0.0, (0.0, 1.0)), (2e10, (1.0, 0.0)), (math.inf, (1.0, 0.0))]
)
def test_of_chi2_at_the_ends(chi2, expected):
    assert chi2_tails(chi2, 27240) == expected


@given(_DIGITS, st.floats(-4.0, 3.0))
def test_of_student(digits, t):
    dof, t = 10.0**digits, 10.0**t
    expected = special.stdtr(dof, -t)
    assert student_tail(t, dof) == pytest.approx(expected, rel=1e-10, abs=1e-290)


@given(_DIGITS, st.floats(-6.0, math.log10(0.49)))
def test_what_student_is_above_as_seldom(digits, tail):
    dof, tail = 10.0**digits, 10.0**tail
    assert student_quantile(tail, dof) == pytest.approx(-special.stdtrit(dof, tail), rel=1e-9)


@given(st.floats(-30.0, 30.0))
def test_of_the_normal(x):
    assert normal_tail(x) == pytest.approx(special.ndtr(-x), rel=1e-12)
