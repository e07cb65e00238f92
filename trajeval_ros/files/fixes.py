# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How good a receiver's fixes are: NavSatFix has three statuses for it, and drivers fill them so.

An RTK fix with integer ambiguities is `STATUS_GBAS_FIX` of all of them; one with float ambiguities
is that too of Septentrio's, Swift's and NMEA's drivers, and `STATUS_FIX` of u-blox's; what tells
them apart is the covariance. Ambiguities are integers only where the position is known to a
fraction of the wavelength, 19 cm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# sensor_msgs/NavSatStatus; and what one has that nobody has set, since Iron.
NO_FIX, _SBAS, _GBAS, _UNSET = -1, 1, 2, -2
# Standard deviations, m, an axis: half a wavelength of L1; and less than what code alone gives.
_FIXED, _FLOAT = 0.095, 0.5


class Mode(StrEnum):
    """What a fix is."""

    FIXED = "fixed"
    FLOAT = "float"
    RTK = "rtk"
    """Fixed or float: without a covariance that is not told."""
    DIFFERENTIAL = "differential"
    SINGLE = "single"
    NONE = "none"


ASSUMED: Mapping[Mode, float] = {Mode.RTK: 0.5, Mode.DIFFERENTIAL: 1.0, Mode.SINGLE: 3.0}
"""Standard deviation, m, of east and north, where none is given; upwards it is twice that."""

_NAMES = {
    Mode.FIXED: "RTK fixed",
    Mode.FLOAT: "RTK float",
    Mode.RTK: "RTK, fixed or float",
    Mode.DIFFERENTIAL: "differential",
    Mode.SINGLE: "single",
    Mode.NONE: "none",
}


def mode_of(status: int, covariance: Array | None) -> Mode:
    """What a fix is. covariance: (3, 3), east, north, up; None where it is not known."""
    if status == NO_FIX or status < _UNSET:
        return Mode.NONE
    if covariance is None:
        return {_GBAS: Mode.RTK, _SBAS: Mode.DIFFERENTIAL}.get(status, Mode.SINGLE)
    std = float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))
    if std < _FIXED and status != _SBAS:
        return Mode.FIXED
    if status == _SBAS:
        return Mode.DIFFERENTIAL
    return Mode.FLOAT if status == _GBAS or std < _FLOAT else Mode.SINGLE


def known_covariance(values: object, kind: int) -> Array | None:
    """A message's covariance, (3, 3); None where it is unknown, or filled in with nothing."""
    covariance = np.array(values, dtype=np.float64).reshape(3, 3)
    diagonal = np.diagonal(covariance)
    if kind == 0 or not np.isfinite(covariance).all() or not (diagonal[:2] > 0.0).all():
        return None
    return covariance


def assumed_covariance(mode: Mode) -> Array:
    """What is assumed where none is known, (3, 3)."""
    std = ASSUMED.get(mode, ASSUMED[Mode.SINGLE])
    return np.diag([std**2, std**2, (2.0 * std) ** 2])


@dataclass(frozen=True, slots=True)
class FixCounts:
    """How many fixes of each mode there are, and of how many the covariance is assumed."""

    modes: Mapping[Mode, int] = field(default_factory=dict)
    assumed: int = 0

    def with_fix(self, mode: Mode, *, assumed: bool) -> FixCounts:
        """With one more."""
        modes = {**self.modes, mode: self.modes.get(mode, 0) + 1}
        return FixCounts(modes, self.assumed + assumed)

    @property
    def named(self) -> dict[str, int]:
        """As in ``summary.json``: every mode, and ``assumed``."""
        return {**{mode.value: self.modes.get(mode, 0) for mode in Mode}, "assumed": self.assumed}

    @property
    def kinds(self) -> int:
        """How many modes of fixes there are."""
        return sum(1 for mode, count in self.modes.items() if count and mode is not Mode.NONE)

    def sentence(self, title: str, use_covariance: bool) -> str:
        """What there is to say of a topic's, and of how they are taken."""
        parts = [f"{self.modes[mode]:,} {_NAMES[mode]}" for mode in Mode if self.modes.get(mode)]
        text = f"{title}: fixes are {', '.join(parts)}"
        if not use_covariance:
            if self.kinds < 2:
                return text
            name = title.replace(" ", "_")
            return (
                f"{text}, and all count alike: with {name}.use_covariance=true each is as certain"
                " as it says"
            )
        if not self.assumed:
            return text
        stds = ", ".join(
            f"{std:g} m ({_NAMES[mode]})" for mode, std in ASSUMED.items() if self.modes.get(mode)
        )
        return f"{text}; of {self.assumed:,} the covariance is unknown: assumed is {stds} an axis"
