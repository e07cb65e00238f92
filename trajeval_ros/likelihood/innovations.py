# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The relative errors given the past ones: the block recursion of the running relative error.

See `relative`. Each class owns the state of one recursion over steps that arrive batch by batch.
"""

import math

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack, loops
from trajeval_ros.likelihood.band import BandWhitener
from trajeval_ros.likelihood.gaussian import CovarianceError, are_positive
from trajeval_ros.likelihood.joint import FactorRows

Array = npt.NDArray[np.float64]

# The reference of the joint recursion moves this often, to keep the lever arms short.
_POSES_PER_REFERENCE = 64


def _innovations(
    error: Array, adjoint: Array, covariance: Array, mean: Array, spread: Array
) -> tuple[Array, Array, Array, Array]:
    """Each step's error given the past: the block recursion of ``Q V Q^T``'s Cholesky factor.

    With eps_i ~ N(m, P) the gauge's error at pose i, given the errors up to there, the next step's
    error is ``e + A m ~ N(0, S)``, ``S = A P A^T + Sigma``, and then ``m, P`` are the old ones
    times ``S^-1 Sigma``: as products. The factor of the explicit ``Q V Q^T`` has the difference
    ``Sigma - Sigma S^-1 Sigma`` in their place, and loses up to ten digits where a long lever arm
    makes P's rotation small beside Sigma's (7 digits on KITTI's 3.7 km).

    error: (n, 6). adjoint: (n, 6, 6). covariance: Sigma at the steps' ends, (n, 6, 6).
    mean, spread: m, (6,) and P, (6, 6), before the first step.

    Returns chi2 and log-determinants of the innovations, (n,), and m and P after the last step.
    Raises CovarianceError, its index counting steps.
    """
    _check(covariance, 0)
    return (_by_loop if loops.there() else _by_lapack)(error, adjoint, covariance, mean, spread)


def _by_loop(
    error: Array, adjoint: Array, covariance: Array, mean: Array, spread: Array
) -> tuple[Array, Array, Array, Array]:
    """`_innovations` in C."""
    chi2, log_det = np.empty((2, len(error)))
    mean, spread = mean.copy(), spread.copy()
    given = map(loops.doubles, (error, adjoint, covariance))
    wrong = loops.call("innovations", len(error), *given, mean, spread, chi2, log_det)
    if wrong:
        # A step of 10,000 km: its lever arm leaves no digit of the noise.
        raise CovarianceError(wrong - 1)
    return chi2, log_det, mean, spread


def _by_lapack(
    error: Array, adjoint: Array, covariance: Array, mean: Array, spread: Array
) -> tuple[Array, Array, Array, Array]:
    """`_innovations` step by step."""
    innovation, factor = np.empty(error.shape), np.empty(adjoint.shape)
    state = np.concatenate([spread, mean[None]])
    # Each step's S needs the P of the one before: inherently sequential.
    for i, (e, a, sigma) in enumerate(zip(error, adjoint, covariance, strict=True)):
        state = state.dot(a.T)
        state[:6] = a.dot(state[:6])
        state[6] += e
        innovation[i] = state[6]
        factor[i], gain, wrong = lapack.dposv(state[:6] + sigma, sigma, lower=1)
        if wrong:
            raise CovarianceError(i)
        state = state.dot(gain)
        state[:6] = 0.5 * (state[:6] + state[:6].T)
    white = np.linalg.solve(np.tril(factor), innovation[..., None])[..., 0]
    log_det = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=-1)
    return (white**2).sum(axis=-1), log_det, state[6], state[:6]


def _check(covariance: Array, first: int) -> None:
    """Raise CovarianceError where one of the covariances, (n, 6, 6), is not positive definite.

    Its index counts from ``first``.
    """
    if are_positive(covariance):
        return
    try:
        # It lets NaN through.
        wrong = ~np.isfinite(np.linalg.cholesky(covariance)[:, 5, 5])
    except np.linalg.LinAlgError:
        wrong = np.array([not _has_factor(one) for one in covariance])
    if wrong.any():
        raise CovarianceError(first + int(np.argmax(wrong)))


def _has_factor(covariance: Array) -> bool:
    lower, wrong = lapack.dpotrf(covariance, lower=1)
    return not wrong and math.isfinite(lower[5, 5])


class IndependentRecursion:
    """The innovations of steps between poses whose errors are independent of each other."""

    def __init__(self) -> None:
        self._mean = np.zeros(6)
        self._spread: Array | None = None

    def update(
        self, error: Array, adjoint: Array, blocks: Array | FactorRows
    ) -> tuple[Array, Array]:
        """Each step's chi2 and log-determinant. blocks: from the pose before the steps on."""
        if isinstance(blocks, FactorRows):
            raise TypeError("the rows of a factor are those of a joint covariance")
        sigma = blocks[:, 0]
        if self._spread is None:
            _check(sigma[:1], -1)
            spread = sigma[0]
        else:
            spread = self._spread
        chi2, log_det, self._mean, self._spread = _innovations(
            error, adjoint, sigma[1:], self._mean, spread
        )
        return chi2, log_det


def _joint_innovations(
    white: Array, mean: Array, spread_root: Array
) -> tuple[Array, Array, Array, Array]:
    """Each pose's residual given the past, of whitened residuals affine in the gauge's error.

    white: ``[J r]``, (n, 6, 7); the residual of a pose is ``J d + r`` with unit covariance.
    mean, spread_root: of ``d ~ N(m, G G^T)``, (6,) and (6, 6), given what was before.

    Returns chi2 and log-determinants, (n,), of the residuals given the past, and m and G after it.
    ``G C^-T`` with ``C C^T = I + (J G)^T (J G)`` is the next G: again without a difference.
    """
    chi2, log_det = np.empty(len(white)), np.empty(len(white))
    identity = np.eye(6)
    # Each pose's covariance needs the G of the one before: inherently sequential.
    for i, columns in enumerate(white):
        residual = columns[:, :6] @ mean + columns[:, 6]
        seen = columns[:, :6] @ spread_root
        lower, _ = lapack.dpotrf(identity + seen @ seen.T, lower=1)
        innovation, _ = lapack.dtrtrs(lower, residual, lower=1)
        chi2[i] = innovation @ innovation
        log_det[i] = 2.0 * np.log(np.diagonal(lower)).sum()
        # J d + r = noise: G's part of the residual, S^-1 times it.
        weighted, _ = lapack.dtrtrs(lower, innovation, lower=1, trans=1)
        mean = mean - spread_root @ (seen.T @ weighted)
        lower, _ = lapack.dpotrf(identity + seen.T @ seen, lower=1)
        narrowed, _ = lapack.dtrtrs(lower, spread_root.T, lower=1)
        spread_root = narrowed.T
    return chi2, log_det, mean, spread_root


class JointRecursion:
    """The innovations of steps between poses whose errors are correlated over a few poses.

    The errors eps of all the poses are affine in that of a reference pose, by way of the steps':
    ``eps_i = A_i eps_{i-1} + e_i``. Whitened by V's factor they are independent of each other, and
    what they say of the reference is summed up, as Gaussian, from pose to pose.
    """

    def __init__(self, bandwidth: int) -> None:
        self._whitener = BandWhitener(bandwidth, 7)
        # Of the error of the last pose so far, given the steps up to there.
        self._mean = np.zeros(6)
        self._spread_root: Array | None = None

    def update(
        self, error: Array, adjoint: Array, blocks: Array | FactorRows
    ) -> tuple[Array, Array]:
        """Each step's chi2 and log-determinant. blocks: from the pose before the steps on."""
        before = self._whitener.copy(), self._mean, self._spread_root
        chi2, log_det = np.empty(len(error)), np.empty(len(error))
        try:
            if self._spread_root is None:
                self._begin(blocks[:1])
            for start in range(0, len(error), _POSES_PER_REFERENCE):
                piece = slice(start, start + _POSES_PER_REFERENCE)
                try:
                    chi2[piece], log_det[piece] = self._take(
                        error[piece], adjoint[piece], blocks[1:][piece]
                    )
                except CovarianceError as wrong:
                    raise CovarianceError(start + wrong.index) from None
        except CovarianceError:
            self._whitener, self._mean, self._spread_root = before
            raise
        return chi2, log_det

    def _begin(self, blocks: Array | FactorRows) -> None:
        """The first pose: its error alone is what tells of the gauge."""
        try:
            white, _ = self._whitener.update(blocks, np.eye(6, 7)[None])
        except CovarianceError:
            raise CovarianceError(-1) from None
        self._spread_root = np.asarray(np.linalg.inv(white[0, :, :6]), dtype=np.float64)

    def _take(
        self, error: Array, adjoint: Array, blocks: Array | FactorRows
    ) -> tuple[Array, Array]:
        columns = np.empty((len(error), 6, 7))
        last = np.eye(6, 7)
        # A product of all the adjoints so far: inherently sequential.
        for i, step in enumerate(adjoint):
            last = step @ last
            last[:, 6] += error[i]
            columns[i] = last
        white, noise_log_det = self._whitener.update(blocks, columns)
        assert self._spread_root is not None
        chi2, log_det, mean, root = _joint_innovations(white, self._mean, self._spread_root)
        # From the error of the reference to that of the last pose, the next reference.
        backward = np.eye(7)
        backward[:6, :6] = np.linalg.inv(last[:, :6])
        backward[:6, 6] = -backward[:6, :6] @ last[:, 6]
        self._whitener.transform(backward)
        self._mean = last[:, :6] @ mean + last[:, 6]
        self._spread_root = last[:, :6] @ root
        return chi2, log_det + noise_log_det
