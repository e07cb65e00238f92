# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Near the maximum of a process, by the chains of `axes`: parameters, weights and nuisances.

Rotations come first: what their errors, smoothed, do to positions is then taken off those.
Nuisances and parameters are found in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.error_model import maximum, structure
from trajeval_ros.error_model.axes import Axes, climbed
from trajeval_ros.error_model.likelihood import Data, Likelihood, by_group
from trajeval_ros.error_model.process import NUMBERS, Kind
from trajeval_ros.error_model.series import Series

Array = npt.NDArray[np.float64]

_LEAST_STD = 1e-7
LARGEST_STD = 1e3
# Noise of this share of the ground truth's standard deviation, or a drift of it in all of the time,
# is none.
_NONE = 0.03
# Up to so many times the least, a component is as good as nothing.
_NOTHING = 10.0
# Starts are told apart after so many steps, and a search ends after so many.
_FEW = 4
_STEPS = 20
# More poses than this are searched in stretches first, that lie so far (s) apart then.
MANY = 1000
_STRETCH = 200
_APART = 1e6
# Nuisances and parameters in turn: so often, until a step is this share of its deviation.
_TURNS = 4
_SHORT = 0.3
# Nuisances moved by more than so many standard deviations leave other errors to begin with.
_LONG = 3.0
# Of what is taken all of, so much may be left.
_ROUND_OFF = 1e-12
_RULES: Array = np.array([_FEW, _STEPS, _TURNS, _SHORT, _LONG, _ROUND_OFF], dtype=np.float64)
# So many columns, the errors with them, are searched in C, which has room for no more.
_MOST_COLUMNS = 16
# What the other group tells counts so little where it is left out, and is not nothing: orientations
# alone do not show where the world is.
_IGNORED = 1e-8


class Guess(NamedTuple):
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
    if kind in data.bounds:
        return data.bounds[kind]
    span = float(data.times[-1] - data.times[0])
    shortest = data.shortest
    low, high = [], []
    for std in data.known.tolist():
        none = max(_NONE * std, _LEAST_STD)
        least = {"jitter_std": none, "drift_std": none / math.sqrt(span), "wander_std": none}
        least.update(velocity_std=none / span, velocity_time=shortest, wander_time=shortest)
        most = dict.fromkeys(("velocity_time", "wander_time"), max(span, 2.0 * shortest))
        low.append([math.log(least[name]) for name in kind.names])
        high.append([math.log(most.get(name, LARGEST_STD)) for name in kind.names])
    found = data.bounds[kind] = np.array(low), np.array(high)
    for each in found:
        each.flags.writeable = False  # whoever asks next is given the same
    return found


def search(kind: Kind, data: Data, gauge: Array, gain: float, begin: Guess | None = None) -> Guess:
    """Search from the structure function, or from what has been found.

    That of another process, or of other poses, tells of nuisances, and of weights or parameters
    as far as these are shared. It ends where another step gains less than ``gain``, nats.
    """
    return _Search(kind, data, gauge, gain).run(begin)


def elsewhere(guess: Guess, data: Data, gauge: Array, gain: float) -> Guess | None:
    """Where searches from other starts end, by group, if that is likelier; None where none is.

    Outliers make more than one maximum, as does a component that is nothing: what is taken for one
    hides the other. So a group that has either begins again without factors, where it is and at the
    structure function. Any other has one maximum, and no other start.
    """
    return _Search(guess.kind, data, gauge, gain).elsewhere(guess)


def by_one_group(guess: Guess, data: Data, gauge: Array) -> list[tuple[Array, Array]]:
    """θ (c,) and its covariance by translations alone and by rotations alone, at a maximum."""
    return _Search(guess.kind, data, gauge, 0.0).alone(guess)


def chains(here: Likelihood) -> list[Axes]:
    """The chains of both groups at a maximum of the likelihood, its nuisances taken off."""
    data = here.data
    count = data.nuisances.shape[2]
    guess = Guess(here.kind, here.parameters, *here.weights, here.theta[:count], np.eye(count))
    return _Search(here.kind, data, here.gauge, 0.0).at(guess, here.theta)


def _weights(of: Data | Guess, group: int) -> dict[str, Array]:
    """Those of a group's series."""
    return {
        "measured": np.ascontiguousarray(of.measured[:, group]),
        "moved": np.ascontiguousarray(of.moved[:, group]),
    }


def stretches(count: int) -> npt.NDArray[np.intp]:
    """The numbers of the poses in stretches of so many, evenly over all of them."""
    begins = np.linspace(0, count - _STRETCH, MANY // _STRETCH).astype(np.intp)
    return np.asarray((begins[:, None] + np.arange(_STRETCH)).ravel())


def part_of(data: Data, part: npt.NDArray[np.intp]) -> Data:
    """Some poses, so long apart between stretches that these are independent.

    The likelihoods of two processes there are none of the same data.
    """
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

    def __init__(self, kind: Kind, data: Data, gauge: Array, gain: float) -> None:
        self._kind, self._data, self._gain = kind, data, gain
        self._low, self._high = bounds(kind, data)
        self._precision = data.precision
        # (2, N, 3, c + 1), the errors last.
        if kind is Kind.WANDER:
            self._both = by_group(data.nuisances, gauge, data.errors[..., None])
            self._precision = np.concatenate([data.precision, np.zeros(6)])
        else:
            self._both = data.by_group

    @cached_property
    def _series(self) -> list[Series]:
        data = self._data
        return [
            Series(data.intervals, self._both[g, ..., -1].T, data.variance[g], **_weights(data, g))
            for g in range(2)
        ]

    def run(self, begin: Guess | None) -> Guess:
        """Nuisances and parameters in turn."""
        if loops.there() and self._both.shape[3] <= _MOST_COLUMNS:
            return self._run_in_c(begin)
        places: list[Axes] | None = None
        self._begin = begin
        theta = np.zeros(len(self._precision))
        if begin is not None:
            theta[: len(begin.theta)] = begin.theta
            if len(begin.measured) == len(self._data.times):
                self._series = [
                    each._replace(**_weights(begin, g)) for g, each in enumerate(self._series)
                ]
            if begin.kind is self._kind:
                places = [
                    Axes(self._kind, parameters, series)
                    for parameters, series in zip(begin.parameters, self._series, strict=True)
                ]
        for _ in range(_TURNS):
            places = self._climbed(places, theta)
            step, covariance = self._regressed(places, theta)
            theta = theta + step
            size = np.abs(step) / np.sqrt(np.diag(covariance))
            if (size < _SHORT).all():
                break
            if begin is None and (size > _LONG).any():
                places = None
        return self._guess(places or self._climbed(None, theta), theta, covariance)

    def _run_in_c(self, begin: Guess | None) -> Guess:
        """As `run`."""
        data, kind = self._data, self._kind
        (_, count, _, columns), size = self._both.shape, len(kind.names)
        theta, covariance = np.zeros(columns - 1), np.empty((columns - 1, columns - 1))
        parameters, factors = np.empty((2, size)), np.empty((2, 2 * count - 1))
        known: tuple[loops.Argument, ...] = -1, 0, parameters, 0
        weights: Data | Guess = data
        if begin is not None:
            theta[: len(begin.theta)] = begin.theta
            same = len(begin.measured) == count
            weights = begin if same else data
            given = loops.doubles(begin.parameters)
            known = NUMBERS[begin.kind], given.shape[1], given, int(same)
        failed = loops.call(
            "search_run",
            NUMBERS[kind],
            count,
            columns,
            size,
            *map(loops.doubles, (data.intervals, self._both, data.variance, data.travel)),
            *map(loops.doubles, (self._precision, self._low, self._high)),
            maximum.RULES,
            structure.RULES,
            _RULES,
            float(self._gain),
            *known,
            loops.doubles(np.concatenate([weights.measured, weights.moved]).T),
            parameters,
            factors,
            theta,
            covariance,
            np.empty(loops.call("search_room", count, columns)),
        )
        if failed:
            raise np.linalg.LinAlgError("no likelihood")
        measured, moved = (loops.doubles(each.T) for each in np.split(factors, [count], axis=1))
        of_nuisances = len(data.precision)
        found = theta[:of_nuisances], covariance[:of_nuisances, :of_nuisances]
        return Guess(kind, parameters, measured, moved, *found)

    def _guess(self, places: list[Axes], theta: Array, covariance: Array) -> Guess:
        count = len(self._data.precision)
        return Guess(
            self._kind,
            np.stack([place.parameters for place in places]),
            np.stack([place.weights[0] for place in places], axis=1),
            np.stack([place.weights[1] for place in places], axis=1),
            theta[:count],
            covariance[:count, :count],
        )

    def elsewhere(self, begin: Guess) -> Guess | None:
        """The likeliest end of other starts, all at the nuisances found."""
        again = [self._may_have_others(begin, g) for g in range(2)]
        if not any(again):
            return None
        theta = np.zeros(len(self._precision))
        theta[: len(begin.theta)] = begin.theta
        moved = [False, False]

        def chain(g: int, series: Series) -> Axes:
            here = Axes(self._kind, begin.parameters[g], series._replace(**_weights(begin, g)))
            if not again[g]:
                return here
            low, high = self._low[g], self._high[g]
            bare = series._replace(
                measured=np.ones_like(series.measured), moved=np.ones_like(series.moved)
            )
            places = [begin.parameters[g], *structure.starts(self._kind, bare)]
            there = max(
                (
                    climbed(self._kind, np.clip(at, low, high), bare, low, high, self._gain, _STEPS)
                    for at in places
                ),
                key=maximum.penalised,
            )
            moved[g] = maximum.penalised(there) > maximum.penalised(here) + self._gain
            return there if moved[g] else here

        places = self._rotation_first(theta, chain)
        if not any(moved):
            return None
        step, covariance = self._regressed(places, theta)
        return self._guess(places, theta + step, covariance)

    def _may_have_others(self, guess: Guess, group: int) -> bool:
        """Whether a group has outliers, or a component that is nothing."""
        sizes = [not name.endswith("time") for name in self._kind.names]
        least = self._low[group][sizes] + np.log(_NOTHING)
        return bool(
            (guess.measured[:, group] > 1.0).any()
            or (guess.moved[:, group] > 1.0).any()
            or (guess.parameters[group][sizes] < least).any()
        )

    def at(self, guess: Guess, theta: Array) -> list[Axes]:
        """The chains at a guess; theta: of all nuisances, (c,)."""

        def chain(g: int, series: Series) -> Axes:
            return Axes(self._kind, guess.parameters[g], series._replace(**_weights(guess, g)))

        return self._rotation_first(theta, chain)

    def _climbed(self, places: list[Axes] | None, theta: Array) -> list[Axes]:
        """Each group at its maximum, given the nuisances."""

        def chain(g: int, series: Series) -> Axes:
            return self._maximum(g, None if places is None else places[g], series)

        return self._rotation_first(theta, chain)

    def _rotation_first(self, theta: Array, chain: Callable[[int, Series], Axes]) -> list[Axes]:
        """The ``chain`` of each group's errors, given the nuisances; headings turn translations."""
        flat = self._both.reshape(-1, len(theta) + 1)
        residual = (flat @ np.append(-theta, 1.0)).reshape(2, -1, 3)
        found: list[Axes] = []
        for g in (1, 0):
            errors = residual[g]
            if g == 0 and self._kind is not Kind.WANDER:
                heading = np.ascontiguousarray(found[0].states[:, 0].T)
                errors = self._turned(heading[..., None], errors[..., None])[..., 0]
            errors = np.ascontiguousarray(errors.T)
            found.insert(0, chain(g, self._series[g]._replace(errors=errors)))
        return found

    def _maximum(self, group: int, place: Axes | None, series: Series) -> Axes:
        low, high = self._low[group], self._high[group]
        if place is not None:
            measured, moved = place.weights
            series = series._replace(measured=measured, moved=moved)
            begin = place.parameters, series
        else:
            candidates = [
                climbed(self._kind, np.clip(start, low, high), series, low, high, self._gain, _FEW)
                for start in self._starts(group, series)
            ]
            best = max(candidates, key=maximum.penalised)
            begin = best.parameters, best.series
        return climbed(self._kind, *begin, low, high, self._gain, _STEPS)

    def _starts(self, group: int, series: Series) -> list[Array]:
        """Parameters (p,) to begin at."""
        found = structure.starts(self._kind, self._cleaned(group, series))
        if self._kind is Kind.VELOCITY and self._begin is not None:
            # Beside the drift that there is, too.
            drift = self._begin.parameters[group]
            found.append(np.concatenate([drift, found[0][2:]]))
        return found

    def _cleaned(self, group: int, series: Series) -> Series:
        """Without what has factors already, as drift."""
        if self._begin is None or len(self._begin.measured) != len(series.variance):
            return series
        place = Axes(self._begin.kind, self._begin.parameters[group], series)
        measured, moved = place.weights
        leaps = np.cumsum(place.moves[:, 0] * (1.0 - 1.0 / moved), axis=1)
        errors = series.errors - place.residual * (1.0 - 1.0 / measured)
        errors[:, 1:] -= leaps
        return series._replace(errors=errors)

    def _regressed(self, places: list[Axes], theta: Array) -> tuple[Array, Array]:
        """A step of θ by generalised least squares, and its covariance."""
        found, covariance = self._solved(np.sum(self._normals(places), axis=0))
        return found - theta, covariance

    def _solved(self, normal: Array) -> tuple[Array, Array]:
        """θ and its covariance by normal equations (c + 1, c + 1), the right-hand side last."""
        # What the process takes all of has no information but by round-off.
        own = np.diag(normal)[:-1]
        least = self._precision + _ROUND_OFF * np.abs(own)
        information = normal[:-1, :-1] + np.diag(least)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), least))
        information = scale[:, None] * information * scale + _ROUND_OFF * np.eye(len(own))
        values, vectors = np.linalg.eigh(0.5 * (information + information.T))
        vectors = scale[:, None] * vectors
        covariance = vectors / np.maximum(values, _ROUND_OFF) @ vectors.T
        return covariance @ normal[:-1, -1], covariance

    def alone(self, begin: Guess) -> list[tuple[Array, Array]]:
        """θ and its covariance by translations alone and by rotations alone."""
        places = [
            Axes(
                self._kind,
                begin.parameters[g],
                series._replace(**_weights(begin, g)),
            )
            for g, series in enumerate(self._series)
        ]
        normals = self._normals(places)
        return [self._solved(normals[g] + _IGNORED * normals[1 - g])[:2] for g in range(2)]

    def _normals(self, places: list[Axes]) -> list[Array]:
        """The normal equations (c + 1, c + 1) of each group, the errors last."""
        positions, rotations = self._both
        of_rotations = places[1].products(rotations)
        if self._kind is not Kind.WANDER:
            positions = self._turned(places[1].smoothed(rotations), positions)
        return [places[0].products(positions), of_rotations]

    def _turned(self, rotations: Array, positions: Array) -> Array:
        """Positions (N, 3, m) and what ``rotations`` of that shape have moved them by until there.

        They take the place of the rotations.
        """
        if loops.there():
            travel, work = (
                np.ascontiguousarray(self._data.travel),
                np.empty((3, rotations.shape[2])),
            )
            given = travel, np.ascontiguousarray(positions), rotations, work
            loops.call("chain_turn", len(rotations), rotations.shape[2], *given)
            return rotations
        moved = np.zeros_like(rotations)
        travel = self._data.travel.T[..., None]
        x, y, z = rotations[:-1].swapaxes(0, 1)
        moved[1:, 0] = travel[1] * z - travel[2] * y
        moved[1:, 1] = travel[2] * x - travel[0] * z
        moved[1:, 2] = travel[0] * y - travel[1] * x
        return np.asarray(positions + np.cumsum(moved, axis=0))
