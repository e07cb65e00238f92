# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When to publish what: the messages of two topics in one order of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros.online.feed import arrival_times

Stamps = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Schedule:
    """Events in the order in which they happen.

    ``times`` (N,) are the data's own time in nanoseconds, never decreasing; ``topics`` (N,) say
    which of the inputs, ``rows`` (N,) which message of it.
    """

    times: Stamps
    topics: npt.NDArray[np.intp]
    rows: npt.NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.times)


def merge(*stamps: Stamps) -> Schedule:
    """Return the schedule of several topics; each keeps its own order, whatever its stamps."""
    moments = [arrival_times(each) for each in stamps]
    topics = np.repeat(np.arange(len(stamps)), [len(each) for each in stamps])
    rows = np.concatenate([np.arange(len(each)) for each in stamps])
    times = np.concatenate(moments)
    # Stable: at the same time the first topic, the ground truth, comes first.
    order = np.argsort(times, kind="stable")
    return Schedule(times[order], topics[order], rows[order])
