# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The restricted likelihood of an estimate's error (``docs/error_model.md``, The likelihood).

With z_i the error of pose i in the world's axes, a position and a rotation vector,

    z_i = x_i + K_i θ + ξ_i + n_i,   ξ_i + n_i ~ N(0, R_i),   R_i = V_i + J,

x the process of `process`, the rotation of which turns what follows: x_(i+1) has the position
``- hat(p_(i+1) - p_i) φ_i`` besides. The states s and θ are integrated out under flat priors (θ
under a hardly informative one). Stacked with the process's own equations, Ω the covariance of
all noise and X the design, that is one regression,

    log L = -½ (log|Ω| + log|Xᵀ Ω⁻¹ X| + rᵀ Ω⁻¹ r + dof log 2π),

whose information Λ of the states is block-tridiagonal. Its gradient is Fisher's identity, the
expectation of the complete data's score, from the blocks of Λ⁻¹ on and beside the diagonal.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.error_model.band import regressed
from trajeval_ros.error_model.factored import ROUND_OFF
from trajeval_ros.error_model.grouped import GroupedSteps
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.system import AXES, PREDICTED, System, Told
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]

# No disturbance, m or rad, is larger than this.
_LARGEST = 1e100

# More are integrated out by NumPy: `theta.c` has no room.
_MOST_NUISANCES = 16
_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class Data:
    """What is fitted, of N poses.

    times: (N,), s. errors: z (N, 6), m and rad, in the world's axes. covariance: V (N, 6, 6),
    likewise. travel: ``p_(i+1) - p_i`` of the ground truth, (N - 1, 3), m.
    nuisances: K (N, 6, c). precision: of θ's prior, (c,).
    measured, moved: factors of the variances of each pose's jitter and of the error's own move in
    each step, (N, 2) and (N - 1, 2), translation and rotation.
    """

    times: Array
    errors: Array
    covariance: Array
    travel: Array
    nuisances: Array
    precision: Array
    measured: Array
    moved: Array

    def weighted(self, measured: Array, moved: Array) -> Data:
        """With other factors; what has been worked out of the rest is there still."""
        found = copy(self)
        vars(found).update(measured=measured, moved=moved)
        return found

    @cached_property
    def intervals(self) -> Array:
        """Between the poses, (N - 1,), s."""
        return np.diff(self.times)

    @cached_property
    def shortest(self) -> float:
        """The median interval, s."""
        return median(self.intervals)

    @cached_property
    def variances(self) -> Array:
        """Of the ground truth on the three axes of each group, (2, 3, N)."""
        return np.ascontiguousarray(np.einsum("nii->in", self.covariance)).reshape(2, AXES, -1)

    @cached_property
    def variance(self) -> Array:
        """Of the ground truth on one axis of each group, (2, N)."""
        return np.asarray(self.variances.mean(axis=1))

    @cached_property
    def known(self) -> Array:
        """The standard deviation that the ground truth has of each group at the median, (2,)."""
        found = [[median(axis) for axis in group] for group in self.variances]
        return np.asarray(np.sqrt(np.array(found).mean(axis=1)))

    @cached_property
    def bounds(self) -> dict[Kind, tuple[Array, Array]]:
        """Of the parameters, as far as they have been asked for."""
        return {}

    @cached_property
    def by_group(self) -> Array:
        """Columns of the nuisances and, last, the errors; (2, N, 3, c + 1)."""
        return by_group(self.nuisances, self.errors[..., None])


def by_group(*columns: Array) -> Array:
    """Columns (N, 6, c) beside each other, of translation and of rotation; (2, N, 3, all)."""
    count, ends = len(columns[0]), np.cumsum([each.shape[2] for each in columns])
    found = np.empty((2, count, AXES, int(ends[-1])))
    for each, end in zip(columns, ends, strict=True):
        part = found[..., end - each.shape[2] : end]
        part[...] = each.reshape(count, 2, AXES, -1).swapaxes(0, 1)
    return found


class Likelihood:
    """The restricted likelihood at one ψ, and what the data say there of states and nuisances."""

    def __init__(self, kind: Kind, parameters: Array, data: Data, gauge: Array) -> None:
        """Integrate the states out, and the nuisances.

        parameters: ψ, (2, p), of translation and rotation, as ``kind.names``. gauge: columns
        (N, 6, 6) of the world's alignment; they are nuisances where the process is not free.

        Raises numpy.linalg.LinAlgError where there is no likelihood.
        """
        self.kind, self.parameters, self.data, self.gauge = kind, parameters, data, gauge
        self.count = len(data.times)
        bounded = kind is Kind.WANDER
        self._steps = GroupedSteps(kind, parameters, data.intervals, data.moved)
        self._jitter = np.exp(2.0 * parameters[:, 0])
        moves, noise, precision, process_log_det = self._steps.all
        prior, log_prior, _ = self._steps.begin
        self._system = System(
            data.covariance,
            data.measured * self._jitter,
            data.nuisances,
            gauge if bounded else gauge[:, :, :0],
            data.errors,
            np.zeros_like(data.travel) if bounded else data.travel,
            moves,
            noise,
            precision,
            prior,
            AXES * (process_log_det - log_prior),
        )
        self._regressed = regressed(self._system)
        self._integrate()

    def _integrate(self) -> None:
        """θ, the log-likelihood."""
        normal, count = self._regressed.normal, self.data.nuisances.shape[2]
        self.theta: Array
        self.theta_covariance: Array
        size = len(normal) - 1
        if loops.there() and size <= _MOST_NUISANCES:
            self.theta, self.theta_covariance = np.empty(size), np.empty((size, size))
            found = np.empty(2)
            given = loops.doubles(normal), loops.doubles(self.data.precision)
            told = self.theta, self.theta_covariance, found
            failed = loops.call("theta_integrated", size, count, *given, *told)
            self.chi2, self._schur_log_det = found.tolist()
        else:
            failed = self._integrate_alone(normal, count)
        if failed or not np.isfinite(self.chi2):
            raise np.linalg.LinAlgError("the nuisances' information is not positive definite")
        bounded = self.kind is Kind.WANDER
        self.dof = 6 * self.count - (0 if bounded else 6)
        self.value = -0.5 * (
            self.chi2
            + self._regressed.log_det
            + self._schur_log_det
            + (self.dof - len(self.theta)) * _LOG_2PI
        )
        # At the nuisances found, the world's alignment integrated out in every process.
        of_gauge = 0.0
        if bounded:
            gauge = normal[count:-1, count:-1]
            of_gauge = float(np.linalg.slogdet(gauge)[1]) - len(gauge) * _LOG_2PI
        self.at_theta = -0.5 * (
            self.chi2 + self._regressed.log_det + self.dof * _LOG_2PI + of_gauge
        )

    def _integrate_alone(self, normal: Array, count: int) -> bool:
        """θ and what it leaves, by NumPy; whether its information is not positive definite."""
        schur: Array = normal[:-1, :-1].copy()
        np.einsum("ii->i", schur)[:count] += self.data.precision
        scale = 1.0 / np.sqrt(np.maximum(np.diag(schur), 1e-300))
        unit = scale[:, None] * schur * scale
        self.theta_covariance = scale[:, None] * np.linalg.inv(unit) * scale
        self.theta = self.theta_covariance @ normal[:-1, -1]
        self.chi2 = float(normal[-1, -1] - normal[:-1, -1] @ self.theta)
        sign, log_schur = np.linalg.slogdet(unit)
        self._schur_log_det = float(log_schur) - 2.0 * float(np.log(scale).sum())
        return bool(sign <= 0.0)

    @cached_property
    def told(self) -> Told:
        """What the data say of the disturbances."""
        root: Array = np.asarray(np.linalg.cholesky(self.theta_covariance), np.float64)
        return self._regressed.told(self.theta, root)

    def gradient(self) -> Array:
        """``∂ log L / ∂ψ``, (2, p)."""
        return np.asarray(self.scores().sum(axis=0))

    def scores(self) -> Array:
        """What each pose, with the step that leads to it, adds to the gradient; (N, 2, p)."""
        return self._scores

    @cached_property
    def _scores(self) -> Array:
        told, slopes = self.told, self._steps.slopes
        found: Array = np.zeros((2, len(self.kind.names), self.count))
        found[:, 0] = self._system.jitter.T * (told.squares - told.informed)
        found[..., 1:] += 0.5 * np.einsum("gcdn,jgcdn->gjn", told.moves - told.moved, slopes.noise)
        found[:, -1, 1:] += np.einsum("gcn,gcn->gn", slopes.moves[:, :, -1], told.crossed)
        last = told.states[0, -PREDICTED:].reshape(2, AXES)
        begin = (last**2).sum(axis=1) + told.first
        found[..., 0] += 0.5 * AXES * self._steps.begin[2]
        found[..., 0] -= 0.5 * slopes.prior[:, :, -1, -1].T * begin[:, None]
        return np.moveaxis(found, -1, 0)

    def average_information(self) -> Array:
        """Of ψ, (2p, 2p): the mean of the observed and the expected one.

        ``½ qᵢᵀ P qⱼ`` with ``qᵢ = (∂V/∂ψᵢ) P z``, V the covariance of the errors with the states in
        it and P its inverse but for what is integrated out (Gilmour, Thompson and Cullis, 1995).
        With M the precision of the states by the process alone, that is, of the process,
        ``½ (tᵢᵀ Q tⱼ - gᵢᵀ Λ⁻¹ gⱼ)`` with ``g = ∂M s = Aᵀ t``, and of the jitter ``g = R⁻¹ q``.
        """
        return self._average_information

    @cached_property
    def _average_information(self) -> Array:
        found, ahead = self._regressed.average(self.told, self._steps.slopes)
        return np.asarray(0.5 * (found - ahead.T @ self.theta_covariance @ ahead))

    def disturbances(self) -> tuple[Array, Array, Array, Array]:
        """Squared sizes of each pose's jitter and each step's move, as the data tell them.

        For each, (N, 2) and (N - 1, 2), by group: the square of the generalised least squares
        estimate over the three axes, and its variance on one axis beside the disturbance's own.
        """
        told, system = self.told, self._system
        variances = np.einsum("nii->ni", system.covariance).reshape(-1, 2, AXES)
        of_noise = 1.0 / (variances.mean(axis=2) + system.jitter)
        answers = []
        for square, informed, most, own in (
            (told.squares, told.informed, of_noise.T, system.jitter.T),
            (
                told.moves[:, 0, 0],
                told.moved[:, 0, 0],
                system.precision[:, 0, 0],
                system.noise[:, 0, 0],
            ),
        ):
            information = informed / AXES
            # Below this share of what it is taken from, it is round-off.
            mean = np.maximum(np.maximum(information, ROUND_OFF * most), 1e-100)
            # Errors of absurd data are bounded before they are squared.
            size = np.minimum(np.sqrt(square), _LARGEST * mean) / mean
            answers += [(size**2).T, np.maximum(1.0 / mean - own, 0.0).T]
        return answers[0], answers[1], answers[2], answers[3]

    def own_noise(self) -> tuple[Array, Array]:
        """The variances of one axis that poses (2,) and steps (N - 1, 2) have without weights."""
        return self._jitter, self._system.noise[:, 0, 0].T / self.data.moved

    @property
    def weights(self) -> tuple[Array, Array]:
        """Factors of the variances, of poses and of steps."""
        return self.data.measured, self.data.moved

    def at(self, parameters: Array, weights: tuple[Array, Array]) -> Likelihood:
        """The likelihood at another place."""
        return Likelihood(self.kind, parameters, self.data.weighted(*weights), self.gauge)

    def innovations(self) -> Array:
        """What each pose is beyond its prediction from those before, whitened; (N, 6)."""
        return self.whitened()[1]

    def whitened(self) -> tuple[Array, Array]:
        """The nuisances' columns (N, 6, c) and the innovations (N, 6), whitened.

        The first pose of a free process is not predicted, and is not there.
        """
        white = self._regressed.whitened()
        columns = white[..., :-1]
        return columns, white[..., -1] - columns @ self.theta


def clustered_ratio(columns: Array, white: Array, covariance: Array, blocks: int) -> Array:
    """Standard deviations of θ that the data show, over those that the model says; (c,).

    White's estimate: the scores ``Xᵢᵀ νᵢ`` of whitened columns and innovations, summed over so
    many stretches of time, whose sums have the information's variance where the model holds.
    covariance: of θ, as the model says.
    """
    each = np.einsum("nic,ni->nc", columns, white)
    shown = covariance @ scatter(each, blocks) @ covariance
    # Round-off may leave a direction without any scatter just below zero.
    return np.asarray(np.sqrt(np.maximum(np.diag(shown), 0.0) / np.diag(covariance)))


def scatter(scores: Array, blocks: int) -> Array:
    """The covariance of a sum of scores (N, c), by so many stretches of time; (c, c)."""
    edges = np.linspace(0, len(scores), blocks + 1).astype(int)[:-1]
    sums = np.add.reduceat(scores, edges, axis=0)
    return np.asarray(sums.T @ sums * (blocks / (blocks - 1.0)))
