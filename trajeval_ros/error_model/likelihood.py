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

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.error_model.factored import ROUND_OFF, backwards
from trajeval_ros.error_model.information import Factor
from trajeval_ros.error_model.process import Kind, steps

Array = npt.NDArray[np.float64]

# No disturbance, m or rad, is larger than this.
_LARGEST = 1e100

_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True)
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


@dataclass(frozen=True, slots=True)
class _Covariances:
    """Sums over the three axes of each group.

    noise: what is known of each pose's score ``R⁻¹ n``, (N, 2). moved, earlier: of the moves, and
    of the states with those that follow, (N - 1, k, k). first: of the first state, (k, k).
    """

    noise: Array
    moved: list[Array]
    earlier: list[Array]
    first: list[Array]


class Likelihood:
    """The restricted likelihood at one ψ, and what the data say there of states and nuisances."""

    def __init__(self, kind: Kind, parameters: Array, data: Data, gauge: Array) -> None:
        """Factor the information.

        parameters: ψ, (2, p), of translation and rotation, as ``kind.names``. gauge: columns
        (N, 6, 6) of the world's alignment; they are nuisances where the process is not free.
        """
        self.kind, self.parameters, self.data, self.gauge = kind, parameters, data, gauge
        self.count, self.size = len(data.times), 6 * kind.components
        self.columns, self.precision = data.nuisances, data.precision
        if kind is Kind.WANDER:
            self.columns = np.concatenate([data.nuisances, gauge], axis=2)
            self.precision = np.concatenate([data.precision, np.zeros(gauge.shape[2])])
        self._steps = [
            steps(kind, each, np.diff(data.times), factors)
            for each, factors in zip(parameters, data.moved.T, strict=True)
        ]
        self._jitter = np.exp(2.0 * parameters[:, 0])
        self.noise = data.covariance.copy()
        diagonal = np.repeat(data.measured * self._jitter, 3, axis=1)
        np.einsum("nii->ni", self.noise)[...] += diagonal
        self.weight = np.linalg.inv(self.noise)
        self.transition = self._assembled([s.transition for s in self._steps])
        if kind is not Kind.WANDER:
            self.transition[:, :3, 3:6] -= se3.hat(data.travel)
        self._step_weights = [np.asarray(np.linalg.inv(s.noise), np.float64) for s in self._steps]
        self.process_weight = self._assembled(self._step_weights)
        self._process_log_det = 3.0 * sum(
            float(np.linalg.slogdet(s.noise)[1].sum()) for s in self._steps
        )
        self.process_prior = self._assembled([s.prior[None] for s in self._steps])[0]
        onwards = self.process_weight @ self.transition
        own = np.zeros((self.count, self.size, self.size))
        own[:, :6, :6] = self.weight
        own[0] += self.process_prior
        own[1:] += self.process_weight
        own[:-1] += np.swapaxes(self.transition, 1, 2) @ onwards
        self.information = own, -onwards
        self.factor = Factor.of(*self.information)
        self._regress()

    def _assembled(self, groups: list[Array]) -> Array:
        """Blocks (n, k, k) of translation and rotation, each on three axes; (n, m, m)."""
        k = groups[0].shape[1]
        result = np.zeros((len(groups[0]), k, 2, 3, k, 2, 3))
        for g, block in enumerate(groups):
            for axis in range(3):
                result[:, :, g, axis, :, g, axis] = block
        return result.reshape(len(groups[0]), self.size, self.size)

    def _regress(self) -> None:
        """θ, the states, the residuals, the log-likelihood."""
        size, columns = self.size, self.columns
        both = np.concatenate([columns, self.data.errors[..., None]], axis=2)
        weighted = self.weight @ both
        right = np.zeros((self.count, size, both.shape[2]))
        right[:, :6] = weighted
        self._forward = self.factor.forward(right)
        flat = both.shape[2]
        normal = both.reshape(-1, flat).T @ weighted.reshape(-1, flat)
        taken = self._forward.reshape(-1, flat)
        normal -= taken.T @ taken
        schur = normal[:-1, :-1] + np.diag(self.precision)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(schur), 1e-300))
        self.theta_covariance = (
            scale[:, None] * np.linalg.inv(scale[:, None] * schur * scale) * scale
        )
        self.theta: Array = self.theta_covariance @ normal[:-1, -1]
        left = self._forward @ np.append(-self.theta, 1.0)
        self.states = self.factor.backward(left[..., None])[..., 0]
        self.residual = self.data.errors - self.states[:, :6] - columns @ self.theta
        self.moves = self.states[1:] - (self.transition @ self.states[:-1, :, None])[..., 0]
        self.chi2 = float(normal[-1, -1] - normal[:-1, -1] @ self.theta)
        sign, log_schur = np.linalg.slogdet(scale[:, None] * schur * scale)
        if sign <= 0.0 or not np.isfinite(self.chi2):
            raise np.linalg.LinAlgError("the nuisances' information is not positive definite")
        self._schur_log_det = float(log_schur) - 2.0 * float(np.log(scale).sum())
        prior = 3.0 * sum(s.log_prior for s in self._steps)
        self._states_log_det = (
            float(np.linalg.slogdet(self.noise)[1].sum())
            + self._process_log_det
            - prior
            + self.factor.log_det
        )
        self.dof = 6 * self.count - (6 if self.kind is not Kind.WANDER else 0)
        self.value = -0.5 * (
            self.chi2
            + self._states_log_det
            + self._schur_log_det
            + (self.dof - len(self.theta)) * _LOG_2PI
        )
        # At the nuisances found, the world's alignment integrated out in every process.
        of_gauge = 0.0
        if self.kind is Kind.WANDER:
            gauge = schur[self.data.nuisances.shape[2] :, self.data.nuisances.shape[2] :]
            of_gauge = float(np.linalg.slogdet(gauge)[1]) - len(gauge) * _LOG_2PI
        self.at_theta = -0.5 * (self.chi2 + self._states_log_det + self.dof * _LOG_2PI + of_gauge)

    @cached_property
    def state_columns(self) -> Array:
        """What the states take of the nuisances' columns, (N, m, c)."""
        return self.factor.backward(self._forward[..., :-1])

    @cached_property
    def _covariances(self) -> _Covariances:
        """What is known of the disturbances, as far as likelihood's slopes need it."""
        own, beside = self.factor.covariances(*self.information)
        root = np.linalg.cholesky(self.theta_covariance)
        columns = self.state_columns
        ahead = (columns[1:] - self.transition @ columns[:-1]) @ root
        before, first = columns[:-1] @ root, columns[0] @ root
        noise = np.einsum("nij,nij->ni", self.weight @ own[:, :6, :6], self.weight)
        seen = self.weight @ ((self.columns - columns[:, :6]) @ root)
        noise += np.einsum("nic,nic->ni", seen, seen)
        moved, earlier, begin = [], [], []
        for g, step in enumerate(self._steps):
            f, back = step.transition, np.swapaxes(step.transition, 1, 2)
            here, later, across = (
                self._traces(each, g) for each in (own[:-1], own[1:], np.swapaxes(beside, 1, 2))
            )
            follows = here @ back
            both = np.swapaxes(across, 1, 2) @ back
            spread = f @ follows
            if g == 0 and self.kind is not Kind.WANDER:
                # Headings turn what follows.
                turn = self.transition[:, None, :3, 3:6]
                with_heading = (self._blocks(own[:-1])[:, :, 0, :, 0, 1] * turn).sum(axis=(2, 3))
                ahead_of = (self._blocks(beside)[:, :, 0, :, 0, 1] * turn).sum(axis=(2, 3))
                heading = (turn[:, 0] @ own[:-1, 3:6, 3:6] * turn[:, 0]).sum(axis=(1, 2))
                cross = (f @ with_heading[..., None])[..., 0]
                follows[:, :, 0] += with_heading
                both[:, :, 0] += ahead_of
                spread[:, :, 0] += cross
                spread[:, 0] += cross
                spread[:, 0, 0] += heading
            mean = [self._group(each, g) for each in (ahead, before, first[None])]
            flat = [each.reshape(*each.shape[:2], -1) for each in mean]
            moved.append(
                later - both - np.swapaxes(both, 1, 2) + spread + flat[0] @ flat[0].swapaxes(1, 2)
            )
            earlier.append(across - follows + flat[1] @ flat[0].swapaxes(1, 2))
            begin.append(self._traces(own[:1], g)[0] + flat[2][0] @ flat[2][0].T)
        return _Covariances(noise.reshape(-1, 2, 3).sum(axis=2), moved, earlier, begin)

    def _blocks(self, blocks: Array) -> Array:
        """(n, m, m) by component, group and axis."""
        k = self.kind.components
        return blocks.reshape(-1, k, 2, 3, k, 2, 3)

    def _traces(self, blocks: Array, group: int) -> Array:
        """Blocks (n, m, m), summed over a group's three axes; (n, k, k)."""
        split = self._blocks(blocks)[:, :, group, :, :, group]
        return np.asarray(np.einsum("ncada->ncd", split))

    def _group(self, vectors: Array, group: int) -> Array:
        """The part (n, k, 3, ...) of vectors (n, m, ...) that is a group's."""
        k = self.kind.components
        return vectors.reshape(len(vectors), k, 2, 3, *vectors.shape[2:])[:, :, group]

    def gradient(self) -> Array:
        """``∂ log L / ∂ψ``, (2, p)."""
        return np.asarray(self.scores().sum(axis=0))

    def scores(self) -> Array:
        """What each pose, with the step that leads to it, adds to the gradient; (N, 2, p)."""
        known = self._covariances
        found: Array = np.zeros((self.count, 2, len(self.kind.names)))
        u = (self.weight @ self.residual[..., None])[..., 0]
        seen = u * u - np.einsum("nii->ni", self.weight)
        diagonal = seen.reshape(-1, 2, 3).sum(axis=2) + known.noise
        found[:, :, 0] = self.data.measured * diagonal * self._jitter
        for g, step in enumerate(self._steps):
            w, state = self._group(self.moves, g), self._group(self.states, g)
            weight = self._step_weights[g]
            moments = w @ np.swapaxes(w, 1, 2) + known.moved[g]
            information = weight @ moments @ weight - 3.0 * weight
            crossed = (state[:-1] @ np.swapaxes(w, 1, 2) + known.earlier[g]) @ weight
            begin = state[0] @ state[0].T + known.first[g]
            for j in range(1, len(self.kind.names)):
                found[1:, g, j] = 0.5 * np.einsum("ncd,ncd->n", step.slope_noise[j], information)
                if self.kind.names[j].endswith("time"):
                    slope = step.slope_transition[j]
                    found[1:, g, j] += np.einsum("ncd,ndc->n", slope, crossed)
                found[0, g, j] = 1.5 * step.slope_log_prior[j]
                found[0, g, j] -= 0.5 * np.vdot(step.slope_prior[j], begin)
        return found

    def average_information(self) -> Array:
        """Of ψ, (2p, 2p): the mean of the observed and the expected one.

        ``½ qᵢᵀ P qⱼ`` with ``qᵢ = (∂V/∂ψᵢ) P z``, V the covariance of the errors with the states in
        it and P its inverse but for what is integrated out (Gilmour, Thompson and Cullis, 1995).
        With M the precision of the states by the process alone, that is, of the process,
        ``½ (tᵢᵀ Q tⱼ - gᵢᵀ Λ⁻¹ gⱼ)`` with ``g = ∂M s = Aᵀ t``, and of the jitter ``g = R⁻¹ q``.
        """
        p, count = len(self.kind.names), self.count
        scores = (self.weight @ self.residual[..., None])[..., 0].reshape(-1, 2, 3)
        into = np.zeros((count, self.size, 2, p))  # g
        through = np.zeros_like(into)  # t
        errors = np.zeros((count, 6, 2))
        back = np.zeros_like(into)
        for g, step in enumerate(self._steps):
            weight = self._step_weights[g]
            state = self._group(self.states, g)
            felt = weight @ self._group(self.moves, g)
            part = self._group(through, g)[:, :, :, g]
            for j in range(1, p):
                each = step.slope_noise[j] @ felt
                if self.kind.names[j].endswith("time"):
                    each = each + step.slope_transition[j] @ state[:-1]
                part[1:, ..., j] = -(weight @ each)
                part[0, ..., j] = step.slope_prior[j] @ state[0]
            if self.kind is not Kind.DRIFT:
                # Of the last component alone, which nothing but itself follows from.
                here = np.zeros((count, 3))
                here[:-1] = -np.einsum("nc,nca->na", step.slope_transition[-1][:, :, -1], felt)
                self._group(into, g)[:, -1, :, g, -1] = here
                decay = step.transition[:, -1, -1]
                self._group(back, g)[:, -1, :, g, -1] = backwards(decay, here.T).T
            variance = 2.0 * self.data.measured[:, g, None] * self._jitter[g]
            errors[:, 3 * g : 3 * g + 3, g] = variance * scores[:, g]
        flat = through.reshape(count, self.size, 2 * p)
        into += through
        into[:-1] -= (np.swapaxes(self.transition, 1, 2) @ flat[1:]).reshape(into[1:].shape)
        through += back
        weighted = self.weight @ errors
        into[:, :6, :, 0] = weighted
        columns = into.reshape(count * self.size, 2 * p)
        forward = self.factor.forward(into.reshape(count, self.size, 2 * p))
        forward = forward.reshape(columns.shape)
        found = -forward.T @ forward
        found[::p, ::p] += errors.reshape(-1, 2).T @ weighted.reshape(-1, 2)
        for g, step in enumerate(self._steps):
            part = self._group(through, g)[:, :, :, g]
            moved = np.einsum("ncd,ndap->ncap", step.noise, part[1:])
            own = part[1:].reshape(-1, p).T @ moved.reshape(-1, p)
            proper = np.diag(step.prior) > 0.0
            first = part[0][proper]
            own += np.einsum("cai,caj->ij", first, first / np.diag(step.prior)[proper, None, None])
            found[g * p : (g + 1) * p, g * p : (g + 1) * p] += own
        # What is integrated out.
        ahead = -self._forward[..., :-1].reshape(len(columns), -1).T @ forward
        ahead[:, ::p] += self.columns.reshape(6 * count, -1).T @ weighted.reshape(-1, 2)
        found -= ahead.T @ self.theta_covariance @ ahead
        return np.asarray(0.5 * found)

    def disturbances(self) -> tuple[Array, Array, Array, Array]:
        """Squared sizes of each pose's jitter and each step's move, as the data tell them.

        For each, (N, 2) and (N - 1, 2), by group: the square of the generalised least squares
        estimate over the three axes, and its variance on one axis beside the disturbance's own.
        """
        known = self._covariances
        own_noise = np.einsum("nii->ni", self.weight).reshape(-1, 2, 3).sum(axis=2)
        scores = [(self.weight @ self.residual[..., None]).reshape(-1, 2, 3)]
        told = [(own_noise - known.noise) / 3.0]
        most = [own_noise / 3.0]
        felt, process, rows = [], [], []
        for g, weight in enumerate(self._step_weights):
            felt.append((weight[:, :1] @ self._group(self.moves, g))[:, 0])
            row = weight[:, 0]
            taken = np.einsum("nc,ncd,nd->n", row, known.moved[g], row)
            process.append(row[:, 0] - taken / 3.0)
            rows.append(row[:, 0])
        scores.append(np.stack(felt, axis=1))
        told.append(np.stack(process, axis=1))
        most.append(np.stack(rows, axis=1))
        answers = []
        for score, information, largest, own in zip(
            scores,
            told,
            most,
            (self.data.measured * self._jitter, self._moving()),
            strict=True,
        ):
            # Below this share of what it is taken from, it is round-off.
            mean = np.maximum(np.maximum(information, ROUND_OFF * largest), 1e-100)
            # Errors of absurd data are bounded before they are squared.
            size = np.linalg.norm(score, axis=2)
            square = (np.minimum(size, _LARGEST * mean) / mean) ** 2
            answers += [square, np.maximum(1.0 / mean - own, 0.0)]
        return answers[0], answers[1], answers[2], answers[3]

    def own_noise(self) -> tuple[Array, Array]:
        """The variances of one axis that poses (2,) and steps (N - 1, 2) have without weights."""
        return self._jitter, self._moving() / self.data.moved

    def _moving(self) -> Array:
        """The variances of the error's own moves, of one axis, (N - 1, 2)."""
        return np.stack([step.noise[:, 0, 0] for step in self._steps], axis=1)

    @property
    def weights(self) -> tuple[Array, Array]:
        """Factors of the variances, of poses and of steps."""
        return self.data.measured, self.data.moved

    def at(self, parameters: Array, weights: tuple[Array, Array]) -> Likelihood:
        """The likelihood at another place."""
        data = replace(self.data, measured=weights[0], moved=weights[1])
        return Likelihood(self.kind, parameters, data, self.gauge)

    def innovations(self) -> Array:
        """What each pose is beyond its prediction from those before, whitened; (N, 6)."""
        return self.whitened()[1]

    def whitened(self) -> tuple[Array, Array]:
        """The nuisances' columns (N, 6, c) and the innovations (N, 6), whitened."""
        both = np.concatenate([self.columns, self.data.errors[..., None]], axis=2)
        white = self._whitened(both)
        columns = white[..., :-1]
        return columns, white[..., -1] - columns @ self.theta

    def _whitened(self, columns: Array) -> Array:
        """Columns (N, 6, c) of what the errors hold, each less what those before it predict.

        The factor runs forwards: without what the next step says, row i of it holds the state
        given the poses up to i. From the rest of the data there, the prediction's.
        """
        own, _ = self.factor.blocks()
        information = own @ np.swapaxes(own, 1, 2)
        f = self.transition
        information[:-1] -= np.swapaxes(f, 1, 2) @ self.process_weight @ f
        known = np.linalg.inv(information)
        state = known[:, :6] @ (own @ self._forward)
        # The first pose of a free process is not predicted.
        first = 0 if self.kind is Kind.WANDER else 1
        noise, rest = self.noise[first:], (columns - state)[first:]
        covariance = noise - known[first:, :6, :6]
        solved = np.linalg.solve(covariance, np.concatenate([noise, rest], axis=2))
        found = noise @ solved
        spread, gained = found[..., :6], found[..., 6:]
        root = np.linalg.cholesky(0.5 * (spread + np.swapaxes(spread, 1, 2)))
        return np.asarray(np.linalg.solve(root, gained))


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
