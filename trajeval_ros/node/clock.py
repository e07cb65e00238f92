# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two judgements of time, on numbers alone: where the stamps' clock is, and whether a bag loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# Back by this much, and it is a jump; below, it is jitter.
JUMP = 1_000_000_000
# Stamps alone (no /clock) jump if this many in a row are that far back, on each topic that speaks.
_CONFIRMATIONS = 20


class StampClock:
    """The time on the clock of the stamps.

    Recorded stamps need not be on the node's ROS clock. What the clock is asked for is only how
    long to wait, so the time is that of the newest stamp plus the ROS time since it came: for live
    stamps that is the ROS time less the latency, and for recorded ones it works as well.
    """

    def __init__(self) -> None:
        """Start without a stamp."""
        self._newest: int | None = None
        self._came = 0

    def note(self, stamps: list[int], now: int | None) -> None:
        """Take the newest stamps (ns) that were let in, as it is ``now`` on the ROS clock."""
        if now is None or not stamps:
            return
        newest = max(stamps)
        if self._newest is None or newest > self._newest:
            self._newest, self._came = newest, now

    def now(self, now: int | None) -> int | None:
        """Return the time; None without a clock or a stamp."""
        if now is None or self._newest is None:
            return None
        return self._newest + max(0, now - self._came)


@dataclass(slots=True)
class _Back:
    newest: int | None = None
    behind: int = 0
    latest: int = 0


class JumpDetector:
    """Tells when time starts over: a bag that loops or was seeked.

    The ROS clock is the surest sign. Without ``/clock`` only the stamps jump; then many in a row
    must lie back, in order, and on both topics if both have spoken, since a few stamps out of order
    are no jump.
    """

    def __init__(self) -> None:
        """Start over."""
        self._clock: int | None = None
        self._topics = (_Back(), _Back())

    def clock(self, now: int | None) -> int | None:
        """Take the ROS time; return how far it jumped back (ns), or None."""
        before, self._clock = self._clock, now if now is not None else self._clock
        if now is None or before is None or now > before - JUMP:
            return None
        return before - now

    def stamps(self, topic: int, stamps: npt.NDArray[np.int64]) -> None:
        """Take stamps that arrived on topic 0 or 1."""
        state = self._topics[topic]
        for stamp in stamps.tolist():
            if state.newest is None or stamp > state.newest - JUMP:
                state.behind = 0
                state.newest = stamp if state.newest is None else max(stamp, state.newest)
            elif state.behind and stamp < state.latest - JUMP:
                state.behind = 0
            else:
                state.behind += 1
                state.latest = stamp

    def forget_stamps(self) -> None:
        """A new run has begun."""
        self._topics = (_Back(), _Back())

    def stamps_jumped(self) -> bool:
        """Whether the stamps have started over."""
        spoken = [state for state in self._topics if state.newest is not None]
        return bool(spoken) and all(state.behind >= _CONFIRMATIONS for state in spoken)
