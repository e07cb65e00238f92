# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The generalized absolute error to first order, the paper's S_AE (``docs/method.md``, section 4).

With the error of one pose unknown, the relative errors give, to first order, those of all others::

    eps_i = Ad(T_gt_i^-1 T_gt_ref) (eps_ref + c_i),    c_i = c_{i-1} + Ad(T_gt_ref^-1 T_gt_i) e_i

(with ``c_ref = 0``), and ``N(eps; 0, V)`` integrated over eps_ref is the absolute likelihood. It
equals the relative one exactly, whatever V is, and is computed along another path: V is factored
and not ``Q V Q^T``. Their difference is a check of both.
"""

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.likelihood.band import BandWhitener
from trajeval_ros.likelihood.gaussian import NOTHING, CovarianceError, GaussianLogLikelihood
from trajeval_ros.likelihood.independent import absorbed_columns, is_for_loops
from trajeval_ros.likelihood.information import Information
from trajeval_ros.likelihood.joint import FactorRows
from trajeval_ros.likelihood.relative import block_bandwidth, covariance_blocks, relative_error

Array = npt.NDArray[np.float64]

# The reference is moved this often, so that c_i and the lever arms in the adjoints are those of a
# short piece, a kilometre or a thousand from where the trajectory began.
_POSES_PER_REFERENCE = 64


class FirstOrderAbsolute:
    """The first-order absolute likelihood over a trajectory that arrives batch by batch.

    One more pose costs the same however many there were. It owns the state of the recursion.
    However a trajectory is cut into batches, the numbers are the same but for round-off.
    """

    def __init__(self, bandwidth: int = 0) -> None:
        """bandwidth: the block bandwidth of V; 0 where poses' errors are independent.

        It does not matter where the rows of V's factor are given.
        """
        self._bandwidth = bandwidth
        self._whitener = BandWhitener(bandwidth, 7)
        self._ground_truth = np.zeros((0, 4, 4))
        self._estimate = np.zeros((0, 4, 4))
        # On the error of the last pose so far, in its body frame.
        self._information = Information.none(6)

    @property
    def total(self) -> GaussianLogLikelihood:
        """The log-likelihood so far, with six degrees of freedom less than there are errors."""
        return self._information.integral() if self._information.count else NOTHING

    def update(
        self,
        ground_truth: Array,
        covariance: Array | FactorRows,
        estimate: Array,
        error: Array | None = None,
    ) -> None:
        """Take the next poses.

        Arguments as for `RunningRelative.update`, and errors; the state then stays as it was.
        error: of the steps that end at these poses, where it is known: that update's.
        """
        blocks = covariance_blocks(covariance, self._bandwidth)
        before = vars(self) | {"_whitener": self._whitener.copy()}
        start = 0
        try:
            for start in range(0, len(ground_truth), _POSES_PER_REFERENCE):
                piece = slice(start, start + _POSES_PER_REFERENCE)
                # The first pose of all ends no step.
                first = len(ground_truth) - len(error) if error is not None else 0
                steps = slice(max(start - first, 0), piece.stop - first)
                known = None if error is None else error[steps]
                self._take(ground_truth[piece], blocks[piece], estimate[piece], known)
        except ValueError as wrong:
            vars(self).update(before)
            if isinstance(wrong, CovarianceError):
                raise CovarianceError(start + wrong.index) from None
            raise

    def _take(
        self,
        ground_truth: Array,
        blocks: Array | FactorRows,
        estimate: Array,
        error: Array | None,
    ) -> None:
        n = len(ground_truth)
        poses = np.concatenate([self._ground_truth, ground_truth])
        estimates = np.concatenate([self._estimate, estimate])
        if error is None:
            error, _ = relative_error(poses, estimates)
        if not np.isfinite(error).all():
            raise ValueError("a pose is not finite")
        from_reference = se3.inverse(poses[0]) @ poses
        to_reference = se3.adjoint(from_reference)
        shift = np.zeros((len(poses), 6))
        np.cumsum((to_reference[1:] @ error[..., None])[..., 0], axis=0, out=shift[1:])
        columns = np.empty((n, 6, 7))
        columns[..., :6] = se3.adjoint(se3.inverse(from_reference[-n:]))
        columns[..., 6:] = columns[..., :6] @ shift[-n:, :, None]
        if is_for_loops(blocks):
            information = absorbed_columns(self._information, blocks[:, 0], columns)
        else:
            white, log_det = self._whitener.update(blocks, columns)
            information = self._information.absorb(white.reshape(-1, 7), float(log_det.sum()))
        # eps_ref = Ad(T_gt_ref^-1 T_gt_last) eps_last - c_last
        change = np.zeros((7, 7))
        change[:6, :6], change[:6, 6], change[6, 6] = to_reference[-1], -shift[-1], 1.0
        self._information = information.change(change[:6, :6], change[:6, 6])
        self._whitener.transform(change)
        self._ground_truth, self._estimate = poses[-1:].copy(), estimates[-1:].copy()


def absolute_first_order(
    ground_truth: Array, covariance: Array | FactorRows, estimate: Array
) -> GaussianLogLikelihood:
    """The first-order absolute likelihood of a whole window.

    ground_truth, estimate: (M, 4, 4). covariance: as in `covariance_blocks`.
    """
    running = FirstOrderAbsolute(block_bandwidth(covariance))
    running.update(ground_truth, covariance, estimate)
    return running.total
