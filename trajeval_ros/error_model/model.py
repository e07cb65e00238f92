# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model of an estimate: how good it is, and what is not its fault."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from trajeval_ros.error_model.changes import ClockChange, Stretch
from trajeval_ros.error_model.nuisances import NAMES, OBSERVED_STD, Nuisances
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.stamping import Scatter

Array = npt.NDArray[np.float64]


class Figure(NamedTuple):
    """A figure with its standard deviation, or its 95 % interval.

    interval: by the profile of the likelihood, where a parameter is near nothing, or hardly told:
    from zero where it may be none, to infinity where nothing bounds it. Standard deviations of an
    error have no standard deviation then (NaN).
    """

    value: float
    std: float
    interval: tuple[float, float] | None = None

    def divided(self, factor: float) -> Figure:
        """In another unit."""
        ends = self.interval
        scaled = None if ends is None else (ends[0] / factor, ends[1] / factor)
        return Figure(self.value / factor, self.std / factor, scaled)


class Jump(NamedTuple):
    """A move that no drift explains. stamp: ns, of the pose after it; sizes in m and rad."""

    stamp: int
    translation: float
    rotation: float


class Unobserved(NamedTuple):
    """A direction of the nuisances that the motion does not show.

    direction: (9,), in the order of `NAMES`, s, 1, m, rad and 1, one standard deviation long.
    """

    direction: Array

    @property
    def names(self) -> tuple[str, ...]:
        """The nuisances that take part, the strongest first."""
        share = np.abs(self.direction) / OBSERVED_STD
        order = np.argsort(-share)
        return tuple(NAMES[i] for i in order if share[i] > 0.3 * share.max())


class ErrorModel(NamedTuple):
    """What is fitted.

    kind: the likeliest process. groups: its parameters, of translation (m) and rotation (rad).
    nuisances, covariance: (9, 9), in the order of `NAMES`; extrinsic as a step from the left.
    log_likelihood: of the errors at the fitted parameters and nuisances, nats, up to the
    alignment, of ``poses`` poses, less what outliers cost; uncorrected: with no nuisance at all, at
    the same parameters.
    chi2_per_dof, whiteness: of the innovations; the autocorrelations (2, lags), from lag 1 on.
    alternatives: nats a pose of each process. clock_changes: other than at a steady rate;
    clock_stretches: what parts of the run say of the offset.
    clock_by_group: the clock offset by positions alone and by orientations alone.
    stamps: by how much the estimate's own stamps scatter, where they do.
    converged: whether the likelihood's maximum was reached, to within a standard deviation.
    """

    kind: Kind
    groups: dict[str, dict[str, Figure]]
    nuisances: Nuisances
    covariance: Array
    unobserved: tuple[Unobserved, ...]
    poses: int
    log_likelihood: float
    uncorrected: float
    chi2_per_dof: float
    whiteness: Array
    jumps: tuple[Jump, ...]
    alternatives: dict[Kind, float]
    clock_changes: tuple[ClockChange, ...] = ()
    clock_stretches: tuple[Stretch, ...] = ()
    clock_by_group: tuple[Figure, ...] = ()
    stamps: Scatter | None = None
    converged: bool = True

    @property
    def std(self) -> Array:
        """Standard deviations of the nuisances, (9,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def nats_per_pose(self) -> float:
        """``log_likelihood`` a pose."""
        return self.log_likelihood / self.poses
