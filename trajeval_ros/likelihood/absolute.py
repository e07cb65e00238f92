# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The generalized absolute error with exact residuals (``docs/method.md``, section 4).

With the residuals ``eps_i(g) = Log(T_gt_i^-1 g T_est_i)`` under an alignment g, the absolute
likelihood is the integral of ``N(eps(g); 0, V)`` over the gauge. Its Laplace approximation is

    -1/2 (chi2(g*) + log|V| + log|Lambda| + (6 M - d) log 2 pi),    Lambda = J^T V^-1 J,

at the g* that minimises ``chi2 = eps^T V^-1 eps``, with J the residuals' derivative by the
gauge's d freedoms (see `gauge` for the measure).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.alignment.gauge import SE3, Gauge, Similarity
from trajeval_ros.alignment.observability import Observability, Spread, observability
from trajeval_ros.likelihood.band import BandFactor, BandWhitener
from trajeval_ros.likelihood.gaussian import NOTHING, CovarianceError, GaussianLogLikelihood
from trajeval_ros.likelihood.independent import absorbed, is_for_loops
from trajeval_ros.likelihood.information import Information
from trajeval_ros.likelihood.joint import FactorRows
from trajeval_ros.likelihood.relative import (
    block_bandwidth,
    covariance_blocks,
    joined_blocks,
    own_covariance,
)
from trajeval_ros.likelihood.search import (
    Ending,
    Problem,
    absolute_residual,
    best_perturbation,
    log_scale_std,
    minimize,
    pose_alignment,
    start_alignment,
)

__all__ = ["Absolute", "Ending", "RunningAbsolute", "absolute", "absolute_residual"]

Array = npt.NDArray[np.float64]


class Absolute(NamedTuple):
    """The absolute error of a set of poses, under the alignment that makes it likeliest.

    likelihood: the integral over the gauge, by Laplace's approximation; None where it diverges, a
    free scale not being determined (see ``observability``).
    alignment: g*, the likelihood-weighted alignment.
    covariance: of the alignment, (7, 7), as in `Gauge.covariance`; a scale that is not determined
    is held, and has an infinite variance.
    residual: eps(g*), (M, 6), body frame.
    observability: what of the gauge these poses determine.
    ending, iterations: of the search.
    """

    likelihood: GaussianLogLikelihood | None
    alignment: Similarity
    covariance: Array
    residual: Array
    observability: Observability
    ending: Ending
    iterations: int


def absolute(
    ground_truth: Array,
    covariance: Array | FactorRows,
    estimate: Array,
    gauge: Gauge = SE3,
    start: Similarity | None = None,
) -> Absolute:
    """The absolute error of a whole set of poses, fully nonlinear.

    ground_truth, estimate: (M, 4, 4), M > 0, each in a world of its own.
    covariance: as in `relative.covariance_blocks`.
    start: where the search begins; Umeyama's alignment, or a pose's, if not given.

    Raises CovarianceError where the covariance is not positive definite, ValueError where there is
    no pose or one is not finite.
    """
    if len(ground_truth) == 0:
        raise ValueError("there is no pose to align")
    if not (np.isfinite(ground_truth).all() and np.isfinite(estimate).all()):
        raise ValueError("a pose is not finite")
    blocks = covariance_blocks(covariance, block_bandwidth(covariance))
    spread = Spread.none().absorb(ground_truth[:, :3, 3], own_covariance(blocks))
    centre = spread.mean
    problem = Problem(ground_truth, estimate, _factor(blocks), gauge, centre)
    if start is None:
        start = start_alignment(problem)
    observed = observability(gauge, spread)
    if observed.scale_observed:
        best, information, ending, iterations = minimize(problem, start)
        observed = observability(gauge, spread, log_scale_std(gauge, information))
    if not observed.scale_observed:
        problem = problem._replace(gauge=gauge.without_scale())
        best, information, ending, iterations = minimize(problem, start)
    return Absolute(
        information.integral() if observed.scale_observed else None,
        best,
        _alignment_covariance(problem.gauge, best, centre, information, observed),
        problem.residuals(best),
        observed,
        ending,
        iterations,
    )


def _factor(blocks: Array | FactorRows) -> BandFactor | FactorRows | Array:
    if is_for_loops(blocks):
        return blocks[:, 0]
    return blocks if isinstance(blocks, FactorRows) else BandFactor.of(blocks)


def _alignment_covariance(
    gauge: Gauge,
    alignment: Similarity,
    centre: Array,
    information: Information,
    observed: Observability,
) -> Array:
    covariance = gauge.covariance(alignment, centre, information.covariance())
    if not observed.scale_observed:
        covariance[6, 6] = np.inf
    return covariance


# The poses before the anchor settles, and then the poses from one anchor to the next.
_POSES_PER_ANCHOR = 64


def _next_anchoring(count: int) -> int:
    """After how many poses the anchor is moved next: 1, 2, 4 ... 64, 128, 192 ..."""
    if count < _POSES_PER_ANCHOR:
        return 1 << count.bit_length()
    return (count // _POSES_PER_ANCHOR + 1) * _POSES_PER_ANCHOR


class RunningAbsolute:
    """The absolute likelihood over a trajectory that arrives batch by batch, in bounded memory.

    Each residual is exact at an anchor, the alignment that was the best when its pose came, and is
    linear in the alignment from there. The anchor moves to the best alignment after 1, 2, 4 ... 64,
    128, 192 ... poses, and the centre of perturbations with it to the last pose. The first 64 poses
    are kept, and their residuals are then computed anew; later, what was summed before is carried
    over to first order. So the figures depend on the poses alone, not on how they are cut into
    batches, and one more pose costs the same however many there were.
    """

    def __init__(self, gauge: Gauge = SE3, bandwidth: int = 0) -> None:
        """bandwidth: the block bandwidth of V; 0 where poses' errors are independent.

        It does not matter where the rows of V's factor are given.
        """
        self._gauge = gauge
        self._bandwidth = bandwidth
        self._whitener = BandWhitener(bandwidth, gauge.dimension + 1)
        self._anchor: Similarity | None = None
        self._centre = np.zeros(3)
        self._information = Information.none(gauge.dimension)
        self._spread = Spread.none()
        # What follows from these two and the anchor, as long as they are the same: each is asked
        # for several times a batch.
        self._observed: tuple[Information, Spread, Observability] | None = None
        self._best: tuple[Information, Spread, Array] | None = None
        # Ground truth, covariance blocks and estimate of the first poses.
        self._first: tuple[Array, Array | FactorRows, Array] | None = None

    @property
    def total(self) -> GaussianLogLikelihood | None:
        """The log-likelihood so far; None where a free scale is not determined (yet).

        It has d degrees of freedom less than there are errors.
        """
        if self._anchor is None:
            return NOTHING
        if not self._scale_is_observed:
            return None
        # Of perturbations of the best alignment, about the same centre.
        delta, information = self._optimum(), self._information
        left_over = information.root @ delta + information.offset
        chi2 = float(left_over @ left_over)
        log_det = 2.0 * self._gauge.log_volume(delta)
        return information.integral() + GaussianLogLikelihood(chi2, log_det, 0)

    @property
    def alignment(self) -> Similarity | None:
        """The best alignment so far; None before the first pose."""
        if self._anchor is None:
            return None
        delta = self._optimum()
        return self._gauge.perturb(self._anchor, self._centre, delta)

    @property
    def covariance(self) -> Array | None:
        """The covariance of `alignment`, (7, 7), as `Absolute.covariance`; None without a pose."""
        alignment = self.alignment
        if alignment is None:
            return None
        observed = self.observability
        gauge, information = self._gauge, self._information
        if not observed.scale_observed:
            gauge = gauge.without_scale()
            information = information.leading(gauge.dimension)
        return _alignment_covariance(gauge, alignment, self._centre, information, observed)

    @property
    def observability(self) -> Observability:
        """What of the gauge the poses so far determine."""
        information, spread = self._information, self._spread
        known = self._observed
        if known is None or known[0] is not information or known[1] is not spread:
            std = log_scale_std(self._gauge, information)
            known = information, spread, observability(self._gauge, spread, std)
            self._observed = known
        return known[2]

    @property
    def _scale_is_observed(self) -> bool:
        """That of `observability`, which is not worked out for a gauge without a scale."""
        return not self._gauge.has_scale or self.observability.scale_observed

    def update(self, ground_truth: Array, covariance: Array | FactorRows, estimate: Array) -> None:
        """Take the next poses.

        Arguments as for `RunningRelative.update`, and errors; the state then stays as it was.
        """
        blocks = covariance_blocks(covariance, self._bandwidth)
        before = vars(self) | {"_whitener": self._whitener.copy()}
        start = 0
        try:
            while start < len(ground_truth):
                count = self._spread.count
                piece = slice(start, start + _next_anchoring(count) - count)
                self._take(ground_truth[piece], blocks[piece], estimate[piece])
                start = piece.stop
        except ValueError as wrong:
            vars(self).update(before)
            if isinstance(wrong, CovarianceError):
                raise CovarianceError(start + wrong.index) from None
            raise

    def _take(self, ground_truth: Array, blocks: Array | FactorRows, estimate: Array) -> None:
        """Take poses up to where the anchor moves next, at the most."""
        anchor, centre = self._anchor, self._centre
        if anchor is None:
            anchor = pose_alignment(ground_truth[0], estimate[0], self._gauge)
            centre = ground_truth[0, :3, 3].copy()
        self._add(ground_truth, blocks, estimate, anchor, centre)
        self._anchor, self._centre = anchor, centre
        before = self._spread.count
        self._spread = self._spread.absorb(ground_truth[:, :3, 3], own_covariance(blocks))
        if before < _POSES_PER_ANCHOR:
            new = (ground_truth, blocks, estimate)
            self._first = new if self._first is None else _joined(self._first, new)
        if self._spread.count == _next_anchoring(before):
            if self._first is not None:
                self._settle(*self._first, anchor)
            else:
                self._move_anchor(anchor, ground_truth[-1, :3, 3].copy())
        if self._spread.count >= _POSES_PER_ANCHOR:
            self._first = None

    def _add(
        self,
        ground_truth: Array,
        blocks: Array | FactorRows,
        estimate: Array,
        anchor: Similarity,
        centre: Array,
    ) -> None:
        """Add the residuals at the anchor, and their derivatives, to the sums."""
        if is_for_loops(blocks):
            poses = ground_truth, estimate, blocks[:, 0]
            self._information = absorbed(self._information, poses, anchor, self._gauge, centre)
            return
        aligned = anchor.apply(estimate)
        residual = absolute_residual(ground_truth, aligned)
        if not np.isfinite(residual).all():
            raise ValueError("a pose is not finite")
        jacobian = self._gauge.jacobian(residual, aligned, centre)
        columns = np.concatenate([jacobian, residual[..., None]], axis=-1)
        white, log_det = self._whitener.update(blocks, columns)
        self._information = self._information.absorb(
            white.reshape(-1, columns.shape[-1]), float(log_det.sum())
        )

    def _optimum(self) -> Array:
        """The best perturbation of the anchor, (d,); the scale held where it is not determined."""
        information, spread = self._information, self._spread
        known = self._best
        if known is None or known[0] is not information or known[1] is not spread:
            if self._scale_is_observed:
                best = best_perturbation(self._gauge, information)
            else:
                leading = information.leading(information.dimension - 1)
                best = np.append(leading.optimum(), 0.0)
            known = self._best = information, spread, best
        return known[2]

    def _settle(
        self,
        ground_truth: Array,
        blocks: Array | FactorRows,
        estimate: Array,
        anchor: Similarity,
    ) -> None:
        """Sum the first poses' residuals anew, at the best alignment for all of them."""
        gauge = self._gauge
        if not observability(gauge, self._spread).scale_observed:
            gauge = gauge.without_scale()
        problem = Problem(ground_truth, estimate, _factor(blocks), gauge, self._spread.mean)
        best, *_ = minimize(problem, start_alignment(problem, anchor))
        self._anchor, self._centre = best, ground_truth[-1, :3, 3].copy()
        self._whitener = BandWhitener(self._bandwidth, self._gauge.dimension + 1)
        self._information = Information.none(self._gauge.dimension)
        self._add(ground_truth, blocks, estimate, self._anchor, self._centre)

    def _move_anchor(self, anchor: Similarity, centre: Array) -> None:
        """Carry the sums over to the best alignment, to first order."""
        delta = self._optimum()
        change = np.eye(len(delta) + 1)
        change[:-1, :-1] = self._gauge.rebase(delta, centre - self._centre)
        change[:-1, -1] = delta
        self._anchor = self._gauge.perturb(anchor, self._centre, delta)
        self._information = self._information.change(change[:-1, :-1], delta)
        self._whitener.transform(change)
        self._centre = centre


_Poses = tuple[Array, Array | FactorRows, Array]


def _joined(first: _Poses, second: _Poses) -> _Poses:
    return (
        np.concatenate([first[0], second[0]]),
        joined_blocks(first[1], second[1]),
        np.concatenate([first[2], second[2]]),
    )
