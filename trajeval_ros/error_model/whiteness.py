# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether innovations are white, as those of a model that holds are."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def autocorrelation(innovations: Array, lags: int) -> Array:
    """Of innovations (n, axes) over the axes together, from lag 1 to ``lags``, or n - 1.

    None where the innovations are exactly nothing.
    """
    found = np.zeros(min(lags, len(innovations) - 1))
    power = float((innovations**2).sum())
    if power > 0.0:
        for lag in range(1, len(found) + 1):
            found[lag - 1] = float((innovations[lag:] * innovations[:-lag]).sum()) / power
    return found
