# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The covariance function of several groups of coordinates, a sum of kernels each.

A sum of Matérn kernels is Markov: with the transition matrix Φ of all of them,

    k(s, t) = past(m - s) · future(t - m),    s <= m <= t,    past(v + w) = past(v) Φ(w),

for rows ``past`` and ``future`` of as many numbers as Φ has rows. Of a kernel with ``a = r u / l``
the ``past`` are the ``aⁱ exp(-a)``, and the entries of ``future`` and Φ sums of multiples of these,
all positive: they are as accurate as k itself.
"""

from __future__ import annotations

import math
from functools import cache, cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.hyperparameters import GroupHyperparameters
from trajeval_ros.ground_truth.kernels import Kernel, Matern

Array = npt.NDArray[np.float64]


class KernelSum:
    """``k(u) = Σ_k σ_k² ρ_k(u / l_k)`` of G groups, which share the kernels, and of S stretches.

    Where k of them are said to be asked for, the first is the process itself, and the second its
    motion's derivative ``∂/∂t``, of what is no noise.
    """

    def __init__(self, kernels: tuple[Kernel, ...], variances: Array, lengths: Array) -> None:
        """``variances`` σ² and ``lengths`` l of each of m kernels; (m, G, S) both."""
        self._kernels = kernels
        self._variances, self._lengths = variances, lengths
        curvatures = np.array([kernel.curvature for kernel in kernels])[:, None, None]
        self.variances: Array = np.stack(
            [variances.sum(axis=0), (variances * curvatures / lengths**2).sum(axis=0)]
        )
        """``k(0)`` and ``-k''(0)``, the motion's alone; (2, G, S)."""

    # What the loops in C need not is made when it is first asked for.
    @cached_property
    def _places(self) -> tuple[list[int], list[int] | slice]:
        """The groups that differ in their lengths, and the place in these of each group's equal.

        Groups with the same lengths have the same correlations.
        """
        lengths, places = self._lengths, dict[bytes, int]()
        which = [places.setdefault(lengths[:, g].tobytes(), g) for g in range(lengths.shape[1])]
        distinct = sorted(places.values())
        if len(distinct) == len(which):
            return distinct, slice(None)
        return distinct, [distinct.index(g) for g in which]

    @property
    def _distinct(self) -> list[int]:
        return self._places[0]

    @property
    def _which(self) -> list[int] | slice:
        return self._places[1]

    @staticmethod
    def of(kernels: tuple[Kernel, ...], groups: tuple[GroupHyperparameters, ...]) -> KernelSum:
        """Take the kernels that the groups have components for, of one stretch."""
        return _of(tuple(type(kernel) for kernel in kernels), groups)

    def __call__(self, apart: Array) -> Array:
        """``k`` of times ``apart`` (S, n) seconds, not negative; (G, S, n)."""
        scaled = apart / self._lengths[:, self._distinct, :, None]
        each = np.stack(
            [kernel.correlation(u) for kernel, u in zip(self._kernels, scaled, strict=True)]
        )
        return self._summed(each, self._variances)

    def cross(self, apart: Array, kinds: int = 1) -> Array:
        """The covariances of k that are asked for with samples, (k, G, S, n).

        They are asked for ``apart`` (S, n) seconds later than the samples, or earlier.
        """
        size = np.abs(apart)
        found = [self(size)]
        if kinds > 1:
            scaled = size / self._lengths[:, self._distinct, :, None]
            each = np.stack(
                [kernel.derivative(u) for kernel, u in zip(self._kernels, scaled, strict=True)]
            )
            slope = self._summed(each, self._variances / self._lengths)
            found.append(slope * np.sign(apart))
        return np.stack(found)

    def _summed(self, each: Array, factors: Array) -> Array:
        """Each kernel's of the distinct groups (m, D, S, n), times ``factors`` (m, G, S).

        ``each`` may be overwritten.
        """
        scaled = each[:, self._which]
        scaled *= factors[..., None]
        return np.asarray(np.add.reduce(scaled, axis=0))


@lru_cache(maxsize=64)
def _of(kinds: tuple[type[Kernel], ...], groups: tuple[GroupHyperparameters, ...]) -> KernelSum:
    components = [group.components for group in groups]
    kernels = tuple(kind() for kind in kinds[: len(components[0])])
    variances = np.array([[c.std**2 for c in parts] for parts in components]).T
    lengths = np.array([[c.length_scale for c in parts] for parts in components]).T
    kind = MarkovSum if all(isinstance(kernel, Matern) for kernel in kernels) else KernelSum
    return kind(kernels, variances[..., None], lengths[..., None])


class MarkovSum(KernelSum):
    """Of Matérn kernels.

    The powers of all kernels stand side by side, r in all: first every ``exp(-a)``, then the
    ``a exp(-a)`` of those kernels that have it, and so on.
    """

    def __init__(self, kernels: tuple[Kernel, ...], variances: Array, lengths: Array) -> None:
        """Put those with the most powers first."""
        of = [kernel for kernel in kernels if isinstance(kernel, Matern)]
        of.sort(key=lambda kernel: -len(kernel.coefficients))
        order = [kernels.index(kernel) for kernel in of]
        super().__init__(tuple(of), variances[order], lengths[order])
        self._table = _table(tuple(type(kernel) for kernel in of))
        self.rank = len(self._table.kernel)
        """Number of rows of Φ."""
        self._rates = np.array([kernel.rate for kernel in of])[:, None, None] / self._lengths

    @cached_property
    def _scales(self) -> Array:
        """Of what is asked for, of each power; (2, G, S, 1, r)."""
        scales = np.stack([self._variances, self._variances * self._rates])[:, self._table.kernel]
        return np.moveaxis(scales, 1, -1)[..., None, :]

    @cached_property
    def _rate(self) -> Array:
        """The kernel's, of each power; (G, S, 1, r)."""
        return np.moveaxis(self._rates[self._table.kernel], 0, -1)[..., None, :]

    def __call__(self, apart: Array) -> Array:
        """``k`` of times ``apart`` (S, n) seconds, not negative; (G, S, n)."""
        return np.asarray(self.cross(apart)[0])

    def cross(self, apart: Array, kinds: int = 1) -> Array:
        """As that of any sum."""
        a = self._rates[:, self._distinct, :, None] * np.abs(apart)
        decay = np.negative(a)
        np.exp(decay, out=decay)
        found = [self._summed(_polynomials(self._table.values, a, decay), self._variances)]
        if kinds > 1:
            each = _polynomials(self._table.slopes, a, decay)
            found.append(self._summed(each, self._variances * self._rates) * np.sign(apart))
        return np.stack(found) if kinds > 1 else found[0][None]

    @property
    def kernels(self) -> tuple[Matern, ...]:
        """Those with the most powers first."""
        return tuple(kernel for kernel in self._kernels if isinstance(kernel, Matern))

    @property
    def rates(self) -> Array:
        """``r / l`` of the kernels, of a sum of one stretch; (G, m)."""
        return np.asarray(self._rates[..., 0].T)

    @property
    def component_variances(self) -> Array:
        """``σ²`` of the kernels, of a sum of one stretch; (G, m)."""
        return np.asarray(self._variances[..., 0].T)

    def powers(self, apart: Array) -> Array:
        """All kernels' powers of times ``apart`` (S, n) seconds, not negative.

        Of the groups that differ in their lengths; (D, S, n, r).
        """
        rates = np.moveaxis(self._rates[:, self._distinct], 0, -1)[..., None, :]
        a = rates * apart[..., None]
        result = np.empty((*a.shape[:-1], self.rank))
        before, *widths = self._table.widths
        np.exp(-a, out=result[..., :before])
        begin = 0
        for width in widths:
            known, end = result[..., begin : begin + width], begin + before
            np.multiply(a[..., :width], known, out=result[..., end : end + width])
            begin, before = end, width
        return result

    def past(self, powers: Array, kinds: int = 1) -> Array:
        """``past`` of the times whose ``powers`` (D, S, n, r) are given, of k; (k, G, S, n, r).

        Of what is asked for at s, in the notation above.
        """
        found = powers[self._which][None]
        if kinds > 1:
            slope = (powers @ self._table.past_slope)[self._which] * self._rate
            found = np.concatenate([found, slope[None]])
        return found

    def future(self, powers: Array, kinds: int = 1) -> Array:
        """``future`` of those times, of k that are asked for; (k, G, S, n, r)."""
        future = powers @ self._table.futures[:kinds, None, None]
        return np.asarray(future[:, self._which] * self._scales[:kinds])

    def transition(self, powers: Array) -> Array:
        """``Φ`` of the times whose ``powers`` (D, S, 1, r) are given; (G, S, r, r)."""
        found = powers @ self._table.transition
        return np.asarray(found[self._which].reshape(-1, powers.shape[1], self.rank, self.rank))


class _Table(NamedTuple):
    """What Matérn kernels are in their powers, whatever their σ and l; see `MarkovSum`.

    ``widths``: number of kernels that have each power; ``kernel`` (r,): whose each is; ``values``
    and ``slopes``: the coefficients of ρ and ``ρ' / r`` power by power, (width, 1, 1, 1) each.
    ``futures`` (2, r, r): of the powers (r,), the ``future`` and its derivative over the kernel's
    rate; ``past_slope`` (r, r): that of the ``past`` as its beginning moves on; ``transition``
    (r, r²): Φ.
    """

    widths: tuple[int, ...]
    kernel: list[int]
    values: tuple[Array, ...]
    slopes: tuple[Array, ...]
    futures: Array
    past_slope: Array
    transition: Array


@cache
def _table(kinds: tuple[type[Matern], ...]) -> _Table:
    """Those with the most powers come first."""
    kernels = [kind() for kind in kinds]
    sizes = [len(kernel.coefficients) for kernel in kernels]
    widths = tuple(sum(size > j for size in sizes) for j in range(sizes[0]))
    places = [(k, j) for j, width in enumerate(widths) for k in range(width)]
    index, rank = {place: i for i, place in enumerate(places)}, len(places)
    of = [k for k, _ in places]
    values = np.array([kernels[k].coefficients[j] for k, j in places])
    # Noise has no derivative, and is no motion.
    moves = np.array([kernels[k].curvature > 0.0 for k in of], dtype=np.float64)
    slopes = np.array([-kernels[k].slope[j - 1] if j else 0.0 for k, j in places])
    future, derivative, past_slope = np.zeros((rank, rank)), np.diag(-moves), np.diag(moves)
    transition = np.zeros((rank, rank, rank))
    for (k, j), row in index.items():
        for i in range(j + 1):
            power, column = index[k, j - i], index[k, i]
            future[power, column] = values[row] * math.comb(j, i)
            transition[power, column, row] = math.comb(j, i)
        if j:
            derivative[row, index[k, j - 1]] = j
            past_slope[index[k, j - 1], row] = -j
    ends = np.cumsum(widths)[:-1]
    by_power = [np.split(each[:, None, None, None], ends) for each in (values, slopes)]
    polynomials = [tuple(each) for each in by_power]
    return _Table(
        widths,
        of,
        polynomials[0],
        polynomials[1],
        np.stack([future, future @ derivative]),
        past_slope,
        transition.reshape(rank, -1),
    )


def _polynomials(coefficients: tuple[Array, ...], a: Array, decay: Array) -> Array:
    """``Σ_j c_j aʲ exp(-a)`` of each kernel; (m, D, S, n)."""
    value = np.zeros_like(a)
    for each in reversed(coefficients):
        those = value[: len(each)]
        those *= a[: len(each)]
        those += each
    value *= decay
    return value
