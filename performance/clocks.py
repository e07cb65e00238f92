# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times that are compared with each other, taken in turn, so that both meet the same machine."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def in_turn(rounds: int, *works: Callable[[], object]) -> Array:
    """Return the processor time (s) of each of ``works`` in each round; (rounds, works).

    Each is run once before, for what a first time costs.
    """
    for work in works:
        work()
    taken = np.empty((rounds, len(works)))
    for times in taken:
        for i, work in enumerate(works):
            begin = time.process_time()
            work()
            times[i] = time.process_time() - begin
    return taken


def ratio(times: Array, over: int = 0, under: int = 1) -> float:
    """Return the median over the rounds of the ratio of two works' times."""
    return float(np.median(times[:, over] / times[:, under]))
