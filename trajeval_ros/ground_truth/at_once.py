# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What segments say of a batch of queries, blended, by one loop in C.

`segment.answers` and `trajectory` do the same in NumPy, a segment after the other; there every step
of a segment costs as much as some samples of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth.hyperparameters import DEGREES_OF_FREEDOM
from trajeval_ros.ground_truth.regression import ROUND_OFF
from trajeval_ros.ground_truth.segment import Twists
from trajeval_ros.ground_truth.segmentation import Blended

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# Of so many numbers the answer to a query needs more than of each sample that it is given.
_MORE = 256
_NO_HANDOVER = (0, 0, 0)


class Answers:
    """To queries (q,), from one segment after the other.

    ``poses`` (q, 4, 4), ``covariances`` (q, 6, 6), ``twists`` if they are asked for, as those of a
    `trajectory.Posterior`; ``shared`` (q,): the standard deviation of the stamps together, s.
    """

    def __init__(self, stamps: Stamps, until: Stamps, order: Stamps, twists: bool) -> None:
        """Ask at ``stamps`` (q,), by the samples ``until`` (q,); ``order`` (q,) sorts them."""
        count = len(stamps)
        self._stamps, self._until, self._order = map(np.ascontiguousarray, (stamps, until, order))
        self._weights = np.zeros(count)
        self.poses = np.empty((count, 4, 4))
        self.covariances = np.empty((count, 6, 6))
        self.shared = np.empty(count)
        asked = count if twists else 0
        found = Twists(np.empty((asked, 6)), np.empty((asked, 6, 6)))
        self._found = found
        self.twists = found if twists else None

    def add(self, asked: Sequence[Blended]) -> None:
        """Take what segments say, each later than all before, and conditioned on its samples."""
        if not asked or not len(self._stamps):
            return
        segments, epochs, bounds = [], [], []
        for each in asked:
            incoming, outgoing = (
                _NO_HANDOVER if handover is None else handover.addresses
                for handover in (each.incoming, each.outgoing)
            )
            own = each.segment.epochs
            segments.append((*each.segment.addresses, len(own), *incoming, *outgoing))
            for epoch in own:
                before = loops.address(epoch.before)
                epochs.append((epoch.first, *epoch.since, before, *epoch.regression.addresses))
                bounds.append((*epoch.process.least_scales, epoch.process.stamp_shared))
        most = max(row[0] for row in segments)
        loops.call(
            "posterior_add",
            np.array(segments),
            len(segments),
            np.array(epochs),
            np.array(bounds),
            self._order,
            self._stamps,
            self._until,
            len(self._stamps),
            1 if self.twists is None else 2,
            DEGREES_OF_FREEDOM,
            ROUND_OFF,
            se3.EXPONENTIAL_TABLE,
            len(se3.EXPONENTIAL_TABLE),
            se3.LOGARITHM_TABLE,
            len(se3.LOGARITHM_TABLE),
            self._weights,
            self.poses,
            self.covariances,
            self._found.means,
            self._found.covariances,
            self.shared,
            most,
            np.empty(4 * (most + _MORE)),
        )

    @property
    def are_whole(self) -> bool:
        """Whether there is one to each query."""
        return bool((np.abs(self._weights - 1.0) <= 1e-6).all())
