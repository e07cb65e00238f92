# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A regression with the states integrated out, by their information, which is block-tridiagonal.

Λ has m rows a pose; its blocks beside the diagonal join neighbouring poses. With ``Λ = L Lᵀ`` the
blocks of ``S = Λ⁻¹`` that are where Λ has some are what is known of a pose from both sides, less
what is counted twice, with L' the factor of the poses in reverse order:

    S_ii = (L_ii L_iiᵀ + L'_ii L'_iiᵀ - Λ_ii)⁻¹,   S_(i+1,i) = -S_(i+1,i+1) L_(i+1,i) L_ii⁻¹.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack, se3
from trajeval_ros.error_model.factored import backwards
from trajeval_ros.error_model.system import AXES, PREDICTED, Slopes, System, Told

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Factor:
    """L of n poses with m rows each, in LAPACK's lower band storage."""

    band: Array
    size: int

    @staticmethod
    def of(diagonal: Array, below: Array) -> Factor:
        """The factor. diagonal: (n, m, m); below: blocks (i + 1, i), (n - 1, m, m).

        Raises numpy.linalg.LinAlgError where the matrix is not positive definite.
        """
        band = _banded(diagonal, below)
        factor, info = lapack.dpbtrf(band, lower=1, overwrite_ab=1)
        if info != 0 or not np.isfinite(factor[0]).all():
            raise np.linalg.LinAlgError("the information matrix is not positive definite")
        return Factor(np.asarray(factor), diagonal.shape[1])

    @property
    def log_det(self) -> float:
        """``log |Λ|``."""
        return 2.0 * float(np.log(self.band[0]).sum())

    def forward(self, columns: Array) -> Array:
        """``L⁻¹ X`` of X (n, m, c)."""
        flat = columns.reshape(-1, columns.shape[-1])
        solution, _ = lapack.dtbtrs(self.band, flat, uplo="L")
        return np.ascontiguousarray(solution).reshape(columns.shape)

    def backward(self, columns: Array) -> Array:
        """``L⁻ᵀ X`` of X (n, m, c)."""
        flat = columns.reshape(-1, columns.shape[-1])
        solution, _ = lapack.dtbtrs(self.band, flat, uplo="L", trans="T")
        return np.ascontiguousarray(solution).reshape(columns.shape)

    def blocks(self) -> tuple[Array, Array]:
        """``L_ii`` (n, m, m) and ``L_(i+1,i)`` (n - 1, m, m)."""
        size, height = self.size, 2 * self.size
        columns = np.ascontiguousarray(self.band.T).reshape(-1, size, height)
        own, below = np.zeros((len(columns), size, size)), np.zeros((len(columns), size, size))
        for c in range(size):
            own[:, c:, c] = columns[:, c, : size - c]
            below[:, :, c] = columns[:, c, size - c : height - c]
        return own, below[:-1]

    def covariances(self, diagonal: Array, below: Array) -> tuple[Array, Array]:
        """``S_ii`` (n, m, m) and ``S_(i+1,i)`` (n - 1, m, m), of what this is the factor of."""
        own, beside = self.blocks()
        reverse, _ = Factor.of(diagonal[::-1], np.swapaxes(below, 1, 2)[::-1]).blocks()
        known = own @ np.swapaxes(own, 1, 2) - diagonal
        known += (reverse @ np.swapaxes(reverse, 1, 2))[::-1]
        found: Array = np.asarray(np.linalg.inv(known), np.float64)
        gains = np.asarray(beside @ np.linalg.inv(own[:-1]), np.float64)
        return found, np.asarray(-found[1:] @ gains)


def _banded(diagonal: Array, below: Array) -> Array:
    """Blocks (n, m, m) and those below them, (n - 1, m, m), in LAPACK's lower band storage."""
    count, size = diagonal.shape[:2]
    height = 2 * size
    columns = np.zeros((count, size, height))
    for c in range(size):
        columns[:, c, : size - c] = diagonal[:, c:, c]
        columns[:-1, c, size - c : height - c] = below[:, :, c]
    return columns.reshape(-1, height).T


class Information:
    """`Regressed`, all poses at once."""

    def __init__(self, system: System) -> None:
        """Factor the information of the states.

        Raises numpy.linalg.LinAlgError where a matrix is not positive definite.
        """
        self._system = system
        self._count, self._components = len(system.errors), system.moves.shape[1]
        size = 6 * self._components
        self._noise = system.covariance.copy()
        np.einsum("nii->ni", self._noise)[...] += np.repeat(system.jitter, AXES, axis=1)
        root = np.linalg.cholesky(self._noise)
        noise_log_det = 2.0 * float(np.log(np.einsum("nii->ni", root)).sum())
        if not np.isfinite(noise_log_det):
            raise np.linalg.LinAlgError("a pose's covariance is not positive definite")
        self._weight = np.linalg.inv(self._noise)
        self._transition = self._assembled(system.moves)
        self._transition[:, :3, 3:6] -= se3.hat(system.travel)
        self._step_weight = self._assembled(system.precision)
        onwards = self._step_weight @ self._transition
        own = np.zeros((self._count, size, size))
        own[:, :6, :6] = self._weight
        own[0] += self._assembled(system.prior[..., None])[0]
        own[1:] += self._step_weight
        own[:-1] += np.swapaxes(self._transition, 1, 2) @ onwards
        self._blocks = own, -onwards
        self._factor = Factor.of(*self._blocks)
        self.log_det = noise_log_det + system.process_log_det + self._factor.log_det
        both = system.both
        weighted = self._weight @ both
        right = np.zeros((self._count, size, both.shape[2]))
        right[:, :6] = weighted
        self._forward = self._factor.forward(right)
        taken = _rows(self._forward)
        self.normal: Array = _rows(both).T @ _rows(weighted) - taken.T @ taken

    def _assembled(self, groups: Array) -> Array:
        """Blocks (2, k, k, n) of translation and rotation, each on three axes; (n, m, m)."""
        k, n = self._components, groups.shape[-1]
        result = np.zeros((n, k, 2, 3, k, 2, 3))
        for g, block in enumerate(np.moveaxis(groups, -1, 1)):
            for axis in range(AXES):
                result[:, :, g, axis, :, g, axis] = block
        return result.reshape(n, 6 * k, 6 * k)

    def _traces(self, blocks: Array) -> Array:
        """Blocks (n, m, m), summed over each group's three axes; (2, k, k, n)."""
        k = self._components
        return np.asarray(np.einsum("ncgadga->gcdn", blocks.reshape(-1, k, 2, 3, k, 2, 3)))

    def _products(self, left: Array, right: Array) -> Array:
        """Of rows (n, m, c), summed over columns and each group's three axes; (2, k, k, n)."""
        left, right = (x.reshape(-1, self._components, 2, 3, x.shape[2]) for x in (left, right))
        return np.asarray(np.einsum("ncgax,ndgax->gcdn", left, right))

    def told(self, theta: Array, root: Array) -> Told:
        """What the data say."""
        system, f, w = self._system, self._transition, self._weight
        columns = self._factor.backward(self._forward @ _ends(root, theta))
        residual = system.both @ _ends(root, theta) - columns[:, :6]
        seen = w @ residual
        states, scores = columns[..., -1], seen[..., -1]
        own, beside = self._factor.covariances(*self._blocks)
        known = np.einsum("nij,nij->ni", w @ own[:, :6, :6], w)
        known += (seen[..., :-1] ** 2).sum(axis=2)
        onwards = f @ columns[:-1]
        ahead, before = columns[1:] - onwards, columns[:-1]
        after = np.swapaxes(beside, 1, 2)
        follows = f @ own[:-1]
        both = f @ after
        moved = own[1:] - both - np.swapaxes(both, 1, 2) + follows @ np.swapaxes(f, 1, 2)
        weight = system.precision
        moved = self._traces(moved) + self._products(ahead[..., :-1], ahead[..., :-1])
        earlier = self._traces(after - np.swapaxes(follows, 1, 2))
        earlier += self._products(before, ahead)
        last = columns[0, -PREDICTED:, :-1]
        first = np.einsum("ii->i", own[0])[-PREDICTED:] + (last**2).sum(axis=1)
        timed = float(system.prior[:, -1, -1].all())
        felt = (self._step_weight @ ahead[..., -1:])[..., 0]
        return Told(
            states,
            scores,
            felt,
            _grouped(scores**2),
            _grouped(np.einsum("nii->ni", w) - known),
            self._products(felt[..., None], felt[..., None]),
            AXES * weight - _times(_times(weight, moved), weight),
            timed * _times(earlier, weight)[:, -1],
            timed * first.reshape(2, AXES).sum(axis=1),
        )

    def average(self, told: Told, slopes: Slopes) -> tuple[Array, Array]:
        """With M the states' precision by the process, ``g = ∂M s = Aᵀ t`` of each parameter."""
        system, w, f = self._system, self._weight, self._transition
        p, k, count = len(slopes.noise), self._components, self._count
        into = np.zeros((count, k, 2, AXES, 2, p))  # g
        through = np.zeros_like(into)  # t
        back = np.zeros_like(into)
        errors = np.zeros((count, 2, AXES, 2, p))
        states = told.states.reshape(count, k, 2, AXES)
        felt = told.felt.reshape(-1, k, 2, AXES)
        for g in range(2):
            of_noise, of_moves = slopes.noise[:, g], slopes.moves[g]
            each = np.einsum("jcdn,nda->ncaj", of_noise, felt[:, :, g])
            each[..., -1] += np.einsum("cdn,nda->nca", of_moves, states[:-1, :, g])
            through[1:, :, g, :, g] = -np.einsum("cdn,ndaj->ncaj", system.precision[g], each)
            through[0, :, g, :, g] = np.einsum("jcd,da->caj", slopes.prior[:, g], states[0, :, g])
            # The last component alone follows from itself.
            here = np.zeros((count, AXES))
            here[:-1] = -np.einsum("cn,nca->na", of_moves[:, -1], felt[:, :, g])
            into[:, -1, g, :, g, -1] = here
            back[:, -1, g, :, g, -1] = backwards(system.moves[g, -1, -1], here.T).T
            errors[:, g, :, g, 0] = 2.0 * (
                system.jitter[:, g, None] * told.scores.reshape(-1, 2, AXES)[:, g]
            )
        flat = through.reshape(count, 6 * k, 2 * p)
        into += through
        into[:-1] -= (np.swapaxes(f, 1, 2) @ flat[1:]).reshape(into[1:].shape)
        through += back
        wrong = errors.reshape(count, 6, 2 * p)
        weighted = w @ wrong
        into[:, 0] += weighted.reshape(count, 2, AXES, 2, p)
        forward = _rows(self._factor.forward(into.reshape(count, 6 * k, 2 * p)))
        found = _rows(wrong).T @ _rows(weighted) - forward.T @ forward
        moved = (self._assembled(system.noise) @ flat[1:]).reshape(-1, 2 * p)
        found += _rows(flat[1:]).T @ moved
        first = flat[0].reshape(k, 2, AXES, 2 * p)
        for c in range(k):
            for g in range(2):
                if system.prior[g, c, c] > 0.0:
                    found += first[c, g].T @ first[c, g] / system.prior[g, c, c]
        ahead = _rows(system.columns).T @ _rows(weighted)
        ahead -= _rows(self._forward[..., :-1]).T @ forward
        return found, ahead

    def whitened(self) -> Array:
        """The factor runs forwards: without what the next step says, row i holds what is known.

        From the rest of the data there, the prediction's.
        """
        own, _ = self._factor.blocks()
        information = own @ np.swapaxes(own, 1, 2)
        f = self._transition
        information[:-1] -= np.swapaxes(f, 1, 2) @ self._step_weight @ f
        known = np.linalg.inv(information)
        state = known[:, :PREDICTED] @ (own @ self._forward)
        first = self._system.predicted
        noise, rest = self._noise[first:], (self._system.both - state)[first:]
        covariance = noise - known[first:, :PREDICTED, :PREDICTED]
        solved = np.linalg.solve(covariance, np.concatenate([noise, rest], axis=2))
        found = noise @ solved
        spread, gained = found[..., :6], found[..., 6:]
        root = np.linalg.cholesky(0.5 * (spread + np.swapaxes(spread, 1, 2)))
        return np.asarray(np.linalg.solve(root, gained))


def _rows(columns: Array) -> Array:
    """Columns (n, m, c) of all poses below each other, (n m, c)."""
    return columns.reshape(-1, columns.shape[-1])


def _times(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("gabn,gbcn->gacn", a, b))


def _grouped(values: Array) -> Array:
    """Values (N, 6), summed over each group's three axes; (2, N)."""
    return np.asarray(values.reshape(-1, 2, AXES).sum(axis=2).T)


def _ends(root: Array, theta: Array) -> Array:
    """What makes columns and errors those of a root of θ's covariance, and what θ leaves."""
    size = len(theta)
    found = np.zeros((size + 1, size + 1))
    found[:size, :size], found[:size, size], found[size, size] = root, -theta, 1.0
    return found
