# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likelihood of an estimate against positions, pose by pose, in bounded memory.

The residuals of `trajeval_ros.likelihood.positions` are linear in products of the unknowns: with
the features ``f_i = (p_est_i, 1, vec R_est_i)``, (13,), ::

    r_i(g, l) = p_i - Z f_i,        Z(g, l) = [s R | t | R ⊗ l],        (3, 13)

so that sums over the poses, whitened and triangularised, hold all that is to be known of them: the
likelihood at any g and l is exact, however far from where it was summed up, and its optimum is
sought in forty rows. In the differences of a relative error the column of t cancels. They are
whitened pose by pose, by what the poses before say of t: with ``W_k = Σ_{i<k} V_i^-1``, ::

    r_k - W_k^-1 Σ_{i<k} V_i^-1 r_i  ~  N(0, V_k + W_k^-1)

are independent of each other, and theirs is the likelihood of the displacements.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Gauge, Similarity
from trajeval_ros.alignment.umeyama import Moments, align
from trajeval_ros.likelihood.gaussian import GaussianLogLikelihood
from trajeval_ros.likelihood.information import Information
from trajeval_ros.likelihood.positions import (
    PositionState,
    factors,
    moved,
    prior,
    prior_chi2,
    searched,
    started,
)

Array = npt.NDArray[np.float64]

_FEATURES = 13
# Of a pose's features the constant one, whose column of Z is the world's translation.
_CONSTANT = 3
_UNKNOWNS = 3 * _FEATURES
_TURNING = [place for place in range(_UNKNOWNS) if place % _FEATURES != _CONSTANT]
# What is known no better than this, rad or 1, is not determined.
_UNDETERMINED = 0.3
# The motion that shows a rotation is larger than the errors by this factor, per axis.
_SHOWN = 1.5
# A stretch of the run has so many poses at first; at most so many stretches are told apart, and
# then every two are one.
_FEWEST, _STRETCHES = 3, 80
# Steps to the bottom of what the search has found: it ends where chi2 falls no more, which the
# state still may.
_POLISHING = 3
# Where the last search has ended is good to start from until there are so many times as many poses.
_GROWN = 1.05


class PositionError(NamedTuple):
    """The errors of a set of positions, under the alignment and lever arm that are likeliest.

    The covariance is the larger of that of the ground truth's noise alone and that which the
    scatter of the scores over some forty and twenty stretches or more shows (White): an estimate
    has errors of its own. Of fewer than three poses for each unknown there is no such scatter, and
    it is that of the noise times chi2 a degree of freedom. Of an estimate that drifts through the
    whole run it is too small all the same.

    absolute, relative: their likelihoods; None where the motion does not determine the alignment:
    the integral over it would be of what Laplace's approximation does not hold for.
    alignment: g*. lever_arm: l*, (3,), m, in the body's frame. covariance: of the gauge's freedoms,
    about ``centre``, and of l, (d + 3, d + 3).
    shows_lever_arm: whether l is what it seems. The likelihood takes the estimate's own motion to
    be exact; where that is no larger than the errors, it is noise that turns the alignment, and l
    with it.
    rmse, step_rmse: root mean square of the residuals r(g*, l*) and of their differences from pose
    to pose, m.
    """

    absolute: GaussianLogLikelihood | None
    relative: GaussianLogLikelihood | None
    alignment: Similarity
    lever_arm: Array
    centre: Array
    covariance: Array
    shows_lever_arm: bool
    rmse: float
    step_rmse: float
    gauge: Gauge

    @property
    def lever_arm_std(self) -> Array:
        """(3,), m; near 10 where the motion does not show it."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)[-3:]))

    @property
    def consistency(self) -> float | None:
        """``|AE - RE| / |RE|``: round-off, under a gauge with the world's translation."""
        if self.absolute is None or self.relative is None or 0 not in self.gauge.free:
            return None
        relative = self.relative.log_likelihood
        return abs(self.absolute.log_likelihood - relative) / max(abs(relative), 1.0)

    def residual(self, positions: Array, estimate: Array) -> Array:
        """``p - g (p_est + R_est l)`` of poses: (M, 3) and (M, 4, 4) to (M, 3), world axes, m."""
        aligned = self.alignment.apply(estimate)
        arm = (aligned[:, :3, :3] @ self.lever_arm[:, None])[..., 0]
        return np.asarray(positions - aligned[:, :3, 3] - arm)


class _Sums(NamedTuple):
    """What is kept of all poses. Sums of squares are held by their triangular factors.

    absolute: of ``L^-1 [F | p]``, the unknowns being -Z row by row. relative: the same of the
    displacements, without t. residuals, steps: of ``[f | p]`` and its differences, unweighted,
    (13 + 3) squared. moments: of the estimate's positions and the ground truth's.
    weight, mean: ``Σ V_i^-1`` and ``Σ V_i^-1 [F | p]``, (3, 3) and (3, 40). newest: the last [f|p].
    """

    absolute: Information
    relative: Information
    residuals: Array
    steps: Array
    moments: Moments
    weight: Array
    mean: Array
    newest: Array

    @staticmethod
    def empty() -> _Sums:
        size = _FEATURES + 3
        return _Sums(
            Information.none(_UNKNOWNS),
            Information.none(len(_TURNING)),
            np.zeros((size, size)),
            np.zeros((size, size)),
            Moments.empty(),
            np.zeros((3, 3)),
            np.zeros((3, _UNKNOWNS + 1)),
            np.zeros((0, size)),
        )

    def with_poses(self, rows: Array, white: Array, factor: Array) -> _Sums:
        """With poses: [f | p], (n, 16), ``L^-1 [F | p]``, (n, 3, 40), and L, (n, 3, 3)."""
        columns = _columns(rows)
        log_det = 2.0 * float(np.log(np.einsum("mii->mi", factor)).sum())
        absolute = self.absolute.absorb(white.reshape(-1, _UNKNOWNS + 1), log_det)
        # V^-1 = L^-T L^-1, summed up to each pose.
        inverse = np.linalg.inv(factor)
        weights = np.swapaxes(inverse, 1, 2) @ inverse
        means = np.swapaxes(inverse, 1, 2) @ white
        weight = np.cumsum(np.concatenate([self.weight[None], weights]), axis=0)
        mean = np.cumsum(np.concatenate([self.mean[None], means]), axis=0)
        first = 0 if len(self.newest) else 1
        known = np.linalg.inv(weight[first:-1])
        predicted = columns[first:] - known @ mean[first:-1]
        covariance = factor[first:] @ np.swapaxes(factor[first:], 1, 2) + known
        step = np.linalg.cholesky(covariance)
        kept = np.linalg.solve(step, predicted[..., [*_TURNING, _UNKNOWNS]])
        relative = self.relative.absorb(
            kept.reshape(-1, len(_TURNING) + 1),
            2.0 * float(np.log(np.einsum("mii->mi", step)).sum()),
        )
        differences = np.diff(np.concatenate([self.newest, rows]), axis=0)
        return _Sums(
            absolute,
            relative,
            _triangle(np.concatenate([self.residuals, rows])),
            _triangle(np.concatenate([self.steps, differences])),
            self.moments.updated(rows[:, :3], rows[:, _FEATURES:]),
            weight[-1],
            mean[-1],
            rows[-1:],
        )


class _Stretches:
    """Sums of the squares of ``L^-1 [F | p]`` over consecutive stretches of the run."""

    def __init__(self) -> None:
        self.squares = np.zeros((0, _UNKNOWNS + 1, _UNKNOWNS + 1))
        self._size = _FEWEST
        self._in_last = _FEWEST

    def add(self, white: Array) -> None:
        """Take poses, (n, 3, 40), however they are cut."""
        while len(white):
            if self._in_last == self._size:
                self._open()
            taken = white[: self._size - self._in_last]
            flat = taken.reshape(-1, _UNKNOWNS + 1)
            self.squares[-1] += flat.T @ flat
            self._in_last += len(taken)
            white = white[len(taken) :]

    def _open(self) -> None:
        if len(self.squares) == _STRETCHES:
            self.squares = self.squares[::2] + self.squares[1::2]
            self._size *= 2
        self.squares = np.concatenate([self.squares, np.zeros_like(self.squares[:1])])
        if not self.squares.size:
            self.squares = np.zeros((1, _UNKNOWNS + 1, _UNKNOWNS + 1))
        self._in_last = 0

    def levels(self) -> tuple[Array, ...]:
        """The stretches, and every two of them together."""
        odd = np.zeros_like(self.squares[: len(self.squares) % 2])
        even = np.concatenate([self.squares, odd])
        return self.squares, even[::2] + even[1::2]


class RunningPositions:
    """The errors of poses against positions, updated with every pose."""

    def __init__(self, gauge: Gauge) -> None:
        """Start without poses."""
        self._gauge = gauge
        self._origins: tuple[Array, Array] | None = None
        self._sums = _Sums.empty()
        self._stretches = _Stretches()
        self._found: PositionError | None = None
        self._near: tuple[int, PositionState] | None = None
        self.count = 0

    def update(self, positions: Array, covariance: Array, estimate: Array) -> None:
        """Take the next poses.

        positions: (M, 3), m. covariance: (M, 3, 3) of their errors, world axes, independent of each
        other. estimate: (M, 4, 4), in a world of its own, of the body that l is fixed to.

        Raises CovarianceError where a covariance is not positive definite; then nothing is taken.
        """
        if not len(positions):
            return
        factor = factors(covariance)
        if self._origins is None:
            # Coordinates of a country are large, and differences of them small.
            self._origins = positions[0].copy(), estimate[0, :3, 3].copy()
        target, source = positions - self._origins[0], estimate[:, :3, 3] - self._origins[1]
        turns = estimate[:, :3, :3].reshape(-1, 9)
        rows = np.concatenate([source, np.ones((len(source), 1)), turns, target], axis=1)
        white = np.asarray(np.linalg.solve(factor, _columns(rows)), np.float64)
        self._sums = self._sums.with_poses(rows, white, factor)
        self._stretches.add(white)
        self.count += len(positions)
        self._found = None

    def error(self) -> PositionError | None:
        """The errors of all poses so far; None of fewer than two."""
        if self.count < 2 or self._origins is None:
            return None
        if self._found is None:
            problem = _Problem(self._sums, self._gauge, *self._origins)
            state = searched(problem)
            for _ in range(_POLISHING):
                state = _polished(problem, state)
            information = problem.linearized(state)
            covariance = self._covariance(problem, state, information)
            self._found = self._described(problem, state, information, covariance)
            self._near = self.count, state
        return self._found

    def newest(self) -> PositionError | None:
        """As `error`, for a fraction of its time: a step from where the last one was.

        It depends on when it is asked, and its covariance is that of the noise alone.
        """
        if self._near is None or self._origins is None or self.count > _GROWN * self._near[0]:
            return self.error()
        problem = _Problem(self._sums, self._gauge, *self._origins)
        state = _polished(problem, self._near[1])
        information = problem.linearized(state)
        known = np.diagonal(information.root).all()
        size = information.dimension
        covariance = information.covariance() if known else np.full((size, size), np.inf)
        return self._described(problem, state, information, covariance)

    def _described(
        self, problem: _Problem, state: PositionState, information: Information, covariance: Array
    ) -> PositionError:
        of_truth, of_estimate = problem.of_truth, problem.of_estimate
        determined = _is_determined(self._gauge, information)
        rmse, step_rmse = problem.roots(state)
        pose = state.alignment.pose.copy()
        pose[:3, 3] += of_truth - state.alignment.scale * pose[:3, :3] @ of_estimate
        return PositionError(
            information.integral() if determined else None,
            problem.relative(state).integral() if determined else None,
            Similarity(pose, state.alignment.scale),
            state.lever_arm,
            of_truth + self._sums.moments.mean_target,
            covariance,
            determined and _is_shown(self._gauge, self._sums.moments, state, rmse),
            rmse,
            step_rmse,
            self._gauge,
        )

    def _covariance(
        self, problem: _Problem, state: PositionState, information: Information
    ) -> Array:
        dimension = information.dimension
        if not np.diagonal(information.root).all():
            return np.full((dimension, dimension), np.inf)
        plain = information.covariance()
        larger = np.ones(dimension)
        if self.count // _FEWEST <= dimension:
            freedom = max(3 * self.count - dimension, 1)
            larger = np.maximum(larger, problem.squares(state) / freedom)
        slopes, point = problem.slopes(state), problem.point(state)
        for squares in self._stretches.levels():
            stretches = len(squares)
            if stretches <= dimension:
                break
            # What each stretch alone would move the state by.
            moves = (squares @ point)[:, :_UNKNOWNS] @ slopes @ plain
            variance = (moves**2).sum(axis=0) * stretches / (stretches - dimension)
            larger = np.maximum(larger, variance / np.diagonal(plain))
        larger = np.sqrt(larger)
        return np.asarray(plain * np.outer(larger, larger))


def position_error(
    positions: Array, covariance: Array, estimate: Array, gauge: Gauge
) -> PositionError:
    """The errors of poses, all at once; arguments as of `RunningPositions.update`.

    Raises CovarianceError where a covariance is not positive definite, ValueError where there are
    fewer than two poses or one is not finite.
    """
    if len(positions) < 2:
        raise ValueError("there are not two poses")
    if not (np.isfinite(positions).all() and np.isfinite(estimate).all()):
        raise ValueError("a pose is not finite")
    running = RunningPositions(gauge)
    running.update(positions, covariance, estimate)
    found = running.error()
    assert found is not None
    return found


class _Problem(NamedTuple):
    """All poses in a few rows; the state's worlds have their origins at those of the poses."""

    sums: _Sums
    gauge: Gauge
    of_truth: Array
    of_estimate: Array

    @property
    def centre(self) -> Array:
        """Of the gauge's perturbations."""
        return self.sums.moments.mean_target

    def start(self) -> PositionState:
        """Umeyama's alignment of the positions, and no lever arm."""
        found = align(self.sums.moments, self.gauge.name)
        return started(found, self.gauge, self.of_estimate - self.of_truth)

    def point(self, state: PositionState) -> Array:
        """What ``[F | p]`` is multiplied by to give r: -Z row by row, and 1; (40,)."""
        return np.append(-_matrix(state).reshape(-1), 1.0)

    def slopes(self, state: PositionState) -> Array:
        """The derivatives of -Z by the gauge's freedoms and by l, (39, d + 3)."""
        z, rotation = _matrix(state), state.alignment.pose[:3, :3]
        found = np.zeros((3, _FEATURES, 10))
        found[:, _CONSTANT, :3] = np.eye(3)
        for axis in range(3):
            turn = se3.hat(np.eye(3)[axis])
            found[..., 3 + axis] = turn @ z
            found[:, _CONSTANT, 3 + axis] -= turn @ self.centre
            # l_c is multiplied by R's columns b, features 4 + 3 b + c.
            found[:, 4 + axis :: 3, 7 + axis] = rotation
        found[:, : _CONSTANT + 1, 6] = z[:, : _CONSTANT + 1]
        found[:, _CONSTANT, 6] -= self.centre
        return -found.reshape(_UNKNOWNS, 10)[:, [*self.gauge.free, 7, 8, 9]]

    def linearized(self, state: PositionState) -> Information:
        """What the residuals, linear about a state, say of its change."""
        return self._reduced(self.sums.absolute, self.slopes(state), self.point(state), state)

    def relative(self, state: PositionState) -> Information:
        """The same of the displacements, which do not contain the world's translation."""
        turning = [n for n, free in enumerate(self.gauge.free) if free >= 3]
        dimension = self.gauge.dimension
        kept = [*turning, *range(dimension, dimension + 3)]
        slopes = self.slopes(state)[np.ix_(_TURNING, kept)]
        point = self.point(state)[[*_TURNING, _UNKNOWNS]]
        return self._reduced(self.sums.relative, slopes, point, state)

    def _reduced(
        self, sums: Information, slopes: Array, point: Array, state: PositionState
    ) -> Information:
        """Sums over -Z as one over the state's change, with l's prior."""
        rows, prior_log_det = prior(self.gauge, state)
        dimension = slopes.shape[1]
        columns = np.column_stack([sums.root @ slopes, sums.root @ point[:-1] + sums.offset])
        found = Information.none(dimension).absorb(rows[:, -dimension - 1 :], prior_log_det)
        found = found.absorb(columns, sums.log_det)
        return replace(found, chi2=found.chi2 + sums.chi2, count=sums.count + len(rows))

    def squares(self, state: PositionState) -> float:
        """``Σ r^T V^-1 r``."""
        sums = self.sums.absolute
        left = sums.root @ self.point(state)[:-1] + sums.offset
        return float(left @ left) + sums.chi2

    def chi2(self, state: PositionState) -> float:
        """What is minimised."""
        return self.squares(state) + prior_chi2(state)

    def moved(self, state: PositionState, delta: Array) -> PositionState:
        """The state changed by (d + 3,)."""
        return moved(self.gauge, self.centre, state, delta)

    def roots(self, state: PositionState) -> tuple[float, float]:
        """Root mean squares of the residuals and of their differences, m."""
        matrix = np.concatenate([-_matrix(state).T, np.eye(3)])
        count = self.sums.moments.count
        return (
            float(np.linalg.norm(self.sums.residuals @ matrix) / np.sqrt(count)),
            float(np.linalg.norm(self.sums.steps @ matrix) / np.sqrt(count - 1)),
        )


def _matrix(state: PositionState) -> Array:
    """Z, (3, 13)."""
    rotation = state.alignment.pose[:3, :3]
    arm = (rotation[:, :, None] * state.lever_arm).reshape(3, 9)
    return np.concatenate(
        [state.alignment.scale * rotation, state.alignment.pose[:3, 3:], arm], axis=1
    )


def _columns(rows: Array) -> Array:
    """``[F | p]``, (n, 3, 40), of [f | p], (n, 16): f once for each axis."""
    columns = np.zeros((len(rows), 3, _UNKNOWNS + 1))
    for axis in range(3):
        columns[:, axis, axis * _FEATURES : (axis + 1) * _FEATURES] = rows[:, :_FEATURES]
    columns[..., -1] = rows[:, _FEATURES:]
    return columns


def _triangle(rows: Array) -> Array:
    # NumPy's annotation leaves out that mode="r" returns an array alone.
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _polished(problem: _Problem, state: PositionState) -> PositionState:
    """A step further, where it leads no worse."""
    information = problem.linearized(state)
    if not np.diagonal(information.root).all():
        return state
    proposal = problem.moved(state, information.optimum())
    chi2 = problem.chi2(state)
    return proposal if problem.chi2(proposal) <= chi2 * (1.0 + 1e-12) else state


def _is_determined(gauge: Gauge, information: Information) -> bool:
    """Whether rotation and scale of the alignment are known to a third of a radian, or of one."""
    if not np.diagonal(information.root).all():
        return False
    std = np.sqrt(np.diagonal(information.covariance()))
    turns = [place for place, free in enumerate(gauge.free) if free >= 3]
    return bool((std[turns] < _UNDETERMINED).all())


def _is_shown(gauge: Gauge, moments: Moments, state: PositionState, rmse: float) -> bool:
    """Whether the body moves by more than the errors along what shows the free rotations."""
    if not any(free >= 3 for free in gauge.free):
        return True
    # A turn about the vertical shows along one horizontal axis, any turn along two.
    aligned = state.alignment.scale * moments.factor[:, :3] @ state.alignment.pose[:3, :3].T
    body, place = (aligned[:, :2], 0) if gauge.name == "yaw_translation" else (aligned, 1)
    extent = np.linalg.svd(body, compute_uv=False)[place]
    return bool(extent >= _SHOWN * rmse * np.sqrt(moments.count / 3.0))
