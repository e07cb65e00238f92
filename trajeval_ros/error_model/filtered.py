# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The chain of `axes` by Kalman's filter and the smoother of its disturbances, in C.

The formulas are in ``loops/chain.c``.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.error_model.maximum import RULES
from trajeval_ros.error_model.process import NUMBERS, Kind
from trajeval_ros.error_model.series import Series

Array = npt.NDArray[np.float64]

# As the records of the same names in C.
FILTERED = np.dtype(
    [
        ("transition", "f8", 4),
        ("noise", "f8", 3),
        ("drift", "f8"),
        ("variance", "f8"),
        ("jitter", "f8"),
        ("precision", "f8"),
        ("gain", "f8", 2),
        ("covariance", "f8", 3),
        ("innovation", "f8", 4),
        ("velocity", "f8", 4),
    ]
)
SMOOTHED = np.dtype(
    [("score", "f8", 4), ("state", "f8", (2, 4)), ("felt", "f8", (2, 4)), ("adjoint", "f8", 4)]
)
# What a climb works with, numbers a pose.
_WORK = 11
_AXES = 3


class _Smoothed(NamedTuple):
    """Records of the poses, disturbances of poses and of steps, and the gradient."""

    records: npt.NDArray[np.void]
    poses: Array
    steps: Array
    gradient: Array

    @staticmethod
    def empty(count: int, parameters: int) -> _Smoothed:
        """Of so many poses."""
        poses, steps = np.empty((2, count)), np.empty((2, count - 1))
        return _Smoothed(np.empty(count, SMOOTHED), poses, steps, np.empty(parameters))

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """As C writes to them."""
        return self.records.view(np.float64), self.poses, self.steps, self.gradient


class Known(NamedTuple):
    """What a climb leaves: records of the filter, what it has found, and the smoother's, if any."""

    filtered: npt.NDArray[np.void]
    found: Array
    smoothed: _Smoothed | None


def climbed(
    kind: Kind,
    parameters: Array,
    series: Series,
    low: Array,
    high: Array,
    gain: float,
    steps: int,
    near: bool,
    weighted: bool,
) -> tuple[Array, Series, Known]:
    """As `trajeval_ros.error_model.maximum.climb`: the place that is reached.

    Raises numpy.linalg.LinAlgError where there is no likelihood to begin with.
    """
    count, size = series.errors.shape[1], len(parameters)
    here = np.array(parameters, dtype=np.float64)
    factors = np.concatenate([series.measured, series.moved])
    filtered, found = np.empty(count, FILTERED), np.empty(2 + _AXES)
    smoothed = _Smoothed.empty(count, size)
    given = map(loops.doubles, (series.intervals, series.errors, series.variance, low, high, RULES))
    rules = float(gain), steps, int(near), int(weighted)
    records, *rest = smoothed.arrays
    reached = here, factors, filtered.view(np.float64), found, records, *rest
    work = np.empty(_WORK * count)
    told = loops.call("chain_climb", NUMBERS[kind], count, size, *given, *rules, *reached, work)
    if told < 0:
        raise np.linalg.LinAlgError("no likelihood")
    there = series._replace(measured=factors[:count], moved=factors[count:])
    return here, there, Known(filtered, found, smoothed if told else None)


class Filtered:
    """At ψ (p,)."""

    def __init__(
        self, kind: Kind, parameters: Array, series: Series, known: Known | None = None
    ) -> None:
        """Filter the errors, unless what that says is known."""
        self._kind, self._count = kind, series.errors.shape[1]
        self._parameters, self._intervals, self._errors, variance, measured, self._moved = map(
            loops.doubles,
            (
                parameters,
                series.intervals,
                series.errors,
                series.variance,
                series.measured,
                series.moved,
            ),
        )
        self._known = None if known is None else known.smoothed
        if known is not None:
            self._filtered, self._found = known.filtered, known.found
            self.value = float(self._found[0])
            return
        self._filtered = np.empty(self._count, FILTERED)
        self._found = np.empty(2 + _AXES)
        failed = self._call(
            "chain_filter",
            self._intervals,
            self._errors,
            variance,
            measured,
            self._moved,
            self._filtered.view(np.float64),
            self._found,
        )
        if failed:
            raise np.linalg.LinAlgError("no likelihood")
        self.value = float(self._found[0])

    def _call(self, name: str, *arrays: Array) -> int:
        return loops.call(name, NUMBERS[self._kind], self._count, self._parameters, *arrays)

    @cached_property
    def _smoothed(self) -> _Smoothed:
        if self._known is not None:
            return self._known
        smoothed = _Smoothed.empty(self._count, len(self._parameters))
        self._call(
            "chain_smooth",
            self._intervals,
            self._errors,
            self._moved,
            self._filtered.view(np.float64),
            self._found,
            *smoothed.arrays,
        )
        return smoothed

    @property
    def states(self) -> Array:
        """x, (3, k, N)."""
        state = self._smoothed.records["state"]
        return np.asarray(state[:, : self._kind.components, :_AXES].transpose(2, 1, 0))

    @property
    def residual(self) -> Array:
        """What the states leave of the errors, (3, N)."""
        score = self._smoothed.records["score"][:, :_AXES].T
        return np.asarray(self._filtered["variance"] * score)

    @property
    def moves(self) -> Array:
        """``Q felt``, (3, k, N - 1)."""
        felt = self._smoothed.records["felt"][:-1, :, :_AXES]
        index = np.array([[0, 1], [1, 2]])
        noise = self._filtered["noise"][:-1][:, index]
        moves: Array = np.einsum("nab,nbx->xan", noise, felt)
        return moves[:, : self._kind.components]

    @property
    def noise(self) -> Array:
        """The variance of each step's first component, (N - 1,)."""
        return np.asarray(self._filtered["noise"][:-1, 0])

    def products(self, columns: Array) -> Array:
        """``Xᵀ P X`` (c, c) of columns X (N, 3, c)."""
        whitened = self._whitened(columns).reshape(-1, columns.shape[2])
        return np.asarray(whitened.T @ whitened)

    def smoothed(self, columns: Array) -> Array:
        """The processes of columns (N, 3, c)."""
        found = self._whitened(columns)
        self._of_columns("chain_smooth_others", columns, found)
        return found

    def _whitened(self, columns: Array) -> Array:
        """Innovations by their standard deviations, (N, 3, c)."""
        found = np.empty(columns.shape)
        self._of_columns("chain_whiten", columns, found)
        return found

    def _of_columns(self, name: str, columns: Array, found: Array) -> None:
        lanes = columns.shape[1] * columns.shape[2]
        given = self._filtered.view(np.float64), loops.doubles(columns), found
        loops.call(name, self._count, lanes, *given, np.empty((2, lanes)))

    def gradient(self) -> Array:
        """``∂ log L / ∂ψ``, (p,)."""
        return self._smoothed.gradient

    def average_information(self) -> Array:
        """Of ψ, (p, p)."""
        found = np.empty((len(self._parameters), len(self._parameters)))
        self._call(
            "chain_information",
            self._intervals,
            self._moved,
            self._filtered.view(np.float64),
            self._found,
            self._smoothed.records.view(np.float64),
            found,
        )
        return found

    def disturbances(self) -> tuple[Array, Array, Array, Array]:
        """Of the poses, (N,) each, and of the steps, (N - 1,) each."""
        _, poses, steps, _ = self._smoothed
        return poses[0], poses[1], steps[0], steps[1]
