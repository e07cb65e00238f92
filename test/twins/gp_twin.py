# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gaussian-process regression by dense linear algebra: slow and obvious."""

import numpy as np
from scipy.special import gammaln

FLAT = 1e3  # standard deviation of the mean, in units of the signal's
NU = 20.0


def correlation(name, u):
    """A kernel at scaled distance u, from its textbook formula."""
    if name == "SquaredExponential":
        return np.exp(-0.5 * u**2)
    if name == "Exponential":
        return np.exp(-u)
    if name == "Matern32":
        return (1 + np.sqrt(3) * u) * np.exp(-np.sqrt(3) * u)
    if name == "Matern52":
        return (1 + np.sqrt(5) * u + 5 * u**2 / 3) * np.exp(-np.sqrt(5) * u)
    assert name == "Matern72"
    a = np.sqrt(7) * u
    return (1 + a + 2 * a**2 / 5 + a**3 / 15) * np.exp(-a)


def kernel(names, components, first, second):
    """The sum of kernels between times, (n,) and (m,)."""
    apart = np.abs(first[:, None] - second[None, :])
    return sum(
        c.std**2 * correlation(name, apart / c.length_scale)
        for name, c in zip(names, components, strict=False)
    )


def posterior(names, components, times, values, noise, asked):
    """Mean (q, c) and joint covariance (q, q): simple kriging, plus the unknown mean's part."""
    covariance = kernel(names, components, times, times) + np.diag(noise)
    cross = kernel(names, components, asked, times)
    prior = kernel(names, components, asked, asked)
    ones = np.ones((len(times), 1))
    weight = np.linalg.solve(covariance, ones)
    information = 1.0 / (FLAT**2 * sum(c.std**2 for c in components)) + (ones.T @ weight)[0, 0]
    mean = weight.T @ values / information
    rest = 1.0 - cross @ weight
    return (
        cross @ np.linalg.solve(covariance, values - ones @ mean) + mean,
        prior - cross @ np.linalg.solve(covariance, cross.T) + rest @ rest.T / information,
    )


def square(names, components, times, values, noise):
    """``tr(xᵀ (K + flat 11ᵀ)⁻¹ x)``."""
    flat = FLAT**2 * sum(c.std**2 for c in components)
    covariance = kernel(names, components, times, times) + flat + np.diag(noise)
    return float(np.sum(values * np.linalg.solve(covariance, values)))


def log_likelihood(names, components, noise_std, times, values, variances):
    """A segment's Student-t log-likelihood with its constant mean integrated out."""
    count, coordinates = values.shape
    covariance = kernel(names, components, times, times) + np.diag(noise_std**2 + variances)
    inverse = np.linalg.inv(covariance)
    ones = np.ones((count, 1))
    information = ones.T @ inverse @ ones
    projection = inverse - inverse @ ones @ np.linalg.inv(information) @ ones.T @ inverse
    squared = float(np.trace(values.T @ projection @ values))
    freedom = coordinates * (count - 1)
    log_det = np.linalg.slogdet(covariance)[1] + np.log(information[0, 0])
    return (
        gammaln((NU + freedom) / 2)
        - gammaln(NU / 2)
        - freedom / 2 * np.log(NU * np.pi)
        - coordinates / 2 * log_det
        - (NU + freedom) / 2 * np.log1p(squared / NU)
    )


def slope(names, components, times, values, noise, asked):
    """Mean (c,) and variance of the motion's derivative at one time: its covariances by formula."""
    covariance = kernel(names, components, times, times) + np.diag(noise)
    cross, prior = np.zeros(len(times)), 0.0
    apart = asked - times
    for name, c in zip(names, components, strict=False):
        if name == "Exponential":
            continue  # noise
        u = np.abs(apart) / c.length_scale
        cross += np.sign(apart) * c.std**2 / c.length_scale * _derivative(name, u)
        curvature = {"SquaredExponential": 1, "Matern32": 3, "Matern52": 5 / 3, "Matern72": 7 / 5}
        prior += c.std**2 / c.length_scale**2 * curvature[name]
    ones = np.ones(len(times))
    weight = np.linalg.solve(covariance, ones)
    information = 1.0 / (FLAT**2 * sum(c.std**2 for c in components)) + ones @ weight
    mean = weight @ values / information
    rest = -cross @ weight
    return (
        cross @ np.linalg.solve(covariance, values - ones[:, None] * mean),
        prior - cross @ np.linalg.solve(covariance, cross) + rest**2 / information,
    )


def _derivative(name, u):
    if name == "SquaredExponential":
        return -u * np.exp(-0.5 * u**2)
    if name == "Matern32":
        return -3 * u * np.exp(-np.sqrt(3) * u)
    if name == "Matern52":
        return -5 / 3 * u * (1 + np.sqrt(5) * u) * np.exp(-np.sqrt(5) * u)
    a = np.sqrt(7) * u
    return -np.sqrt(7) * a / 15 * (3 + 3 * a + a**2) * np.exp(-a)
