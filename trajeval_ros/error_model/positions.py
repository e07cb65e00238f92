# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model of an estimate against positions without orientations.

The residuals of `trajeval_ros.likelihood.positions` at the clock offset τ, ::

    r_i = p(t_i + τ) - (s R p_est_i + t) - R R_est_i l  ~  ground truth + jitter + x_i,

x a random walk (drift) or an Ornstein-Uhlenbeck process (wander), each the same along every axis.
With φ_i = exp(-dt_i / T), 1 for the walk, the quasi-differences ``r_i - φ_i r_{i-1}`` have a
banded covariance, and a unit determinant: what is left of r_0 is the world's translation, which is
integrated out, as are its rotation, the scale, l and τ (restricted maximum likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.alignment.gauge import Gauge
from trajeval_ros.error_model.nuisances import Ask
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.whiteness import autocorrelation
from trajeval_ros.likelihood.gaussian import CovarianceError, GaussianLogLikelihood
from trajeval_ros.likelihood.information import Information
from trajeval_ros.likelihood.positions import (
    LEVER_ARM_STD,
    PositionProblem,
    PositionState,
    searched,
    whitened,
)

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# Of fewer poses nothing is fitted: a model would be of their chance.
_FEWEST = 30
_MOST_OF_THEM = 0.5
_CLOCK_STD = 10.0
"""Of τ's prior, s."""
_ROUNDS = 6
_SETTLED = 0.01
"""Of a standard deviation."""
# m, m/√s: what is smaller is nothing; and larger than any error.
_SMALLEST, _LARGEST = 1e-6, 1e4
_LAGS = 10
# Both processes hold for any instants: of a long run so many poses, evenly, tell as much.
_MOST = 4000
# Nats that a wander's further parameter gains beyond chance (95 %).
_BEYOND_CHANCE = 1.92
# Of a logarithm, for second differences: the log-likelihood is good to 1e-9 of some thousand nats.
_STEP = 0.03
# What the data do not tell has no standard deviation: e-fold.
_TOLD = 1.0
# Columns that the loop in C takes.
_WIDEST = 32


@dataclass(frozen=True, slots=True)
class PositionErrorModel:
    """What is fitted.

    kind: the likelier of drift and wander. parameters: with it, ``jitter_std`` (m) and
    ``drift_std`` (m/√s), or ``wander_std`` (m) and ``wander_time`` (s), each a value and its
    standard deviation (None where the data do not tell). clock_offset: τ, s, to be added to the
    estimate's stamps. lever_arm: (3,), m. covariance: of l and τ, (4, 4), larger where innovations
    go together. likelihood: restricted, of ``poses`` poses. whiteness: the innovations'
    autocorrelations, from lag 1 on.
    """

    kind: Kind
    parameters: dict[str, tuple[float, float | None]]
    clock_offset: float
    lever_arm: Array
    covariance: Array
    likelihood: GaussianLogLikelihood
    poses: int
    whiteness: Array


@dataclass(frozen=True, slots=True)
class _Data:
    """Residuals about a state, and the prior of the unknowns.

    columns: (M, 3, n + 1): the derivatives by the gauge, by l and by τ, and the residual.
    The first three columns are the world's translation. gaps: (M - 1,), s.
    prior: whitened rows, (4, n + 1), of log-determinant ``prior_log_det``.
    """

    columns: Array
    covariance: Array
    gaps: Array
    prior: Array
    prior_log_det: float

    def whitened(self, kind: Kind, logs: Array) -> tuple[Array, float]:
        """Quasi-differences of the columns with unit covariance, and its log-determinant.

        Those of a walk are differences, M - 1 of them, which contain no translation.
        """
        jitter, size = np.exp(2.0 * logs[:2])
        unknowns = self.columns.shape[2] - (3 if kind is Kind.DRIFT else 0)
        if loops.there() and unknowns <= _WIDEST:
            time = 0.0 if kind is Kind.DRIFT else float(np.exp(logs[2]))
            return self._filtered(float(jitter), float(size), time, unknowns)
        noise = self.covariance + jitter * np.eye(3)
        walks = kind is Kind.DRIFT
        keep = np.ones_like(self.gaps) if walks else np.exp(-self.gaps * np.exp(-logs[2]))
        added = size * (self.gaps if walks else 1.0 - keep**2)
        keep, added = keep[:, None, None], added[:, None, None]
        columns = self.columns[1:] - keep * self.columns[:-1]
        here = noise[1:] + keep**2 * noise[:-1] + added * np.eye(3)
        # Of a pose's residual with that of the pose before it.
        before = -keep * noise[:-1]
        if walks:
            columns, before = columns[..., 3:], before[1:]
        else:
            columns = np.concatenate([self.columns[:1], columns])
            here = np.concatenate([noise[:1] + size * np.eye(3), here])
        return whitened(here, before, columns)

    def _filtered(
        self, jitter: float, size: float, time: float, unknowns: int
    ) -> tuple[Array, float]:
        """The same by a Kalman filter; time: 0 of a walk."""
        count = len(self.columns)
        white = np.empty((3 * (count if time > 0.0 else count - 1), unknowns))
        log_det = np.empty(1)
        arrays = self.columns, self.covariance, self.gaps
        width = self.columns.shape[2]
        wrong = loops.call(
            "band_positions", *arrays, white, log_det, count, width, unknowns, jitter, size, time
        )
        if wrong:
            raise CovarianceError(wrong - 1)
        return white, float(log_det[0])

    def information(self, kind: Kind, logs: Array) -> Information:
        """What they say of the unknowns; of a walk, of all but the translation."""
        white, log_det = self.whitened(kind, logs)
        prior = self.prior[:, -white.shape[1] :]
        found = Information.none(white.shape[1] - 1).absorb(prior, self.prior_log_det)
        return found.absorb(white, log_det)

    def likelihood(self, kind: Kind, logs: Array) -> float:
        """Of the residuals, the unknowns integrated out, nats."""
        return self.information(kind, logs).integral().log_likelihood


def fit_positions(
    stamps: Stamps, estimate: Array, truth: Ask, gauge: Gauge
) -> PositionErrorModel | None:
    """Fit the model; None where there are too few poses, or the motion does not tell it.

    stamps: (M,), ns, on the ground truth's clock. estimate: (M, 4, 4). truth: answers positions
    with covariances and velocities; orientations are arbitrary. gauge: with a translation.
    """
    if len(stamps) > _MOST:
        some = np.linspace(0, len(stamps) - 1, _MOST).astype(int)
        stamps, estimate = stamps[some], estimate[some]
    clock = 0.0
    state: PositionState | None = None
    fitted: dict[Kind, tuple[float, Array]] = {}
    try:
        for _ in range(_ROUNDS):
            data, problem, state = _data(stamps, estimate, truth, gauge, clock, state)
            fitted = _fitted(data, fitted)
            kind, logs = _likelier(fitted)
            information = data.information(kind, logs)
            delta, covariance = information.optimum(), information.covariance()
            step = np.zeros(gauge.dimension + 3)
            step[-len(delta) + 1 :] = delta[:-1]
            if (np.abs(delta) <= _SETTLED * np.sqrt(np.diagonal(covariance))).all():
                break
            state, clock = problem.moved(state, step), clock + float(delta[-1])
    except (np.linalg.LinAlgError, CovarianceError, _TooFewError):
        return None
    assert state is not None
    white, _ = data.whitened(kind, logs)
    innovations = (white[:, :-1] @ delta + white[:, -1]).reshape(-1, 3)
    whiteness = autocorrelation(innovations, _LAGS)
    return PositionErrorModel(
        kind,
        _parameters(data, kind, logs),
        clock,
        state.lever_arm,
        covariance[-4:, -4:] * _long_run(whiteness),
        information.integral(),
        len(data.columns),
        whiteness,
    )


class _TooFewError(ValueError):
    """Too few poses have a ground truth."""


def _data(
    stamps: Stamps,
    estimate: Array,
    truth: Ask,
    gauge: Gauge,
    clock: float,
    state: PositionState | None,
) -> tuple[_Data, PositionProblem, PositionState]:
    """The residuals at a clock offset about a state, None being the likeliest."""
    answer = truth(stamps + round(1e9 * clock))
    known = answer.valid
    if known.sum() < max(_FEWEST, _MOST_OF_THEM * len(known)):
        raise _TooFewError
    turn = answer.poses[known, :3, :3]
    covariance = turn @ answer.covariances[known, :3, :3] @ np.swapaxes(turn, 1, 2)
    velocity = turn @ answer.twists[known, :3, None]
    problem = PositionProblem.of(answer.poses[known, :3, 3], covariance, estimate[known], gauge)
    if state is None:
        state = searched(problem)
    columns = problem.columns(state)
    columns = np.concatenate([columns[..., :-1], velocity, columns[..., -1:]], axis=-1)
    prior = np.zeros((4, columns.shape[-1]))
    std = np.array([*[LEVER_ARM_STD] * 3, _CLOCK_STD])
    prior[:, -5:-1] = np.diag(1.0 / std)
    prior[:, -1] = np.array([*state.lever_arm, clock]) / std
    data = _Data(
        np.ascontiguousarray(columns),
        np.ascontiguousarray(covariance),
        1e-9 * np.diff(stamps[known]),
        prior,
        2.0 * float(np.log(std).sum()),
    )
    return data, problem, state


def _fitted(
    data: _Data, before: dict[Kind, tuple[float, Array]]
) -> dict[Kind, tuple[float, Array]]:
    """Of each process the log-likelihood and its parameters' logarithms, from those ``before``."""
    # Only here: its import takes a tenth of a second, which every run would pay.
    from scipy.optimize import minimize

    gap, span = float(np.median(data.gaps)), float(data.gaps.sum())
    size = np.log([_SMALLEST, _LARGEST])
    # A wander that is slower is a walk, and one that is faster is jitter.
    time = np.log([gap, max(span, 2.0 * gap)])
    found = {}
    for kind in (Kind.DRIFT, Kind.WANDER):
        bounds = np.array([size, size, time][: len(kind.names)])
        starts = [before[kind][1]] if kind in before else _starts(data, kind)
        climbed = [
            minimize(
                lambda logs, kind=kind: -data.likelihood(kind, logs),
                np.clip(start, *bounds.T),
                method="L-BFGS-B",
                bounds=bounds,
            )
            for start in starts
        ]
        best = min(climbed, key=lambda one: float(one.fun))
        found[kind] = -float(best.fun), np.asarray(best.x)
    return found


def _starts(data: _Data, kind: Kind) -> list[Array]:
    """Where most of what there is from pose to pose is jitter, and where little of it is."""
    residual = data.columns[..., -1]
    step, size = (
        max(float(np.sqrt((each**2).mean())), _SMALLEST)
        for each in (np.diff(residual, axis=0), residual)
    )
    gap, span = float(np.median(data.gaps)), float(data.gaps.sum())
    if kind is Kind.WANDER:
        return [np.log([share * step, size, 0.03 * span]) for share in (1.0, 0.1)]
    walk = step / np.sqrt(gap)
    return [np.log([step, 0.3 * walk]), np.log([0.1 * step, walk])]


def _likelier(fitted: dict[Kind, tuple[float, Array]]) -> tuple[Kind, Array]:
    walk, wander = fitted[Kind.DRIFT], fitted[Kind.WANDER]
    if wander[0] > walk[0] + _BEYOND_CHANCE:
        return Kind.WANDER, wander[1]
    return Kind.DRIFT, walk[1]


def _parameters(data: _Data, kind: Kind, logs: Array) -> dict[str, tuple[float, float | None]]:
    """Each with its standard deviation, from the curvature of the log-likelihood."""
    size = len(logs)
    steps = _STEP * np.eye(size)
    hessian = np.zeros((size, size))
    for i in range(size):
        for j in range(i, size):
            corners = [
                sign * other * data.likelihood(kind, logs + sign * steps[i] + other * steps[j])
                for sign in (1.0, -1.0)
                for other in (1.0, -1.0)
            ]
            hessian[i, j] = hessian[j, i] = -sum(corners) / (4.0 * _STEP**2)
    # A parameter that is as good as nothing must not take the others' with it.
    told = np.diagonal(hessian) > 1.0 / _TOLD**2
    relative = np.full(size, np.inf)
    if told.any():
        variance = np.diagonal(np.linalg.pinv(hessian[np.ix_(told, told)]))
        relative[told] = np.sqrt(np.where(variance > 0.0, variance, np.inf))
    return {
        name: (float(value), float(value * std) if std < _TOLD else None)
        for name, value, std in zip(kind.names, np.exp(logs), relative, strict=True)
    }


def _long_run(whiteness: Array) -> float:
    """By how much a mean of the innovations varies more than one of white ones; 1 at least.

    Up to the first lag that is negative: further ones are chance.
    """
    negative = np.flatnonzero(whiteness <= 0.0)
    until = negative[0] if len(negative) else len(whiteness)
    return 1.0 + 2.0 * float(whiteness[:until].sum())
