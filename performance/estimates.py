# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a second estimate costs, and ten: one ground truth is modelled once for all."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from performance.ground_truth import simulated
from performance.tables import Table, Target, at_most, targets
from trajeval_ros import se3
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.samples import PoseSamples

SECONDS = 30
RATE = 200
EVERY = 10
"""Of so many samples of the ground truth each estimate has one: 20 Hz."""
COUNTS = (1, 2, 10)
_SECOND = 1_000_000_000


def seconds(count: int) -> float:
    """Processor time (s) of a run of ``count`` estimates, fed ten times a second as it comes."""
    run = simulated(0, SECONDS * RATE, RATE)
    truth = PoseSamples(run.stamps, *se3.to_position_quaternion(run.poses))
    rng = np.random.default_rng(1)
    estimates = {}
    for k in range(count):
        poses, stamps = run.poses[k % EVERY :: EVERY], run.stamps[k % EVERY :: EVERY]
        noisy = poses @ se3.exp(0.01 * rng.normal(size=(len(poses), 6)))
        name = f"estimate_{k}"
        estimates[name] = PoseSamples(stamps + k * 1_000_000, *se3.to_position_quaternion(noisy))
    begin = time.process_time()
    engine = Engine({}, tuple(estimates))
    for until in range(0, SECONDS * 10):
        span = slice(until * RATE // 10, (until + 1) * RATE // 10)
        engine.add_ground_truth(truth[span])
        part = slice(until * RATE // EVERY // 10, (until + 1) * RATE // EVERY // 10)
        for name, samples in estimates.items():
            engine.add_estimate(samples[part], name)
        engine.advance_all(int(truth.stamps[span][-1]))
    engine.finish_all()
    return time.process_time() - begin


def measured(rounds: int = 2) -> Iterator[Target]:
    """Time them in turn."""
    times = np.array([[seconds(count) for count in COUNTS] for _ in range(rounds + 1)][1:])
    ratios = np.median(times / times[:, :1], axis=0)
    yield at_most("processor time of a second estimate, over the first's", ratios[1] - 1.0, 0.35)
    yield at_most("processor time of ten estimates, over one's", float(ratios[2]), 3.5)


def run() -> Iterator[Table]:
    """Return the table."""
    yield targets("estimates", "Several estimates", list(measured()))
