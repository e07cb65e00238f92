# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model as plain values: what ``summary.json`` holds. SI units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.error_model.changes import joined
from trajeval_ros.error_model.model import ErrorModel, Figure
from trajeval_ros.error_model.nuisances import NAMES
from trajeval_ros.error_model.process import GROUPS, Kind
from trajeval_ros.error_model.stamping import Scatter

if TYPE_CHECKING:
    from trajeval_ros.error_model.positions import PositionErrorModel

Array = npt.NDArray[np.float64]
Figures = dict[str, object]

# Of so many parts of the run it is said what each says of the clock.
_STRETCHES = 20


def named(model: ErrorModel) -> Figures:
    """Each figure as ``{"value", "std"}``, vectors as lists; those that are not there, left out."""
    std, nuisances = model.std, model.nuisances
    step = se3.log(nuisances.extrinsic)
    position, quaternion = se3.to_position_quaternion(nuisances.extrinsic)
    groups = {
        group: {name: _figure(figure) for name, figure in model.groups[group].items()}
        for group in GROUPS
    }
    return {
        "model": "wander" if model.kind is Kind.WANDER else "drift",
        **groups,
        "clock_offset": {"value": nuisances.clock_offset, "std": float(std[0])},
        "clock_offset_by": {
            group: _figure(each) for group, each in zip(GROUPS, model.clock_by_group, strict=False)
        },
        "clock_rate": {"value": nuisances.clock_rate, "std": float(std[1])},
        **_stamps(model.stamps),
        "extrinsic": {
            "translation": {"value": position.tolist(), "std": std[2:5].tolist()},
            "rotation": {"value": step[3:].tolist(), "std": std[5:8].tolist()},
            "length": _length(position, model.covariance[2:5, 2:5]),
            "length_nats": _gain(position, model.covariance[2:5, 2:5]),
            "angle": _length(step[3:], model.covariance[5:8, 5:8]),
            "angle_nats": _gain(step[3:], model.covariance[5:8, 5:8]),
            "pose": [*position.tolist(), *quaternion.tolist()],
        },
        "scale": {"value": nuisances.scale, "std": float(std[8] * nuisances.scale)},
        "covariance": model.covariance.tolist(),
        "unobserved": [
            {
                "of": list(each.names),
                "direction": dict(zip(NAMES, each.direction.tolist(), strict=True)),
            }
            for each in model.unobserved
        ],
        "poses": model.poses,
        "converged": model.converged,
        "log_likelihood": model.log_likelihood,
        "nats_per_pose": model.nats_per_pose,
        "nats_per_pose_uncorrected": model.uncorrected / model.poses,
        "nats_per_pose_of": {str(kind): value for kind, value in model.alternatives.items()},
        "chi2_per_dof": model.chi2_per_dof,
        "whiteness": dict(zip(GROUPS, model.whiteness.tolist(), strict=True)),
        "jumps": [
            {"stamp": each.stamp, "translation": each.translation, "rotation": each.rotation}
            for each in model.jumps
        ],
        "clock_changes": [each._asdict() for each in model.clock_changes],
        "clock_stretches": [each._asdict() for each in joined(model.clock_stretches, _STRETCHES)],
    }


def _stamps(scatter: Scatter | None) -> Figures:
    """By how much the estimate's own scatter, where they do."""
    if scatter is None:
        return {}
    return {
        "stamp_std": {"value": scatter.value, "std": scatter.std},
        "stamp_nats": scatter.nats,
        "stamp_errors": {"translation": scatter.translation, "rotation": scatter.rotation},
    }


def _length(vector: Array, covariance: Array) -> Figures:
    """A vector's, (3,), with its standard deviation along it; of nothing, the largest of any."""
    size = float(np.linalg.norm(vector))
    if not size:
        return {"value": size, "std": float(np.sqrt(np.diagonal(covariance).max()))}
    along = vector / size
    return {"value": size, "std": float(np.sqrt(along @ covariance @ along))}


def _gain(vector: Array, covariance: Array) -> float:
    """Nats that a vector, (3,), gains over none, to second order: the same in all axes."""
    return 0.5 * float(vector @ np.linalg.solve(covariance, vector))


def _figure(figure: Figure) -> Figures:
    found: Figures = {"value": figure.value, "std": _finite(figure.std)}
    if figure.interval is not None:
        found["interval"] = [_finite(end) for end in figure.interval]
    return found


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def named_on_positions(model: PositionErrorModel) -> Figures:
    """The same of a model against positions: what contains an orientation is left out.

    The extrinsic is the lever arm's, in the axes of the estimate's body.
    """
    arm, std = model.lever_arm, np.sqrt(np.diagonal(model.covariance))
    translation = {
        name: {"value": value, "std": known} for name, (value, known) in model.parameters.items()
    }
    if "drift_std" in translation:
        translation["long_run_drift"] = translation["drift_std"]
    return {
        "model": "wander" if model.kind is Kind.WANDER else "drift",
        "translation": translation,
        "clock_offset": {"value": model.clock_offset, "std": float(std[3])},
        "extrinsic": {
            "translation": {"value": (-arm).tolist(), "std": std[:3].tolist()},
            "pose": [*(-arm).tolist(), 0.0, 0.0, 0.0, 1.0],
        },
        "poses": model.poses,
        "log_likelihood": model.likelihood.log_likelihood,
        "nats_per_pose": model.likelihood.log_likelihood / model.poses,
        "chi2_per_dof": model.likelihood.chi2 / model.likelihood.dof,
        "whiteness": {"translation": model.whiteness.tolist()},
    }
