# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The covariance of the ground truth's errors at different times (``docs/method.md``).

With a segment's weight w, scale s, map B from local to body coordinates, and posterior
cross-covariance C (over s²) given the larger of the two queries' sets of samples,

    V_ij = D_i [ Σ_seg  w_i w_j  B_i s_i C(t_i, t_j) s_j B_jᵀ ] D_jᵀ

for all poses i, j that share segments, and zero for the others. Each C is a covariance matrix, so
each term is positive semi-definite, their sum is, and whatever D_i are. They are chosen so that
``V_ii`` is the blended ``Σ_i``: with M_i the bracket for j = i,

    D_i = (Σ_i M_i⁻¹)^½,        D M Dᵀ = D D M = Σ    (as f(Σ M⁻¹) M = M f(Σ M⁻¹)ᵀ for any power f),

which, unlike Cholesky factors, does not depend on the choice of body axes, and is the identity
where one segment alone answers.

A smooth process that is asked at close intervals has a V that is singular but for round-off. As
much of the variance P of each coordinate as round-off may disturb is therefore taken to be white,
M_i being as much larger and so V_ii just the same::

    α P + β k(0) (1 + √P / n)

The first term is for the factorisation of V. The second is for C itself, a difference of numbers of
the size of the process's variance k(0), whose error grows with the weights u that a posterior mean
gives the samples: as their noise n comes through, ``P >= n² |u|²``. For a
process of a metre's standard deviation and a noise of a millimetre these are tenths of a
micrometre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.adaptation import Epoch
from trajeval_ros.ground_truth.segment import Answer, Segment

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]

# α: a Cholesky factor of n rows perturbs a matrix of unit diagonal by about n units of round-off
# (Higham, Accuracy and Stability of Numerical Algorithms, theorem 10.3), and n is some thousands:
# 2**14 * 2**-52.
_WHITE = 2.0**-38
# β: as in `regression`, the difference is known to 64 units of round-off of k(0).
_WHITE_PRIOR = 2.0**-46


@dataclass(frozen=True, slots=True)
class Part:
    """An epoch's share in the answers to a batch of queries.

    ``index``: its segment's, and its own in that; ``asked`` (n,) are the indices of the queries it
    answers, in their order; ``share`` (n,) the segment's weights there.
    """

    index: tuple[int, int]
    segment: Segment
    epoch: Epoch
    asked: Indices
    share: Array


class _Queries(NamedTuple):
    """A segment's queries: each one's place in the order of all, its stamp, and D w B s."""

    places: npt.NDArray[np.int64]
    stamps: Stamps
    roots: Array


_NO_QUERIES = _Queries(
    np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty((0, 6, 6))
)


class JointCovariance:
    """Relates each pose to those before it; owner of what it remembers of these.

    A segment's queries are remembered until one comes that the segment has no share in. All sums
    are over arrays whose shapes depend on the queries alone, so the digits do not depend on how
    they are cut into batches.
    """

    def __init__(self) -> None:
        """Start without queries."""
        self._count = 0
        self._remembered: dict[tuple[int, int], _Queries] = {}

    def extend(
        self,
        stamps: Stamps,
        until: Stamps,
        covariances: Array,
        parts: list[Part],
        answers: Answer,
    ) -> tuple[Array, ...]:
        """Return for each of the next poses its covariances ``E[ξ_j ξ_iᵀ]`` with poses j before it.

        (p, 6, 6) for each, those of the p poses just before it, oldest first: all others are zero.
        ``stamps`` and ``until`` (q,) as in :meth:`GroundTruth.posterior`, not decreasing, nor from
        call to call; ``covariances`` (q, 6, 6), blended; ``answers`` of all parts, one after the
        other.
        """
        ends = np.cumsum([len(part.asked) for part in parts])
        own = [answers[end - len(part.asked) : end] for part, end in zip(parts, ends, strict=True)]
        unmixing = _unmixing(covariances, parts, own)
        places = self._count + np.arange(len(stamps))
        extended = {}
        for part, answer in zip(parts, own, strict=True):
            asked = part.asked
            roots = unmixing[asked] @ (answer.to_body * answer.scales[:, None])
            before = self._remembered.get(part.index, _NO_QUERIES)
            extended[part.index] = _Queries(
                np.concatenate([before.places, places[asked]]),
                np.concatenate([before.stamps, stamps[asked]]),
                np.concatenate([before.roots, part.share[:, None, None] * roots]),
            )
        first = np.full(len(stamps), self._count + len(stamps))
        for part in parts:
            oldest = extended[part.index].places[0]
            first[part.asked] = np.minimum(first[part.asked], oldest)
        cross = [np.zeros((int(n), 6, 6)) for n in places - first]
        for part in parts:
            self._add(cross, part, extended[part.index], until)
        self._count += len(stamps)
        self._remembered = {
            part.index: extended[part.index] for part in parts if part.asked[-1] == len(stamps) - 1
        }
        return tuple(cross)

    def _add(self, cross: list[Array], part: Part, queries: _Queries, until: Stamps) -> None:
        """Add one segment's term to the covariances of its new queries with all of its queries."""
        known = len(queries.places) - len(part.asked)
        rows = part.segment.cross_variances(part.epoch, queries.stamps, known, until[part.asked])
        for j, (row, target) in enumerate(zip(rows, part.asked, strict=True)):
            earlier = known + j
            if earlier:
                weighted = (queries.roots[:earlier] * row[:, None]).reshape(-1, 6)
                block = weighted @ queries.roots[earlier].T
                # The queries of a segment follow each other.
                cross[target][-earlier:] += block.reshape(earlier, 6, 6)


def _unmixing(covariances: Array, parts: list[Part], answers: list[Answer]) -> Array:
    """D of the module's description; (q, 6, 6)."""
    mixed = np.zeros_like(covariances)
    for part, answer in zip(parts, answers, strict=True):
        root = answer.to_body * answer.scales[:, None]
        variance, noise = part.epoch.process.variances
        white = (
            _WHITE_PRIOR * variance * (1.0 + np.sqrt(answer.variances) / (answer.scales * noise))
        )
        square = (part.share**2)[:, None, None]
        more = np.einsum("qij,qj,qkj->qik", root, white, root)
        mixed[part.asked] += square * ((1.0 + _WHITE) * answer.covariances + more)
    lower = np.linalg.cholesky(mixed)
    inverse = np.linalg.inv(lower)
    value, vector = np.linalg.eigh(inverse @ covariances @ inverse.swapaxes(-1, -2))
    left = lower @ vector
    right = vector.swapaxes(-1, -2) @ inverse
    return np.asarray((left * np.sqrt(value)[:, None]) @ right)
