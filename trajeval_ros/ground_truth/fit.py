# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How well the process fits the ground truth's samples, segment by segment."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from trajeval_ros.ground_truth.adaptation import Epoch
from trajeval_ros.ground_truth.faults import Faults
from trajeval_ros.ground_truth.process import Process
from trajeval_ros.ground_truth.segment import Segment

_RECENT = 16
# So many of the instants at which the process changed are remembered.
_ANEW = 200
# The noise has grown when it is so many times that of the first segments.
_GROWN = 3.0
_OWN = 0.7
# What noise usually is lies from a fifth of the soft limit to it: the middle of their logarithms.
_MIDDLE = 0.45
# Fewer samples do not tell noise from motion.
_ENOUGH = 24
_SECOND = 1_000_000_000
# ... without a break for so many seconds.
_NOISY = 10


@dataclass(frozen=True, slots=True)
class Fit:
    """``mean_squares`` of the standardised innovations of translation and rotation, recently.

    They are one when the process fits, and above where it promises too much. ``noise_std``: what
    the samples' noise is now, its correlated part included, m and rad; ``segments`` closed, and
    ``adapted``, the number of those whose samples refuted the process that they began with;
    ``stamp_std``: how uncertain the samples' stamps are, s; ``anew``: stamps (ns) of the last
    samples that refuted the process, so that another one was chosen.
    """

    mean_squares: tuple[float, float]
    noise_std: tuple[float, float]
    segments: int
    adapted: int
    stamp_std: float
    anew: tuple[int, ...] = ()

    @property
    def named(self) -> dict[str, float]:
        """The numbers but for those of the segments, by name; m and rad."""
        return {
            "translation_mean_square": self.mean_squares[0],
            "rotation_mean_square": self.mean_squares[1],
            "translation_noise_std": self.noise_std[0],
            "rotation_noise_std": self.noise_std[1],
            "stamp_std": self.stamp_std,
        }


class Fits:
    """Looks at each closed segment."""

    def __init__(self, faults: Faults) -> None:
        """``faults``: where noise that grows is noted."""
        self._faults = faults
        self._recent: deque[tuple[float, float]] = deque(maxlen=_RECENT)
        self._noise = (0.0, 0.0)
        self._first: tuple[float, float] | None = None
        self._noisy_since: int | None = None
        self._noted = 0
        self._segments = 0
        self._adapted = 0
        self._anew: deque[int] = deque(maxlen=_ANEW)
        self._stamp_std = 0.0
        self._fit: Fit | None = None

    @property
    def fit(self) -> Fit | None:
        """As it is now; None before the first segment."""
        if self._fit is None and self._recent:
            translation, rotation = (_median(each) for each in zip(*self._recent, strict=True))
            self._fit = Fit(
                (translation, rotation),
                self._noise,
                self._segments,
                self._adapted,
                self._stamp_std,
                tuple(self._anew),
            )
        return self._fit

    def add(self, segment: Segment) -> None:
        """Take a closed segment whose process is known."""
        if len(segment) < 3:
            return
        epoch = segment.epochs[-1]
        self._recent.append(_mean_squares(epoch))
        self._segments += 1
        self._adapted += len(segment.epochs) > 1
        for changed in segment.epochs[1:]:
            stamp = int(segment.samples.stamps[changed.first - 1])
            # A segment that overlaps has seen the same.
            if not self._anew or stamp - self._anew[-1] > _SECOND:
                self._anew.append(stamp)
        self._noise = _noise(epoch.process)
        self._stamp_std = math.hypot(epoch.process.stamp_std, epoch.process.stamp_shared)
        self._fit = None
        white = _white(epoch)
        if self._first is None:
            # Less than what is usual is not known well enough to grow.
            translation, rotation = map(max, white, _usual(epoch.process))
            self._first = translation, rotation
        # Where samples are rare, much of the noise stands for motion between them.
        if len(segment) >= _ENOUGH and any(
            now > _GROWN * first and now > _OWN * noise
            for now, first, noise in zip(white, self._first, self._noise, strict=True)
        ):
            self._note_noise(segment.start, int(segment.samples.stamps[-1]))
        else:
            self._noisy_since = None

    def _note_noise(self, begin: int, end: int) -> None:
        """The noise has grown in a segment: note the seconds, those before as it goes on."""
        if self._noisy_since is None:
            self._noisy_since, self._noted = begin, 0
        seconds = (end - self._noisy_since) // _SECOND
        if seconds >= _NOISY:
            self._faults.add("noise_grows", self._noisy_since, end, seconds - self._noted)
            self._noted = seconds


def _mean_squares(epoch: Epoch) -> tuple[float, float]:
    """Of the standardised innovations of translation and rotation, since its regimes hold."""
    squares = epoch.regression.innovations(1)[..., 0]
    half, last = len(squares) // 2, squares.shape[1] - 1
    translation, rotation = (min(since - 1, last) for since in epoch.since)
    return (
        float(squares[:half, translation:].sum()) / (3.0 * (last + 1 - translation)),
        float(squares[half:, rotation:].sum()) / (3.0 * (last + 1 - rotation)),
    )


def _median(values: Sequence[float]) -> float:
    """NumPy's takes twenty times as long for so few."""
    ordered = sorted(values)
    return 0.5 * (ordered[(len(values) - 1) // 2] + ordered[len(values) // 2])


def _white(epoch: Epoch) -> tuple[float, float]:
    """The noise that is not tied to the motion, with the instrument's, of translation and rotation.

    Below the instrument's accuracy no growth of it matters.
    """
    if epoch.process.learned is None:
        return _noise(epoch.process)
    translation, rotation = (
        math.hypot(2.0**regime.noise * math.exp(learned.theta[-1]), learned.accuracy)
        for learned, regime in zip(epoch.process.learned, epoch.regimes, strict=True)
    )
    return translation, rotation


def _usual(process: Process) -> tuple[float, float]:
    """The middle of what noise usually is, of translation and rotation; zero where it is given."""
    if process.learned is None:
        return 0.0, 0.0
    translation, rotation = (_MIDDLE * learned.grid.soft_limit for learned in process.learned)
    return translation, rotation


def _noise(process: Process) -> tuple[float, float]:
    """The standard deviation of a sample's noise, with the part that is correlated in time."""
    translation, rotation = (
        math.hypot(group.noise_std, group.components[3].std if len(group.components) > 3 else 0.0)
        for group in process.groups
    )
    return translation, rotation
