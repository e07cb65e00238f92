# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the engine hands out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.ground_truth.faults import Fault
from trajeval_ros.ground_truth.fit import Fit
from trajeval_ros.ground_truth.hyperparameters import Hyperparameters

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Level = Literal["info", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Evaluations:
    """Poses evaluated by one call, in the order of their stamps.

    ``stamps`` (M,) ns, the estimate's own; ``ground_truth`` (M, 4, 4) T_world_body with
    ``covariance`` (M, 6, 6) of its right perturbation, body frame; ``estimate`` (M, 4, 4) in its
    own world, of the ground truth's body (the extrinsic is applied); ``relative_error`` (M, 6) of
    the step that ends at each pose, m and rad, body frame, a row of NaN for the first pose of a
    run, which ends none; ``absolute_error`` (M, 6) under ``Results.alignment``; ``chi2``,
    ``log_det`` and ``log_likelihood`` (M,) of that step given the past, 0 for the first pose;
    ``relative_log_likelihood`` (M,) summed up to each pose, nats;
    ``sampled`` (M,) where the ground truth was sampled as usual, not in a gap: what the
    conventional figures, which know no uncertainty, are of; ``twist`` (M, 6) of the ground truth
    there, m/s and rad/s, body frame; ``nearest`` (M,) ns, the stamp of the sample of the ground
    truth nearest to each, on its own clock.
    """

    stamps: Stamps
    ground_truth: Array
    covariance: Array
    estimate: Array
    relative_error: Array
    absolute_error: Array
    chi2: Array
    log_det: Array
    log_likelihood: Array
    relative_log_likelihood: Array
    sampled: Mask
    twist: Array
    nearest: Stamps

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.stamps)


NO_EVALUATIONS = Evaluations(
    np.empty(0, dtype=np.int64),
    np.empty((0, 4, 4)),
    np.empty((0, 6, 6)),
    np.empty((0, 4, 4)),
    np.empty((0, 6)),
    np.empty((0, 6)),
    np.empty(0),
    np.empty(0),
    np.empty(0),
    np.empty(0),
    np.empty(0, dtype=np.bool_),
    np.empty((0, 6)),
    np.empty(0, dtype=np.int64),
)


class Notice(NamedTuple):
    """Something the user should know: ``code`` in snake_case, ``text`` in one line."""

    level: Level
    code: str
    text: str


class Results(NamedTuple):
    """What one call brought about.

    ``notices`` are those that are new; :meth:`~trajeval_ros.online.engine.Engine.notices` has those
    that hold.

    ``absolute_log_likelihood`` (nats) and ``alignment`` (the estimate's world in the ground
    truth's) are those of all poses so far, None before the first. ``cross``, with
    ``likelihood.covariance: joint`` alone: what belongs to ``evaluations.covariance``, as in
    :class:`~trajeval_ros.online.window.EvaluatedPoses`.
    """

    evaluations: Evaluations
    notices: tuple[Notice, ...]
    absolute_log_likelihood: float | None
    alignment: Similarity | None
    cross: tuple[Array, ...] = ()
    position_only: bool = False
    """Whether there are no orientations: what contains one is not a number."""


@dataclass(frozen=True, slots=True)
class TopicHealth:
    """One topic's account; stamps in ns, of the first and the newest pose let in.

    ``first_rejected``: by reason, how many poses had come before the first that was not let in for
    it; not for reasons that the ground truth gives.
    """

    received: int
    used: int
    pending: int
    rejected: dict[str, int]
    first_stamp: int | None
    latest_stamp: int | None
    first_rejected: dict[str, int] = field(default_factory=dict)


class Health(NamedTuple):
    """The engine's state, for diagnostics.

    ``consistency``: ``|first-order AE - RE| / |RE|``, which is round-off when all is well; None
    before it is known. ``faults``: those of the ground truth; ``fit``: how its process fits.
    """

    estimate: TopicHealth
    ground_truth: TopicHealth
    hyperparameters: Hyperparameters | None
    segments: int
    consistency: float | None
    faults: tuple[Fault, ...] = ()
    fit: Fit | None = None
    truth_turns: bool = True
    """Whether the ground truth has orientations."""
