# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The numbers that shape the ground truth's Gaussian process."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GroupHyperparameters:
    """One group of coordinates: translation (m) or rotation (rad).

    ``signal_std`` σ and ``noise_std`` n in the group's unit, ``length_scale`` l in seconds.
    """

    signal_std: float
    length_scale: float
    noise_std: float

    def __post_init__(self) -> None:
        """Raise :class:`ValueError` unless all three are positive and finite."""
        for name in ("signal_std", "length_scale", "noise_std"):
            value = getattr(self, name)
            if not 0.0 < value < float("inf"):
                raise ValueError(f"{name} must be positive and finite, got {value!r}")


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Both groups; one set serves all segments (``docs/method.md``, Ground truth)."""

    translation: GroupHyperparameters
    rotation: GroupHyperparameters
