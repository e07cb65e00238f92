# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where the search for the nuisances begins: what is so large that no linearisation reaches it.

Each is taken only where it explains most of what is unexplained without it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.error_model.nuisances import Ask, Nuisances
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_LONGEST_OFFSET = 3.0
# Angular speeds must correlate this well, and what their correlation lacks of 1 must fall to this
# share; the unexplained rotation and position likewise.
_CORRELATION = 0.7
_LACK = 0.5
# rad, rad/s and m: less motion tells nothing.
_TURNING = 0.03
_MOVING = 0.05
_STEP = 500_000_000


def start(stamps: Stamps, estimate: Array, ask: Ask) -> Nuisances:
    """The nuisances to begin with. stamps: (N,) ns; estimate: (N, 4, 4)."""
    found = Nuisances(_offset(stamps, estimate, ask), 0.0, np.eye(4), 1.0)
    reference = ask(found.stamps(stamps))
    good = reference.valid
    truth, estimate, stamps = reference.poses[good], estimate[good], stamps[good]
    if len(stamps) < 3:
        return Nuisances.none()
    turn = _turn(stamps, truth[:, :3, :3], estimate[:, :3, :3])
    extrinsic = np.eye(4)
    extrinsic[:3, :3] = turn
    scale = _scale(truth[:, :3, 3], estimate[:, :3, 3])
    return found._replace(extrinsic=extrinsic, scale=scale)


def _speeds(stamps: Stamps, rotation: Array) -> tuple[Array, Array]:
    """Angular speeds (rad/s) between every fourth pose, and when (s after the first)."""
    first, second = np.arange(len(stamps) - 3), np.arange(3, len(stamps))
    length = (stamps[second] - stamps[first]) * 1e-9
    near = length < 4.0 * median(length)
    turned = se3.log_so3(np.swapaxes(rotation[first], 1, 2) @ rotation[second])
    middle = (stamps[first] + stamps[second] - 2 * stamps[0]) * 0.5e-9
    speed = np.linalg.norm(turned, axis=1) / np.maximum(length, 1e-9)
    return speed[near], middle[near]


def _offset(stamps: Stamps, estimate: Array, ask: Ask) -> float:
    """The clock offset at which the angular speeds correlate best, 0 where none stands out."""
    reference = ask(stamps)
    good = reference.valid
    if good.sum() < 60:
        return 0.0
    kept = stamps[good]
    other, when = _speeds(kept, estimate[good, :3, :3])
    truth, when_truth = _speeds(kept, reference.poses[good, :3, :3])
    if min(other.std(), truth.std()) < _TURNING:
        return 0.0
    interval = median(np.diff(kept)) * 1e-9
    steps = np.arange(-int(_LONGEST_OFFSET / interval), int(_LONGEST_OFFSET / interval) + 1)
    if not 3 <= len(steps) < 4000 or when[-1] < 4.0 * _LONGEST_OFFSET:
        return 0.0
    correlation = _correlations(when, other, when_truth, truth, interval * steps.astype(np.float64))
    best, none = int(np.argmax(correlation)), len(steps) // 2
    lack = (1.0 - correlation[best]) / max(1.0 - correlation[none], 1e-3)
    if correlation[best] < _CORRELATION or lack > _LACK:
        return 0.0
    return float(steps[best] * interval)


def _correlations(
    when: Array, speed: Array, when_truth: Array, truth: Array, offsets: Array
) -> Array:
    """Of ``speed`` (n,) with ``truth`` (m,), interpolated at each offset; 0 where none varies."""
    correlation = np.zeros(len(offsets))
    if loops.there():
        given = map(loops.doubles, (when, speed, when_truth, truth, offsets))
        counts, work = (len(when), len(truth), len(offsets)), np.empty(len(truth))
        loops.call("correlations", *counts, *given, correlation, work)
        return correlation
    for i, lag in enumerate(offsets):
        inside = (when + lag >= when_truth[0]) & (when + lag <= when_truth[-1])
        there, here = np.interp(when[inside] + lag, when_truth, truth), speed[inside]
        if inside.any() and min(np.ptp(here), np.ptp(there)) > 0.0:
            correlation[i] = np.corrcoef(here, there)[0, 1]
    return correlation


def _turn(stamps: Stamps, truth: Array, estimate: Array) -> Array:
    """B of ``φ_truth = B φ_estimate`` (Wahba's problem), if rotations need it; (3, 3)."""
    later = np.searchsorted(stamps, stamps + _STEP)
    first = np.flatnonzero(later < len(stamps))
    if len(first) < 10:
        return np.eye(3)
    known, other = (
        se3.log_so3(np.swapaxes(r[first], 1, 2) @ r[later[first]]) for r in (truth, estimate)
    )
    if np.sqrt((known**2).sum(axis=1).mean()) < _TURNING:
        return np.eye(3)
    u, singular, vt = np.linalg.svd(known.T @ other)
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    as_is, turned = np.abs(known - other).sum(), np.abs(known - other @ turn.T).sum()
    explained = turned < _LACK * as_is and singular[1] > 0.02 * singular[0]
    return np.asarray(turn) if explained else np.eye(3)


def _scale(truth: Array, estimate: Array) -> float:
    """The scale of a Sim(3) alignment, if positions need it."""
    similar = align_positions(estimate, truth, "sim3")
    rigid = align_positions(estimate, truth, "se3")
    spread = float(np.sqrt(truth.var(axis=0).sum()))
    if spread < _MOVING or not similar.scale > 0.0 or similar.rmse > _LACK * rigid.rmse:
        return 1.0
    return float(similar.scale)
