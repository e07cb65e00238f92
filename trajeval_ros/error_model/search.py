# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Near the maximum of a process, by the chains of `axes`: parameters, weights and nuisances.

Rotations come first: what their errors, smoothed, do to positions is then taken off those.
Nuisances and parameters are found in turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from trajeval_ros.error_model.axes import Axes, Series
from trajeval_ros.error_model.likelihood import Data
from trajeval_ros.error_model.maximum import climb
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.structure import starts

Array = npt.NDArray[np.float64]

_LEAST_STD = 1e-7
LARGEST_STD = 1e3
# Noise of this share of the ground truth's standard deviation, or a drift of it in all of the time,
# is none.
_NONE = 0.03
# A search ends where another step gains less than this, nats, or after so many steps; starts are
# told apart after a few.
_GAIN = 0.02
_STEPS = 12
_FEW = 2
# Where weights are there already, it goes on with this round of them; and where only the parameters
# are.
_AGAIN = 6
_FIRST = 2
# More poses than this are searched in stretches first, that lie so far (s) apart then.
_MANY = 1000
_STRETCH = 200
_APART = 1e6
# Nuisances and parameters in turn: so often, until a step is this share of its deviation.
_TURNS = 6
# On all poses after stretches of them.
_ON_ALL = 2
_SHORT = 0.3
# Nuisances moved by more than so many standard deviations leave other errors to begin with.
_LONG = 3.0


@dataclass(frozen=True, slots=True)
class Guess:
    """Near a maximum.

    parameters: ψ (2, p). measured, moved: weights, (N, 2) and (N - 1, 2). theta: of the nuisances,
    (c,), with its covariance.
    """

    kind: Kind
    parameters: Array
    measured: Array
    moved: Array
    theta: Array
    theta_covariance: Array

    @property
    def weights(self) -> tuple[Array, Array]:
        """Of poses and of steps."""
        return self.measured, self.moved


def bounds(kind: Kind, data: Data) -> tuple[Array, Array]:
    """The least and the largest of each parameter, (2, p) each."""
    intervals = np.diff(data.times)
    span = float(data.times[-1] - data.times[0])
    shortest = float(np.median(intervals))
    known = np.sqrt(np.median(np.einsum("nii->ni", data.covariance), axis=0).reshape(2, 3).mean(1))
    low, high = np.zeros((2, len(kind.names))), np.zeros((2, len(kind.names)))
    for g, std in enumerate(known):
        none = max(_NONE * float(std), _LEAST_STD)
        least = {"jitter_std": none, "drift_std": none / np.sqrt(span), "wander_std": none}
        least["velocity_std"] = none / span
        for i, name in enumerate(kind.names):
            of_time = name.endswith("time")
            low[g, i] = np.log(shortest if of_time else least[name])
            high[g, i] = np.log(max(span, 2.0 * shortest) if of_time else LARGEST_STD)
    return low, high


def search(kind: Kind, data: Data, gauge: Array, begin: Guess | None = None) -> Guess:
    """Search from the structure function, or from what has been found of other errors.

    In a part of the poses first where there are many: in stretches of them.
    """
    count = len(data.times)
    if count > _MANY and (begin is None or begin.kind is not kind):
        part = _stretches(count)
        coarse = _Search(kind, _part(data, part), gauge[part], bounds(kind, data))
        found = coarse.run(begin, _TURNS if begin is None else 1)
        begin = found if begin is None else replace(found, theta=begin.theta)
        return _Search(kind, data, gauge, bounds(kind, data)).run(begin, _ON_ALL)
    return _Search(kind, data, gauge, bounds(kind, data)).run(begin)


def _stretches(count: int) -> npt.NDArray[np.intp]:
    """The numbers of the poses in stretches of so many, evenly over all of them."""
    begins = np.linspace(0, count - _STRETCH, _MANY // _STRETCH).astype(np.intp)
    return np.asarray((begins[:, None] + np.arange(_STRETCH)).ravel())


def _part(data: Data, part: npt.NDArray[np.intp]) -> Data:
    """Some poses, so long apart between stretches that these are independent."""
    gaps = np.diff(part) > 1
    times = data.times[part]
    times[1:] += _APART * np.cumsum(gaps)
    travel = np.where(gaps[:, None], 0.0, data.travel[part[:-1]])
    steps = np.minimum(part[:-1], len(data.moved) - 1)
    return Data(
        times,
        data.errors[part],
        data.covariance[part],
        travel,
        data.nuisances[part],
        data.precision,
        data.measured[part],
        data.moved[steps],
    )


class _Search:
    """Errors and columns with the pose as their last axis, by group."""

    def __init__(self, kind: Kind, data: Data, gauge: Array, limits: tuple[Array, Array]) -> None:
        self._kind, self._data = kind, data
        self._low, self._high = limits
        columns = [data.nuisances, data.errors[..., None]]
        self._precision = data.precision
        if kind is Kind.WANDER:
            columns.insert(1, gauge)
            self._precision = np.concatenate([data.precision, np.zeros(6)])
        # (2, c + 1, 3, N), the errors last.
        both = np.concatenate(columns, axis=2).reshape(len(data.times), 2, 3, -1)
        self._both = np.ascontiguousarray(both.transpose(1, 3, 2, 0))
        variance = np.einsum("nii->ni", data.covariance).reshape(-1, 2, 3).mean(axis=2)
        intervals = np.diff(data.times)
        self._series = [
            Series(
                intervals, self._both[g, -1], variance[:, g], data.measured[:, g], data.moved[:, g]
            )
            for g in range(2)
        ]

    def run(self, begin: Guess | None, turns: int = _TURNS) -> Guess:
        """Nuisances and parameters in turn."""
        places: list[Axes] | None = None
        theta = np.zeros(len(self._precision))
        round_ = 0
        if begin is not None:
            theta[: len(begin.theta)] = begin.theta
            if begin.kind is self._kind:
                weighted = len(begin.measured) == len(self._data.times)
                round_ = _AGAIN if weighted else _FIRST
                places = self._placed(begin, weighted=weighted)
        size = np.zeros(1)
        for _ in range(turns):
            if (size > _LONG).any():
                places = None
            places = self._climbed(places, theta, round_)
            round_ = _AGAIN
            step, covariance = self._regressed(places, theta)
            theta = theta + step
            size = np.abs(step) / np.sqrt(np.diag(covariance))
            if (size < _SHORT).all():
                break
        assert places is not None
        count = len(self._data.precision)
        return Guess(
            self._kind,
            np.stack([place.parameters for place in places]),
            np.stack([place.weights[0] for place in places], axis=1),
            np.stack([place.weights[1] for place in places], axis=1),
            theta[:count],
            covariance[:count, :count],
        )

    def _climbed(self, places: list[Axes] | None, theta: Array, round_: int) -> list[Axes]:
        """Each group at its maximum, rotation first, given the nuisances."""
        residual = self._both[:, -1] - np.tensordot(theta, self._both[:, :-1], (0, 1))
        found: list[Axes] = []
        for g in (1, 0):
            errors = residual[g]
            if g == 0 and self._kind is not Kind.WANDER:
                errors = errors + self._turned(found[0].states[None, :, 0])[0]
            series = replace(self._series[g], errors=errors)
            place = None if places is None else places[g]
            found.insert(0, self._maximum(g, place, series, round_))
        return found

    def _maximum(self, group: int, place: Axes | None, series: Series, round_: int) -> Axes:
        low, high = self._low[group], self._high[group]
        if place is not None:
            measured, moved = place.weights
            series = replace(series, measured=measured, moved=moved)
            begin = Axes(self._kind, place.parameters, series)
            return climb(begin, low, high, _GAIN, _STEPS, round_)
        candidates = []
        for start in starts(self._kind, series):
            here = Axes(self._kind, np.clip(start, low, high), series)
            candidates.append(climb(here, low, high, _GAIN, _FEW))
        begin = max(candidates, key=lambda place: place.value)
        return climb(begin, low, high, _GAIN, _STEPS)

    def _placed(self, begin: Guess, *, weighted: bool) -> list[Axes]:
        """Where another search has ended; ``weighted``: its weights are of these poses."""
        places = []
        for g, series in enumerate(self._series):
            if weighted:
                weights = {"measured": begin.measured[:, g], "moved": begin.moved[:, g]}
                series = replace(series, **weights)
            places.append(Axes(self._kind, begin.parameters[g], series))
        return places

    def _regressed(self, places: list[Axes], theta: Array) -> tuple[Array, Array]:
        """A step of θ by generalised least squares, and its covariance."""
        flat = len(theta) + 1
        normal = np.zeros((flat, flat))
        heading = None
        for g in (1, 0):
            both = self._both[g]
            if heading is not None:
                both = both + heading
            smoothed = places[g].smoothed(both.reshape(flat * 3, -1)).reshape(both.shape)
            rest = (both - smoothed) * places[g].weight
            normal += both.reshape(flat, -1) @ rest.reshape(flat, -1).T
            if self._kind is not Kind.WANDER:
                heading = self._turned(smoothed)
        information = normal[:-1, :-1] + np.diag(self._precision)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        inverse = np.linalg.inv(scale[:, None] * information * scale)
        covariance = scale[:, None] * inverse * scale
        return covariance @ normal[:-1, -1] - theta, covariance

    def _turned(self, rotation: Array) -> Array:
        """What rotations (m, 3, N) have moved positions by until each pose."""
        moved = np.zeros_like(rotation)
        travel = self._data.travel.T
        x, y, z = rotation[..., 0, :-1], rotation[..., 1, :-1], rotation[..., 2, :-1]
        moved[:, 0, 1:] = travel[1] * z - travel[2] * y
        moved[:, 1, 1:] = travel[2] * x - travel[0] * z
        moved[:, 2, 1:] = travel[0] * y - travel[1] * x
        return np.cumsum(moved, axis=-1)
