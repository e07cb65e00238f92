# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Gaussian process of the ground truth's segments."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from trajeval_ros.ground_truth.hyperparameters import (
    LEAST_SCALE,
    GroupHyperparameters,
    Hyperparameters,
)
from trajeval_ros.ground_truth.kernel_sum import KernelSum
from trajeval_ros.ground_truth.kernels import Kernel
from trajeval_ros.ground_truth.regimes import USUAL, Learned, Regime

Array = npt.NDArray[np.float64]
Regimes = tuple[Regime, Regime]

AS_LEARNED: Regimes = (USUAL, USUAL)


@dataclass(frozen=True, slots=True)
class Process:
    """A sum of kernels and its hyperparameters.

    ``accuracy``: the instrument's, in translation (m) and rotation (rad); a segment's scale does
    not bring the noise below it. ``learned``: what the hyperparameters come from, of translation
    and rotation; None where they are given, and no segment's samples change them. ``stamp_std``:
    how uncertain each sample's stamp is, s; ``stamp_shared``: how uncertain those are together
    that follow each other, s.
    """

    kernels: tuple[Kernel, ...]
    hyperparameters: Hyperparameters
    accuracy: tuple[float, float]
    learned: tuple[Learned, Learned] | None = None
    stamp_std: float = 0.0
    stamp_shared: float = 0.0
    least_scales: tuple[float, ...] = field(init=False, compare=False, repr=False)
    """The least ``s²`` of translation and rotation."""
    _known: dict[Regimes, Process] = field(default_factory=dict, compare=False, repr=False)
    _parts: dict[int, tuple[KernelSum, Array]] = field(
        default_factory=dict, compare=False, repr=False
    )
    rules: list[tuple[Array, npt.NDArray[np.intp], Array, Array]] = field(
        default_factory=list, compare=False, repr=False
    )
    """What `adaptation` works out of ``learned`` once, the same under all regimes."""

    def __post_init__(self) -> None:
        """What is asked for often is worked out once."""
        noises = (group.noise_std for group in self.groups)
        least = (
            max(LEAST_SCALE, min((floor / noise) ** 2, 1.0))
            for floor, noise in zip(self.accuracy, noises, strict=True)
        )
        object.__setattr__(self, "least_scales", tuple(least))

    @staticmethod
    def of(
        learned: tuple[Learned, Learned], stamp_std: float = 0.0, stamp_shared: float = 0.0
    ) -> Process:
        """The process that was learned."""
        translation, rotation = learned
        hyperparameters = Hyperparameters(translation.under(USUAL), rotation.under(USUAL))
        accuracy = (translation.accuracy, rotation.accuracy)
        kernels = translation.model.kernels
        return Process(kernels, hyperparameters, accuracy, learned, stamp_std, stamp_shared)

    def under(self, regimes: Regimes) -> Process:
        """The process of a stretch in other regimes."""
        if self.learned is None or regimes == AS_LEARNED:
            return self
        if regimes not in self._known:
            translation, rotation = map(Learned.under, self.learned, regimes)
            self._known[regimes] = replace(
                self, hyperparameters=Hyperparameters(translation, rotation), _known={}, _parts={}
            )
        return self._known[regimes]

    @property
    def groups(self) -> tuple[GroupHyperparameters, GroupHyperparameters]:
        """The hyperparameters of translation and rotation."""
        return self.hyperparameters.translation, self.hyperparameters.rotation

    @property
    def variances(self) -> tuple[Array, Array]:
        """``k(t, t)`` and the noise's standard deviation of each coordinate; (6,)."""
        signal = [sum(c.std**2 for c in group.components) for group in self.groups]
        return np.repeat(signal, 3), np.repeat([group.noise_std for group in self.groups], 3)

    def parts(self, size: int) -> tuple[KernelSum, Array]:
        """The kernels' sum and the noise's variances (2 size,), ``size`` groups of each."""
        if size not in self._parts:
            groups = tuple(group for group in self.groups for _ in range(size))
            noise = np.array([group.noise_std**2 for group in groups])
            self._parts[size] = KernelSum.of(self.kernels, groups), noise
        return self._parts[size]
