# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground-truth samples that arrive after later ones.

What has been handed on to the process is decided. Of a topic in order everything is, at once; one
on which samples overtake each other is held back, for as long as twice what the latest of them was
late by. What is decided depends on the order of arrival alone, not on how it is cut into batches.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.segment import Samples

Stamps = npt.NDArray[np.int64]

_MARGIN = 2


class Disorder:
    """Holds back samples, by stamp, until those that are still on their way can have come."""

    def __init__(self) -> None:
        """Start without samples, and without delay."""
        self._delay = 0  # ns
        self._decided: int | None = None
        self._held: Samples | None = None

    @property
    def held(self) -> Stamps:
        """Stamps of the samples held back."""
        return np.empty(0, dtype=np.int64) if self._held is None else self._held.stamps

    def takes(self, stamp: int, newest: int, max_wait: int) -> bool:
        """Whether a sample (ns) that comes after the ``newest`` still has a place.

        One that has none, and is at most ``max_wait`` late, makes all that follow wait.
        """
        self._decide(newest - self._delay)
        lateness = newest - stamp
        if lateness > max_wait or stamp in self.held:
            return False
        assert self._decided is not None
        if stamp > self._decided:
            return True
        self._delay = min(max(self._delay, _MARGIN * lateness), max_wait)
        return False

    def accept(self, samples: Samples, newest: int) -> Samples:
        """Take samples in the order of their stamps; return all that is decided.

        ``newest``: stamp (ns) of the newest that has come.
        """
        self._decide(newest - self._delay)
        return self._decided_of(samples)

    def confirm(self, until: int) -> Samples:
        """Decide what is stamped up to ``until`` (ns): what was on its way must have come."""
        if self._held is None:
            return _NOTHING
        self._decide(until)
        return self._decided_of(_NOTHING)

    def conclude(self) -> Samples:
        """No more samples will come."""
        held, self._held = self._held, None
        return _NOTHING if held is None else held

    def _decide(self, until: int) -> None:
        self._decided = until if self._decided is None else max(until, self._decided)

    def _decided_of(self, samples: Samples) -> Samples:
        waiting = samples if self._held is None else _merged(self._held, samples)
        assert self._decided is not None
        count = int(np.searchsorted(waiting.stamps, self._decided, side="right"))
        self._held = waiting[count:] if count < len(waiting) else None
        return waiting[:count]


_NOTHING = Samples(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)))


def _merged(held: Samples, samples: Samples) -> Samples:
    """Both by stamp; a covariance is there where both have one."""
    if not len(samples):
        return held
    both = held + samples
    if held.stamps[-1] < samples.stamps[0]:
        return both
    order = np.argsort(both.stamps)
    covariances = None if both.covariances is None else both.covariances[order]
    return Samples(both.stamps[order], both.poses[order], covariances)
