# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of a run, updated with every evaluated pose, in bounded memory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.gauge import SE3, Gauge, Similarity
from trajeval_ros.alignment.observability import Observability
from trajeval_ros.conventional.running import RunningConventional
from trajeval_ros.likelihood.absolute import RunningAbsolute, absolute_residual
from trajeval_ros.likelihood.first_order import FirstOrderAbsolute
from trajeval_ros.likelihood.gaussian import GaussianLogLikelihood
from trajeval_ros.likelihood.joint import FactorRows, JointFactor
from trajeval_ros.likelihood.relative import RunningRelative
from trajeval_ros.likelihood.running_positions import PositionError, RunningPositions
from trajeval_ros.online.instants import Instants
from trajeval_ros.online.positions import evaluations_on_positions, world_covariance
from trajeval_ros.online.residuals import MeanSquares, ResidualMoments
from trajeval_ros.online.results import Evaluations
from trajeval_ros.online.settings import EvaluationSettings
from trajeval_ros.online.window import EvaluatedPoses, SlidingWindow, Window

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

_ENOUGH_TO_STRAIN = 100
# What is told of each pose is worked out at once. The rest waits until so many poses have come, for
# so long (ns), or a figure is asked for: a batch costs hardly more than a pose.
_TOGETHER = 256
_LONGEST_WAIT = 2_000_000_000


class _Scored(NamedTuple):
    """Poses with the relative errors (n, 6) and adjoints (n, 6, 6) of the steps that end at them.

    ``sampled`` as of `Evaluation.add`.
    """

    poses: EvaluatedPoses
    error: Array
    adjoint: Array
    sampled: Mask


class Evaluation:
    """Every running figure, and the window; the owner of their state."""

    def __init__(self, settings: EvaluationSettings) -> None:
        """Start without poses."""
        self.settings = settings
        self.gauge: Gauge = settings.gauge
        self._window = SlidingWindow(settings.window)
        # Factored once for all three.
        self._factor = JointFactor() if settings.joint else None
        self._relative = RunningRelative(0 if self._factor is None else None)
        self._first_order = FirstOrderAbsolute()
        self._absolute = RunningAbsolute(self.gauge)
        self._absolute_total = self._absolute.total
        self._alignment = self._absolute.alignment
        self._conventional = RunningConventional(
            self.gauge.name, settings.relative_delta, settings.relative_unit
        )
        self._instants = Instants(self.gauge.name, settings.relative_delta, settings.relative_unit)
        self._steps = MeanSquares()
        self._residuals = ResidualMoments()
        self._positions: RunningPositions | None = RunningPositions(self.gauge)
        self._newest: tuple[Array, Array] | None = None
        self._waiting: list[_Scored] = []
        self._waiting_poses = 0
        self.count = 0

    @property
    def window_duration(self) -> int:
        """Length of the sliding window, ns."""
        return self._window.duration

    @window_duration.setter
    def window_duration(self, duration: int) -> None:
        self._take_in()
        self._window.duration = duration

    def add_ground_truth(self, stamps: Stamps, poses: Array) -> None:
        """Take samples (N,), ns, increasing, (N, 4, 4), that no pose before needs."""
        self._instants.add_ground_truth(stamps, poses)

    def add(self, poses: EvaluatedPoses, offset: int, sampled: Mask) -> Evaluations:
        """Take the next poses and return their evaluations.

        ``offset`` (ns): that of the estimate's clock from the ground truth's; ``sampled`` (M,)
        where the ground truth was sampled as usual: only there the conventional figures, which know
        no uncertainty, take it for the truth.
        """
        first = self.count == 0
        stamps, ground_truth, estimate = poses.stamps, poses.ground_truth, poses.estimate
        covariance: Array | FactorRows = poses.covariance
        if self._factor is not None:
            assert poses.cross is not None
            covariance = self._factor.update(poses.covariance, poses.cross)
        before = self._relative.total.log_likelihood
        steps = self._relative.update(ground_truth, covariance, estimate)
        self._absolute.update(ground_truth, covariance, estimate)
        # Each costs a solution, and is asked for several times.
        self._absolute_total = self._absolute.total
        self._alignment = self._absolute.alignment
        if self._positions is not None:
            self._positions.update(ground_truth[:, :3, 3], world_covariance(poses), estimate)
        self.count += len(stamps)
        if isinstance(covariance, FactorRows):
            self._take(_Scored(poses, steps.error, steps.adjoint, sampled), covariance)
        else:
            self._wait(_Scored(poses, steps.error, steps.adjoint, sampled))
        log_likelihood = _padded(steps.log_likelihood, first, 0.0)
        alignment = self._alignment
        assert alignment is not None
        return Evaluations(
            stamps - offset,
            ground_truth,
            poses.covariance,
            estimate,
            _padded(steps.error, first, np.nan),
            absolute_residual(ground_truth, alignment.apply(estimate)),
            _padded(steps.chi2, first, 0.0),
            _padded(steps.log_det, first, 0.0),
            log_likelihood,
            before + np.cumsum(log_likelihood),
            sampled,
            np.full((len(stamps), 6), np.nan) if poses.twist is None else poses.twist,
            stamps if poses.nearest is None else poses.nearest,
        )

    def _wait(self, scored: _Scored) -> None:
        """Take these poses in with others, unless they have waited long enough."""
        self._waiting.append(scored)
        self._waiting_poses += len(scored.poses)
        waited = scored.poses.stamps[-1] - self._waiting[0].poses.stamps[0]
        if self._waiting_poses >= _TOGETHER or waited >= _LONGEST_WAIT:
            self._take_in()

    def _take_in(self) -> None:
        """Take in the poses that wait."""
        if self._waiting:
            scored = _joined(self._waiting)
            self._waiting, self._waiting_poses = [], 0
            self._take(scored, scored.poses.covariance)

    def _take(self, scored: _Scored, covariance: Array | FactorRows) -> None:
        poses, error, sampled = scored.poses, scored.error, scored.sampled
        stamps, ground_truth, estimate = poses.stamps, poses.ground_truth, poses.estimate
        first = len(error) < len(poses)
        self._first_order.update(ground_truth, covariance, estimate, error)
        self._conventional.update(stamps[sampled], ground_truth[sampled], estimate[sampled])
        self._instants.add_estimate(stamps, estimate)
        self._window.append(poses, _padded(error, first, 0.0), _padded(scored.adjoint, first, 0.0))
        self._steps.update(error)
        self._residuals.update(ground_truth, estimate)

    def drop_positions(self) -> None:
        """There are orientations: positions alone are not looked at any more."""
        self._positions = None

    @property
    def positions(self) -> PositionError | None:
        """The errors of positions alone; None of fewer than two, and where they are dropped."""
        return None if self._positions is None else self._positions.error()

    @property
    def newest_positions(self) -> PositionError | None:
        """The same for a fraction of the time, for what is told with each pose."""
        return None if self._positions is None else self._positions.newest()

    def on_positions(self, evaluations: Evaluations) -> Evaluations:
        """Evaluations, the newest ones, without what contains an orientation."""
        before = self._newest
        if len(evaluations):
            self._newest = evaluations.ground_truth[-1, :3, 3], evaluations.estimate[-1]
        return evaluations_on_positions(evaluations, before, self.newest_positions)

    @property
    def relative(self) -> GaussianLogLikelihood:
        """The generalized relative error of the run."""
        return self._relative.total

    @property
    def first_order(self) -> GaussianLogLikelihood:
        """The paper's first-order absolute error of the run, under the ``se3`` gauge."""
        self._take_in()
        return self._first_order.total

    @property
    def absolute(self) -> GaussianLogLikelihood | None:
        """The running absolute error of the run; None where the gauge is not determined."""
        return self._absolute_total

    @property
    def absolute_log_likelihood(self) -> float | None:
        """The running absolute log-likelihood, nats; None where there is none (yet)."""
        total = self._absolute_total
        return total.log_likelihood if self.count and total is not None else None

    @property
    def alignment(self) -> Similarity | None:
        """The running alignment; None before the first pose."""
        return self._alignment

    @property
    def observability(self) -> Observability:
        """What of the gauge the run determines."""
        return self._absolute.observability

    @property
    def alignment_covariance(self) -> Array | None:
        """Covariance of the running alignment, (7, 7)."""
        return self._absolute.covariance

    @property
    def conventional(self) -> RunningConventional:
        """The conventional figures of the run, at the ground truth's instants if it is sparse."""
        self._take_in()
        return self._instants.figures or self._conventional

    @property
    def is_at_ground_truth(self) -> bool:
        """Whether those are at the ground truth's instants."""
        self._take_in()
        return self._instants.are_told

    @property
    def step_mean_squares(self) -> MeanSquares:
        """Mean squares of the relative errors."""
        self._take_in()
        return self._steps

    @property
    def residuals(self) -> ResidualMoments:
        """Moments that give the absolute errors' mean squares under any alignment."""
        self._take_in()
        return self._residuals

    @property
    def consistency(self) -> float | None:
        """``|first-order AE - RE| / |RE|``; None with fewer than two poses."""
        if self.count < 2:
            return None
        relative = self._relative.total.log_likelihood
        difference = abs(self.first_order.log_likelihood - relative)
        return difference / max(abs(relative), 1.0)

    @property
    def strain(self) -> float | None:
        """``|running AE - first-order AE| / |first-order AE|``, how far first order holds.

        None under another gauge than ``se3``, and with too few poses to say.
        """
        running = self._absolute_total
        if running is None or self.gauge is not SE3 or self.count < _ENOUGH_TO_STRAIN:
            return None
        first_order = self.first_order.log_likelihood
        return abs(running.log_likelihood - first_order) / max(abs(first_order), 1.0)

    def window(self) -> Window:
        """The poses of the sliding window, and their steps."""
        self._take_in()
        return self._window.contents()


def _joined(parts: list[_Scored]) -> _Scored:
    """One after the other; none of them of a joint covariance."""
    if len(parts) == 1:
        return parts[0]
    all_poses, *further = zip(*parts, strict=True)
    stamps, ground_truth, covariance, estimate = (
        np.concatenate([getattr(poses, name) for poses in all_poses])
        for name in ("stamps", "ground_truth", "covariance", "estimate")
    )
    poses = EvaluatedPoses(stamps, ground_truth, covariance, estimate)
    return _Scored(poses, *map(np.concatenate, further))


def _padded(values: Array, first: bool, filling: float) -> Array:
    """Put a row of ``filling`` in front where the first pose ends no step."""
    if not first:
        return values
    return np.concatenate([np.full((1, *values.shape[1:]), filling), values])
