# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The likelihoods: the window's relative error beside bare LAPACK, and a million poses."""

from __future__ import annotations

import pickle
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from performance.clocks import in_turn, ratio
from performance.tables import Table, Target, at_most, targets
from trajeval_ros import se3
from trajeval_ros.likelihood.band import lower_band
from trajeval_ros.likelihood.gaussian import GaussianLogLikelihood
from trajeval_ros.likelihood.relative import relative_error, step_covariance, steps_likelihood
from trajeval_ros.online.evaluation import Evaluation
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.settings import settings_of
from trajeval_ros.online.summary import window_relative
from trajeval_ros.online.window import EvaluatedPoses

Array = npt.NDArray[np.float64]

_RATE = 20
_BATCH = 20


def poses(start: int, count: int) -> tuple[Array, Array, Array]:
    """Return ground truth, its covariance and an estimate, poses ``start`` ... of an endless run.

    (n, 4, 4), (n, 6, 6), (n, 4, 4); 20 poses a second on a Lissajous figure of some metres.
    """
    random = np.random.default_rng(start)
    t = np.arange(start, start + count) / _RATE
    truth = np.tile(np.eye(4), (count, 1, 1))
    truth[:, :3, :3] = se3.exp_so3(
        np.stack([0.3 * np.sin(0.9 * t), 0.2 * np.cos(1.1 * t), 2.0 * np.sin(0.1 * t)], axis=-1)
    )
    truth[:, :3, 3] = np.stack([5 * np.sin(0.3 * t), 4 * np.cos(0.2 * t), np.sin(t)], axis=-1)
    half = random.normal(0.0, 1e-3, (count, 6, 8))
    covariance = half @ half.swapaxes(-1, -2)
    estimate = truth @ se3.exp(random.normal(0.0, 5e-3, (count, 6)))
    return truth, covariance, estimate


def window_targets(count: int = 1000, rounds: int = 60) -> Iterator[Target]:
    """Compare the window's relative error with LAPACK's factor and solution of the same matrix."""
    truth, covariance, estimate = poses(0, count)
    error, adjoint = relative_error(truth, estimate)
    adjoints = np.concatenate([np.zeros((1, 6, 6)), adjoint])
    band = lower_band(step_covariance(adjoints, covariance[:, None]))
    right = error.reshape(-1)
    run = Run(window=10.0 * count / _RATE)
    run.add(truth, covariance, estimate)

    def windowed() -> GaussianLogLikelihood:
        window = run.evaluation.window()
        return window_relative(window, window.poses.covariance)

    def bare() -> tuple[float, float]:
        factor, _ = lapack.dpbtrf(band, lower=1)
        solution, _ = lapack.dpbtrs(factor, right, lower=1)
        return right @ solution, 2.0 * np.log(factor[0]).sum()

    times = in_turn(
        rounds,
        bare,
        lambda: steps_likelihood(error, adjoint, covariance),
        windowed,
    )
    chi2, log_det = bare()
    found = windowed()
    apart = max(abs(found.chi2 / chi2 - 1.0), abs(found.log_det / log_det - 1.0))
    over = "over LAPACK's band factorisation and solution"
    yield at_most(f"windowed RE of {count:,} poses from its steps, {over}", ratio(times, 1, 0), 3.0)
    yield at_most(f"the same in the node, {over}", ratio(times, 2, 0), 3.0)
    yield at_most("largest relative difference of chi2 and log-determinant", apart, 1e-9, ".0e")


class Run:
    """Every running figure over an endless run."""

    def __init__(self, window: float = 30.0) -> None:
        """Start without poses; ``window`` (s)."""
        self.evaluation = Evaluation(settings_of(complete({"window.duration": window})).evaluation)
        self.taken = 0

    def take(self, count: int, batch: int) -> None:
        """Take ``count`` more poses, ``batch`` at a time."""
        made = poses(self.taken, count)
        for start in range(0, count, batch):
            piece = slice(start, start + batch)
            self.add(*(part[piece] for part in made))

    def add(self, truth: Array, covariance: Array, estimate: Array) -> None:
        """Take more poses."""
        stamps = np.arange(self.taken, self.taken + len(truth)) * (1_000_000_000 // _RATE)
        self.taken += len(truth)
        sampled = np.ones(len(truth), dtype=np.bool_)
        self.evaluation.add(EvaluatedPoses(stamps, truth, covariance, estimate, None), 0, sampled)
        self.evaluation.window()  # what waits is taken in


def length_targets(few: int = 1000, many: int = 1_000_000, rounds: int = 200) -> Iterator[Target]:
    """Compare the cost of one more pose, and the state, after few and after many poses."""
    young, old = Run(), Run()
    # The window must be full on both sides.
    young.take(few, _BATCH)
    sizes = []
    step = min(10_000, max(few, many // 10))
    while old.taken < many:
        old.take(step, 1000)
        sizes.append(len(pickle.dumps(old.evaluation)))
    batches = {
        run: [poses(run.taken + i * _BATCH, _BATCH) for i in range(rounds + 1)]
        for run in (young, old)
    }
    times = in_turn(
        rounds,
        lambda: old.add(*batches[old].pop()),
        lambda: young.add(*batches[young].pop()),
    )
    yield at_most(
        f"one more pose in all running figures, after {many:,} poses over after {few:,}",
        ratio(times),
        1.1,
    )
    cost = float(np.median(times[:, 0])) / _BATCH * 1e6
    yield Target(f"its cost in batches of {_BATCH}, µs", "", f"{cost:.0f}", None)
    yield at_most(
        f"state of all running figures, after {many:,} poses over after {step:,}",
        max(sizes) / sizes[0],
        1.05,
        ".3f",
    )
    yield Target("the state, kB", "", f"{sizes[-1] / 1e3:.0f}", None)


def run() -> Iterator[Table]:
    """Measure on made-up poses: nothing here depends on what they are."""
    found = list(window_targets())
    yield targets("likelihoods window", "Relative error of a window", found)
    yield targets("likelihoods run", "Running figures over a million poses", list(length_targets()))
