# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses that the ground truth has answered and that are not scored after all."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]


class Withdrawn:
    """Leaves withdrawn poses out of what a posterior says of the poses before each.

    The ``cross`` of :class:`~trajeval_ros.ground_truth.trajectory.Posterior` counts every pose that
    was asked for. It remembers only withdrawn poses that one to come may still be related to.
    """

    def __init__(self) -> None:
        """Start without poses."""
        self._asked = 0
        self._gone: Numbers = np.empty(0, dtype=np.int64)

    def number(self, count: int) -> Numbers:
        """Return the numbers (n,) of the next ``count`` poses asked for."""
        numbers = self._asked + np.arange(count)
        self._asked += count
        return numbers

    def add(self, numbers: Numbers) -> None:
        """Withdraw poses."""
        self._gone = np.union1d(self._gone, numbers)

    def left_out(self, numbers: Numbers, cross: tuple[Array, ...]) -> tuple[Array, ...]:
        """Return ``cross`` of the poses ``numbers`` (n,) without its blocks of withdrawn ones."""
        if not len(self._gone):
            return cross
        return tuple(
            blocks[~np.isin(np.arange(number - len(blocks), number), self._gone)]
            for number, blocks in zip(numbers.tolist(), cross, strict=True)
        )

    def forget(self, related: int) -> None:
        """Forget what the newest pose, related to so many before it, and later ones are not to."""
        self._gone = self._gone[self._gone >= self._asked - 1 - related]
