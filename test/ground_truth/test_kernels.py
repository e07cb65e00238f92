# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from twins import gp_twin

from trajeval_ros.ground_truth.kernels import (
    Exponential,
    Matern32,
    Matern52,
    Matern72,
    SquaredExponential,
)

KERNELS = [SquaredExponential(), Exponential(), Matern32(), Matern52(), Matern72()]
U = np.concatenate([[0.0], np.logspace(-9, 2, 200)])


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: type(k).__name__)
def test_is_the_textbook_formula(kernel):
    expected = gp_twin.correlation(type(kernel).__name__, U)
    np.testing.assert_allclose(kernel.correlation(U), expected, rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(kernel.with_slope(U)[0], kernel.correlation(U), rtol=1e-15)
    assert kernel.correlation(np.zeros(1))[0] == 1.0


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: type(k).__name__)
def test_slope_is_the_derivative_in_log_length(kernel):
    u, step = U[(U > 1e-3) & (U < 20.0)], 1e-6
    shorter, longer = kernel.correlation(u * np.exp(step)), kernel.correlation(u * np.exp(-step))
    np.testing.assert_allclose(
        kernel.with_slope(u)[1], (longer - shorter) / (2 * step), rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: type(k).__name__)
def test_is_positive_definite(kernel):
    times = np.random.default_rng(0).uniform(0.0, 10.0, 40)
    apart = np.abs(times[:, None] - times)
    assert np.linalg.eigvalsh(kernel.correlation(apart)).min() > -1e-12
