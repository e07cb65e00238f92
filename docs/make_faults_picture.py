# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes ``docs/images/ground_truth_faults.png`` with the package itself.

    PYTHONPATH=. .venv/bin/python docs/make_faults_picture.py

A smooth flight, sampled with 2 mm of noise and one fault of the ground truth a panel: how far a
cubic spline through the samples is from the truth, in position or (a flip) orientation, and how far
the package's ground truth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

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
    """One sample in a hundred is a metre off."""
    wrong = rng.random(len(times)) < 0.01
    poses[wrong, :3, 3] += 1.0 / np.sqrt(3.0)
    return times, poses


def frozen(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """The last pose for a second, with new stamps."""
    still = (times > 24.0) & (times < 25.0)
    poses[still] = poses[still][0]
    return times, poses


def flip(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """1.5 s of a body that is turned by 180 degrees."""
    flipped = (times > 24.0) & (times < 25.5)
    poses[flipped, :3, :3] = poses[flipped, :3, :3] @ np.diag([-1.0, -1.0, 1.0])
    return times, poses


def origin_jump(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """The origin moves by 0.37 m."""
    poses[times > 24.0, :3, 3] += [0.3, 0.2, 0.1]
    return times, poses


def jump_in_gap(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """It moves in 0.2 s without samples."""
    poses[times > 24.0, :3, 3] += [0.3, 0.2, 0.1]
    kept = (times < 23.8) | (times > 24.0)
    return times[kept], poses[kept]


def stamps_late(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """Stamped on arrival, up to some hundredths late."""
    late = np.maximum.accumulate(times + rng.exponential(0.01, len(times)))
    return late + 1e-6 * np.arange(len(late)), poses


def stamps_quantised(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """Stamps are rounded to 10 ms."""
    return np.round(times, 2), poses


def noise_grows(rng: np.random.Generator, times: Array, poses: Array) -> tuple[Array, Array]:
    """Noise of 30 mm in place of 2."""
    poses[times > 24.0, :3, 3] += rng.normal(0.0, 0.03, (int((times > 24.0).sum()), 3))
    return times, poses


def topic(seconds: Array, poses: Array) -> PoseSamples:
    """Poses as the engine takes them."""
    stamps = START + np.rint(seconds * 1e9).astype(np.int64)
    return PoseSamples(stamps, *se3.to_position_quaternion(poses))


def spline(times: Array, poses: Array, asked: Array) -> Array:
    """Poses of cubic splines through the samples; (n, 4, 4)."""
    found = np.tile(np.eye(4), (len(asked), 1, 1))
    found[:, :3, 3] = CubicSpline(times, poses[:, :3, 3])(asked)
    found[:, :3, :3] = RotationSpline(times, Rotation.from_matrix(poses[:, :3, :3]))(
        asked
    ).as_matrix()
    return found


def ours(times: Array, poses: Array, asked: Array, regular: bool) -> tuple[Array, Array, list[str]]:
    """Where the package's ground truth answers, s; its poses; the faults that it names."""
    engine = Engine({"ground_truth.stamps": "regularize" if regular else "measured"})
    results = feed(engine, topic(times, poses), topic(asked, truth(asked)))
    found = [each.evaluations for each in results]
    stamps = np.concatenate([each.stamps for each in found])
    summary: Any = engine.summary()
    named = [fault["code"] for fault in summary["ground_truth"]["faults"]]
    answered = np.asarray((stamps - START) * 1e-9)
    return answered, np.concatenate([each.ground_truth for each in found]), named


def errors(poses: Array, times: Array, angle: bool) -> Array:
    """From the truth at ``times``, mm or, if it is the ``angle``, degrees."""
    right = truth(times)
    if not angle:
        return 1e3 * np.linalg.norm(poses[:, :3, 3] - right[:, :3, 3], axis=1)
    between = np.swapaxes(right[:, :3, :3], 1, 2) @ poses[:, :3, :3]
    return np.degrees(np.linalg.norm(se3.log_so3(between), axis=1))


FAULTS = (
    *(outliers, frozen, flip, origin_jump),
    *(jump_in_gap, stamps_late, stamps_quantised, noise_grows),
)


def main() -> None:
    """Draw the picture."""
    figure, axes = plt.subplots(4, 2, figsize=(9.5, 7.0), sharex=True, layout="constrained")
    for axis, fault in zip(axes.T.ravel(), FAULTS, strict=True):
        rng = np.random.default_rng(1)
        # Ticks of 10 ms are far from those of a clock whose period is no multiple of them.
        rate = 64.0 if fault is stamps_quantised else RATE
        taken = np.arange(0.0, SECONDS, 1.0 / rate)
        clean = truth(taken)
        clean[:, :3, 3] += rng.normal(0.0, 2e-3, (len(taken), 3))
        clean[:, :3, :3] @= se3.exp_so3(rng.normal(0.0, 2e-3, (len(taken), 3)))
        times, poses = fault(rng, taken, clean)
        asked = np.arange(20.0, 30.0, 0.013)
        angle, stamped = fault is flip, fault in (stamps_late, stamps_quantised)
        answered, found, named = ours(times, poses, asked, stamped)
        smooth = spline(times, poses, asked)
        for label, color, at, those in (
            ("cubic spline", SPLINE, asked, smooth),
            ("trajeval_ros", OURS, answered, found),
        ):
            # A constant lag is the clock's, and no error of either.
            lags = np.arange(-0.03, 0.03, 0.001) if stamped else np.zeros(1)
            error = min((errors(those, at - lag, angle) for lag in lags), key=np.median)
            axis.semilogy(at, error, color=color, linewidth=0.9, label=label)
        axis.set_ylim(*((0.01, 3e3) if angle else (0.1, 3e4)))
        axis.set_title((fault.__doc__ or "").rstrip("."), fontsize=9, loc="left")
        axis.set_title(", ".join(named) or "not named", fontsize=8, loc="right", family="monospace")
        axis.set_ylabel("error, deg" if angle else "error, mm", fontsize=8)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.3)
    axes[0, 0].legend(loc="upper right", fontsize=8, ncols=2)
    for axis in axes[-1]:
        axis.set_xlabel("time, s", fontsize=8)
    figure.savefig(IMAGE, dpi=80)


if __name__ == "__main__":
    main()
