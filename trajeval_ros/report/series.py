# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the figures draw, computed from a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.report.coverage import SECOND, Coverage, Gap
from trajeval_ros.report.run import Run

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# Ten times the usual variance is no longer usual.
_USUAL = 10.0**0.5


@dataclass(frozen=True)
class Series:
    """Arrays over B poses in time order.

    Seconds count from ``start`` on the ground truth's clock.
    ``seconds`` (B,) of each pose with ``ground_truth`` (B, 3) and ``estimate`` (B, 3), positions in
    the ground truth's world, the latter under ``alignment``, ``translation_error``,
    ``rotation_error`` (B,) in m and rad: the alignment is ATE's (``is_ate``), or, where the motion
    does not show that, the likelihood's; ``translation_axes``, ``rotation_axes`` (B, 3) the
    same along and about the world's axes; ``raw_rotation_error`` (B,) rad, without an alignment;
    ``translation_band``, ``rotation_band`` (B,) two standard deviations of the ground truth along
    its least certain axis, ``position_covariance`` (B, 3, 3) in the world's axes;
    ``has_rotation``: whether the orientations mean something.

    ``*_log_likelihood`` (B,) the running totals, nats; ``window_*`` over the window that ends
    there, in which χ² has ``window_dof`` degrees of freedom.
    """

    start: int
    end: float
    seconds: Array
    ground_truth: Array
    estimate: Array
    alignment: Similarity
    is_ate: bool
    has_rotation: bool
    translation_error: Array
    rotation_error: Array
    translation_axes: Array
    rotation_axes: Array
    raw_rotation_error: Array
    translation_band: Array
    rotation_band: Array
    position_covariance: Array
    relative_log_likelihood: Array
    absolute_log_likelihood: Array
    window_relative: Array
    window_absolute: Array
    window_chi2: Array
    window_dof: Array

    @property
    def shows_errors(self) -> bool:
        """Whether the errors say anything: one pose is aligned to no error, whatever it is."""
        return self.is_ate or len(self.seconds) > 1

    @property
    def worst(self) -> int:
        """Index of the pose that is furthest off beyond what the ground truth is known to.

        Where the ground truth is a guess itself, in a gap, a large difference says little.
        """
        return int(np.argmax(self.translation_error - self.translation_band))

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """Where the ground truth is known about as well as usual: not in its gaps, (B,)."""
        return np.asarray(self.translation_band <= _USUAL * np.median(self.translation_band))

    @property
    def breaks(self) -> npt.NDArray[np.intp]:
        """Indices before which a line is to be broken: nothing was scored for long."""
        steps = np.diff(self.seconds)
        if len(steps) == 0:
            return np.empty(0, np.intp)
        long = max(10.0 * float(np.median(steps)), 0.5)
        return np.flatnonzero(steps > long) + 1


def offset(run: Run) -> int:
    """Nanoseconds from the estimate's clock to the ground truth's."""
    return round(float(run.parameters["estimate.time_offset"]) * SECOND)


def span(run: Run) -> tuple[int, int]:
    """First and last moment of the run on the ground truth's clock, nanoseconds."""
    moments = [
        *(m for m in (run.ground_truth.earliest, run.ground_truth.latest) if m is not None),
        *(m + offset(run) for m in (run.estimate.earliest, run.estimate.latest) if m is not None),
    ]
    if len(run.poses):
        moments += [int(run.poses["stamp"][place]) + offset(run) for place in (0, -1)]
    return (min(moments), max(moments)) if moments else (0, 0)


def make_series(run: Run) -> Series:
    """Compute the series of a run with at least one evaluated pose."""
    poses = run.poses
    start, end = span(run)
    similarity, is_ate = _alignment(run)
    estimate = similarity.apply(poses["estimate"])
    back = poses["ground_truth"][:, :3, :3].swapaxes(-1, -2)
    error = se3.log_so3(back @ estimate[:, :3, :3])
    raw = se3.log_so3(back @ poses["estimate"][:, :3, :3])
    difference = estimate[:, :3, 3] - poses["ground_truth"][:, :3, 3]
    covariance = poses["covariance"]
    rotation = poses["ground_truth"][:, :3, :3]
    clock = offset(run)
    window = float(run.parameters["window.duration"])
    before = np.searchsorted(poses["stamp"], poses["stamp"] - round(window * SECOND))

    def within(name: str) -> Array:
        # NaN, the total before anything was known, counts as nothing.
        total = np.concatenate([[0.0], np.nan_to_num(poses[name].astype(np.float64))])
        return np.asarray(total[1:] - total[before])

    return Series(
        start=start,
        end=(end - start) / SECOND,
        seconds=(poses["stamp"] + clock - start) / SECOND,
        ground_truth=poses["ground_truth"][:, :3, 3],
        estimate=estimate[:, :3, 3],
        alignment=similarity,
        is_ate=is_ate,
        has_rotation=not run.summary.get("position_only"),
        translation_error=np.linalg.norm(difference, axis=-1),
        rotation_error=np.linalg.norm(error, axis=-1),
        translation_axes=difference,
        rotation_axes=np.einsum("bij,bj->bi", rotation, error),
        raw_rotation_error=np.linalg.norm(raw, axis=-1),
        translation_band=2.0 * _widest(covariance[:, :3, :3]),
        rotation_band=2.0 * _widest(covariance[:, 3:, 3:]),
        position_covariance=rotation @ covariance[:, :3, :3] @ rotation.swapaxes(-1, -2),
        relative_log_likelihood=poses["relative_log_likelihood"],
        absolute_log_likelihood=poses["absolute_log_likelihood"],
        window_relative=within("relative_log_likelihood"),
        window_absolute=within("absolute_log_likelihood"),
        window_chi2=within("relative_chi2"),
        window_dof=6.0 * within("count"),
    )


def _alignment(run: Run) -> tuple[Similarity, bool]:
    """The estimate's world in the ground truth's, and whether it is the one that ATE is under."""
    conventional = run.summary["conventional"]
    rotation = run.summary.get("position_only") or conventional.get("ate_rotation_rmse")
    is_ate = None not in (conventional.get("ate_translation_rmse"), rotation)
    found = conventional["alignment"] if is_ate else run.summary["absolute"]["alignment"]
    pose = np.array(found["pose"])
    return Similarity(se3.from_position_quaternion(pose[:3], pose[3:]), found["scale"]), is_ate


def _widest(covariance: Array) -> Array:
    """Standard deviation along the least certain axis, (...,), of covariances (..., 3, 3)."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariance)[..., -1]))


def vertical_axis(positions: Array) -> int:
    """Return the axis to take for the height: z, unless the run extends far less along another."""
    if len(positions) == 0:
        return 2
    extent = np.ptp(positions, axis=0)
    least = int(np.argmin(extent))
    return least if extent[least] < 0.25 * extent[2] else 2


def upwards(axis: int) -> float:
    """Return the sign of what is up along the axis of the height: a camera has its y down."""
    return -1.0 if axis == 1 else 1.0


def coverage_gaps(coverage: Coverage) -> list[Gap]:
    """Return the stretches in which a topic was silent for far longer than between two messages."""
    if coverage.earliest is None or coverage.latest is None or coverage.total < 3:
        return []
    interval = (coverage.latest - coverage.earliest) / SECOND / (coverage.total - 1)
    return coverage.gaps(longer_than=max(8.0 * interval, 0.25))


def rate_of(coverage: Coverage, start: int, end: float, shift: int) -> tuple[Array, Array]:
    """Return edges in seconds from ``start`` and the rate in hertz in bins fit to be drawn."""
    edges, rate = coverage.rate()
    if len(rate) == 0:
        return np.zeros(1), np.zeros(0)
    seconds = (edges + shift - start) / SECOND
    width = float(seconds[1] - seconds[0])
    # No more than there are: a wrong stamp on the other topic may make the run last for centuries.
    merged = min(max(1, round(max(end / 200.0, 1.0) / width)), len(rate))
    padding = -len(rate) % merged
    padded = np.concatenate([rate, np.zeros(padding)]).reshape(-1, merged)
    # The last bin may stick out of the data; its mean is over the part that does not.
    counted = np.full(len(padded), float(merged))
    counted[-1] -= padding
    return seconds[0] + np.arange(len(padded) + 1) * width * merged, padded.sum(axis=1) / counted
