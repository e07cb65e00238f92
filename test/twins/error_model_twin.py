# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model's likelihood by its dense covariance: slow, obvious."""

import numpy as np

from trajeval_ros import se3
from trajeval_ros.error_model.process import Kind, steps


def _blocks(groups, k):
    result = np.zeros((k, 2, 3, k, 2, 3))
    for g, block in enumerate(groups):
        for axis in range(3):
            result[:, g, axis, :, g, axis] = block
    return result.reshape(6 * k, 6 * k)


def covariance(kind, parameters, data):
    """Of the errors but for what is flat, (6N, 6N), and the flat states' columns (6N, 6 or 0).

    The states are ``A⁻¹ w``, written down row by row.
    """
    count, k = len(data.times), kind.components
    size = 6 * k
    groups = [
        steps(kind, each, np.diff(data.times), factors)
        for each, factors in zip(parameters, data.moved.T, strict=True)
    ]
    a, q = np.eye(count * size), np.zeros((count * size, count * size))
    prior = _blocks([g.prior for g in groups], k)
    flat = np.flatnonzero(np.diag(prior) == 0.0)
    proper = np.flatnonzero(np.diag(prior) > 0.0)
    q[np.ix_(proper, proper)] = np.linalg.inv(prior[np.ix_(proper, proper)])
    for i in range(count - 1):
        f = _blocks([g.transition[i] for g in groups], k)
        if kind is not Kind.WANDER:
            f[:3, 3:6] -= se3.hat(data.travel[i])
        here, later = (slice(j * size, (j + 1) * size) for j in (i, i + 1))
        a[later, here] = -f
        q[later, later] = _blocks([g.noise[i] for g in groups], k)
    inverse = np.linalg.inv(a)
    chosen = (np.arange(count)[:, None] * size + np.arange(6)).ravel()
    total = (inverse @ q @ inverse.T)[np.ix_(chosen, chosen)]
    for i in range(count):
        here = slice(6 * i, 6 * i + 6)
        jitter = np.repeat(data.measured[i] * np.exp(2.0 * parameters[:, 0]), 3)
        total[here, here] += data.covariance[i] + np.diag(jitter)
    return total, inverse[chosen][:, flat]


def log_likelihood(kind, parameters, data, gauge):
    """Restricted: the flat states, or the gauge, and the nuisances integrated out. And θ."""
    total, flat = covariance(kind, parameters, data)
    if kind is Kind.WANDER:
        flat = gauge.reshape(len(total), -1)
    columns = np.concatenate([data.nuisances.reshape(len(total), -1), flat], axis=1)
    prior = np.concatenate([data.precision, np.zeros(flat.shape[1])])
    y = data.errors.ravel()
    weighted = np.linalg.solve(total, np.column_stack([columns, y]))
    information = columns.T @ weighted[:, :-1] + np.diag(prior)
    theta = np.linalg.solve(information, columns.T @ weighted[:, -1])
    chi2 = y @ weighted[:, -1] - theta @ information @ theta
    dof = len(y) - len(prior)
    log_det = np.linalg.slogdet(total)[1] + np.linalg.slogdet(information)[1]
    return -0.5 * (chi2 + log_det + dof * np.log(2.0 * np.pi)), theta[: len(data.precision)]


def average_information(kind, parameters, data, gauge):
    """``½ (∂V/∂ψᵢ P z)ᵀ P (∂V/∂ψⱼ P z)``, V's derivatives by differences."""
    total, flat = covariance(kind, parameters, data)
    if kind is Kind.WANDER:
        flat = gauge.reshape(len(total), -1)
    columns = np.concatenate([data.nuisances.reshape(len(total), -1), flat], axis=1)
    prior = np.concatenate([data.precision, np.zeros(flat.shape[1])])
    weight = np.linalg.inv(total)
    information = columns.T @ weight @ columns + np.diag(prior)
    projection = weight - weight @ columns @ np.linalg.solve(information, columns.T @ weight)
    scores = projection @ data.errors.ravel()
    moved = []
    for index in np.ndindex(parameters.shape):
        step = np.zeros_like(parameters)
        step[index] = 1e-4
        later, earlier = (covariance(kind, parameters + s * step, data)[0] for s in (1, -1))
        moved.append((later - earlier) @ scores / 2e-4)
    moved = np.array(moved)
    return 0.5 * moved @ projection @ moved.T
