# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated run: a quadrotor's aggressive flight, its ground truth and a drifting estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

SECOND = 1_000_000_000
_GRAVITY = 9.81


@dataclass(frozen=True)
class Poses:
    """Stamps in nanoseconds, (N,), and poses T_world_body, (N, 4, 4)."""

    stamps: Stamps
    poses: Array


@dataclass(frozen=True)
class Simulation:
    """Ground truth and estimate of one run, each in its own world frame."""

    ground_truth: Poses
    estimate: Poses


def motion(seconds: Array) -> Array:
    """Return the true poses T_world_body, (..., 4, 4), of the flight at times (...).

    The position is a sum of sines, entered smoothly from a stand. The thrust axis follows the
    acceleration plus gravity, as a multirotor's must, and the heading turns by itself; speeds
    reach 4 m/s and the tilt 20 degrees.
    """
    phase = _warp(seconds)
    position = _path(phase)
    step = 1e-3
    # Central second difference of a path that is smooth to all orders: exact to 1e-6 m/s².
    before, after = _path(_warp(seconds - step)), _path(_warp(seconds + step))
    thrust = (before - 2 * position + after) / step**2 + np.array([0.0, 0.0, _GRAVITY])
    heading = 0.9 * phase + 0.6 * np.sin(0.7 * phase)
    forward = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=-1)
    z_axis = _unit(thrust)
    y_axis = _unit(np.cross(z_axis, forward))
    poses = np.zeros((*np.shape(seconds), 4, 4))
    poses[..., :3, 0] = np.cross(y_axis, z_axis)
    poses[..., :3, 1] = y_axis
    poses[..., :3, 2] = z_axis
    poses[..., :3, 3] = position
    poses[..., 3, 3] = 1.0
    return poses


def _warp(seconds: Array) -> Array:
    """Time along the path: stands for two seconds, then gathers speed within about three."""
    # softplus, written so that it does not overflow
    return np.asarray(0.45 * np.logaddexp(0.0, (seconds - 3.5) / 0.6))


def _path(phase: Array) -> Array:
    x = 3.0 * np.sin(0.8 * phase) + 0.8 * np.sin(1.9 * phase)
    y = 2.5 * np.sin(1.13 * phase) + 0.6 * np.cos(2.1 * phase)
    z = 1.5 + 0.7 * np.sin(0.61 * phase) + 0.25 * np.sin(1.7 * phase)
    return np.stack([x, y, z], axis=-1)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def simulate(
    duration: float = 80.0,
    seed: int = 1,
    *,
    dropouts: tuple[tuple[float, float], ...] = ((0.35, 2.5), (0.7, 4.0)),
    ground_truth_rate: float = 100.0,
    estimate_rate: float = 20.0,
    ground_truth_std: tuple[float, float] = (0.0005, 0.00087),
    drift_std: tuple[float, float] = (0.012, 0.002),
    estimate_std: tuple[float, float] = (0.004, 0.002),
    start: int = 1_750_000_000 * SECOND,
) -> Simulation:
    """Return a run of ``duration`` seconds, the same one for the same ``seed``.

    The ground truth has white noise, jittered stamps and dropouts (where, as a share of the run,
    and for how many seconds). The estimate has its own clock phase, a random walk of its world
    frame (metres and radians per square root of a second), white noise, and a world of its own.
    Standard deviations are (metres, radians).
    """
    generator = np.random.default_rng(seed)

    count = round(duration * ground_truth_rate)
    jitter = np.clip(generator.normal(0.0, 0.08, count), -0.4, 0.4)
    seconds = (np.arange(count) + 0.5 + jitter) / ground_truth_rate
    kept = np.ones(count, bool)
    for where, length in dropouts:
        kept &= (seconds < where * duration) | (seconds > where * duration + length)
    seconds = seconds[kept]
    noise = _noise(generator, len(seconds), ground_truth_std)
    ground_truth = se3.compose(motion(seconds), se3.exp(noise))

    # A phase of its own, so that no estimate has a ground-truth sample's stamp.
    times = np.arange(0.3137, duration - 0.3, 1.0 / estimate_rate)
    drift = np.cumsum(_noise(generator, len(times), drift_std), axis=0) / np.sqrt(estimate_rate)
    world = se3.exp(np.array([[4.0, -2.0, 0.5, 0.02, -0.03, 2.1]]))
    estimate = se3.compose(
        world, se3.exp(drift), motion(times), se3.exp(_noise(generator, len(times), estimate_std))
    )
    return Simulation(
        ground_truth=Poses(start + _nanoseconds(seconds), ground_truth),
        estimate=Poses(start + _nanoseconds(times), estimate),
    )


def _noise(generator: np.random.Generator, count: int, std: tuple[float, float]) -> Array:
    return generator.normal(size=(count, 6)) * np.repeat(std, 3)


def _nanoseconds(seconds: Array) -> Stamps:
    return np.rint(seconds * SECOND).astype(np.int64)
