# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How probable hyperparameters make many segments, the slope of that, and its information.

The likelihood of a segment has its constant mean and its scale integrated out: with
``Π = K⁻¹ - K⁻¹ 1 (1ᵀ K⁻¹ 1)⁻¹ 1ᵀ K⁻¹``, n samples of c coordinates, ``q = tr(xᵀ Π x)``,
``d = c (n - 1)`` and ν degrees of freedom, it is a multivariate Student t,

    log p = log Γ((ν + d)/2) - log Γ(ν/2) - d/2 log(νπ)
            - ½ c (log|K| + log 1ᵀ K⁻¹ 1) - ½ (ν + d) log(1 + q/ν),
    ∂ log p/∂θ = ½ tr((w Π x xᵀ Π - c Π) ∂K/∂θ),   w = (ν + d)/(ν + q)

and with the average information, half-way between the observed and the expected one, which needs
no products of matrices,

    ½ w (tr(xᵀ Π ∂K/∂θ_i Π ∂K/∂θ_j Π x) - tr(xᵀ Π ∂K/∂θ_i Π x) tr(xᵀ Π ∂K/∂θ_j Π x) / (ν + q))

(``docs/method.md``, Ground truth). One segment with a motion of its own, or with an outlier, does
not carry the others away.

Where all kernels are Matérn ones a loop in C has all of this from Kalman's filter, in time that
grows as n: of a record with thousands of samples as well. Without it, and with other kernels, the
matrices are dense, and the time grows as n³.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import lapack, loops
from trajeval_ros.ground_truth.hyperparameters import DEGREES_OF_FREEDOM
from trajeval_ros.ground_truth.kernels import Kernel, Matern

Array = npt.NDArray[np.float64]

# Records shorter than the longest are filled up with samples so far off (s) that no kernel reaches.
_FAR = 1e9


class Record(NamedTuple):
    """What one segment gives to learn from.

    ``times`` (n,) s; ``values`` (n, c); ``variances`` (n,), known ones that add to the noise.
    """

    times: Array
    values: Array
    variances: Array


class Likelihood:
    """The sum of the log-likelihoods of many records, as a function of the hyperparameters.

    These are ``log_parameters`` (2k + 1,): log σ and log l of each of k kernels, and at last log n;
    or (s, 2k + 1), a row for each of s sets of records that have their own.
    """

    def __init__(
        self,
        kernels: tuple[Kernel, ...],
        records: Sequence[Record],
        sets: Sequence[int] | Sequence[Sequence[int]] | None = None,
    ) -> None:
        """Take at least one record; all have the same number of coordinates.

        ``sets`` (m,): whose row each record takes, from the first to the last of these; without it,
        all the first one's. Or (q, m): the records are there q times, one after the other.
        """
        each = np.zeros(len(records), dtype=np.int64) if sets is None else np.array(sets)
        copies, each = each.size // len(records), each.ravel()
        self._shape = _Shape.of(records, copies)
        self._markov: _Markov | None = None
        self._dense: list[tuple[npt.NDArray[np.intp], _Shape, _Dense]] = []
        matern = [kernel for kernel in kernels if isinstance(kernel, Matern)]
        if loops.there() and len(matern) == len(kernels):
            self._markov = _Markov(matern, records, each)
        else:
            # Sets of the same records have the same matrices but for σ.
            known: dict[tuple[int, ...], _Dense] = {}
            for number in range(int(each.max()) + 1):
                places = np.flatnonzero(each == number)
                those = [records[i] for i in (places % len(records)).tolist()]
                same = tuple(map(id, those))
                data = known[same] = known.get(same) or _Dense(kernels, those)
                self._dense.append((places, _Shape.of(those), data))

    @property
    def in_c(self) -> tuple[tuple[loops.Argument, ...], int] | None:
        """What ``lesson.c`` is told of the records, and how much room it needs for these.

        None where the matrices are dense.
        """
        data, shape = self._markov, self._shape
        if data is None:
            return None
        records = (
            *data.records(shape),
            data.rates,
            shape.constants[data.order],
            DEGREES_OF_FREEDOM,
        )
        return records, data.room_for_slopes + 2 * len(shape.counts)

    def __call__(self, log_parameters: Array) -> Fit:
        """Return the log-likelihood, whose slope and information can then be asked for."""
        if self._markov is not None:
            return _MarkovFit(self._shape, self._markov, log_parameters)
        rows = np.atleast_2d(log_parameters)
        fits = [
            (places, _DenseFit(shape, data, row))
            for (places, shape, data), row in zip(self._dense, rows, strict=True)
        ]
        return fits[0][1] if log_parameters.ndim == 1 else _Fits(self._shape, fits)


class _Shape(NamedTuple):
    """What the m records' likelihoods need beside determinants and squares.

    ``counts`` (m,) of samples; ``freedom`` (m,), d above; ``constants`` (m,), of d alone.
    """

    coordinates: int
    counts: npt.NDArray[np.int64]
    freedom: npt.NDArray[np.int64]
    constants: Array

    @staticmethod
    def of(records: Sequence[Record], copies: int = 1) -> _Shape:
        """That of these, so often one after the other."""
        counts = np.array([len(record.times) for record in records])
        coordinates = records[0].values.shape[1]
        freedom = coordinates * (counts - 1)
        nu = DEGREES_OF_FREEDOM
        constants = [
            math.lgamma(0.5 * (nu + d)) - math.lgamma(0.5 * nu) - 0.5 * d * math.log(nu * math.pi)
            for d in freedom.tolist()
        ]
        each = (np.tile(values, copies) for values in (counts, freedom, constants))
        return _Shape(coordinates, *each)


class Fit(ABC):
    """The log-likelihood of records at one place, minus infinity where K is not definite.

    The slopes cost only where they are asked for.
    """

    def __init__(self, shape: _Shape) -> None:
        """Start where K is not definite."""
        self._shape = shape
        self.values = np.full(len(shape.counts), -math.inf)
        """Each record's; (m,)."""
        self.fits = np.full(len(shape.counts), math.inf)
        """Each record's mean square, standardised: one when the process fits; (m,)."""
        self.value = -math.inf
        """Their sum."""

    def _take(self, log_dets: Array, squares: Array) -> None:
        """Take each record's ``log|K| + log 1ᵀ K⁻¹ 1`` and q; (m,) both."""
        shape, nu = self._shape, DEGREES_OF_FREEDOM
        self.fits = squares / np.maximum(shape.freedom, 1)
        self.values = (
            shape.constants
            - 0.5 * shape.coordinates * log_dets
            - 0.5 * (nu + shape.freedom) * np.log1p(squares / nu)
        )
        self.value = math.fsum(self.values)

    @property
    @abstractmethod
    def gradient(self) -> Array:
        """The slope, where K is positive definite; (..., 2k + 1), of each set."""

    @property
    @abstractmethod
    def information(self) -> Array:
        """The average information, where K is positive definite; (..., 2k + 1, 2k + 1)."""


class _Fits(Fit):
    """Those of sets of records, each given by its places among all."""

    def __init__(self, shape: _Shape, fits: Sequence[tuple[npt.NDArray[np.intp], Fit]]) -> None:
        """Put the records back to their places."""
        super().__init__(shape)
        self._fits = [fit for _, fit in fits]
        for places, fit in fits:
            self.values[places], self.fits[places] = fit.values, fit.fits
        self.value = math.fsum(self.values)

    @property
    def gradient(self) -> Array:
        return np.stack([fit.gradient for fit in self._fits])

    @property
    def information(self) -> Array:
        return np.stack([fit.information for fit in self._fits])


class _Markov:
    """Records one after the other, as the loop takes them: ``order`` (m,), the longest first."""

    def __init__(
        self,
        kernels: Sequence[Matern],
        records: Sequence[Record],
        sets: npt.NDArray[np.int64],
    ) -> None:
        """As a :class:`Likelihood`."""
        counts = np.array([len(record.times) for record in records])
        copies = len(sets) // len(records)
        each = np.tile(counts, copies)
        self.order = np.argsort(-each, kind="stable")
        self.counts = each[self.order]
        self.begins = np.tile(np.cumsum(counts) - counts, copies)[self.order]
        self.sets = sets[self.order]
        self.longest = int(self.counts[0])
        self.orders = np.array([len(kernel.coefficients) for kernel in kernels])
        self.rates = np.array([kernel.rate for kernel in kernels])
        self.times, self.values, self.variances = (
            loops.doubles(np.concatenate(each))
            for each in zip(*((r.times, r.values, r.variances) for r in records), strict=True)
        )

    def records(self, shape: _Shape) -> tuple[loops.Argument, ...]:
        """What the loops take first: the records, the orders of the kernels, and the sets."""
        return (
            self.begins,
            self.counts,
            len(shape.counts),
            self.times,
            self.values,
            self.variances,
            shape.coordinates,
            self.orders,
            len(self.orders),
            self.sets,
        )

    @cached_property
    def room_for_values(self) -> int:
        """How many numbers the loop needs room for."""
        return self._room(slopes=False)

    @cached_property
    def room_for_slopes(self) -> int:
        """The same with the slopes."""
        return self._room(slopes=True)

    def _room(self, *, slopes: bool) -> int:
        return record_room(tuple(self.orders.tolist()), self.values.shape[1], self.longest, slopes)


@lru_cache(maxsize=256)
def record_room(orders: tuple[int, ...], coordinates: int, longest: int, slopes: bool) -> int:
    """How many numbers the loops need room for where the ``longest`` record has so many samples.

    ``orders``: how many coefficients each kernel has.
    """
    room = np.empty(1, dtype=np.int64)
    sizes = len(orders), coordinates, longest, int(slopes)
    loops.call("record_room", np.array(orders), *sizes, room)
    return int(room[0])


class _MarkovFit(Fit):
    def __init__(self, shape: _Shape, data: _Markov, log_parameters: Array) -> None:
        """Go through every record."""
        super().__init__(shape)
        self._data = data
        natural = np.exp(loops.doubles(log_parameters))
        self._rows = natural.shape
        self._arguments = (
            *data.records(shape),
            data.rates / natural[..., 1:-1:2],
            natural[..., :-1:2] ** 2,
            natural[..., -1:] ** 2,
        )
        work, found = np.empty(data.room_for_values), np.empty((len(shape.counts), 2))
        loops.call("record_values", *self._arguments, work, found)
        found[data.order] = found.copy()
        self._take(found[:, 0], found[:, 1])

    @cached_property
    def _slopes(self) -> tuple[Array, Array]:
        """The gradient and the information."""
        *sets, size = self._rows
        gradient, information = np.empty(self._rows), np.empty((*self._rows, size))
        work, nu = np.empty(self._data.room_for_slopes), DEGREES_OF_FREEDOM
        several = math.prod(sets)
        loops.call("record_slopes", *self._arguments, several, nu, work, gradient, information)
        return gradient, information

    @property
    def gradient(self) -> Array:
        return self._slopes[0]

    @property
    def information(self) -> Array:
        return self._slopes[1]


class _Dense:
    """Records side by side, for NumPy."""

    def __init__(self, kernels: tuple[Kernel, ...], records: Sequence[Record]) -> None:
        """As a :class:`Likelihood`."""
        self.kernels = kernels
        size = max(len(record.times) for record in records)
        coordinates = records[0].values.shape[1]
        times = np.tile(_FAR * np.arange(1.0, size + 1.0), (len(records), 1))
        self.variances = np.zeros((len(records), size))
        self.right = np.zeros((len(records), size, 1 + coordinates))  # 1 and x; 0 beyond the end
        for row, record in enumerate(records):
            sampled = slice(len(record.times))
            times[row, sampled] = record.times
            self.variances[row, sampled] = record.variances
            self.right[row, sampled, 0] = 1.0
            self.right[row, sampled, 1:] = record.values
        # Of symmetric matrices the lower triangle, packed row after row: half the work.
        rows, columns = np.tril_indices(size)
        self.lower = rows * size + columns
        self.diagonal = np.flatnonzero(rows == columns)
        self.unpacked = np.empty((size, size), dtype=np.intp)
        self.unpacked[rows, columns] = self.unpacked[columns, rows] = np.arange(len(rows))
        self.apart = np.abs(times[:, rows] - times[:, columns])
        self._known: list[tuple[float, tuple[Array, Array]] | None] = [None] * len(kernels)

    def correlation(self, kernel: int, length: float) -> tuple[Array, Array]:
        """A kernel's ``ρ`` of length scale ``length`` (s) and ``∂ρ/∂log l``, packed.

        The last one is kept: regimes differ in their σ alone.
        """
        known = self._known[kernel]
        if known is None or known[0] != length:
            found = self.kernels[kernel].with_slope(self.apart * (1.0 / length))
            self._known[kernel] = known = length, found
        return known[1]

    def packed(self, matrices: Array) -> Array:
        """The lower triangles of (n, n) each."""
        return np.take(matrices.reshape(len(matrices), -1), self.lower, axis=1, mode="clip")

    def full(self, packed: Array) -> Array:
        """The symmetric matrices, (n, n) each."""
        return np.take(packed, self.unpacked, axis=1, mode="clip")


class _DenseFit(Fit):
    """What it costs to factor K is spent once."""

    def __init__(self, shape: _Shape, data: _Dense, log_parameters: Array) -> None:
        """Factor every record's K."""
        super().__init__(shape)
        self._data = data
        signals, lengths = np.exp(log_parameters[:-1:2]), np.exp(log_parameters[1:-1:2])
        self._noise = math.exp(log_parameters[-1]) ** 2
        # Each kernel's σ², and what it is to be multiplied with: its part of K, its slope in log l.
        self._parts = [
            (signal**2, *data.correlation(kernel, length))
            for kernel, (signal, length) in enumerate(zip(signals, lengths, strict=True))
        ]
        self._factor()

    def _factor(self) -> None:
        """Let ``ones`` be K⁻¹ 1 (m, n), ``alpha`` Π x (m, n, c)."""
        data = self._data
        covariance = np.zeros_like(data.apart)
        for variance, correlation, _ in self._parts:
            covariance += variance * correlation
        covariance[:, data.diagonal] += self._noise + data.variances
        records, size = data.variances.shape
        flat = np.zeros((records, size * size))
        flat[:, data.lower] = covariance
        # LAPACK counts by columns: to it these are upper triangles. It overwrites them.
        self._factors = flat.reshape(records, size, size)
        solved, diagonals = np.empty_like(data.right), np.empty((records, size))
        for i, matrix in enumerate(self._factors):
            factor, info = lapack.dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
            if info:
                return
            diagonals[i] = factor.diagonal()
            solved[i], _ = lapack.dpotrs(factor, data.right[i], lower=0)
        sampled, x, ones = data.right[..., 0], data.right[..., 1:], solved[..., 0]
        information = ones.sum(axis=1)
        mean = (ones[..., None] * x).sum(axis=1) / information[:, None]
        self._ones, self._information = ones, information
        self._alpha = solved[..., 1:] - ones[..., None] * mean[:, None]
        log_dets = 2.0 * (sampled * np.log(diagonals)).sum(axis=1) + np.log(information)
        squares = (x * self._alpha).sum(axis=(1, 2))
        self._spread = DEGREES_OF_FREEDOM + squares
        self._take(log_dets, squares)

    @cached_property
    def _inverses(self) -> Array:
        """``K⁻¹``, the lower triangles, in place of the factors; (m, n, n)."""
        for factor, count in zip(self._factors, self._shape.counts, strict=True):
            lapack.dpotri(factor.T, lower=0, overwrite_c=1)
            factor[count:] = 0.0
        return self._factors

    @cached_property
    def gradient(self) -> Array:
        """The slope, where K is positive definite; (2k + 1,)."""
        data, alpha = self._data, self._alpha
        weights = (DEGREES_OF_FREEDOM + self._shape.freedom) / self._spread
        ones = self._ones[..., None]
        left = [weights[:, None, None] * alpha, ones / self._information[:, None, None]]
        right = [alpha, self._shape.coordinates * ones]
        outer = np.concatenate(left, axis=2) @ np.concatenate(right, axis=2).swapaxes(1, 2)
        outer -= self._shape.coordinates * self._inverses
        packed = data.packed(outer)
        trace = float(np.take(packed, data.diagonal, axis=1).sum())
        packed[:, data.diagonal] *= 0.5  # every other entry stands for two
        slopes = [
            variance * s
            for variance, part, slope in self._parts
            for s in (2.0 * np.vdot(packed, part), np.vdot(packed, slope))
        ]
        return np.array([*slopes, self._noise * trace])

    @cached_property
    def information(self) -> Array:
        """The average information, where K is positive definite; (2k + 1, 2k + 1)."""
        data, alpha, ones = self._data, self._alpha, self._ones[:, :, None]
        turned = [  # ∂K/∂θ Π x
            data.full(slope) @ (factor * alpha)
            for variance, *slopes in self._parts
            for factor, slope in zip((2.0 * variance, variance), slopes, strict=True)
        ]
        left = np.concatenate([*turned, 2.0 * self._noise * alpha], axis=2)
        right = data.full(data.packed(self._inverses)) @ left
        right -= ones * (ones.swapaxes(1, 2) @ left / self._information[:, None, None])
        # Records, samples, parameters, coordinates.
        left, right = (
            m.reshape(*alpha.shape[:2], -1, self._shape.coordinates) for m in (left, right)
        )
        squares = (left * alpha[:, :, None]).sum(axis=(1, 3))  # xᵀ Π ∂K/∂θ Π x
        weights = 0.5 * (DEGREES_OF_FREEDOM + self._shape.freedom) / self._spread
        left *= weights[:, None, None, None]
        first = np.tensordot(left, right, axes=((0, 1, 3), (0, 1, 3)))
        return np.asarray(first - (squares * (weights / self._spread)[:, None]).T @ squares)
