# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truths with given hyperparameters, and patterns of samples."""

import itertools

import numpy as np
from hypothesis import strategies as st
from twins.runs import SECOND, START, motion

from trajeval_ros import se3
from trajeval_ros.ground_truth.hyperparameters import (
    Component,
    GroupHyperparameters,
    Hyperparameters,
)
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.segmentation import SegmentShape
from trajeval_ros.ground_truth.trajectory import GroundTruth, Settings

SHAPE = SegmentShape(duration=2 * SECOND, overlap=0.5, min_samples=8, max_samples=256)
GIVEN = Hyperparameters(
    GroupHyperparameters((Component(1.0, 1.5),), 0.002),
    GroupHyperparameters((Component(0.8, 1.5),), 0.003),
)


def ground_truth(samples=None, hyperparameters=GIVEN, shape=SHAPE, kernel="matern52", floor=1e-6):
    """One with these samples; ``hyperparameters`` None: it learns them."""
    truth = GroundTruth(Settings(kernel, hyperparameters, floor, floor, shape))
    if samples is not None:
        truth.append(samples)
    return truth


def at(seconds):
    """Stamps of seconds since the start."""
    return START + np.rint(np.asarray(seconds, dtype=np.float64) * SECOND).astype(np.int64)


def sampled(times, path=motion, std=(0.002, 0.003), seed=0):
    """Samples of a path at times (s), with noise."""
    noise = np.random.default_rng(seed).normal(size=(len(times), 6)) * np.repeat(std, 3)
    return Samples(at(times), path(np.asarray(times)) @ se3.exp(noise))


def regular(duration, rate):
    return np.arange(round(duration * rate) + 1) / rate


def whole(truth, stamps):
    """The answers given all samples."""
    return truth.posterior(np.asarray(stamps), np.full(len(stamps), truth.stamps[-1]))


def cut(samples, edges):
    """The samples in batches."""
    edges = [0, *sorted(edges), len(samples)]
    return [samples[a:b] for a, b in itertools.pairwise(edges)]


@st.composite
def patterns(draw):
    """Times (s) of samples: rates that change, jitter, gaps from nothing to minutes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    intervals = []
    for _ in range(draw(st.integers(1, 4))):
        rate = draw(st.sampled_from([0.5, 2.0, 10.0, 50.0, 300.0]))
        count = draw(st.integers(2, 120))
        jitter = draw(st.sampled_from([0.0, 0.3, 0.95]))
        intervals.append((1.0 + jitter * rng.uniform(-1, 1, count)) / rate)
        intervals.append([draw(st.sampled_from([1e-6, 0.02, 0.5, 3.0, 60.0]))])
    return np.cumsum(np.concatenate(intervals[:-1]))


shapes = st.builds(
    SegmentShape,
    duration=st.sampled_from([SECOND // 5, SECOND, 2 * SECOND, 10 * SECOND]),
    overlap=st.sampled_from([0.1, 0.25, 0.5]),
    min_samples=st.sampled_from([4, 8, 16]),
    max_samples=st.sampled_from([16, 40, 256]),
)
