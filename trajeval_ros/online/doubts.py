# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Covariances of an estimate that cannot be what they say."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.online.results import Notice

Array = npt.NDArray[np.float64]

# So many equal covariances in a row are a constant somebody wrote down.
_ENOUGH = 20


class CovarianceDoubts:
    """Recognises covariances that are all zero or all the same."""

    def __init__(self) -> None:
        """Start without covariances."""
        self._count = 0
        self._zero = 0
        self._first: Array | None = None
        self._constant = True

    def look_at(self, covariances: Array) -> None:
        """Take the next covariances (n, 6, 6), as they came."""
        if not len(covariances):
            return
        if self._first is None:
            self._first = covariances[0].copy()
        self._count += len(covariances)
        self._zero += int((covariances == 0.0).all(axis=(-1, -2)).sum())
        same = np.array_equal(covariances, np.broadcast_to(self._first, covariances.shape))
        self._constant = self._constant and same

    def notices(self) -> list[Notice]:
        """What there is to say."""
        if self._count < _ENOUGH:
            return []
        if self._zero == self._count:
            text = "the estimate's covariances are all zero: they say nothing"
            return [Notice("warning", "estimate_covariance_zero", text)]
        if self._constant:
            text = "the estimate's covariance is always the same: a constant, not an uncertainty"
            return [Notice("warning", "estimate_covariance_constant", text)]
        return []
