# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Why poses are not used, and how many of them."""

from __future__ import annotations

from collections import Counter
from enum import StrEnum


class Reason(StrEnum):
    """Why a pose was rejected."""

    NON_FINITE = "non_finite"
    IMPLAUSIBLE_POSITION = "implausible_position"
    ZERO_QUATERNION = "zero_quaternion"
    UNNORMALIZED_QUATERNION = "unnormalized_quaternion"
    INVALID_COVARIANCE = "invalid_covariance"
    NEGATIVE_STAMP = "negative_stamp"
    ZERO_STAMP = "zero_stamp"
    DUPLICATE_STAMP = "duplicate_stamp"
    OUT_OF_ORDER = "out_of_order"
    SUPERSEDED = "superseded"
    STAMP_JUMP = "stamp_jump"
    OUTLIER = "outlier"
    FLIP = "flip"
    FROZEN = "frozen"
    NO_GROUND_TRUTH = "no_ground_truth"
    OUTSIDE_GROUND_TRUTH = "outside_ground_truth"
    SINGULAR_COVARIANCE = "singular_covariance"
    TOO_LATE = "too_late"

    @property
    def explanation(self) -> str:
        """One line for the user."""
        return _EXPLANATIONS[self]


_EXPLANATIONS = {
    Reason.NON_FINITE: "a value is NaN or infinite",
    Reason.IMPLAUSIBLE_POSITION: "a coordinate exceeds 1e9 m",
    Reason.ZERO_QUATERNION: "the quaternion is zero",
    Reason.UNNORMALIZED_QUATERNION: "the quaternion's norm is off 1 by more than 0.01",
    Reason.INVALID_COVARIANCE: "the covariance is not symmetric and positive semi-definite",
    Reason.NEGATIVE_STAMP: "the stamp is before 1970",
    Reason.ZERO_STAMP: "the stamp is zero, so it was not set",
    Reason.DUPLICATE_STAMP: "the stamp repeats the one before",
    Reason.OUT_OF_ORDER: "the stamp is max_wait before one that came, or before what is scored",
    Reason.SUPERSEDED: "a later row of the file has the same stamp, and counts",
    Reason.STAMP_JUMP: "the stamp leaps ahead of those around it",
    Reason.OUTLIER: "it lies far from the samples before and after it",
    Reason.FLIP: "it is turned on the spot, unlike the samples before and after it",
    Reason.FROZEN: "it repeats the sample before while the body moves on",
    Reason.NO_GROUND_TRUTH: "no ground truth within ground_truth.max_gap",
    Reason.OUTSIDE_GROUND_TRUTH: "the ground truth near it lies on one side only",
    Reason.SINGULAR_COVARIANCE: "its covariance and the ground truth's sum up to a singular one",
    Reason.TOO_LATE: "it came when its ground truth had been dropped, after 30 s or more",
}


class Account:
    """What became of the poses of one topic."""

    def __init__(self) -> None:
        """Start at zero."""
        self.received = 0
        self._rejected: Counter[Reason] = Counter()
        self._first: dict[Reason, int] = {}

    def reject(self, reason: Reason, count: int = 1, first: int | None = None) -> None:
        """Count rejected poses.

        ``first``: how many poses of the topic had come before the first of these, where known.
        """
        if count:
            self._rejected[reason] += count
            if first is not None:
                self._first.setdefault(reason, first)

    @property
    def rejected(self) -> dict[str, int]:
        """Rejected poses by reason, in the order of :class:`Reason`."""
        return {str(r): self._rejected[r] for r in Reason if self._rejected[r]}

    @property
    def first_rejected(self) -> dict[str, int]:
        """By reason, the place of the first rejected pose in the order of arrival, from 0."""
        return {str(reason): place for reason, place in self._first.items()}

    def count(self, reason: Reason) -> int:
        """Poses rejected for a reason."""
        return self._rejected[reason]

    @property
    def rejected_total(self) -> int:
        """All rejected poses."""
        return self._rejected.total()
