# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likelihoods by their definitions: dense matrices, loops, nothing clever."""

import numpy as np
from scipy.stats import multivariate_normal

from trajeval_ros import se3


def dense(covariance):
    """V from independent blocks (M, 6, 6), or from block rows (M, p + 1, 6, 6)."""
    blocks = covariance[:, None] if covariance.ndim == 3 else covariance
    n = len(blocks)
    v = np.zeros((6 * n, 6 * n))
    for i in range(n):
        for k in range(min(i + 1, blocks.shape[1])):
            j = i - k
            v[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] = blocks[i, k]
            v[6 * j : 6 * j + 6, 6 * i : 6 * i + 6] = blocks[i, k].T
    return v


def block_rows(v, bandwidth):
    """The block rows (M, bandwidth + 1, 6, 6) of a dense V."""
    n = len(v) // 6
    rows = np.zeros((n, bandwidth + 1, 6, 6))
    for i in range(n):
        for k in range(min(i, bandwidth) + 1):
            j = i - k
            rows[i, k] = v[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
    return rows


def relative_errors(ground_truth, estimate):
    """e, (M-1, 6)."""
    errors = []
    for i in range(len(ground_truth) - 1):
        step = np.linalg.solve(ground_truth[i], ground_truth[i + 1])
        error = np.linalg.solve(step, np.linalg.solve(estimate[i], estimate[i + 1]))
        errors.append(se3.log(error))
    return np.array(errors).reshape(-1, 6)


def q_matrix(ground_truth, as_printed=False):
    """Q of ``e = Q xi``; with the step's own adjoint in place of its inverse's, as printed."""
    n = len(ground_truth)
    q = np.zeros((6 * (n - 1), 6 * n))
    for i in range(n - 1):
        step = np.linalg.solve(ground_truth[i], ground_truth[i + 1])
        adjoint = se3.adjoint(step if as_printed else np.linalg.inv(step))
        q[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = -adjoint
        q[6 * i : 6 * i + 6, 6 * i + 6 : 6 * i + 12] = np.eye(6)
    return q


def relative(ground_truth, covariance, estimate, as_printed=False):
    """chi2 and log-determinant of ``N(e; 0, Q V Q^T)``."""
    e = relative_errors(ground_truth, estimate).ravel()
    q = q_matrix(ground_truth, as_printed)
    v = q @ dense(covariance) @ q.T
    if len(e) == 0:
        return 0.0, 0.0
    return float(e @ np.linalg.solve(v, e)), float(np.linalg.slogdet(v)[1])


def relative_by_scipy(ground_truth, covariance, estimate):
    """``log N(e; 0, Q V Q^T)`` by scipy."""
    e = relative_errors(ground_truth, estimate).ravel()
    q = q_matrix(ground_truth)
    v = q @ dense(covariance) @ q.T
    return multivariate_normal(np.zeros(len(e)), 0.5 * (v + v.T)).logpdf(e)


def first_order(ground_truth, covariance, estimate):
    """chi2 and log-determinant of the paper's S_AE: eps_h = A_h1 eps_1 + sum_k A_h,k+1 e_k."""
    n = len(ground_truth)
    errors = relative_errors(ground_truth, estimate)
    rows, constant = [], []
    for h in range(n):
        inverse = np.linalg.inv(ground_truth[h])
        rows.append(se3.adjoint(inverse @ ground_truth[0]))
        constant.append(
            sum(
                (se3.adjoint(inverse @ ground_truth[k + 1]) @ errors[k] for k in range(h)),
                np.zeros(6),
            )
        )
    return integral(np.concatenate(rows), np.concatenate(constant), dense(covariance))


def integral(jacobian, residual, v):
    """chi2 and log-determinant of the integral over x of N(J x + r; 0, V)."""
    lower = np.linalg.cholesky(v)
    white = np.linalg.solve(lower, np.column_stack([jacobian, residual]))
    j, r = white[:, :-1], white[:, -1]
    x = np.linalg.lstsq(j, -r, rcond=None)[0]
    chi2 = float(((j @ x + r) ** 2).sum())
    sign, log_det = np.linalg.slogdet(j.T @ j)
    assert sign > 0
    return chi2, float(2.0 * np.log(np.diagonal(lower)).sum() + log_det)
