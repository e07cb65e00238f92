# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likelihood of one group's errors where its three axes are alike, for the search of a maximum.

Translation and rotation are two chains then, each of one axis with three right-hand sides: a
hundredth of the work of `likelihood.Likelihood`, whose approximation this is. It knows the ground
truth's variance, not its correlations; the nuisances and what a heading error does to positions
are taken off the errors before. Arrays have the pose as their last axis.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from trajeval_ros import loops
from trajeval_ros.error_model.factored import Factored
from trajeval_ros.error_model.filtered import Filtered, Known
from trajeval_ros.error_model.filtered import climbed as climbed_in_c
from trajeval_ros.error_model.maximum import climb
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.series import Series

Array = npt.NDArray[np.float64]


class _Chain(Protocol):
    """The arithmetic at one place; k: ``kind.components``."""

    @property
    def value(self) -> float: ...

    @property
    def states(self) -> Array: ...

    @property
    def residual(self) -> Array: ...

    @property
    def moves(self) -> Array: ...

    @property
    def noise(self) -> Array: ...

    def gradient(self) -> Array: ...

    def average_information(self) -> Array: ...

    def disturbances(self) -> tuple[Array, Array, Array, Array]: ...

    def products(self, columns: Array) -> Array: ...

    def smoothed(self, columns: Array) -> Array: ...


class Axes:
    """The restricted likelihood of a group at ψ (p,).

    Raises numpy.linalg.LinAlgError where there is none.
    """

    def __init__(
        self, kind: Kind, parameters: Array, series: Series, known: Known | None = None
    ) -> None:
        """Its value; the rest when it is asked for, unless it is known."""
        self.kind, self.parameters, self.series = kind, parameters, series
        self._chain: _Chain
        if known is not None or loops.there():
            self._chain = Filtered(kind, parameters, series, known)
        else:
            self._chain = Factored(kind, parameters, series)
        self.value = self._chain.value

    def at(self, parameters: Array, weights: tuple[Array, Array]) -> Axes:
        """The likelihood at another place."""
        series = self.series._replace(measured=weights[0], moved=weights[1])
        return Axes(self.kind, parameters, series)

    @property
    def weights(self) -> tuple[Array, Array]:
        """Factors of the variances, of poses and of steps."""
        return self.series.measured, self.series.moved

    def own_noise(self) -> tuple[Array, Array]:
        """The variances of one axis that poses and steps have where their weights are 1."""
        return np.exp(2.0 * self.parameters[:1]), self._chain.noise / self.series.moved

    @property
    def states(self) -> Array:
        """x, (3, k, N), of WANDER less its mean."""
        return self._chain.states

    @property
    def residual(self) -> Array:
        """What states and mean leave of the errors, (3, N)."""
        return self._chain.residual

    @property
    def moves(self) -> Array:
        """What the steps add to the states, (3, k, N - 1)."""
        return self._chain.moves

    def products(self, columns: Array) -> Array:
        """``Xᵀ P X`` (c, c) of columns X (N, 3, c), P the inverse of the errors' covariance.

        The mean of WANDER is none of it, a flat first state is projected out.
        """
        return self._chain.products(columns)

    def smoothed(self, columns: Array) -> Array:
        """The processes of columns (N, 3, c), as each pose's neighbours tell them."""
        return self._chain.smoothed(columns)

    def gradient(self) -> Array:
        """``∂ log L / ∂ψ``, (p,)."""
        return self._chain.gradient()

    def average_information(self) -> Array:
        """Of ψ, (p, p)."""
        return self._chain.average_information()

    def disturbances(self) -> tuple[Array, Array, Array, Array]:
        """As those of the whole: of the poses, (N,) each, and of the steps, (N - 1,) each."""
        return self._chain.disturbances()


def climbed(
    kind: Kind,
    parameters: Array,
    series: Series,
    low: Array,
    high: Array,
    gain: float,
    steps: int,
    *,
    near: bool = False,
    weighted: bool = True,
) -> Axes:
    """The maximum from ψ (p,), as `trajeval_ros.error_model.maximum.climb`.

    Raises numpy.linalg.LinAlgError where there is no likelihood to begin with.
    """
    if loops.there():
        bounds = low, high
        return Axes(
            kind, *climbed_in_c(kind, parameters, series, *bounds, gain, steps, near, weighted)
        )
    here = Axes(kind, parameters, series)
    return climb(here, low, high, gain, steps, near=near, weighted=weighted)
