# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How an estimate's error goes on from pose to pose (``docs/error_model.md``, The three processes).

The error is a position and a rotation vector in the axes of the aligned world. Each of the two
groups, translation and rotation, has states of so many components on each of its three axes,

    s_(i+1) = F_i s_i + w_i,    w_i ~ N(0, Q_i),    dt = t_(i+1) - t_i,    a = exp(-dt / T)

- drift, a random walk:  F = 1, Q = dt w²
- velocity: besides, the error's velocity b is an Ornstein-Uhlenbeck process (σ, T), integrated
  exactly: F = [[1, T (1 - a)], [0, a]], Q = dt w² in the first and
  σ² [[T² (2 dt/T - 3 + 4a - a²), T (1 - a)²], [T (1 - a)², 1 - a²]]
- wander: the error itself is one: F = a, Q = σ² (1 - a²)

Every parameter is the logarithm of a standard deviation or of a time.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

GROUPS = ("translation", "rotation")


class Kind(enum.StrEnum):
    """Which process."""

    DRIFT = "drift"
    VELOCITY = "velocity"
    WANDER = "wander"

    @property
    def components(self) -> int:
        """States on each axis."""
        return 2 if self is Kind.VELOCITY else 1

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters of one group, the first of which is the jitter's."""
        return {
            Kind.DRIFT: ("jitter_std", "drift_std"),
            Kind.VELOCITY: ("jitter_std", "drift_std", "velocity_std", "velocity_time"),
            Kind.WANDER: ("jitter_std", "wander_std", "wander_time"),
        }[self]


NUMBERS = {Kind.DRIFT: 0, Kind.VELOCITY: 1, Kind.WANDER: 2}
"""What the loops in C call each."""


class Steps(NamedTuple):
    """A group's F and Q, (n, k, k), and their derivatives by each of its p parameters.

    slope_transition, slope_noise: (p, n, k, k). prior: the precision of the first pose's states,
    (k, k), zero where it is flat; slope_prior: (p, k, k); log_prior: its log-determinant without
    the flat ones, with its derivative.
    """

    transition: Array
    noise: Array
    slope_transition: Array
    slope_noise: Array
    prior: Array
    slope_prior: Array
    log_prior: float
    slope_log_prior: Array


def steps(kind: Kind, parameters: Array, intervals: Array, factors: Array | None = None) -> Steps:
    """A group's steps.

    parameters: (p,), in the order of ``kind.names``. intervals: dt, (n,), seconds. factors: of the
    error's own variance in each step, (n,): what leaps is the error, not its velocity.
    """
    n, k, p = len(intervals), kind.components, len(parameters)
    # In memory the pose comes last: each entry is worked out for all poses at once.
    transition, noise = np.zeros((2, k, k, n)).transpose(0, 3, 1, 2)
    d_transition, d_noise = np.zeros((2, p, k, k, n)).transpose(0, 1, 4, 2, 3)
    if kind is not Kind.WANDER:
        transition[:, 0, 0] = 1.0
        noise[:, 0, 0] = intervals * np.exp(2.0 * parameters[1])
        d_noise[1] = 2.0 * noise
    if kind is not Kind.DRIFT:
        variance, time = np.exp(2.0 * parameters[-2]), np.exp(parameters[-1])
        h = intervals / time
        a, rest = np.exp(-h), -np.expm1(-h)
        transition[:, -1, -1] = a
        d_transition[-1, :, -1, -1] = a * h
        stationary = np.zeros_like(noise)
        stationary[:, -1, -1] = variance * rest * (1.0 + a)
        d_noise[-1, :, -1, -1] = -2.0 * variance * a * a * h
        if kind is Kind.VELOCITY:
            transition[:, 0, 1] = time * rest
            d_transition[-1, :, 0, 1] = time * (rest - a * h)
            integral = _integral(h, a)
            stationary[:, 0, 0] = variance * time**2 * integral
            d_noise[-1, :, 0, 0] = variance * time**2 * 2.0 * (integral - h * rest * rest)
            stationary[:, 0, 1] = stationary[:, 1, 0] = variance * time * rest * rest
            cross = variance * time * rest * (rest - 2.0 * a * h)
            d_noise[-1, :, 0, 1] = d_noise[-1, :, 1, 0] = cross
        noise += stationary
        d_noise[-2] = 2.0 * stationary
    if factors is not None:
        noise[:, 0, 0] *= factors
        d_noise[:, :, 0, 0] *= factors
    return Steps(transition, noise, d_transition, d_noise, *first(kind, parameters))


def first(kind: Kind, parameters: Array) -> tuple[Array, Array, float, Array]:
    """Of the first pose: the prior, its slopes, its log-determinant, and that one's (`Steps`)."""
    k, p = kind.components, len(parameters)
    prior, slopes, slope = np.zeros((k, k)), np.zeros((p, k, k)), np.zeros(p)
    if kind is Kind.DRIFT:
        return prior, slopes, 0.0, slope
    precision = np.exp(-2.0 * parameters[-2])
    prior[-1, -1], slopes[-2, -1, -1], slope[-2] = precision, -2.0 * precision, -2.0
    return prior, slopes, -2.0 * float(parameters[-2]), slope


def _integral(h: Array, a: Array) -> Array:
    """``2h - 3 + 4a - a²``, whose first term is ``2h³/3``.

    Below h = 0.05 the series, whose first term left out is below 1e-9 of it, as the round-off of
    the formula is above.
    """
    terms = (2 / 3, -1 / 2, 7 / 30, -1 / 12, 31 / 1260, -1 / 160, 127 / 90720)
    series = h**3 * sum(c * h**i for i, c in enumerate(terms))
    return np.asarray(np.where(h < 0.05, series, 2.0 * h - 3.0 + 4.0 * a - a * a))
