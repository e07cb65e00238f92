# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise-equivalent error: an estimate's errors in metres and radians, by likelihood.

The standard deviations which, added to the ground truth's covariance as white noise of the
estimate, ``Sigma_i + diag(s_t^2 I, s_r^2 I)``, maximise the absolute likelihood of a window
(``docs/method.md``, section 5). The gauge is integrated out, as in the likelihood itself, so that
the degrees of freedom it takes do not make the noise look smaller (restricted maximum likelihood).

With ``C = V + N(v)`` for the variances v = (s_t^2, s_r^2), and residuals ``J x + r``: ::

    l(v) = -1/2 (log|C| + log|Lambda| + u^T C u) + const
    Lambda = J^T C^-1 J,   P = C^-1 - C^-1 J Lambda^-1 J^T C^-1,   u = P r
    dl/dv_a = -1/2 (tr_a P - |u_a|^2)         with the rows and columns of group a alone
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.gauge import Gauge, Similarity
from trajeval_ros.likelihood.absolute import absolute_residual

Array = npt.NDArray[np.float64]

_GROUPS = (slice(0, 3), slice(3, 6))
_MAX_STEPS = 30
_MAX_HALVINGS = 10
# Done when a step promises less than this many nats.
_GAIN = 1e-4
# The residuals are linear about the ground truth's best alignment, which is not quite that of the
# noisier likelihood: they are linearised again, at the latter.
_LINEARIZATIONS = 3


class NoiseEquivalent(NamedTuple):
    """White noise of the estimate that explains its errors best.

    translation_std: m, of each axis of the body frame; 0 where the ground truth explains all.
    rotation_std: rad, likewise.
    converged: whether no further step would gain.
    """

    translation_std: float
    rotation_std: float
    converged: bool


class _Evaluation(NamedTuple):
    """The log-likelihood l(v) but for a constant, its gradient (2,), and its curvature.

    expected: Fisher's information, (2, 2), ``1/2 tr(C^-1 N_a C^-1 N_b)``.
    observed: minus the second derivative, (2, 2), ``u^T N_a P N_b u - 1/2 tr(...)``: another one,
    where the residuals are not the white noise that they are taken for.
    """

    value: float
    gradient: Array
    expected: Array
    observed: Array
    optimum: Array


def _evaluate(covariance: Array, jacobian: Array, residual: Array, variance: Array) -> _Evaluation:
    count, d = len(residual), jacobian.shape[-1]
    noisy = covariance.copy()
    diagonal = np.arange(6)
    noisy[:, diagonal, diagonal] += np.repeat(variance, 3)
    lower = np.linalg.cholesky(noisy)
    log_det = 2.0 * float(np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())
    inverse = np.linalg.inv(lower)
    columns = np.concatenate([jacobian, residual[..., None]], axis=-1)
    white = (inverse @ columns).reshape(6 * count, d + 1)
    # NumPy's annotation leaves out that mode="r" returns an array alone.
    root = np.asarray(np.linalg.qr(white[:, :d], mode="r"))
    optimum = -np.linalg.solve(root, np.linalg.solve(root.T, white[:, :d].T @ white[:, d]))
    left = white[:, :d] @ optimum + white[:, d]
    unwhiten = inverse.swapaxes(-1, -2)
    weight = unwhiten @ unwhiten.swapaxes(-1, -2)
    weighted = unwhiten @ white[:, :d].reshape(count, 6, d)
    u = (unwhiten @ left.reshape(count, 6, 1))[..., 0]
    log_lever = 2.0 * np.log(np.abs(np.diagonal(root))).sum()
    value = -0.5 * float(log_det + log_lever + left @ left)
    gradient, expected, square = np.zeros(2), np.zeros((2, 2)), np.zeros((2, 2))
    pulled = np.zeros((2, d))
    for a, rows in enumerate(_GROUPS):
        seen = np.linalg.solve(root.T, weighted[:, rows].reshape(3 * count, d).T)
        trace = np.einsum("mii->", weight[:, rows, rows]) - (seen**2).sum()
        gradient[a] = -0.5 * (trace - (u[:, rows] ** 2).sum())
        pulled[a] = seen @ u[:, rows].reshape(-1)
        for b, others in enumerate(_GROUPS):
            expected[a, b] = 0.5 * (weight[:, rows, others] ** 2).sum()
            across = (weight[:, rows, others] @ u[:, others, None])[..., 0]
            square[a, b] = (u[:, rows] * across).sum()
    observed = square - pulled @ pulled.T - expected
    return _Evaluation(value, gradient, expected, observed, optimum)


def _scoring_step(variance: Array, at: _Evaluation, information: Array) -> Array:
    """A step of scoring, the variances kept from falling below zero."""
    free = (variance > 0.0) | (at.gradient > 0.0)
    # Covariances of 1e160 and more leave nothing to be known of the noise, not even its scale.
    free &= np.diagonal(information) > 0.0
    step = np.zeros(2)
    if free.any():
        step[free] = np.linalg.solve(information[np.ix_(free, free)], at.gradient[free])
    return np.maximum(variance + step, 0.0) - variance


def _maximize(
    covariance: Array, jacobian: Array, residual: Array, variance: Array
) -> tuple[Array, Array, bool]:
    """The variances (2,), the gauge's optimum (d,) there, and whether it converged."""
    at = _evaluate(covariance, jacobian, residual, variance)
    for iteration in range(_MAX_STEPS):
        # From afar the expected information finds the scale; near the end Newton's step converges.
        newton = iteration > 0 and np.linalg.eigvalsh(at.observed)[0] > 0.0
        step = _scoring_step(variance, at, at.observed if newton else at.expected)
        if float(at.gradient @ step) < _GAIN:
            return variance, at.optimum, True
        for _ in range(_MAX_HALVINGS):
            proposed = _evaluate(covariance, jacobian, residual, variance + step)
            if proposed.value > at.value:
                break
            step = 0.5 * step
        else:
            return variance, at.optimum, False
        variance, at = variance + step, proposed
    return variance, at.optimum, False


def noise_equivalent_error(
    ground_truth: Array,
    covariance: Array,
    estimate: Array,
    gauge: Gauge,
    alignment: Similarity,
) -> NoiseEquivalent:
    """The noise-equivalent error of a window.

    ground_truth, estimate: (M, 4, 4). gauge: with its scale held, where it is not observed.
    covariance: (M, 6, 6); of a joint covariance, block rows (M, p + 1, 6, 6), each pose's own is
    used: its correlations are the ground truth's, and the estimate's error is most of what is seen.
    alignment: the likeliest one, from `absolute`, where the residuals are linearised.

    Raises ValueError where there are fewer poses than the gauge has freedoms to take.
    """
    if 6 * len(ground_truth) < gauge.dimension + 2:
        raise ValueError(f"{len(ground_truth)} poses are too few to find their noise")
    own = covariance if covariance.ndim == 3 else covariance[:, 0]
    centre = ground_truth[:, :3, 3].mean(axis=0)
    variance, converged = np.zeros(2), False
    for linearization in range(_LINEARIZATIONS):
        aligned = alignment.apply(estimate)
        residual = absolute_residual(ground_truth, aligned)
        jacobian = gauge.jacobian(residual, aligned, centre)
        if linearization == 0:
            mean_square = np.array([(residual[:, rows] ** 2).mean() for rows in _GROUPS])
            expected = np.array([np.einsum("mii->m", own[:, g, g]).mean() / 3 for g in _GROUPS])
            variance = np.maximum(mean_square - expected, 0.1 * mean_square)
        before = variance
        variance, optimum, converged = _maximize(own, jacobian, residual, variance)
        if linearization and np.allclose(variance, before, rtol=1e-3, atol=0.0):
            break
        # The scale never falls by more than half in one step.
        if gauge.has_scale:
            optimum[-1] = max(optimum[-1], -0.5)
        alignment = gauge.perturb(alignment, centre, optimum)
    translation, rotation = np.sqrt(variance)
    return NoiseEquivalent(float(translation), float(rotation), converged)
