# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The generalized relative error (``docs/method.md``, section 3).

The error of the step from pose i-1 to pose i, and what the ground truth's error makes of it::

    e_i = Log( (T_gt_{i-1}^-1 T_gt_i)^-1 (T_est_{i-1}^-1 T_est_i) )
        = -A_i xi_{i-1} + xi_i,        A_i = Ad( T_gt_i^-1 T_gt_{i-1} ),    xi ~ N(0, V)

The adjoint is that of the *inverse* step (the paper prints the step's own). ``e = Q xi`` has the
covariance ``Q V Q^T``, whose block bandwidth is one more than that of V.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from trajeval_ros import se3
from trajeval_ros.metrics.band import BandFactor, BandWhitener, empty_band, factorize, fill_band
from trajeval_ros.metrics.gaussian import (
    LOG_2PI,
    NOTHING,
    CovarianceError,
    GaussianLogLikelihood,
)

Array = npt.NDArray[np.float64]

# The reference of the joint recursion moves this often, to keep the lever arms short.
_POSES_PER_REFERENCE = 64
# So many poses' matrices stay in the processor's cache.
_POSES_PER_PIECE = 256


def relative_error(ground_truth: Array, estimate: Array) -> tuple[Array, Array]:
    """The errors of the steps between consecutive poses, and their adjoints.

    ground_truth, estimate: (M, 4, 4), each in a world of its own.
    Returns e, (M-1, 6), in the body frame at the step's end, and A, (M-1, 6, 6).
    """
    backwards = se3.inverse(ground_truth[1:]) @ ground_truth[:-1]
    error = se3.compose(backwards, se3.inverse(estimate[:-1]), estimate[1:])
    return se3.log(error), se3.adjoint(backwards)


def covariance_blocks(covariance: Array, bandwidth: int) -> Array:
    """A covariance's block rows, filled up with zeros to a bandwidth.

    covariance: (M, 6, 6), poses independent of each other; or (M, p + 1, 6, 6), [i, k] being the
    covariance of pose i with pose i - k.
    Returns (M, bandwidth + 1, 6, 6). Raises ValueError where ``p > bandwidth``.
    """
    blocks = covariance[:, None] if covariance.ndim == 3 else covariance
    missing = bandwidth + 1 - blocks.shape[1]
    if missing < 0:
        raise ValueError(
            f"the covariance has block bandwidth {blocks.shape[1] - 1}, more than {bandwidth}"
        )
    if missing == 0:
        return blocks
    return np.concatenate([blocks, np.zeros((len(blocks), missing, 6, 6))], axis=1)


def step_covariance(adjoint: Array, blocks: Array) -> Array:
    """``Q V Q^T`` in block rows, from those of V.

    adjoint: A, (n + b, 6, 6): those of b = bandwidth + 1 earlier steps first (zeros where there
    are none), then those of the n steps.
    blocks: V, (n + 1, bandwidth + 1, 6, 6), from the pose before the n steps on.
    Returns (n, bandwidth + 2, 6, 6).
    """
    before = blocks.shape[1]
    here = adjoint[before:]
    # cross[i, k] = cov(e_i, xi_{i-k}) = V_{i,i-k} - A_i V_{i-1,i-k}
    cross = np.empty((len(here), before + 1, 6, 6))
    np.matmul(here[:, None], -blocks[:-1], out=cross[:, 1:])
    cross[:, 1:-1] += blocks[1:, 1:]
    cross[:, 0] = blocks[1:, 0]
    if before > 1:
        cross[:, 0] -= here @ blocks[1:, 1].swapaxes(-1, -2)
    # cov(e_i, e_{i-k}) = cov(e_i, xi_{i-k}) - cov(e_i, xi_{i-k-1}) A_{i-k}^T
    for k in range(before):
        earlier = adjoint[before - k : len(adjoint) - k]
        cross[:, k] -= cross[:, k + 1] @ earlier.swapaxes(-1, -2)
    return cross


@dataclass(frozen=True, slots=True)
class RelativeSteps:
    """The relative errors of n consecutive steps, and each step's log-likelihood given the past.

    error: e, (n, 6), body frame at the step's end, metres and radians.
    adjoint: A, (n, 6, 6).
    chi2, log_det: (n,); their sums are those of ``log N(e; 0, Q V Q^T)``.
    """

    error: Array
    adjoint: Array
    chi2: Array
    log_det: Array

    @property
    def log_likelihood(self) -> Array:
        """Each step's share of the log-likelihood, (n,), nats."""
        return -0.5 * (self.chi2 + self.log_det + 6 * LOG_2PI)

    @property
    def total(self) -> GaussianLogLikelihood:
        """The log-likelihood of all the steps, given what was before them."""
        return GaussianLogLikelihood(
            float(self.chi2.sum()), float(self.log_det.sum()), 6 * len(self.chi2)
        )


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

    Returns the innovations (n, 6), the factors of S (n, 6, 6), and m and P after the last step.
    Raises CovarianceError, its index counting steps.
    """
    innovation, factor = np.empty(error.shape), np.empty(adjoint.shape)
    # Each step's S needs the P of the one before: inherently sequential.
    for i, (e, a, sigma) in enumerate(zip(error, adjoint, covariance, strict=True)):
        _check(sigma, i)
        innovation[i] = e + a @ mean
        spread = a @ spread @ a.T
        lower, _ = lapack.dpotrf(spread + sigma, lower=1)
        factor[i] = lower
        gain, _ = lapack.dpotrs(lower, sigma, lower=1)
        mean = innovation[i] @ gain
        spread = spread @ gain
        spread = 0.5 * (spread + spread.T)
    return innovation, factor, mean, spread


def _check(covariance: Array, step: int) -> None:
    """Raise CovarianceError where a covariance, (6, 6), is not positive definite."""
    lower, wrong = lapack.dpotrf(covariance, lower=1)
    # LAPACK lets NaN through.
    if wrong or not math.isfinite(lower[5, 5]):
        raise CovarianceError(step)


class _IndependentRecursion:
    """The innovations of steps between poses whose errors are independent of each other."""

    def __init__(self) -> None:
        self._mean = np.zeros(6)
        self._spread: Array | None = None

    def update(self, error: Array, adjoint: Array, blocks: Array) -> tuple[Array, Array]:
        """Each step's chi2 and log-determinant. blocks: from the pose before the steps on."""
        sigma = blocks[:, 0]
        if self._spread is None:
            _check(sigma[0], -1)
            spread = sigma[0]
        else:
            spread = self._spread
        innovation, factor, self._mean, self._spread = _innovations(
            error, adjoint, sigma[1:], self._mean, spread
        )
        white = np.linalg.solve(np.tril(factor), innovation[..., None])[..., 0]
        log_det = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=-1)
        return (white**2).sum(axis=-1), log_det


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


class _JointRecursion:
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

    def update(self, error: Array, adjoint: Array, blocks: Array) -> tuple[Array, Array]:
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

    def _begin(self, blocks: Array) -> None:
        """The first pose: its error alone is what tells of the gauge."""
        try:
            white, _ = self._whitener.update(blocks, np.eye(6, 7)[None])
        except CovarianceError:
            raise CovarianceError(-1) from None
        self._spread_root = np.linalg.inv(white[0, :, :6])

    def _take(self, error: Array, adjoint: Array, blocks: Array) -> tuple[Array, Array]:
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


class RunningRelative:
    """The relative error over a trajectory that arrives batch by batch.

    One more pose costs the same however many there were. It owns the state of the recursion.
    However a trajectory is cut into batches, the numbers are the same but for round-off.
    """

    def __init__(self, bandwidth: int = 0) -> None:
        """bandwidth: the block bandwidth of V; 0 where poses' errors are independent."""
        self._bandwidth = bandwidth
        self._recursion = _JointRecursion(bandwidth) if bandwidth else _IndependentRecursion()
        self._ground_truth = np.zeros((0, 4, 4))
        self._estimate = np.zeros((0, 4, 4))
        self._blocks = np.zeros((0, bandwidth + 1, 6, 6))
        self._total = NOTHING

    @property
    def total(self) -> GaussianLogLikelihood:
        """The log-likelihood of all the steps so far."""
        return self._total

    def update(self, ground_truth: Array, covariance: Array, estimate: Array) -> RelativeSteps:
        """Take the next poses, and return the steps that end at them.

        ground_truth, estimate: (n, 4, 4), each in a world of its own.
        covariance: of the ground truth's error (right perturbation), as in `covariance_blocks`.

        Returns n steps; one less where these are the first poses.
        Raises CovarianceError where a covariance is not positive definite, ValueError where a pose
        is not finite; the state then stays as it was.
        """
        if len(ground_truth) == 0:
            return RelativeSteps(np.zeros((0, 6)), np.zeros((0, 6, 6)), np.zeros(0), np.zeros(0))
        first = 1 - len(self._ground_truth)
        poses = np.concatenate([self._ground_truth, ground_truth])
        estimates = np.concatenate([self._estimate, estimate])
        blocks = np.concatenate([self._blocks, covariance_blocks(covariance, self._bandwidth)])
        error, adjoint = relative_error(poses, estimates)
        if not np.isfinite(error).all():
            raise ValueError("a pose is not finite")
        try:
            chi2, log_det = self._recursion.update(error, adjoint, blocks)
        except CovarianceError as wrong:
            raise CovarianceError(wrong.index + first) from None
        steps = RelativeSteps(error, adjoint, chi2, log_det)
        self._ground_truth, self._estimate = poses[-1:].copy(), estimates[-1:].copy()
        self._blocks = blocks[-1:].copy()
        self._total += steps.total
        return steps


def steps_likelihood(error: Array, adjoint: Array, covariance: Array) -> GaussianLogLikelihood:
    """``log N(e; 0, Q V Q^T)`` of a window's steps at once, by LAPACK's band Cholesky.

    error, adjoint: e, (M-1, 6) and A, (M-1, 6, 6), from `relative_error` or `RelativeSteps`.
    covariance: V of the M poses, as in `covariance_blocks`.

    The factor L of the explicit ``Q V Q^T`` gives ``x = (L L^T)^-1 e``, and then
    ``chi2 = 2 e^T x - (Q^T x)^T V (Q^T x)``, which is off only to second order in the error of L.
    The log-determinant is off to first order: by 1e-11 of itself at most in 30 s of real data, by
    1e-8 where covariances differ by six orders of magnitude from pose to pose. `RunningRelative`
    does not lose these digits, and takes ten times as long.

    Raises CovarianceError as `RunningRelative.update`.
    """
    if len(error) == 0:
        return NOTHING
    bandwidth = 0 if covariance.ndim == 3 else covariance.shape[1] - 1
    blocks = covariance_blocks(covariance, bandwidth)
    band = empty_band(len(error), bandwidth + 1)
    adjoints = np.concatenate([np.zeros((bandwidth + 1, 6, 6)), adjoint])
    # Piece by piece, so that what is passed on stays in the processor's cache.
    for start in range(0, len(error), _POSES_PER_PIECE):
        end = min(start + _POSES_PER_PIECE, len(error))
        piece = step_covariance(adjoints[start : end + bandwidth + 1], blocks[start : end + 1])
        fill_band(band, piece, start)
    try:
        factor = BandFactor(factorize(band))
    except CovarianceError as wrong:
        raise CovarianceError(wrong.index + 1) from None
    solution = factor.solve(error)
    weight = np.zeros((len(blocks), 6))
    weight[1:] = solution
    weight[:-1] -= (solution[:, None] @ adjoint)[:, 0]
    square = (weight[:, None] @ blocks[:, 0] @ weight[..., None]).sum()
    for k in range(1, min(bandwidth + 1, len(blocks))):
        square += 2.0 * (weight[k:, None] @ blocks[k:, k] @ weight[:-k, :, None]).sum()
    chi2 = 2.0 * float((error * solution).sum()) - float(square)
    return GaussianLogLikelihood(chi2, factor.log_det, 6 * len(error))


def relative(ground_truth: Array, covariance: Array, estimate: Array) -> GaussianLogLikelihood:
    """The relative likelihood of a whole window.

    ground_truth, estimate: (M, 4, 4). covariance: as in `covariance_blocks`.
    Raises as `RunningRelative.update`.
    """
    error, adjoint = relative_error(ground_truth, estimate)
    if not np.isfinite(error).all():
        raise ValueError("a pose is not finite")
    return steps_likelihood(error, adjoint, covariance)
