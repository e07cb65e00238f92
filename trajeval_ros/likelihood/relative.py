# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The generalized relative error (``docs/method.md``, section 3).

The error of the step from pose i-1 to pose i, and what the ground truth's error makes of it::

    e_i = Log( (T_gt_{i-1}^-1 T_gt_i)^-1 (T_est_{i-1}^-1 T_est_i) )
        = -A_i xi_{i-1} + xi_i,        A_i = Ad( T_gt_i^-1 T_gt_{i-1} ),    xi ~ N(0, V)

The adjoint is that of the *inverse* step (the paper prints the step's own). ``e = Q xi`` has the
covariance ``Q V Q^T``, whose block bandwidth is one more than that of V.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops, se3
from trajeval_ros.likelihood.band import BandFactor, empty_band, factorize, fill_band
from trajeval_ros.likelihood.gaussian import (
    LOG_2PI,
    NOTHING,
    CovarianceError,
    GaussianLogLikelihood,
)
from trajeval_ros.likelihood.independent import is_for_loops
from trajeval_ros.likelihood.innovations import IndependentRecursion, JointRecursion
from trajeval_ros.likelihood.joint import FactorRows

Array = npt.NDArray[np.float64]

# So many poses' matrices stay in the processor's cache.
_POSES_PER_PIECE = 256

# Where the variances of poses differ by more, the factor of ``Q V Q^T`` has seven digits and fewer.
_WIDEST_SPREAD = 1e10


def relative_error(ground_truth: Array, estimate: Array) -> tuple[Array, Array]:
    """The errors of the steps between consecutive poses, and their adjoints.

    ground_truth, estimate: (M, 4, 4), each in a world of its own.
    Returns e, (M-1, 6), in the body frame at the step's end, and A, (M-1, 6, 6).
    """
    if loops.there():
        return _relative_error(loops.doubles(ground_truth), loops.doubles(estimate))
    backwards = se3.inverse(ground_truth[1:]) @ ground_truth[:-1]
    error = se3.compose(backwards, se3.inverse(estimate[:-1]), estimate[1:])
    return se3.log(error), se3.adjoint(backwards)


def _relative_error(ground_truth: Array, estimate: Array) -> tuple[Array, Array]:
    """`relative_error` in C."""
    count = max(len(ground_truth) - 1, 0)
    error, adjoint = np.empty((count, 6)), np.empty((count, 6, 6))
    series = se3.LOGARITHM_TABLE, len(se3.LOGARITHM_TABLE)
    loops.call("relative_steps", count, ground_truth, estimate, *series, error, adjoint)
    return error, adjoint


def covariance_blocks(covariance: Array | FactorRows, bandwidth: int) -> Array | FactorRows:
    """A covariance's block rows, filled up with zeros to a bandwidth.

    covariance: (M, 6, 6), poses independent of each other; or (M, p + 1, 6, 6), [i, k] being the
    covariance of pose i with pose i - k; or the rows of its factor, which are returned as they are.
    Returns (M, bandwidth + 1, 6, 6). Raises ValueError where ``p > bandwidth``.
    """
    if isinstance(covariance, FactorRows):
        return covariance
    return padded_blocks(covariance, bandwidth)


def padded_blocks(covariance: Array, bandwidth: int) -> Array:
    """Block rows (M, bandwidth + 1, 6, 6), as `covariance_blocks`."""
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


class RelativeSteps(NamedTuple):
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


def block_bandwidth(covariance: Array | FactorRows) -> int:
    """The p of `covariance_blocks`; 0 for the rows of a factor, which know theirs."""
    if isinstance(covariance, FactorRows) or covariance.ndim == 3:
        return 0
    return int(covariance.shape[1]) - 1


def joined_blocks(first: Array | FactorRows, second: Array | FactorRows) -> Array | FactorRows:
    """Consecutive block rows of one covariance, or of its factor, as one."""
    if isinstance(second, FactorRows):
        return first + second if isinstance(first, FactorRows) else second
    assert not isinstance(first, FactorRows)
    return np.concatenate([first, second])


def own_covariance(blocks: Array | FactorRows) -> Array:
    """Each pose's own covariance, (M, 6, 6)."""
    return blocks.own if isinstance(blocks, FactorRows) else blocks[:, 0]


class RunningRelative:
    """The relative error over a trajectory that arrives batch by batch.

    One more pose costs the same however many there were. It owns the state of the recursion.
    However a trajectory is cut into batches, the numbers are the same but for round-off.
    """

    def __init__(self, bandwidth: int | None = 0) -> None:
        """bandwidth: the block bandwidth of V; 0 where poses' errors are independent.

        None: it is not known, and the rows of V's factor are given.
        """
        self._bandwidth = bandwidth or 0
        self._recursion = (
            IndependentRecursion() if bandwidth == 0 else JointRecursion(self._bandwidth)
        )
        self._ground_truth = np.zeros((0, 4, 4))
        self._estimate = np.zeros((0, 4, 4))
        self._blocks: Array | FactorRows = np.zeros((0, self._bandwidth + 1, 6, 6))
        self._total = NOTHING

    @property
    def total(self) -> GaussianLogLikelihood:
        """The log-likelihood of all the steps so far."""
        return self._total

    def update(
        self, ground_truth: Array, covariance: Array | FactorRows, estimate: Array
    ) -> RelativeSteps:
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
        blocks = joined_blocks(self._blocks, covariance_blocks(covariance, self._bandwidth))
        error, adjoint = relative_error(poses, estimates)
        if not np.isfinite(error).all():
            raise ValueError("a pose is not finite")
        try:
            chi2, log_det = self._recursion.update(error, adjoint, blocks)
        except CovarianceError as wrong:
            raise CovarianceError(wrong.index + first) from None
        steps = RelativeSteps(error, adjoint, chi2, log_det)
        self._ground_truth, self._estimate = poses[-1:].copy(), estimates[-1:].copy()
        self._blocks = blocks[-1:] if isinstance(blocks, FactorRows) else blocks[-1:].copy()
        self._total += steps.total
        return steps


def steps_likelihood(error: Array, adjoint: Array, covariance: Array) -> GaussianLogLikelihood:
    """``log N(e; 0, Q V Q^T)`` of a window's steps at once.

    Of independent poses by the loop of `RunningRelative`, where it is there, else by LAPACK's band
    Cholesky.

    error, adjoint: e, (M-1, 6) and A, (M-1, 6, 6), from `relative_error` or `RelativeSteps`.
    covariance: V of the M poses, as in `covariance_blocks`.

    The factor L of the explicit ``Q V Q^T`` gives ``x = (L L^T)^-1 e``, and then
    ``chi2 = 2 e^T x - (Q^T x)^T V (Q^T x)``, which is off only to second order in the error of L.
    The log-determinant is off to first order: by 1e-11 of itself at most in 30 s of real data, by
    1e-8 where covariances differ by six orders of magnitude from pose to pose. `RunningRelative`
    does not lose these digits, and takes ten times as long.

    Raises CovarianceError as `RunningRelative.update`, and where the variances of an axis differ
    by more than ten orders of magnitude: nothing is left of L's digits there.
    """
    if len(error) == 0:
        return NOTHING
    bandwidth = block_bandwidth(covariance)
    blocks = padded_blocks(covariance, bandwidth)
    if is_for_loops(blocks):
        try:
            own, log_det = IndependentRecursion().update(error, adjoint, blocks)
        except CovarianceError as wrong:
            raise CovarianceError(wrong.index + 1) from None
        return GaussianLogLikelihood(float(own.sum()), float(log_det.sum()), 6 * len(error))
    variances = np.diagonal(blocks[:, 0], axis1=-2, axis2=-1)
    far = (variances > _WIDEST_SPREAD * variances.min(axis=0)).any(axis=-1)
    if far.any():
        raise CovarianceError(int(np.argmax(far)))
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


def relative(
    ground_truth: Array, covariance: Array | FactorRows, estimate: Array
) -> GaussianLogLikelihood:
    """The relative likelihood of a whole window.

    ground_truth, estimate: (M, 4, 4). covariance: as in `covariance_blocks`.
    Raises as `RunningRelative.update`.
    """
    if isinstance(covariance, FactorRows):
        return RunningRelative(None).update(ground_truth, covariance, estimate).total
    error, adjoint = relative_error(ground_truth, estimate)
    if not np.isfinite(error).all():
        raise ValueError("a pose is not finite")
    return steps_likelihood(error, adjoint, covariance)
