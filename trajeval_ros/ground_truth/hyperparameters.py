# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The numbers that shape the ground truth's Gaussian process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

# How firmly a segment's scale is held at one: as if so many coordinates had been seen before. Few
# leave quiet segments overconfident; many do not let the process follow a change of the motion.
DEGREES_OF_FREEDOM = 20.0
# Nor is a segment's scale less than this: that it fits well where it is sampled does not make it
# as good between the samples.
LEAST_SCALE = 0.5

# Noise less than so much of a kernel's σ, and the covariance of the samples is singular but for
# round-off.
LEAST_NOISE = 1e-6

FURTHER_COMPONENTS = {
    "smooth": "smooth motion",
    "rough": "rough motion",
    "correlated_noise": "correlated noise",
}
"""What ``matern52`` adds to its signal, in this order, and what each stands for."""


@dataclass(frozen=True, slots=True)
class Component:
    """One kernel's part: ``std`` σ (m or rad), which may be zero, and ``length_scale`` l (s)."""

    std: float
    length_scale: float

    def __post_init__(self) -> None:
        """Raise :class:`ValueError` for a value that is negative or not finite."""
        if not 0.0 <= self.std < float("inf"):
            raise ValueError(f"std must be non-negative and finite, got {self.std!r}")
        _require_positive(length_scale=self.length_scale)


@dataclass(frozen=True, slots=True)
class GroupHyperparameters:
    """One group of coordinates: translation (m) or rotation (rad).

    ``components``, one a kernel of the sum; ``noise_std`` n in the group's unit.
    """

    components: tuple[Component, ...]
    noise_std: float

    def __post_init__(self) -> None:
        """Raise :class:`ValueError` unless the noise is positive and finite."""
        _require_positive(noise_std=self.noise_std)

    @property
    def named(self) -> dict[str, float]:
        """The numbers by the names of the parameters ``gp.translation.*`` and ``gp.rotation.*``."""
        values: dict[str, float] = {}
        for part, component in zip(("signal", *FURTHER_COMPONENTS), self.components, strict=False):
            length = "length_scale" if part == "signal" else f"{part}_length_scale"
            values |= {f"{part}_std": component.std, length: component.length_scale}
        return {**values, "noise_std": self.noise_std}


class Hyperparameters(NamedTuple):
    """Both groups; one set serves all segments (``docs/method.md``, Ground truth)."""

    translation: GroupHyperparameters
    rotation: GroupHyperparameters


def _require_positive(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < float("inf"):
            raise ValueError(f"{name} must be positive and finite, got {value!r}")
