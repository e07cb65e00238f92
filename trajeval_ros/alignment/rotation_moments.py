# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The mean squared rotation error under an alignment that is known only afterwards.

The rotation part of ATE is the RMS of the angle of ``R_gt^T Q R_est``, where Q is the alignment
of all poses together. The angle is that of ``Q M`` with ``M = R_est R_gt^T``, and its square is
not a finite polynomial in M: no fixed set of sums gives it exactly. But it is very smooth, so a
local expansion does. `RotationMoments` cuts SO(3) into fixed cells, keeps for each cell that
occurs the moments up to order four of its members about its centre, and expands the squared
angle there for whatever Q it is asked about.

Expansion. With ``phi = Log(B)``, ``tau = |phi|^2``, ``m = phi . zeta``, ``n = |zeta|^2``,

    |Log(Exp(zeta) B)|^2 = tau + 2 m + S + S'/3 + S''/12 + O(|zeta|^5)
    S   = k n + kappa m^2,    k = (theta/2) cot(theta/2),    kappa = (1 - k) / tau
    S'  = a m n + b m^3,      a = 2 dk + 2 kappa k,          b = 2 dkappa + 2 kappa^2
    S'' = a k n^2 + (2 da + a kappa + 3 b k) m^2 n + (2 db + 3 b kappa) m^4

where d is the derivative by tau: along ``Exp(t zeta) B``, m is half the derivative of tau and
``dm/dt = zeta^T J_l(phi)^-1 zeta = S``; the rest follows by the chain rule.

Accuracy, measured against the angles themselves (``test/alignment/test_rotation_moments.py``):
relative to the RMS better than 1e-9 while the errors stay below 0.5 rad, better than 1e-7 up to
2.5 rad, and typically a hundred times better than that. Next to pi the squared angle has a
ridge, and cells on it are wrong by up to 1 %; a mean over errors which are half turns says
nothing anyway.

Memory: a cell takes 0.3 kB. Errors of a few degrees occupy some ten cells, those of a body frame
that differs, spread over a sphere, a few thousand; all of SO(3) has 66,000, 21 MB.
"""

import itertools

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3

Array = npt.NDArray[np.float64]

CELL = 0.125
"""Edge of a cell in the chart of rotation vectors, rad."""

_ORDER = 4
# Monomials of zeta up to order four as sorted index tuples: (), (0,), ... (2, 2, 2, 2).
_MONOMIALS = [
    indices
    for order in range(_ORDER + 1)
    for indices in itertools.combinations_with_replacement(range(3), order)
]
_POSITION = {indices: position for position, indices in enumerate(_MONOMIALS)}


def _full_indices(order: int) -> npt.NDArray[np.int64]:
    """Where each entry of the symmetric tensor of that order, (3,) * order, is stored."""
    indices = np.empty((3,) * order, dtype=np.int64)
    for entry in itertools.product(range(3), repeat=order):
        indices[entry] = _POSITION[tuple(sorted(entry))]
    return indices


_TENSOR = [_full_indices(order) for order in range(_ORDER + 1)]

# kappa(tau) converges for tau < (2 pi)^2; tau is at most pi^2, so the terms fall by 4 at least and
# 30 of them leave 1e-18.
_KAPPA: Array = np.array(se3.cotangent_series(30))
_DKAPPA: Array = _KAPPA[1:] * np.arange(1, len(_KAPPA))
_DDKAPPA: Array = _DKAPPA[1:] * np.arange(1, len(_DKAPPA))


class RotationMoments:
    """Running moments of rotations (.., 3, 3), enough for the mean of their squared angles.

    The result does not depend on how the rotations are cut into batches, except for round-off.
    """

    def __init__(self) -> None:
        self._count = 0
        self._anchor: Array | None = None
        self._codes: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._centres: Array = np.zeros((0, 3))
        self._moments: Array = np.zeros((0, len(_MONOMIALS)))

    @property
    def count(self) -> int:
        """Number of rotations."""
        return self._count

    @property
    def cells(self) -> int:
        """Number of cells in memory."""
        return len(self._codes)

    def update(self, rotations: Array) -> None:
        """Add rotations M, (N, 3, 3)."""
        if len(rotations) == 0:
            return
        if self._anchor is None:
            # The first one is the origin of the chart, whatever the batches.
            self._anchor = rotations[0].copy()
        from_anchor = se3.log_so3(rotations @ self._anchor.T)
        keys = np.rint(from_anchor / CELL).astype(np.int64)
        centres: Array = keys * np.float64(CELL)
        zeta = se3.log_so3(se3.exp_so3(from_anchor) @ se3.exp_so3(-centres))
        # |key| is at most pi / CELL < 64 in each coordinate.
        codes = (keys + 64) @ np.array([128 * 128, 128, 1])
        order = np.argsort(codes, kind="stable")
        first = np.flatnonzero(np.diff(codes[order], prepend=-1))
        moments = np.add.reduceat(_monomials(zeta)[order], first)
        self._add_cells(codes[order[first]], centres[order[first]], moments)
        self._count += len(rotations)

    def _add_cells(self, codes: npt.NDArray[np.int64], centres: Array, moments: Array) -> None:
        """Add moments (K, 35) to the cells of the given codes (K,), new ones among them."""
        new = ~np.isin(codes, self._codes, assume_unique=True)
        if new.any():
            self._codes = np.concatenate((self._codes, codes[new]))
            order = np.argsort(self._codes)
            self._codes = self._codes[order]
            self._centres = np.concatenate((self._centres, centres[new]))[order]
            empty = np.zeros((int(new.sum()), len(_MONOMIALS)))
            self._moments = np.concatenate((self._moments, empty))[order]
        self._moments[np.searchsorted(self._codes, codes)] += moments

    def mean_square_angle(self, rotation: Array) -> float:
        """The mean over all M of the squared angle of ``rotation @ M``, rad^2.

        Raises:
            ValueError: no rotations so far.
        """
        if self._anchor is None:
            raise ValueError("there are no rotations")
        # The angle of Q Exp(zeta) C is that of its conjugate Exp(zeta) C Q.
        phi = se3.log_so3(se3.exp_so3(self._centres) @ self._anchor @ rotation)
        tau = np.sum(phi * phi, axis=-1)
        powers = tau[:, np.newaxis] ** np.arange(len(_KAPPA))
        kappa, dkappa, ddkappa = (powers[:, : len(c)] @ c for c in (_KAPPA, _DKAPPA, _DDKAPPA))
        k = 1 - tau * kappa
        dk = -kappa - tau * dkappa
        ddk = -2 * dkappa - tau * ddkappa
        a = 2 * dk + 2 * kappa * k
        b = 2 * dkappa + 2 * kappa**2
        da = 2 * ddk + 2 * (dkappa * k + kappa * dk)
        db = 2 * ddkappa + 4 * kappa * dkappa

        # Sums over the members of each cell: m1n1 of m n, and so on.
        t0, t1, t2, t3, t4 = (self._moments[:, indices] for indices in _TENSOR)
        m1 = np.einsum("ca,ca->c", t1, phi)
        m2 = np.einsum("cab,ca,cb->c", t2, phi, phi)
        n1 = np.einsum("caa->c", t2)
        m1n1 = np.einsum("cabb,ca->c", t3, phi)
        m3 = np.einsum("cabd,ca,cb,cd->c", t3, phi, phi, phi)
        n2 = np.einsum("caabb->c", t4)
        m2n1 = np.einsum("cabdd,ca,cb->c", t4, phi, phi)
        m4 = np.einsum("cabde,ca,cb,cd,ce->c", t4, phi, phi, phi, phi)
        sums = (
            t0 * tau
            + 2 * m1
            + (k * n1 + kappa * m2)
            + (a * m1n1 + b * m3) / 3
            + (a * k * n2 + (2 * da + a * kappa + 3 * b * k) * m2n1 + (2 * db + 3 * b * kappa) * m4)
            / 12
        )
        # A sum of squares; where all are round-off, so is their sum, and then of either sign.
        return max(float(np.sum(sums)), 0.0) / self._count


def _monomials(zeta: Array) -> Array:
    """The monomials of zeta (N, 3) up to order four, (N, 35)."""
    columns: dict[tuple[int, ...], Array] = {(): np.ones(len(zeta))}
    for indices in _MONOMIALS[1:]:
        columns[indices] = columns[indices[:-1]] * zeta[:, indices[-1]]
    return np.stack(list(columns.values()), axis=-1)
