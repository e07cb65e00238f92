# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the report remembers of the evaluated poses, in bounded memory.

Poses are gathered into buckets of equal count. A bucket is shown by its worst pose, so that a
peak of the error is never lost, and carries the running totals as they stood at its end, so that
sums over any span of buckets are exact. When there are too many buckets, neighbours are merged.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.online.results import Results

Array = npt.NDArray[np.float64]

FIELDS = np.dtype(
    [
        # of the worst pose, the one with the largest absolute translation error
        ("stamp", np.int64),
        ("ground_truth", np.float64, (4, 4)),
        ("estimate", np.float64, (4, 4)),
        ("covariance", np.float64, (6, 6)),
        ("absolute_translation_error", np.float64),
        ("absolute_rotation_error", np.float64),
        # largest of the bucket; NaN where there is none yet
        ("relative_translation_error", np.float64),
        ("relative_rotation_error", np.float64),
        # at the end of the bucket
        ("last_stamp", np.int64),
        ("count", np.int64),
        ("relative_log_likelihood", np.float64),
        ("absolute_log_likelihood", np.float64),
        ("relative_chi2", np.float64),
        ("relative_log_det", np.float64),
    ]
)
_LARGEST = ("relative_translation_error", "relative_rotation_error")
_AT_END = (
    "last_stamp",
    "count",
    "relative_log_likelihood",
    "absolute_log_likelihood",
    "relative_chi2",
    "relative_log_det",
)

Records = npt.NDArray[np.void]


class Track:
    """Evaluated poses of a run, at most ``2 * capacity`` buckets of them."""

    def __init__(self, capacity: int = 2048) -> None:
        self._capacity = capacity
        self._buckets: Records = np.empty(2 * capacity, FIELDS)
        self._used = 0
        self._stride = 1
        self._pending: Records = np.empty(0, FIELDS)
        self._count = 0
        self._chi2 = 0.0
        self._log_det = 0.0

    def add(self, results: Results) -> None:
        """Take in evaluated poses, later than all before them."""
        if len(results.evaluations) == 0:
            return
        waiting = np.concatenate([self._pending, self._records(results)])
        while len(waiting) >= self._stride:
            room = len(self._buckets) - self._used
            full = min(room, len(waiting) // self._stride)
            taken, waiting = np.split(waiting, [full * self._stride])
            self._buckets[self._used : self._used + full] = _merge(taken, self._stride)
            self._used += full
            if self._used == len(self._buckets):
                self._buckets[: self._capacity] = _merge(self._buckets, 2)
                self._used = self._capacity
                self._stride *= 2
        self._pending = waiting

    def _records(self, results: Results) -> Records:
        evaluations, total = results.evaluations, results.absolute_log_likelihood
        records = np.empty(len(evaluations.stamps), FIELDS)
        absolute, relative = evaluations.absolute_error, evaluations.relative_error
        chi2 = self._chi2 + np.cumsum(evaluations.chi2)
        log_det = self._log_det + np.cumsum(evaluations.log_det)
        records["stamp"] = records["last_stamp"] = evaluations.stamps
        records["ground_truth"] = evaluations.ground_truth
        records["estimate"] = evaluations.estimate
        records["covariance"] = evaluations.covariance
        records["absolute_translation_error"] = np.linalg.norm(absolute[:, :3], axis=-1)
        records["absolute_rotation_error"] = np.linalg.norm(absolute[:, 3:], axis=-1)
        records["relative_translation_error"] = np.linalg.norm(relative[:, :3], axis=-1)
        records["relative_rotation_error"] = np.linalg.norm(relative[:, 3:], axis=-1)
        records["count"] = self._count + 1 + np.arange(len(records))
        records["relative_log_likelihood"] = evaluations.relative_log_likelihood
        records["absolute_log_likelihood"] = np.nan if total is None else total
        records["relative_chi2"] = chi2
        records["relative_log_det"] = log_det
        self._count += len(records)
        self._chi2, self._log_det = float(chi2[-1]), float(log_det[-1])
        return records

    def buckets(self) -> Records:
        """All buckets so far, an unfinished last one included."""
        rest = [_merge(self._pending, len(self._pending))] if len(self._pending) else []
        return np.concatenate([self._buckets[: self._used], *rest])


def _merge(records: Records, size: int) -> Records:
    """Merge each ``size`` consecutive records into one."""
    groups = records.reshape(-1, size)
    error = np.nan_to_num(groups["absolute_translation_error"], nan=-1.0)
    merged: Records = groups[np.arange(len(groups)), np.argmax(error, axis=1)].copy()
    for name in _LARGEST:
        merged[name] = np.fmax.reduce(groups[name], axis=1)
    for name in _AT_END:
        merged[name] = groups[:, -1][name]
    return merged
