# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals of parameters by the profile of the likelihood, for those near nothing.

Where a component of the error is as good as nothing, its information tells no honest standard
deviation. The values at which the likelihood, the group's other parameters at their likeliest, has
fallen by no more than ``½ χ²(95 %)`` are told all the same; by the chains of `axes`, with the
factors of outliers held.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trajeval_ros.error_model.axes import Axes, climbed
from trajeval_ros.error_model.likelihood import Likelihood
from trajeval_ros.error_model.search import bounds, chains

Array = npt.NDArray[np.float64]

# Half of χ² with one degree of freedom at 95 %.
_FALL = 1.92
_GAIN, _STEPS = 0.1, 4
# An end is found when the fall is this near, or after so many points.
_NEAR = 0.1
_POINTS = 8
# Beyond a first step, in the logarithm of a parameter, so much further, then twice as much.
_FURTHER = 0.4
_FAR = 2.0


class Profiles:
    """Of one group at the likelihood's maximum."""

    def __init__(self, here: Likelihood, group: int) -> None:
        """Climb the chain of the group from there."""
        low, high = bounds(here.kind, here.data)
        self._low, self._high = low[group], high[group]
        chain = chains(here)[group]
        begin = chain.kind, chain.parameters, chain.series
        self._top = climbed(*begin, self._low, self._high, _GAIN, _STEPS, weighted=False)

    def interval(self, number: int, deviation: float, ratio: float) -> tuple[float, float]:
        """The 95 % interval of a parameter, from zero where it may be nothing.

        deviation: of its logarithm, roughly. ratio: by how much standard deviations are larger than
        the likelihood says. The upper end is infinite where nothing bounds it.
        """
        half = 1.96 * deviation * ratio
        ends = np.array([-half, half])
        if not self._top.kind.names[number].endswith("time"):
            # Of its variance, near nothing, that is half of the interval.
            ends = 0.5 * np.log(np.maximum(1.0 + 2.0 * ends, 1e-300))
        fall = _FALL * ratio**2
        low, high = (self._end(number, float(end), fall) for end in ends)
        return (0.0 if low is None else low, np.inf if high is None else high)

    def _end(self, number: int, step: float, fall: float) -> float | None:
        """Where the profile has fallen so far on one side; None where it never does.

        step: about how far that is, in the parameter's logarithm.
        """
        here = self._top
        begin = float(here.parameters[number])
        limit = float((self._low if step < 0.0 else self._high)[number])
        further = float(np.copysign(_FURTHER, step))
        # In the root of the fall the profile is nearly straight.
        inside, outside = (begin, 0.0), (np.nan, np.nan)
        at = begin + step
        for _ in range(_POINTS):
            at = max(at, limit) if step < 0.0 else min(at, limit)
            try:
                here = self._held(here, number, at)
                fallen = float(np.sqrt(max(self._top.value - here.value, 0.0) / fall))
            except np.linalg.LinAlgError:  # so far off that no digits are left
                fallen = np.inf
            if abs(fallen - 1.0) < _NEAR:
                break
            if fallen > 1.0:
                outside = at, fallen
            elif at == limit:
                return None
            else:
                inside = at, fallen
            if np.isnan(outside[0]):
                at += further
                further *= 2.0
            elif step > 0.0 and outside[0] - inside[0] > _FAR:
                # From nothing the root rises about as the power 3/2.
                at = max(outside[0] - np.log(outside[1]) / 1.5, inside[0] + 0.5)
            else:
                share = (1.0 - inside[1]) / (outside[1] - inside[1])
                # Where it bends, the straight line would come from one side alone.
                at = inside[0] + 0.5 * (share + 0.5) * (outside[0] - inside[0])
        return float(np.exp(at))

    def _held(self, here: Axes, number: int, at: float) -> Axes:
        """The likeliest place with one parameter held."""
        parameters = here.parameters.copy()
        parameters[number] = at
        low, high = self._low.copy(), self._high.copy()
        low[number] = high[number] = at
        begin = here.kind, parameters, here.series
        return climbed(*begin, low, high, _GAIN, _STEPS, near=True, weighted=False)
