# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whole trajectories through the engine, as if they had arrived live and without delay."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

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
    """Feed ground truth and the only estimate as `feed_all` does, and yield the results."""
    (name,) = engine.names
    for results in feed_all(engine, ground_truth, {name: estimate}, chunk):
        yield results[name]


def feed_all(
    engine: Engine,
    ground_truth: PoseSamples,
    estimates: Mapping[str, PoseSamples],
    chunk: int = 1_000_000_000,
    ahead: int = 0,
) -> Iterator[dict[str, Results]]:
    """Feed all in the order of their stamps, ``chunk`` (ns) at a time, and yield the results.

    ``estimates`` by the engine's names. A pose whose stamp is out of order goes with the poses
    before it. The ground truth may be up to ``ahead`` (ns) of the estimates: many samples at a time
    cost less, and the answers do not depend on it.
    """
    times = _times(engine, ground_truth, estimates)
    yield from _fed(engine, ground_truth, estimates, times, _chunk_ends(times, chunk), ahead)


def feed_evenly(
    engine: Engine,
    ground_truth: PoseSamples,
    estimates: Mapping[str, PoseSamples],
    pieces: int,
) -> Iterator[dict[str, Results]]:
    """Feed all as `feed_all` does, in so many ``pieces`` of about as many poses.

    By number and not by time: a wrong stamp far ahead does not make one piece of all the others.
    """
    times = _times(engine, ground_truth, estimates)
    every = np.sort(np.concatenate(times))
    ends = every[np.linspace(0, len(every) - 1, pieces).astype(int)] if len(every) else every
    yield from _fed(engine, ground_truth, estimates, times, np.unique(ends).tolist())


def _times(
    engine: Engine, ground_truth: PoseSamples, estimates: Mapping[str, PoseSamples]
) -> list[Stamps]:
    """When the poses of each topic arrive."""
    settings = engine.settings.estimates
    return [arrival_times(ground_truth.stamps)] + [
        arrival_times(estimate.stamps + settings[name].time_offset)
        for name, estimate in estimates.items()
    ]


def _fed(
    engine: Engine,
    ground_truth: PoseSamples,
    estimates: Mapping[str, PoseSamples],
    times: Sequence[Stamps],
    ends: Iterable[int],
    ahead: int = 0,
) -> Iterator[dict[str, Results]]:
    """Feed what arrives at ``times`` up to each of ``ends``, and yield the results."""
    topics = [ground_truth, *estimates.values()]
    taken = [0] * len(topics)
    known: int | None = None
    for now in ends:
        until = [int(np.searchsorted(t, now, side="right")) for t in times]
        if known is None or now > known:
            known = now + ahead
            until[0] = int(np.searchsorted(times[0], known, side="right"))
        until[0] = max(until[0], taken[0])
        batches = [topic[a:b] for topic, a, b in zip(topics, taken, until, strict=True)]
        if len(batches[0]):
            engine.add_ground_truth(batches[0])
        for name, batch in zip(estimates, batches[1:], strict=True):
            engine.add_estimate(batch, name)
        taken = until
        yield engine.advance_all(now)
    yield engine.finish_all()


def arrival_times(stamps: Stamps) -> Stamps:
    """When each pose arrives: at its stamp, but no later than the next few, and in order.

    So a wrong stamp far ahead does not hold up the poses after it.
    """
    arrival = stamps.copy()
    for ahead in range(1, _LOOK_AHEAD + 1):
        arrival[:-ahead] = np.minimum(arrival[:-ahead], stamps[ahead:])
    return np.asarray(np.maximum.accumulate(arrival)) if len(stamps) else stamps


def _chunk_ends(times: Sequence[Stamps], chunk: int) -> Iterator[int]:
    """Ends of the chunks that hold poses; an empty stretch is skipped."""
    taken = [0] * len(times)
    while heads := [int(t[n]) for t, n in zip(times, taken, strict=True) if n < len(t)]:
        end = min(heads) + chunk
        taken = [int(np.searchsorted(t, end, side="right")) for t in times]
        yield end
