# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ground truth and an estimate that were given in each other's place.

Errors are symmetrical: no figure tells them apart. What does is what they are called, and how an
estimator begins. Which of the two is noisier tells nothing: GNSS is noisier than odometry.
"""

from __future__ import annotations

import re
from pathlib import PurePath
from typing import NamedTuple

import numpy as np

from trajeval_ros.diagnosis.rotations import Array, Stamps
from trajeval_ros.median import median

_WORD = r"(?:gt|ground_?truth|mocap|vicon|optitrack|qualisys|leica|reference)"
_TRUTH = re.compile(rf"^{_WORD}(?![a-z])|(?<![a-z]){_WORD}$")
_TOPIC = ", topic "
# m, and of the quaternion: an estimator's first pose, and one that is not.
_IDENTITY, _ELSEWHERE = 1e-6, 1e-2
# So many times as often the estimate comes, for how it begins to count.
_MORE_OFTEN = 1.5


class Given(NamedTuple):
    """What was given in one place: its source, stamps (n,) ns, its first position and x y z w."""

    source: str
    stamps: Stamps
    position: Array
    quaternion: Array

    @property
    def is_called_ground_truth(self) -> bool:
        """Whether its file, or its topic, is called as a ground truth is."""
        _, topic, name = self.source.rpartition(_TOPIC)
        words = name.strip("/").split("/") if topic else [PurePath(self.source).stem]
        return any(_TRUTH.search(word.lower()) for word in words)

    def is_away(self, limit: float) -> bool:
        """Whether the first pose is further than that from the identity."""
        far = max(float(np.abs(self.position).max()), float(np.abs(self.quaternion[:3]).max()))
        return far > limit

    @property
    def interval(self) -> float:
        """The usual one, ns."""
        return median(np.diff(self.stamps))


def swapped(truth: Given, estimate: Given) -> str | None:
    """Return the question whether they have been, with what speaks for it; None where nothing."""
    if estimate.is_called_ground_truth and not truth.is_called_ground_truth:
        return "the estimate is called as a ground truth is: have the two been swapped?"
    if min(len(truth.stamps), len(estimate.stamps)) < 2:
        return None
    begins = not truth.is_away(_IDENTITY) and estimate.is_away(_ELSEWHERE)
    if begins and truth.interval > _MORE_OFTEN * estimate.interval:
        return (
            "the ground truth begins at the identity, as an estimator does, and comes less often"
            " than the estimate, which begins elsewhere: have the two been swapped?"
        )
    return None
