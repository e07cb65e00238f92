# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes ``docs/images/ground_truth_faults.png`` with the package itself.

    PYTHONPATH=. .venv/bin/python docs/make_faults_picture.py

A smooth flight, sampled with 2 mm of noise and one fault of the ground truth a panel: how far a
cubic spline through the samples is from the truth, and how far the package's ground truth.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from trajeval_ros import se3
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.samples import PoseSamples

Array = npt.NDArray[np.float64]

IMAGE = Path(__file__).parent / "images" / "ground_truth_faults.png"
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
SECONDS, RATE = 40.0, 50.0
SPLINE, OURS = "#d1495b", "#1f5fa8"


def truth(seconds: Array) -> Array:
    """The flight; (n, 4, 4)."""
    poses = np.tile(np.eye(4), (len(seconds), 1, 1))
    s = seconds[:, None]
    poses[:, :3, 3] = np.sin(s * [0.9, 1.1, 0.7] + [0.0, 0.4, 1.0]) * [1.2, 0.9, 0.4]
    poses[:, :3, :3] = se3.exp_so3(np.sin(s * [0.8, 1.1, 0.4]) * [0.3, 0.2, 1.0])
    return poses


def outliers(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """One sample in a hundred is half a metre off."""
    wrong = rng.random(len(times)) < 0.01
    poses[wrong, :3, 3] += 0.5
    return times, poses


def frozen(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """The last pose is repeated for a second."""
    still = (times > 24.0) & (times < 25.0)
    poses[still] = poses[still][0]
    return times, poses


def origin_jump(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """The origin moves by 0.37 m."""
    poses[times > 24.0, :3, 3] += [0.3, 0.2, 0.1]
    return times, poses


def stamps_late(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """Samples are stamped when they arrive, up to some hundredths late."""
    late = np.maximum.accumulate(times + rng.exponential(0.01, len(times)))
    return late + 1e-6 * np.arange(len(late)), poses


def topic(seconds: Array, poses: Array) -> PoseSamples:
    """Poses as the engine takes them."""
    stamps = START + np.rint(seconds * 1e9).astype(np.int64)
    return PoseSamples(stamps, *se3.to_position_quaternion(poses))


def ours(times: Array, poses: Array, asked: Array, late: bool) -> tuple[Array, Array]:
    """Where the package's ground truth answers, s, and its positions."""
    engine = Engine({"ground_truth.stamps": "regularize" if late else "measured"})
    results = feed(engine, topic(times, poses), topic(asked, truth(asked)))
    found = [each.evaluations for each in results]
    stamps = np.concatenate([each.stamps for each in found])
    positions = np.concatenate([each.ground_truth[:, :3, 3] for each in found])
    return np.asarray((stamps - START) * 1e-9), positions


def main() -> None:
    """Draw the picture."""
    faults = (outliers, frozen, origin_jump, stamps_late)
    figure, axes = plt.subplots(
        len(faults), 1, figsize=(7.0, 6.4), sharex=True, layout="constrained"
    )
    for axis, fault in zip(axes, faults, strict=True):
        rng = np.random.default_rng(1)
        taken = np.arange(0.0, SECONDS, 1.0 / RATE)
        clean = truth(taken)
        clean[:, :3, 3] += rng.normal(0.0, 2e-3, (len(taken), 3))
        clean[:, :3, :3] @= se3.exp_so3(rng.normal(0.0, 2e-3, (len(taken), 3)))
        times, poses = fault(rng, taken, clean)
        asked = np.arange(20.0, 30.0, 0.013)
        # A constant lag is the clock's, and no error of either.
        lag = float(np.median(times - taken))
        spline = CubicSpline(times, poses[:, :3, 3])(asked + lag)
        answered, positions = ours(times, poses, asked, fault is stamps_late)
        for label, color, at, found in (
            ("cubic spline", SPLINE, asked, spline),
            ("trajeval_ros", OURS, answered, positions),
        ):
            error = np.linalg.norm(found - truth(at)[:, :3, 3], axis=1)
            axis.semilogy(at, 1e3 * error, color=color, linewidth=0.9, label=label)
        axis.set_ylim(0.05, 2e3)
        axis.set_title(f"{fault.__name__}: {(fault.__doc__ or '').rstrip('.')}", fontsize=9)
        axis.set_ylabel("error, mm", fontsize=8)
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right", fontsize=8, ncols=2)
    axes[-1].set_xlabel("time, s", fontsize=8)
    figure.savefig(IMAGE, dpi=90)


if __name__ == "__main__":
    main()
