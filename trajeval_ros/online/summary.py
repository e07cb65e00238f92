# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of a run as plain values: what ``summary.json`` holds and ``~/metrics`` publishes."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Gauge, Similarity
from trajeval_ros.alignment.observability import Observability
from trajeval_ros.alignment.umeyama import Alignment
from trajeval_ros.conventional.distributions import Distribution
from trajeval_ros.ground_truth.fit import Fit
from trajeval_ros.ground_truth.hyperparameters import Hyperparameters
from trajeval_ros.likelihood.absolute import Absolute, absolute
from trajeval_ros.likelihood.figures import figures, p_value_of
from trajeval_ros.likelihood.first_order import absolute_first_order
from trajeval_ros.likelihood.gaussian import CovarianceError, GaussianLogLikelihood
from trajeval_ros.likelihood.joint import FactorRows
from trajeval_ros.likelihood.noise_equivalent import noise_equivalent_error
from trajeval_ros.likelihood.relative import RunningRelative, relative, steps_likelihood
from trajeval_ros.online.evaluation import Evaluation
from trajeval_ros.online.results import Health
from trajeval_ros.online.window import EvaluatedPoses, Window

Array = npt.NDArray[np.float64]
Figures = dict[str, object]


def summarize(health: Health, evaluation: Evaluation) -> Figures:
    """Return the summary but for its window; figures without enough data are None."""
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
            "fit": None if health.fit is None else _fit(health.fit),
            "faults": [{**asdict(fault), "text": fault.text} for fault in health.faults],
            "hyperparameters": None
            if hyperparameters is None
            else _hyperparameters(hyperparameters),
        },
        "gauge": evaluation.gauge.name,
        "relative": _relative(evaluation),
        "absolute": _absolute(evaluation),
        "conventional": _conventional(evaluation),
    }


def _fit(fit: Fit) -> Figures:
    """How the process fits the samples; m and rad."""
    return {**fit.named, "segments_closed": fit.segments, "segments_adapted": fit.adapted}


def _hyperparameters(hyperparameters: Hyperparameters) -> Figures:
    """By the names of the parameters ``gp.*``, so that they can be pasted back."""
    return {
        "translation": hyperparameters.translation.named,
        "rotation": hyperparameters.rotation.named,
    }


def likelihood_figures(likelihood: GaussianLogLikelihood | None, poses: int) -> Figures:
    """A log-likelihood, its parts, and what they mean."""
    if likelihood is None or likelihood.dof <= 0:
        return dict.fromkeys(
            (
                "log_likelihood",
                "chi2",
                "dof",
                "log_det",
                "chi2_per_dof",
                "error_in_ground_truth_std",
                "nats_per_pose",
            )
        )
    meaning = figures(likelihood, poses)
    return {
        "log_likelihood": likelihood.log_likelihood,
        "chi2": likelihood.chi2,
        "dof": likelihood.dof,
        "log_det": likelihood.log_det,
        "chi2_per_dof": meaning.chi2_per_dof,
        "error_in_ground_truth_std": meaning.deviations,
        "nats_per_pose": meaning.nats_per_pose,
    }


def _observability(observability: Observability) -> Figures:
    """What of the gauge the motion determines."""
    return {
        "status": str(observability.status),
        "motion": str(observability.motion),
        "unobserved_axes": observability.unobserved_axes.tolist(),
    }


def _relative(evaluation: Evaluation) -> Figures:
    translation, rotation = evaluation.step_mean_squares.roots()
    return {
        **likelihood_figures(evaluation.relative, evaluation.count),
        "translation_rmse": translation,
        "rotation_rmse": rotation,
    }


def _absolute(evaluation: Evaluation) -> Figures:
    alignment = evaluation.alignment
    result = likelihood_figures(evaluation.absolute, evaluation.count)
    first_order = evaluation.first_order
    result["log_likelihood_first_order"] = (
        first_order.log_likelihood if first_order.dof > 0 else None
    )
    result["consistency"] = evaluation.consistency
    result["observability"] = _observability(evaluation.observability)
    result["alignment"] = alignment_figures(
        alignment, evaluation.alignment_covariance, evaluation.gauge
    )
    translation, rotation = (
        (None, None) if alignment is None else evaluation.residuals.roots(alignment)
    )
    return {**result, "translation_rmse": translation, "rotation_rmse": rotation}


def alignment_figures(
    alignment: Similarity | None, covariance: Array | None, gauge: Gauge
) -> Figures:
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


def window_figures(window: Window, gauge: Gauge) -> Figures:
    """The window's likelihoods: relative, and absolute to first order and fully nonlinear."""
    poses, count = window.poses, len(window.poses)
    if count < 2:
        missing = ("p_value", "log_likelihood_first_order", "log_likelihood_nonlinear")
        return {
            "poses": count,
            "duration": None,
            "relative": {**likelihood_figures(None, count), "p_value": None},
            "absolute": {**likelihood_figures(None, count), **dict.fromkeys(missing)},
        }
    covariance = poses.joint_covariance
    data = (poses.ground_truth, covariance, poses.estimate)
    step = window_relative(window, covariance)
    best = absolute(*data, gauge)
    return {
        "poses": count,
        "duration": float((poses.stamps[-1] - poses.stamps[0]) * 1e-9),
        "relative": {
            **likelihood_figures(step, count),
            "p_value": p_value_of(step),
        },
        "absolute": {
            **likelihood_figures(best.likelihood, count),
            "p_value": p_value_of(best.likelihood),
            "log_likelihood_first_order": absolute_first_order(*data).log_likelihood,
            "log_likelihood_nonlinear": _value(best.likelihood),
            **_noise_equivalent(poses, gauge, best),
            "ending": str(best.ending),
            "observability": _observability(best.observability),
        },
    }


def window_relative(window: Window, covariance: Array | FactorRows) -> GaussianLogLikelihood:
    """The relative likelihood of a window; ``covariance`` is its poses' joint one.

    From the steps where they are independent. Covariances that differ by many orders of magnitude
    may leave the steps' band matrix without a factor; then step by step.
    """
    poses = window.poses
    if isinstance(covariance, FactorRows):
        return relative(poses.ground_truth, covariance, poses.estimate)
    try:
        return steps_likelihood(window.error, window.adjoint, covariance)
    except CovarianceError:
        return RunningRelative().update(poses.ground_truth, covariance, poses.estimate).total


def _value(likelihood: GaussianLogLikelihood | None) -> float | None:
    return None if likelihood is None else likelihood.log_likelihood


def _noise_equivalent(poses: EvaluatedPoses, gauge: Gauge, best: Absolute) -> Figures:
    """The white noise, m and rad, that explains the window's errors."""
    names = ("noise_equivalent_translation_std", "noise_equivalent_rotation_std")
    held = gauge if best.observability.scale_observed else gauge.without_scale()
    if 6 * len(poses) < held.dimension + 2:
        return dict.fromkeys(names)
    found = noise_equivalent_error(
        poses.ground_truth, poses.covariance, poses.estimate, held, best.alignment
    )
    return dict(zip(names, (found.translation_std, found.rotation_std), strict=True))


def _conventional(evaluation: Evaluation) -> Figures:
    conventional = evaluation.conventional.figures()
    return {
        "poses": conventional.poses,
        "pairs": conventional.pairs,
        "ate_translation_rmse": conventional.ate_translation_rmse,
        "ate_rotation_rmse": conventional.ate_rotation_rmse,
        "re_translation_rmse": conventional.re_translation_rmse,
        "re_rotation_rmse": conventional.re_rotation_rmse,
        "re_delta": evaluation.settings.relative_delta,
        "re_unit": evaluation.settings.relative_unit,
        "alignment": ate_alignment(conventional.alignment),
        "at": "ground_truth" if evaluation.is_at_ground_truth else "estimate",
    }


def ate_alignment(alignment: Alignment | None) -> Figures:
    """Return what ATE is under, in the form of ``absolute.alignment``.

    That one weighs by the ground truth's covariance, ATE's is the one of the positions alone.
    """
    if alignment is None:
        return {"pose": None, "scale": None}
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = alignment.rotation, alignment.translation
    position, quaternion = se3.to_position_quaternion(pose)
    return {"pose": [*position.tolist(), *quaternion.tolist()], "scale": float(alignment.scale)}


def distributions(evaluation: Evaluation) -> Figures:
    """Mean, median, std, min and max of the conventional errors, None where there are none.

    Of ``sampled_poses`` and ``sampled_pairs``, where there are more than can be kept.
    """
    found = evaluation.conventional.distributions()
    return {
        "ate_translation": _distribution(found.ate_translation),
        "ate_rotation": _distribution(found.ate_rotation),
        "re_translation": _distribution(found.re_translation),
        "re_rotation": _distribution(found.re_rotation),
        "sampled_poses": found.sampled_poses,
        "sampled_pairs": found.sampled_pairs,
    }


def _distribution(found: Distribution | None) -> Figures | None:
    if found is None:
        return None
    return {
        "mean": found.mean,
        "median": found.median,
        "std": found.std,
        "min": found.minimum,
        "max": found.maximum,
    }
