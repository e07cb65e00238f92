# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The chain of `axes` by the Cholesky factor of its states' information, in NumPy.

Arrays have the pose as their last axis.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack
from trajeval_ros.error_model.process import Kind, steps
from trajeval_ros.error_model.series import Series

Array = npt.NDArray[np.float64]

_AXES = 3
ROUND_OFF = 1e-10
"""What is known of a disturbance below this share of what is known of its pose is none."""
# Of what is taken all of, so much may be left.
_ROUND_OFF_OF_PRODUCTS = 1e-12


class Factored:
    """At ψ (p,)."""

    def __init__(self, kind: Kind, parameters: Array, series: Series) -> None:
        """Factor the information of one axis's states."""
        self.kind, self.parameters, self.series = kind, parameters, series
        self._step = step = steps(kind, parameters, series.intervals, series.moved)
        self._jitter = series.measured * np.exp(2.0 * parameters[0])
        self.weight = 1.0 / (series.variance + self._jitter)
        self._moves = step.transition.transpose(1, 2, 0)
        self._noise = step.noise.transpose(1, 2, 0)
        self._precision, log_det = _inverse(self._noise)
        onwards = _times(self._precision, self._moves)
        own = np.zeros((*onwards.shape[:2], len(self.weight)))
        own[..., 1:] = self._precision
        own[..., :-1] += _times(_turned(self._moves), onwards)
        own[0, 0] += self.weight
        own[..., 0] += step.prior
        self._information = own, -onwards
        self._factor = _factored(own, -onwards)
        self._regress(log_det)

    def _regress(self, noise_log_det: float) -> None:
        errors, weight = self.series.errors, self.weight
        k, count = self.kind.components, len(weight)
        right = np.zeros((_AXES + 1, count, k))
        right[:_AXES, :, 0] = errors * weight
        right[_AXES, :, 0] = weight
        states = _solved(self._factor, right[: _AXES + (self.kind is Kind.WANDER)])
        self.states = states[:_AXES]  # (3, k, N)
        self._mean: Array | None = None
        self._mean_information = 1.0
        if self.kind is Kind.WANDER:
            # Each axis has a mean of its own, as the world's alignment is not known.
            self._mean = states[_AXES]
            self._mean_information = float(weight @ (1.0 - self._mean[0]))
            mean = (errors - self.states[:, 0]) @ weight / self._mean_information
            self.states = self.states - mean[:, None, None] * self._mean
            errors = errors - mean[:, None]
        self.residual = errors - self.states[:, 0]
        self.moves = self.states[..., 1:] - np.einsum(
            "abn,xbn->xan", self._moves, self.states[..., :-1]
        )
        band = self._factor
        log_det = -float(np.log(weight).sum()) + noise_log_det - self._step.log_prior
        log_det += 2.0 * float(np.log(band[0]).sum()) + np.log(self._mean_information)
        self.value = -0.5 * (float((errors * self.residual).sum(axis=0) @ weight) + _AXES * log_det)
        if not np.isfinite(self.value):
            raise np.linalg.LinAlgError("no likelihood")

    @cached_property
    def _covariances(self) -> tuple[Array, Array, Array]:
        """Of the states, (k, k, N); of the moves, and of states with them, (k, k, N - 1).

        What is known of a state from both sides, less what is counted twice.
        """
        own, below = self._information
        backwards = _factored(own[..., ::-1], _turned(below)[..., ::-1])
        forward, gain = _pivots(self._factor, self.kind.components)
        backward, _ = _pivots(backwards, self.kind.components)
        found, _ = _inverse(forward + backward[..., ::-1] - own)
        f = self._moves
        beside = -_times(found[..., 1:], gain)
        earlier = _turned(beside) - _times(found[..., :-1], _turned(f))
        moved = found[..., 1:] - _times(beside, _turned(f)) - _times(f, earlier)
        if self._mean is not None:
            one, variance = self._mean, 1.0 / self._mean_information
            step = one[:, 1:] - np.einsum("abn,bn->an", f, one[:, :-1])
            moved = moved + variance * step[:, None] * step
            earlier = earlier + variance * one[:, None, :-1] * step
            found = found + variance * (one - 1.0)[:, None] * (one - 1.0)
        return found, moved, earlier

    @property
    def noise(self) -> Array:
        """The variance of each step's first component, (N - 1,)."""
        return np.asarray(self._noise[0, 0])

    def products(self, columns: Array) -> Array:
        """``Xᵀ P X`` (c, c) of columns X (N, 3, c)."""
        error = _ROUND_OFF_OF_PRODUCTS
        if self.kind is not Kind.WANDER:
            # All of what is constant is the process's.
            error += float(np.abs(self.smoothed(np.ones((len(columns), 1, 1))) - 1.0).max())
        weighted = columns * self.weight[:, None, None]
        squares = np.einsum("nxc,nxc->c", weighted, columns)
        left = (columns - self.smoothed(columns)).reshape(-1, columns.shape[2])
        return np.asarray(weighted.reshape(left.shape).T @ left + np.diag(error * squares))

    def smoothed(self, columns: Array) -> Array:
        """The processes of columns (N, 3, c)."""
        right = np.zeros((columns[0].size, len(columns), self.kind.components))
        right[..., 0] = (columns * self.weight[:, None, None]).reshape(len(columns), -1).T
        return np.asarray(_solved(self._factor, right)[:, 0].T.reshape(columns.shape))

    def gradient(self) -> Array:
        """``∂ log L / ∂ψ``, (p,)."""
        found = np.zeros(len(self.kind.names))
        found[0] = self._felt()[0] @ self._jitter
        _, moved, earlier = self._covariances
        w, precision, step = self.moves, self._precision, self._step
        moments = np.einsum("xan,xbn->abn", w, w) + _AXES * moved
        mixed = np.einsum("xan,xbn->abn", self.states[..., :-1], w) + _AXES * earlier
        information = _times(_times(precision, moments), precision) - _AXES * precision
        crossed = _times(mixed, precision)
        first = np.einsum("xa,xb->ab", self.states[..., 0], self.states[..., 0])
        first += _AXES * self._first
        for j, name in enumerate(self.kind.names[1:], start=1):
            found[j] = 0.5 * np.einsum("nab,abn->", step.slope_noise[j], information)
            if name.endswith("time"):
                found[j] += np.einsum("nab,ban->", step.slope_transition[j], crossed)
            found[j] += 0.5 * (
                _AXES * step.slope_log_prior[j] - np.vdot(step.slope_prior[j], first)
            )
        return found

    @property
    def _first(self) -> Array:
        """The covariance of the first state, (k, k)."""
        found = self._covariances[0][..., 0]
        if self._mean is not None:
            one, variance = self._mean[:, 0], 1.0 / self._mean_information
            found = (
                found - variance * np.outer(one - 1.0, one - 1.0) + variance * np.outer(one, one)
            )
        return found

    def _felt(self) -> tuple[Array, Array]:
        """Half the slope of log L by each pose's variance, and what the data tell of it; (N,)."""
        told = _AXES * (self.weight - self.weight**2 * self._covariances[0][0, 0])
        return np.einsum("xn,xn->n", self.residual, self.residual) * self.weight**2 - told, told

    def average_information(self) -> Array:
        """Of ψ, (p, p); the states' precision M has the slopes ``∂M``, and ``g = ∂M s = Aᵀ t``.

        ``½ (t Q t - g Λ⁻¹ g)`` is the process's, with ``g = R⁻¹ ∂R P z`` for the jitter.
        """
        p, k, step = len(self.kind.names), self.kind.components, self._step
        f, count = self._moves, len(self.weight)
        felt = np.einsum("abn,xbn->xan", self._precision, self.moves)
        through = np.zeros((p, _AXES, k, count))  # t
        for j, name in enumerate(self.kind.names[1:], start=1):
            each = np.einsum("nab,xbn->xan", step.slope_noise[j], felt)
            if name.endswith("time"):
                each += np.einsum("nab,xbn->xan", step.slope_transition[j], self.states[..., :-1])
            through[j, ..., 1:] = -np.einsum("abn,xbn->xan", self._precision, each)
            through[j, ..., 0] = self.states[..., 0] @ step.slope_prior[j]
        back = through[..., 1:]
        into = through.copy()  # g
        into[..., :-1] -= np.einsum("ban,pxbn->pxan", f, back)
        if self.kind is not Kind.DRIFT:
            here = np.zeros((_AXES, count))
            slope = step.slope_transition[-1][..., -1]
            here[:, :-1] = -np.einsum("na,xan->xn", slope, felt)
            into[-1, :, -1] += here
            through[-1, :, -1] += backwards(f[-1, -1], here)
        errors = 2.0 * self._jitter * self.weight * self.residual
        into[0, :, 0] = self.weight * errors
        solved = _solved(self._factor, into.swapaxes(-2, -1).reshape(p * _AXES, count, k))
        solved = solved.reshape(into.shape)
        found = -into.reshape(p, -1) @ solved.reshape(p, -1).T
        found[0, 0] += float((errors**2).sum(axis=0) @ self.weight)
        moved = np.einsum("abn,pxbn->pxan", self._noise, back[1:])
        own = back[1:].reshape(p - 1, -1) @ moved.reshape(p - 1, -1).T
        proper = np.diag(step.prior) > 0.0
        first = through[1:, :, proper, 0]
        own += np.einsum("ixa,jxa->ij", first, first / np.diag(step.prior)[proper])
        found[1:, 1:] += own
        if self._mean is not None:
            ahead = -np.einsum("pxan,an->px", into, self._mean)
            ahead[0] += errors @ self.weight
            found -= ahead @ ahead.T / self._mean_information
        return np.asarray(0.5 * found)

    def disturbances(self) -> tuple[Array, Array, Array, Array]:
        """As those of the whole: of the poses, (N,) each, and of the steps, (N - 1,) each."""
        _, told = self._felt()
        score = self.weight * np.sqrt(np.einsum("xn,xn->n", self.residual, self.residual))
        v = np.einsum("an,xan->xn", self._precision[0], self.moves)
        row = self._precision[0]
        _, moved, _ = self._covariances
        known = row[0] - (row[:, None] * moved * row).sum(axis=(0, 1))
        answers = []
        for size, mean, own, most in (
            (score, told / _AXES, self._jitter, self.weight),
            (np.sqrt(np.einsum("xn,xn->n", v, v)), known, self._noise[0, 0], row[0]),
        ):
            # Below this share of what it is taken from, it is round-off.
            least = np.maximum(mean, ROUND_OFF * most)
            answers += [(size / least) ** 2, np.maximum(1.0 / least - own, 0.0)]
        return answers[0], answers[1], answers[2], answers[3]


def backwards(decay: Array, values: Array) -> Array:
    """``t_i = c_i + a_i t_(i+1)`` of c (m, n), a (n - 1,)."""
    band = np.ones((2, values.shape[1]))
    band[1, :-1] = -decay
    found, _ = lapack.dtbtrs(band, values.T, uplo="L", trans="T", diag="U")
    return np.asarray(found.T)


def _times(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("abn,bcn->acn", a, b))


def _turned(a: Array) -> Array:
    return np.swapaxes(a, 0, 1)


def _inverse(a: Array) -> tuple[Array, float]:
    """The inverses of symmetric (k, k, n), k ≤ 2, and the sum of the log-determinants."""
    if len(a) == 1:
        return 1.0 / a, float(np.log(a).sum())
    determinant = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    found = np.empty_like(a)
    found[0, 0], found[1, 1] = a[1, 1], a[0, 0]
    found[0, 1] = found[1, 0] = -a[0, 1]
    return found / determinant, float(np.log(determinant).sum())


def _factored(own: Array, below: Array) -> Array:
    """The Cholesky factor of a block-tridiagonal matrix as LAPACK's lower band."""
    k, _, count = own.shape
    band = np.zeros((count, k, 2 * k))
    for c in range(k):
        band[:, c, : k - c] = own[c:, c].T
        band[:-1, c, k - c : 2 * k - c] = below[:, c].T
    factor, info = lapack.dpbtrf(band.reshape(-1, 2 * k).T, lower=1, overwrite_ab=1)
    if info != 0:
        raise np.linalg.LinAlgError("the information matrix is not positive definite")
    return np.asarray(factor)


def _solved(factor: Array, right: Array) -> Array:
    """``Λ⁻¹ X`` of X (m, n, k); (m, k, n)."""
    solution, _ = lapack.dpbtrs(factor, right.reshape(len(right), -1).T, lower=1)
    return np.asarray(solution.T.reshape(right.shape).swapaxes(-1, -2))


def _pivots(factor: Array, k: int) -> tuple[Array, Array]:
    """``L_ii L_iiᵀ`` (k, k, n) and ``L_(i+1,i) L_ii⁻¹`` (k, k, n - 1)."""
    band = factor.reshape(2 * k, -1, k)
    if k == 1:
        return band[:1, :, 0][None] ** 2, (band[1, :-1, 0] / band[0, :-1, 0])[None, None]
    a, b, c = band[0, :, 0], band[1, :, 0], band[0, :, 1]
    pivot = np.array([[a * a, a * b], [a * b, b * b + c * c]])
    below = np.array([[band[2, :-1, 0], band[1, :-1, 1]], [band[3, :-1, 0], band[2, :-1, 1]]])
    gain = np.empty_like(below)
    gain[:, 1] = below[:, 1] / c[:-1]
    gain[:, 0] = (below[:, 0] - gain[:, 1] * b[:-1]) / a[:-1]
    return pivot, gain
