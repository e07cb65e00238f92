# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of a run as plain values: what ``summary.json`` holds and ``~/metrics`` publishes."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.ground_truth.hyperparameters import GroupHyperparameters, Hyperparameters
from trajeval_ros.metrics.absolute import absolute
from trajeval_ros.metrics.first_order import absolute_first_order
from trajeval_ros.metrics.gauge import Gauge, Similarity
from trajeval_ros.metrics.gaussian import GaussianLogLikelihood
from trajeval_ros.metrics.relative import relative
from trajeval_ros.online.evaluation import Evaluation
from trajeval_ros.online.parameters import Value
from trajeval_ros.online.results import Health
from trajeval_ros.online.window import EvaluatedPoses

Array = npt.NDArray[np.float64]
Figures = dict[str, object]


def summarize(health: Health, values: Mapping[str, Value], evaluation: Evaluation) -> Figures:
    """Return the whole summary; figures for which there is not enough data are None."""
    estimate, ground_truth = health.estimate, health.ground_truth
    hyperparameters = health.hyperparameters
    return {
        "estimate": {
            "received": estimate.received,
            "evaluated": estimate.used,
            "pending": estimate.pending,
            "rejected": dict(estimate.rejected),
        },
        "ground_truth": {
            "received": ground_truth.received,
            "used": ground_truth.used,
            "pending": ground_truth.pending,
            "rejected": dict(ground_truth.rejected),
            "segments": health.segments,
            "hyperparameters": None
            if hyperparameters is None
            else _hyperparameters(hyperparameters),
        },
        "gauge": evaluation.gauge.name,
        "relative": _relative(evaluation),
        "absolute": _absolute(evaluation),
        "window": window_figures(evaluation.window(), evaluation.gauge),
        "conventional": _conventional(evaluation, values),
    }


def _hyperparameters(hyperparameters: Hyperparameters) -> Figures:
    """By the names of the parameters ``gp.*``, so that they can be pasted back."""
    return {
        "translation": _group(hyperparameters.translation),
        "rotation": _group(hyperparameters.rotation),
    }


def _group(group: GroupHyperparameters) -> Figures:
    prefixes = ("signal", "rough", "correlated_noise")
    figures: Figures = {}
    for prefix, component in zip(prefixes, group.components, strict=False):
        length = "length_scale" if prefix == "signal" else f"{prefix}_length_scale"
        figures |= {f"{prefix}_std": component.std, length: component.length_scale}
    return {**figures, "noise_std": group.noise_std}


def _likelihood(likelihood: GaussianLogLikelihood | None) -> Figures:
    """A log-likelihood with its parts."""
    if likelihood is None or likelihood.dof <= 0:
        return dict.fromkeys(
            (
                "log_likelihood",
                "chi2",
                "dof",
                "log_det",
                "chi2_per_dof",
                "error_in_ground_truth_std",
            )
        )
    ratio = likelihood.chi2 / likelihood.dof
    return {
        "log_likelihood": likelihood.log_likelihood,
        "chi2": likelihood.chi2,
        "dof": likelihood.dof,
        "log_det": likelihood.log_det,
        "chi2_per_dof": ratio,
        "error_in_ground_truth_std": math.sqrt(max(ratio, 0.0)),
    }


def _relative(evaluation: Evaluation) -> Figures:
    translation, rotation = evaluation.step_mean_squares.roots()
    return {
        **_likelihood(evaluation.relative),
        "translation_rmse": translation,
        "rotation_rmse": rotation,
    }


def _absolute(evaluation: Evaluation) -> Figures:
    alignment = evaluation.alignment
    figures = _likelihood(evaluation.absolute)
    first_order = evaluation.first_order
    figures["log_likelihood_first_order"] = (
        first_order.log_likelihood if first_order.dof > 0 else None
    )
    figures["consistency"] = evaluation.consistency
    figures["alignment"] = _alignment(alignment, evaluation.alignment_covariance, evaluation.gauge)
    translation, rotation = (
        (None, None) if alignment is None else evaluation.residuals.roots(alignment)
    )
    return {**figures, "translation_rmse": translation, "rotation_rmse": rotation}


def _alignment(alignment: Similarity | None, covariance: Array | None, gauge: Gauge) -> Figures:
    """The estimate's world in the ground truth's: ``[x, y, z, qx, qy, qz, qw]`` and scale."""
    if alignment is None:
        return {"pose": None, "scale": None, "covariance": None}
    position, quaternion = se3.to_position_quaternion(alignment.pose)
    size = 7 if gauge.has_scale else 6
    known = covariance is not None and bool(np.isfinite(covariance).all())
    return {
        "pose": [*position.tolist(), *quaternion.tolist()],
        "scale": float(alignment.scale),
        "covariance": covariance[:size, :size].tolist()
        if covariance is not None and known
        else None,
    }


def window_figures(poses: EvaluatedPoses, gauge: Gauge) -> Figures:
    """The window's likelihoods: relative, and absolute to first order and fully nonlinear."""
    if len(poses) < 2:
        return {
            "poses": len(poses),
            "duration": None,
            "relative": _likelihood(None),
            "absolute": {
                **_likelihood(None),
                "log_likelihood_first_order": None,
                "log_likelihood_nonlinear": None,
            },
        }
    data = (poses.ground_truth, poses.covariance, poses.estimate)
    best = absolute(*data, gauge)
    nonlinear = best.likelihood
    return {
        "poses": len(poses),
        "duration": float((poses.stamps[-1] - poses.stamps[0]) * 1e-9),
        "relative": _likelihood(relative(*data)),
        "absolute": {
            **_likelihood(nonlinear),
            "log_likelihood_first_order": absolute_first_order(*data).log_likelihood,
            "log_likelihood_nonlinear": nonlinear.log_likelihood if nonlinear else None,
            "ending": str(best.ending),
            "observability": str(best.observability.status),
        },
    }


def _conventional(evaluation: Evaluation, values: Mapping[str, Value]) -> Figures:
    figures = evaluation.conventional.figures()
    return {
        "poses": figures.poses,
        "pairs": figures.pairs,
        "ate_translation_rmse": figures.ate_translation_rmse,
        "ate_rotation_rmse": figures.ate_rotation_rmse,
        "re_translation_rmse": figures.re_translation_rmse,
        "re_rotation_rmse": figures.re_rotation_rmse,
        "re_delta": values["relative.delta"],
        "re_unit": values["relative.unit"],
    }


def whole_run(
    summary: Figures, ground_truth: Array, covariance: Array, estimate: Array, gauge: Gauge
) -> Figures:
    """Return the summary with ``absolute.log_likelihood_nonlinear`` over all poses of a run.

    ``ground_truth`` and ``estimate`` (M, 4, 4), ``covariance`` (M, 6, 6): what the run's
    evaluations held.
    """
    figures = summary["absolute"]
    assert isinstance(figures, dict)
    nonlinear = None
    if len(ground_truth) > 1:
        likelihood = absolute(ground_truth, covariance, estimate, gauge).likelihood
        nonlinear = likelihood.log_likelihood if likelihood else None
    return {**summary, "absolute": {**figures, "log_likelihood_nonlinear": nonlinear}}
