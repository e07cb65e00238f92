# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine's settings as typed values, built in one place from the table of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import GAUGES, Gauge
from trajeval_ros.conventional.step_pairs import STEP_UNITS, StepUnit
from trajeval_ros.ground_truth import trajectory
from trajeval_ros.ground_truth.clock import LOOK_AHEAD
from trajeval_ros.ground_truth.hyperparameters import (
    FURTHER_COMPONENTS,
    Component,
    GroupHyperparameters,
    Hyperparameters,
)
from trajeval_ros.ground_truth.segmentation import SegmentShape
from trajeval_ros.online.axes import AS_GIVEN
from trajeval_ros.online.parameters import ONE, Value

Array = npt.NDArray[np.float64]

PATIENCE = 30_000_000_000
"""How long after an estimate (ns) the sample behind a gap may be stamped, for it to wait for it."""


class Timing(NamedTuple):
    """When an estimate can be answered; all in ns: parameters of the same names, and ``lag``."""

    lag: int
    max_gap: int
    max_wait: int

    @property
    def patience(self) -> int:
        """How long after an estimate its last sample may be stamped; constant in a run."""
        return max(PATIENCE, self.max_gap + self.lag)


class EstimateSettings(NamedTuple):
    """What is an estimate's own.

    ``time_offset`` (ns) is added to its stamps; ``extrinsic``: its body frame in the ground truth's
    body frame, x y z qx qy qz qw; ``axes``: those of its world and body, of `online.axes`.
    """

    use_covariance: bool
    time_offset: int
    extrinsic: tuple[float, ...]
    axes: str = AS_GIVEN

    @property
    def from_body(self) -> Array:
        """``T_estbody_gtbody``, the inverse of the extrinsic; (4, 4)."""
        given = np.array(self.extrinsic, dtype=np.float64)
        return se3.inverse(se3.from_position_quaternion(given[:3], given[3:]))


class EvaluationSettings(NamedTuple):
    """What the figures are of: ``window`` (ns), ``relative_delta`` (by its unit)."""

    gauge: Gauge
    window: int
    joint: bool
    relative_delta: float
    relative_unit: StepUnit


class GroundTruthSettings(NamedTuple):
    """``process``: the model's; ``learned``: whether its hyperparameters are found in the data.

    ``regularize_stamps``: late stamps of a regular clock are replaced by the clock's.
    """

    process: trajectory.Settings
    use_covariance: bool
    learned: bool
    axes: str = AS_GIVEN
    regularize_stamps: bool = False


class Settings(NamedTuple):
    """All that the engine is told; ``estimates`` by their names, in their order."""

    ground_truth: GroundTruthSettings
    timing: Timing
    evaluation: EvaluationSettings
    estimates: Mapping[str, EstimateSettings]


def settings_of(values: Mapping[str, Value], names: Sequence[str] = ONE) -> Settings:
    """Return the settings that parameters say; ``values`` as of `parameters.complete`."""
    read = _Reader(values)
    regularize = read.text("ground_truth.stamps") == "regularize"
    return Settings(
        ground_truth=GroundTruthSettings(
            process=_process(read),
            use_covariance=read.flag("ground_truth.use_covariance"),
            learned=read.text("gp.hyperparameters") == "auto",
            axes=read.text("ground_truth.axes"),
            regularize_stamps=regularize,
        ),
        timing=Timing(
            lag=read.nanoseconds("ground_truth.lag"),
            max_gap=read.nanoseconds("ground_truth.max_gap"),
            # The stamps that come after one tell what it is taken for.
            max_wait=read.nanoseconds("max_wait") + (LOOK_AHEAD if regularize else 0),
        ),
        evaluation=EvaluationSettings(
            gauge=next(g for n, g in GAUGES.items() if n == read.text("gauge")),
            window=read.nanoseconds("window.duration"),
            joint=read.text("likelihood.covariance") == "joint",
            relative_delta=read.number("relative.delta"),
            relative_unit=next(u for u in STEP_UNITS if u == read.text("relative.unit")),
        ),
        estimates={
            name: EstimateSettings(
                use_covariance=read.flag(f"{name}.use_covariance"),
                time_offset=read.nanoseconds(f"{name}.time_offset"),
                extrinsic=read.numbers(f"{name}.extrinsic"),
                axes=read.text(f"{name}.axes"),
            )
            for name in names
        },
    )


def _process(read: _Reader) -> trajectory.Settings:
    kernel = read.text("gp.kernel")

    def group(name: str) -> GroupHyperparameters:
        parts = ["signal_std", "length_scale"]
        components = [Component(*(read.number(f"gp.{name}.{part}") for part in parts))]
        if kernel == "matern52":
            for part in FURTHER_COMPONENTS:
                names = (f"gp.{name}.{part}_{figure}" for figure in ("std", "length_scale"))
                components.append(Component(*(read.number(each) for each in names)))
        return GroupHyperparameters(tuple(components), read.number(f"gp.{name}.noise_std"))

    fixed = read.text("gp.hyperparameters") == "fixed"
    return trajectory.Settings(
        kernel=kernel,
        hyperparameters=Hyperparameters(group("translation"), group("rotation")) if fixed else None,
        translation_std=read.number("ground_truth.translation_std"),
        rotation_std=read.number("ground_truth.rotation_std"),
        shape=SegmentShape(
            read.nanoseconds("segment.duration"),
            read.number("segment.overlap"),
            round(read.number("segment.min_samples")),
            round(read.number("segment.max_samples")),
        ),
        exact_stamps=read.text("ground_truth.stamps") == "exact",
    )


class _Reader:
    """A parameter's value in its type."""

    def __init__(self, values: Mapping[str, Value]) -> None:
        self._values = values

    def text(self, name: str) -> str:
        return str(self._values[name])

    def flag(self, name: str) -> bool:
        return bool(self._values[name])

    def number(self, name: str) -> float:
        value = self._values[name]
        if isinstance(value, tuple):
            raise TypeError(f"{name} is not a number")
        return float(value)

    def numbers(self, name: str) -> tuple[float, ...]:
        value = self._values[name]
        if not isinstance(value, tuple):
            raise TypeError(f"{name} is not a list of numbers")
        return tuple(map(float, value))

    def nanoseconds(self, name: str) -> int:
        return round(self.number(name) * 1e9)
