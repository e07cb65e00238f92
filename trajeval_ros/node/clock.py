# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two judgements of time, on numbers alone: where the stamps' clock is, and whether a bag loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# How long after a jump messages of the run before may still come, s on the steady clock.
_STRAGGLING = 2.0
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
        """Take the newest stamps (ns) that were let in, as it is ``now`` on the ROS clock.

        Never one that may still be rejected: a single stamp from the future would have every
        estimate after it decided at once.
        """
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
class _Topic:
    """What one topic's stamps have done: ``newest`` is one that two in a row have reached."""

    newest: int | None = None
    latest: int | None = None
    behind: int = 0
    jumped: bool = False

    def take(self, stamp: int) -> None:
        if self.newest is not None and stamp < self.newest - JUMP:
            # In order among themselves, or it is no run that starts over.
            in_order = self.behind == 0 or self.latest is None or stamp >= self.latest - JUMP
            self.behind = self.behind + 1 if in_order else 0
            self.jumped = self.jumped or self.behind >= _CONFIRMATIONS
        else:
            self.behind = 0
            reached = stamp if self.latest is None else min(stamp, self.latest)
            self.newest = reached if self.newest is None else max(self.newest, reached)
        self.latest = stamp


class JumpDetector:
    """Tells when time starts over: a bag that loops or was seeked.

    The ROS clock is the surest sign. Without ``/clock`` only the stamps jump; then many in a row
    must lie back, in order, and on both topics if both have spoken, since a few stamps out of order
    are no jump.
    """

    def __init__(self) -> None:
        """Start without a clock and without stamps."""
        self._clock: int | None = None
        self._topics = (_Topic(), _Topic())

    def clock(self, now: int | None) -> int | None:
        """Take the ROS time; return how far it jumped back (ns), or None."""
        before, self._clock = self._clock, now if now is not None else self._clock
        if now is None or before is None or now > before - JUMP:
            return None
        return before - now

    def stamps(self, topic: int, stamps: npt.NDArray[np.int64]) -> None:
        """Take stamps that arrived on topic 0 or 1."""
        for stamp in stamps.tolist():
            self._topics[topic].take(stamp)

    def stamps_jumped(self) -> bool:
        """Whether the stamps have started over."""
        spoken = [topic for topic in self._topics if topic.newest is not None]
        return bool(spoken) and all(topic.jumped for topic in spoken)

    def forget_stamps(self) -> None:
        """A new run has begun."""
        self._topics = (_Topic(), _Topic())


class LeftOver:
    """Tells the messages of the run that has ended from those of the one that has begun.

    ``/clock`` and the other topics come in any order. Once the clock has jumped back, stamps go on
    from there; one that is half the jump ahead of the one before it, or more, was left over.
    """

    def __init__(self, now: int, jumped: int, steady: float) -> None:
        """The clock jumped back by ``jumped`` (ns) to ``now``; it is ``steady`` (s)."""
        self._newest = [now, now]
        self._ahead = jumped // 2
        self._until = steady + _STRAGGLING

    def active(self, steady: float) -> bool:
        """Whether there may still be some."""
        return steady < self._until

    def split(self, topic: int, stamps: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Return which of the ``stamps`` (n,), in the order of arrival, are left over, (n,)."""
        mask = np.zeros(len(stamps), dtype=np.bool_)
        for k, stamp in enumerate(stamps.tolist()):
            if stamp > self._newest[topic] + self._ahead:
                mask[k] = True
            else:
                self._newest[topic] = max(self._newest[topic], stamp)
        return mask
