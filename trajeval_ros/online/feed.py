# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whole trajectories through the engine, as if they had arrived live and without delay."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.results import Results
from trajeval_ros.online.samples import PoseSamples

Stamps = npt.NDArray[np.int64]

_LOOK_AHEAD = 3


def feed(
    engine: Engine, ground_truth: PoseSamples, estimate: PoseSamples, chunk: int = 1_000_000_000
) -> Iterator[Results]:
    """Feed both in the order of their stamps, ``chunk`` (ns) at a time, and yield the results.

    A pose whose stamp is out of order goes with the poses before it.
    """
    (settings,) = engine.settings.estimates.values()
    truth_times = arrival_times(ground_truth.stamps)
    estimate_times = arrival_times(estimate.stamps + settings.time_offset)
    taken = [0, 0]
    for now in _chunk_ends(truth_times, estimate_times, chunk):
        until = [int(np.searchsorted(t, now, side="right")) for t in (truth_times, estimate_times)]
        engine.add_ground_truth(ground_truth[taken[0] : until[0]])
        engine.add_estimate(estimate[taken[1] : until[1]])
        taken = until
        yield engine.advance(now)
    yield engine.finish()


def arrival_times(stamps: Stamps) -> Stamps:
    """When each pose arrives: at its stamp, but no later than the next few, and in order.

    So a wrong stamp far ahead does not hold up the poses after it.
    """
    arrival = stamps.copy()
    for ahead in range(1, _LOOK_AHEAD + 1):
        arrival[:-ahead] = np.minimum(arrival[:-ahead], stamps[ahead:])
    return np.asarray(np.maximum.accumulate(arrival)) if len(stamps) else stamps


def _chunk_ends(first: Stamps, second: Stamps, chunk: int) -> Iterator[int]:
    """Ends of the chunks that hold poses; an empty stretch is skipped."""
    taken = [0, 0]
    while taken[0] < len(first) or taken[1] < len(second):
        heads = [int(t[n]) for t, n in ((first, taken[0]), (second, taken[1])) if n < len(t)]
        end = min(heads) + chunk
        taken = [int(np.searchsorted(t, end, side="right")) for t in (first, second)]
        yield end
