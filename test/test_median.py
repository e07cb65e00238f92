# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The median is NumPy's."""

import warnings

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.median import median

NUMBERS = st.one_of(
    st.lists(st.floats(-1e300, 1e300) | st.sampled_from([np.nan, np.inf, -np.inf])),
    st.lists(st.integers(-(2**62), 2**62)),
)


@given(NUMBERS)
def test_it_is_numpy_s(numbers):
    values = np.array(numbers)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = np.median(values)
    np.testing.assert_allclose(median(values), expected, rtol=1e-15)
