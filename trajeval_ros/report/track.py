# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the report remembers of the evaluated poses, in bounded memory.

Some of the poses, each with the run's totals as they stood there, so that sums over any span
between two of them are exact. Of each stretch the poses stay with the largest error in translation
and in rotation, so that no peak is lost.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.online.results import Evaluations, Results

Array = npt.NDArray[np.float64]

FIELDS = np.dtype(
    [
        ("stamp", np.int64),
        ("ground_truth", np.float64, (4, 4)),
        ("estimate", np.float64, (4, 4)),
        ("covariance", np.float64, (6, 6)),
        ("absolute_translation_error", np.float64),
        ("absolute_rotation_error", np.float64),
        # of the run by then, this pose included
        ("count", np.int64),
        ("relative_log_likelihood", np.float64),
        ("absolute_log_likelihood", np.float64),
        ("relative_chi2", np.float64),
    ]
)

# So many poses are taken in at once.
_BATCH = 64
# As many of a stretch may be among the two that are kept of it, by what is there of it so far.
_CANDIDATES = 4

Records = npt.NDArray[np.void]


class Track:
    """Evaluated poses of a run, about ``2 * capacity`` of them at most, the first and the last too.

    What is kept does not depend on how the poses are cut into batches.
    """

    def __init__(self, capacity: int = 2048) -> None:
        self._capacity = capacity
        self._kept: Records = np.empty(2 * capacity, FIELDS)
        self._used = 0
        # Of so many poses, two are kept; of those of a stretch that is not whole yet, so many by
        # now, the ones that may be among them.
        self._group = 2
        self._begun = 0
        self._pending: Records = np.empty(0, FIELDS)
        self._waiting: list[tuple[Evaluations, float | None]] = []
        self._waiting_poses = 0
        self._first: Records = np.empty(0, FIELDS)
        self._newest: Records = np.empty(0, FIELDS)
        self._count = 0
        self._chi2 = 0.0

    def add(self, results: Results) -> None:
        """Take in evaluated poses, later than all before them.

        They wait for others: a batch costs hardly more than a pose.
        """
        if len(results.evaluations) == 0:
            return
        self._waiting.append((results.evaluations, results.absolute_log_likelihood))
        self._waiting_poses += len(results.evaluations)
        if self._waiting_poses >= _BATCH:
            self._take_in()

    def _take_in(self) -> None:
        if not self._waiting:
            return
        records = np.concatenate([self._records(*each) for each in self._waiting])
        self._waiting, self._waiting_poses = [], 0
        if not len(self._first):
            self._first = records[:1].copy()
        self._newest = records[-1:].copy()
        while len(records):
            if self._begun or len(records) < self._group:
                records = self._begin(records)
                continue
            full = min((len(self._kept) - self._used) // 2, len(records) // self._group)
            taken, records = np.split(records, [full * self._group])
            self._keep(_largest(taken, self._group))

    def _begin(self, records: Records) -> Records:
        """Go on with a stretch that is not whole yet; return what is after it."""
        mine, after = np.split(records, [self._group - self._begun])
        self._begun += len(mine)
        self._pending = np.concatenate([self._pending, mine])
        if self._begun == self._group:
            self._keep(_largest(self._pending, len(self._pending)))
            self._begun, self._pending = 0, np.empty(0, FIELDS)
        elif len(self._pending) > _CANDIDATES:
            self._pending = _candidates(self._pending)
        return after

    def _keep(self, records: Records) -> None:
        """Keep those of whole stretches, for which there is room."""
        self._kept[self._used : self._used + len(records)] = records
        self._used += len(records)
        if self._used == len(self._kept):
            self._kept[: self._capacity] = _largest(self._kept, 4)
            self._used = self._capacity
            self._group *= 2

    def _records(self, evaluations: Evaluations, total: float | None) -> Records:
        records = np.empty(len(evaluations.stamps), FIELDS)
        absolute = evaluations.absolute_error
        chi2 = self._chi2 + np.cumsum(evaluations.chi2)
        records["stamp"] = evaluations.stamps
        records["ground_truth"] = evaluations.ground_truth
        records["estimate"] = evaluations.estimate
        records["covariance"] = evaluations.covariance
        records["absolute_translation_error"] = np.linalg.norm(absolute[:, :3], axis=-1)
        records["absolute_rotation_error"] = np.linalg.norm(absolute[:, 3:], axis=-1)
        records["count"] = self._count + 1 + np.arange(len(records))
        records["relative_log_likelihood"] = evaluations.relative_log_likelihood
        records["absolute_log_likelihood"] = np.nan if total is None else total
        records["relative_chi2"] = chi2
        self._count += len(records)
        self._chi2 = float(chi2[-1])
        return records

    def poses(self) -> Records:
        """Those that are kept so far, in the order of time."""
        self._take_in()
        rest = self._pending
        if len(rest) > 2:
            rest = _largest(rest, len(rest))
        found = np.concatenate([self._first, self._kept[: self._used], rest, self._newest])
        # The first and the newest may be among the others.
        return found[np.unique(found["stamp"], return_index=True)[1]]


def _largest(records: Records, size: int) -> Records:
    """Of each ``size`` consecutive records the two with the largest errors, in their order.

    In translation and in rotation; where that is one, also the one with the smallest translation
    error, or where all are alike the next.
    """
    groups = records.reshape(-1, size)
    rows = np.arange(len(groups))
    translation, rotation = _sizes(groups)
    first, second = np.argmax(translation, axis=1), np.argmax(rotation, axis=1)
    others = translation.copy()
    others[rows, first] = np.inf
    second = np.where(second == first, np.argmin(others, axis=1), second)
    chosen = np.sort(np.stack([first, second], axis=1), axis=1)
    return np.asarray(groups[rows[:, None], chosen].reshape(-1))


def _candidates(records: Records) -> Records:
    """Those that `_largest` may take, whatever comes after them; in their order."""
    translation, rotation = _sizes(records)
    smallest = np.argsort(translation, kind="stable")[:2]
    chosen = {int(np.argmax(translation)), int(np.argmax(rotation)), *smallest.tolist()}
    return records[sorted(chosen)]


def _sizes(records: Records) -> tuple[Array, Array]:
    """The errors in translation and in rotation; below all others where there is none."""
    translation, rotation = (
        np.nan_to_num(records[f"absolute_{part}_error"], nan=-1.0)
        for part in ("translation", "rotation")
    )
    return translation, rotation
