# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tails of distributions: what a table says of them, and which is which."""

import numpy as np
import pytest
from scipy.special import chdtri

from trajeval_ros.likelihood.tails import (
    chi2_tails,
    even_chi2_quantile,
    normal_tail,
    student_quantile,
    student_tail,
)


def test_of_a_normal_number():
    assert normal_tail(1.959964) == pytest.approx(0.025, rel=1e-6)
    assert normal_tail(-1.959964) == pytest.approx(0.975, rel=1e-6)


@pytest.mark.parametrize(("chi2", "dof", "above"), [(3.841459, 1, 0.05), (18.307038, 10, 0.05)])
def test_of_chi2(chi2, dof, above):
    assert chi2_tails(chi2, dof) == pytest.approx((1.0 - above, above), rel=1e-6)


@pytest.mark.parametrize("normal", [-2.5758293035489004, -0.5, 0.0, 1.0, 2.5758293035489004])
def test_of_chi2_with_even_degrees_of_freedom(normal):
    dof = np.array([12, 2, 6, 12, 600, 18, 12_000, 240_000], dtype=float)
    expected = chdtri(dof, normal_tail(normal))
    assert even_chi2_quantile(dof, normal) == pytest.approx(expected, rel=1e-9)
    assert even_chi2_quantile(dof[:0], normal).shape == (0,)


@pytest.mark.parametrize(("t", "dof"), [(12.706205, 1), (2.228139, 10), (1.959966, 1e6)])
def test_of_student(t, dof):
    assert student_tail(t, dof) == pytest.approx(0.025, rel=1e-5)
    assert student_quantile(0.025, dof) == pytest.approx(t, rel=1e-5)
