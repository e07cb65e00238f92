# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two judgements of time, on numbers alone: where the stamps' clock is, and whether a bag loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# How long after a jump messages of the run before may still come, s on the steady clock.
_STRAGGLING = 2.0
# An estimate that is silent while the ground truth goes on for this long, ns, is not waited for.
_SILENCE = 5_000_000_000
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
    begun: int = 0  # how many have come since it jumped back
    began: int = 0

    @property
    def went_on(self) -> int:
        """How far the stamps have gone on since they jumped back, ns."""
        return self.latest - self.began if self.jumped and self.latest is not None else 0

    def take_all(self, stamps: list[int]) -> None:
        known = stamps if self.latest is None else [self.latest, *stamps]
        back = self.newest is not None and known[0] < self.newest - JUMP
        if not stamps or back or known != sorted(known):
            for stamp in stamps:
                self.take(stamp)
            return
        # In order, as mostly: what `take` leaves of all of them.
        reached = known[-2] if len(known) > 1 else known[-1]
        self.newest = reached if self.newest is None else max(self.newest, reached)
        self.latest, self.behind = known[-1], 0
        self.begun = self.begun + len(stamps) if self.jumped else 0

    def take(self, stamp: int) -> None:
        if self.newest is not None and stamp < self.newest - JUMP:
            # In order among themselves, or it is no run that starts over.
            in_order = self.behind == 0 or self.latest is None or stamp >= self.latest - JUMP
            self.behind = self.behind + 1 if in_order else 0
            self.began = stamp if self.behind <= 1 and not self.jumped else self.began
            self.begun = self.begun + 1 if self.jumped else self.behind
            self.jumped = self.jumped or self.behind >= _CONFIRMATIONS
        else:
            self.behind = 0
            self.begun = self.begun + 1 if self.jumped else 0
            reached = stamp if self.latest is None else min(stamp, self.latest)
            self.newest = reached if self.newest is None else max(self.newest, reached)
        self.latest = stamp


class JumpDetector:
    """Tells when time starts over: a bag that loops or was seeked.

    The ROS clock is the surest sign. Without ``/clock`` only the stamps jump; then many in a row
    must lie back, in order, since a few stamps out of order are no jump: on the ground truth and on
    an estimate, as far as they have spoken, and on every other estimate that has not fallen silent.
    """

    def __init__(self, estimates: int = 1) -> None:
        """Start without a clock and without stamps."""
        self._clock: int | None = None
        self._estimates = estimates
        self.forget_stamps()

    def clock(self, now: int | None) -> int | None:
        """Take the ROS time; return how far it jumped back (ns), or None."""
        before, self._clock = self._clock, now if now is not None else self._clock
        if now is None or before is None or now > before - JUMP:
            return None
        return before - now

    def stamps(self, topic: int, stamps: npt.NDArray[np.int64]) -> None:
        """Take stamps that arrived on topic 0, the ground truth, or an estimate's, from 1 on."""
        self._topics[topic].take_all(stamps.tolist())
        if topic == 0:
            return
        # Silent while the ground truth goes on after its jump: it is not waited for.
        self._heard_at[topic - 1] = self._topics[0].went_on

    def stamps_jumped(self) -> bool:
        """Whether the stamps have started over."""
        truth, *estimates = self._topics
        spoken = [
            (topic, truth.went_on - heard)
            for topic, heard in zip(estimates, self._heard_at, strict=True)
            if topic.newest is not None
        ]
        if truth.newest is not None and not truth.jumped:
            return False
        if not spoken:
            return truth.jumped
        return any(topic.jumped for topic, _ in spoken) and all(
            topic.jumped or silence > _SILENCE for topic, silence in spoken
        )

    def split(self, topic: int, stamps: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Mask, of a topic's newest stamps, those from before the run that has begun."""
        return np.arange(len(stamps)) < len(stamps) - self._topics[topic].begun

    def forget_stamps(self) -> None:
        """A new run has begun."""
        self._topics = [_Topic() for _ in range(1 + self._estimates)]
        self._heard_at = [0] * self._estimates


class LeftOver:
    """Tells the messages of the run that has ended from those of the one that has begun.

    ``/clock`` and the other topics come in any order. Once the clock has jumped back, stamps go on
    from there; one that is half the jump ahead of the one before it, or more, was left over.
    """

    def __init__(self, now: int, jumped: int, steady: float, topics: int = 2) -> None:
        """The clock jumped back by ``jumped`` (ns) to ``now``; it is ``steady`` (s)."""
        self._newest = [now] * topics
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
