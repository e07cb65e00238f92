# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth's process: speed beside scikit-learn, the cost of a sample, and memory.

scikit-learn gets the same segments in the same coordinates, the same kernels and the same
hyperparameters; a large ``ConstantKernel`` stands for the unknown mean. It does less: what turns
coordinates into poses, and two segments into one answer, is not in its time.
"""

from __future__ import annotations

import os
import pickle
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import numpy.typing as npt

from performance.calibration import DATA, load
from performance.clocks import in_turn, ratio
from performance.tables import SkippedError, Table, Target, at_least, at_most, targets
from trajeval_ros import se3
from trajeval_ros.ground_truth import regression
from trajeval_ros.ground_truth.hyperparameters import (
    GroupHyperparameters,
    Hyperparameters,
)
from trajeval_ros.ground_truth.lessons import SAMPLES, SEGMENTS, Lessons
from trajeval_ros.ground_truth.models import MODELS
from trajeval_ros.ground_truth.process import Process
from trajeval_ros.ground_truth.regression import scale
from trajeval_ros.ground_truth.segment import Samples, Segment
from trajeval_ros.ground_truth.segmentation import Blended, Segmentation, SegmentShape
from trajeval_ros.ground_truth.trajectory import GroundTruth, Settings
from trajeval_ros.online.parameters import PARAMETERS

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Index = npt.NDArray[np.intp]

KERNEL = str(PARAMETERS["gp.kernel"].default)
SECOND = 1_000_000_000
_QUERIES = 1000
_FLAT = 10.0  # standard deviation of the mean in units of the signal's


def _default(name: str) -> float:
    value = PARAMETERS[name].default
    assert isinstance(value, float | int)
    return float(value)


ACCURACY = (_default("ground_truth.translation_std"), _default("ground_truth.rotation_std"))
SHAPE = SegmentShape(
    round(_default("segment.duration") * SECOND),
    _default("segment.overlap"),
    int(_default("segment.min_samples")),
    int(_default("segment.max_samples")),
)
LAG = round(_default("ground_truth.lag") * SECOND)


def settings(hyperparameters: Hyperparameters | None = None) -> Settings:
    """Return the defaults."""
    return Settings(KERNEL, hyperparameters, *ACCURACY, SHAPE)


def sklearn_process() -> Any:
    """Return scikit-learn's module, or say that it is missing."""
    try:
        from sklearn import gaussian_process
    except ImportError as error:
        raise SkippedError("scikit-learn is missing: pip install scikit-learn") from error
    return gaussian_process


@contextmanager
def silence() -> Iterator[None]:
    """Keep scikit-learn's warnings (no convergence, a variance below zero) to itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def segments_of(samples: Samples) -> list[Blended]:
    """Return the segments that the ground truth is cut into."""
    segmentation = Segmentation(SHAPE)
    for _ in segmentation.append(samples):
        pass
    return list(segmentation)


# Queries


@dataclass(frozen=True, slots=True)
class Answer:
    """Poses (q, 4, 4) and covariances (q, 6, 6)."""

    poses: Array
    covariances: Array

    @property
    def deviations(self) -> Array:
        """Standard deviations; (q, 6)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)))

    def at(self, chosen: Index) -> Answer:
        """Return the answers to some of the queries."""
        return Answer(self.poses[chosen], self.covariances[chosen])


@dataclass(frozen=True, slots=True)
class Part:
    """One segment's queries: which, in seconds, and their weights; its first ``count`` samples."""

    segment: Segment
    asked: npt.NDArray[np.bool_]
    times: Array
    weights: Array
    count: int

    def only(self, query: int, until: int) -> Part:
        """Return the part with one query, and the samples up to ``until`` (ns)."""
        mask = np.arange(len(self.asked)) == query
        mine = mask[self.asked]
        count = int(np.searchsorted(self.segment.samples.stamps, until, side="right"))
        return Part(self.segment, mask, self.times[mine], self.weights[mine], count)


def parts(segments: list[Blended], stamps: Stamps) -> list[Part]:
    """Hand the queries out to the segments."""
    found = []
    for blended in segments:
        weight = blended.weight(stamps)
        asked = weight > 0.0
        if asked.any():
            times = (stamps[asked] - blended.segment.start) * 1e-9
            found.append(Part(blended.segment, asked, times, weight[asked], len(blended.segment)))
    return found


@cache
def matern72() -> Any:
    """Return scikit-learn's class of Matérn kernels, with a closed form for 7/2, which it lacks.

    Without, it takes Bessel functions, many times slower.
    """

    class Matern(sklearn_process().kernels.Matern):  # type: ignore[misc]
        def __call__(self, x: Array, y: Array | None = None, eval_gradient: bool = False) -> Any:
            a = np.sqrt(7.0) / self.length_scale * np.abs(x - (x if y is None else y).T)
            decay = np.exp(-a)
            value = (1.0 + a * (1.0 + a * (0.4 + a / 15.0))) * decay
            if not eval_gradient:
                return value
            slope = (a * a * (0.2 + a * (0.2 + a / 15.0)) * decay)[:, :, None]
            return value, slope[:, :, : 0 if self.hyperparameter_length_scale.fixed else 1]

    return Matern


def peer(group: GroupHyperparameters, optimizer: str | None = None, restarts: int = 0) -> Any:
    """Return scikit-learn's process with a group's kernels and hyperparameters."""
    process = sklearn_process()
    kernels = process.kernels
    mean = _FLAT**2 * sum(c.std**2 for c in group.components)
    fixed = optimizer is None
    total: Any = kernels.ConstantKernel(mean, "fixed")
    for component, smoothness in zip(group.components, (2.5, 3.5, 1.5, 0.5), strict=True):
        free: dict[str, Any] = {} if not fixed else {"length_scale_bounds": "fixed"}
        variance = kernels.ConstantKernel(component.std**2, "fixed" if fixed else (1e-12, 1e6))
        make = matern72() if smoothness == 3.5 else kernels.Matern
        total = total + variance * make(component.length_scale, nu=smoothness, **free)
    if not fixed:
        total = total + kernels.WhiteKernel(group.noise_std**2, (1e-12, 1e-2))
    return process.GaussianProcessRegressor(
        total,
        alpha=group.noise_std**2 if fixed else 1e-12,
        optimizer=optimizer,
        n_restarts_optimizer=restarts,
        random_state=0,
    )


Coordinates = list[tuple[Array, Array, Array]]


def fit_peer(found: list[Part], hyperparameters: Hyperparameters) -> list[tuple[Any, Any]]:
    """Condition scikit-learn's processes, of translation and rotation, on each segment."""
    groups = (hyperparameters.translation, hyperparameters.rotation)
    fitted = []
    for part in found:
        pair = []
        for i, group in enumerate(groups):
            values = part.segment.coordinates[: part.count, 3 * i : 3 * i + 3]
            pair.append(peer(group).fit(part.segment.times[: part.count, None], values))
        fitted.append((pair[0], pair[1]))
    return fitted


def ask_peer(found: list[Part], fitted: list[tuple[Any, Any]]) -> Coordinates:
    """Return, segment by segment, means (q, 6), standard deviations (q, 2), and ``Σ q`` (2,)."""
    answers = []
    for part, pair in zip(found, fitted, strict=True):
        means, stds, squares = [], [], []
        for i, process in enumerate(pair):
            mean, std = process.predict(part.times[:, None], return_std=True)
            means.append(mean)
            stds.append(std[:, 0])
            values = part.segment.coordinates[: part.count, 3 * i : 3 * i + 3]
            squares.append(np.vdot(values, process.alpha_))
        answers.append((np.concatenate(means, axis=1), np.stack(stds, axis=1), np.array(squares)))
    return answers


def blended(found: list[Part], answers: Coordinates, process: Process, count: int) -> Answer:
    """Turn scikit-learn's coordinates into poses, as ``docs/method.md`` has it."""
    poses, covariances = np.tile(np.eye(4), (count, 1, 1)), np.zeros((count, 6, 6))
    total = np.zeros(count)
    for part, (mean, std, squares) in zip(found, answers, strict=True):
        reference = part.segment.samples.poses[0]
        local = np.tile(np.eye(4), (len(mean), 1, 1))
        local[:, :3, :3], local[:, :3, 3] = se3.exp_so3(mean[:, 3:]), mean[:, :3]
        number = np.array([part.count])
        factors = [
            scale(squares[i : i + 1], number, 3, process.least_scales[i])[0] for i in range(2)
        ]
        variance = np.repeat(std**2 * np.array(factors), 3, axis=1)
        to_body = np.zeros((len(mean), 6, 6))
        to_body[:, :3, :3] = np.swapaxes(local[:, :3, :3], -1, -2)
        tangent = np.concatenate([np.zeros((len(mean), 3)), mean[:, 3:]], axis=1)
        to_body[:, 3:, 3:] = se3.right_jacobian(tangent)[:, 3:, 3:]
        total[part.asked] += part.weights
        share = part.weights / total[part.asked]
        pose = reference @ local
        before = np.where((share < 1.0)[:, None, None], poses[part.asked], pose)
        poses[part.asked] = se3.interpolate(before, pose, share)
        covariances[part.asked] += part.weights[:, None, None] * (
            (to_body * variance[:, None]) @ np.swapaxes(to_body, -1, -2)
        )
    return Answer(poses, covariances)


def queries(samples: Samples, count: int = _QUERIES) -> Stamps:
    """Return stamps evenly over the samples, which are not those of samples."""
    first, last = int(samples.stamps[0]), int(samples.stamps[-1])
    return np.linspace(first + 1_234_567, last - 1_234_567, count).astype(np.int64)


def query_targets(
    samples: Samples, rounds: int = 5, count: int = _QUERIES, refitted: int = 20
) -> Iterator[Target]:
    """Time queries with covariance, conditioning included, and compare the answers.

    The mean's prior is narrower than usual, on both sides: scikit-learn's variance is the
    difference of two numbers as large as the prior's.
    """
    learner = GroundTruth(settings())
    learner.append(samples)
    learner.conclude()
    hyperparameters = learner.hyperparameters
    assert hyperparameters is not None
    stamps = queries(samples, count)
    last = np.full(len(stamps), samples.stamps[-1])
    first_after = np.searchsorted(samples.stamps, stamps + LAG)
    until = samples.stamps[np.minimum(first_after, len(samples) - 1)]
    found = parts(segments_of(samples), stamps)

    def fresh() -> GroundTruth:
        ground_truth = GroundTruth(settings(hyperparameters))
        ground_truth.append(samples)
        return ground_truth

    with mock.patch.object(regression, "FLAT", _FLAT), silence():
        waiting = [fresh() for _ in range(2 * rounds + 2)]
        conditioned = fresh()
        fitted = fit_peer(found, hyperparameters)
        few = np.linspace(0, len(stamps) - 1, refitted).astype(np.intp)
        times = in_turn(
            rounds,
            lambda: ask_peer(found, fit_peer(found, hyperparameters)),
            lambda: waiting.pop().posterior(stamps, last),
            lambda: ask_peer(found, fitted),
            lambda: conditioned.posterior(stamps, last),
            lambda: refit_peer(found, hyperparameters, until, few),
            lambda: waiting.pop().posterior(stamps, until),
        )
        process = Process(MODELS[KERNEL].kernels, hyperparameters, ACCURACY)
        ours = conditioned.posterior(stamps, last)
        theirs = blended(found, ask_peer(found, fitted), process, len(stamps))
        truncated = conditioned.posterior(stamps, until)
        answers = refit_peer(found, hyperparameters, until, few)
        refit = blended(*answers, process, len(stamps))
    with_lag = ratio(times, 4, 5) * len(stamps) / refitted
    yield at_least(
        f"{count:,} queries with the lag rule, scikit-learn (fitted anew to the samples of each; "
        f"{refitted} timed) over ours",
        with_lag,
        20.0,
    )
    yield at_least(
        f"{count:,} queries with all samples, scikit-learn (one fit a segment) over ours",
        ratio(times, 0, 1),
        20.0,
    )
    yield Target("the same, already fitted", "", f"{ratio(times, 2, 3):.1f}", None)
    pairs = (
        (Answer(ours.poses, ours.covariances), theirs),
        (Answer(truncated.poses[few], truncated.covariances[few]), refit.at(few)),
    )
    poses = max(np.abs(se3.log(se3.inverse(b.poses) @ a.poses)).max() for a, b in pairs)
    yield at_most("largest difference of the poses, m or rad", float(poses), 1e-6, ".1e")
    stds = max(float(np.abs(a.deviations - b.deviations).max()) for a, b in pairs)
    yield at_most("of the standard deviations, m or rad", stds, 1e-6, ".1e")
    relative = max(float((np.abs(a.deviations / b.deviations - 1.0)).max()) for a, b in pairs)
    yield Target("of the standard deviations, relative", "", f"{relative:.1e}", None)


def refit_peer(
    found: list[Part], hyperparameters: Hyperparameters, until: Stamps, chosen: Index
) -> tuple[list[Part], Coordinates]:
    """Answer the ``chosen`` queries, each by processes fitted to the samples up to ``until``."""
    asked, answers = [], []
    for query in chosen:
        for part in found:
            if part.asked[query]:
                alone = part.only(int(query), int(until[query]))
                fitted = fit_peer([alone], hyperparameters)
                asked.append(alone)
                answers += ask_peer([alone], fitted)
    return asked, answers


# Learning


def learning_targets(samples: Samples) -> Iterator[Target]:
    """Time all that is learned on the way, and scikit-learn's search on single segments."""
    segments = [each.segment for each in segments_of(samples)]
    learned: list[Process] = []

    def lessons() -> None:
        collected = Lessons(MODELS[KERNEL], ACCURACY)
        for segment in segments:
            lesson = collected.add(segment)
            process = None if lesson is None else lesson.learned()
            if lesson is not None and process is not None:
                collected.take(lesson, process)
                learned.append(process)

    ours = in_turn(3, lessons).min()
    start = learned[-1].hyperparameters

    def search(segment: Segment, every: int) -> float:
        begin = time.process_time()
        for i, group in enumerate((start.translation, start.rotation)):
            values = segment.coordinates[::every, 3 * i : 3 * i + 3]
            # Two searches, as ours.
            process = peer(group, "fmin_l_bfgs_b", restarts=1)
            with silence():
                process.fit(segment.times[::every, None], values)
        return time.process_time() - begin

    middle = segments[len(segments) // 2]
    whole = search(middle, 1) * len(segments)
    thinned = search(middle, -(-len(middle) // SAMPLES)) * min(len(segments), SEGMENTS)
    lessons_given = len(learned) // 4
    yield at_most(
        f"learning, all {lessons_given} lessons of 30 s, over scikit-learn's search "
        f"(one of {len(segments)} segments, extrapolated)",
        ours / whole,
        0.1,
        ".4f",
    )
    yield Target(
        f"the same, scikit-learn on as many samples as we take ({SAMPLES} of {SEGMENTS} segments, "
        "extrapolated)",
        "",
        f"{ours / thinned:.3f}",
        None,
    )


# An hour


def simulated(start: int, count: int, rate: int) -> Samples:
    """Return samples ``start`` ... of an endless motion at ``rate`` (Hz), with 0.2 mm of noise."""
    index = np.arange(start, start + count)
    t = index / rate
    noise = np.random.default_rng(start).normal(0.0, 2e-4, (count, 6))
    coordinates = noise + np.stack(
        [
            2.0 * np.sin(0.7 * t),
            1.5 * np.cos(0.5 * t),
            0.3 * np.sin(1.3 * t),
            0.2 * np.sin(0.9 * t),
            0.2 * np.cos(1.1 * t),
            np.pi * np.sin(0.1 * t),
        ],
        axis=-1,
    )
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = se3.exp_so3(coordinates[:, 3:]), coordinates[:, :3]
    return Samples((index * (SECOND // rate)).astype(np.int64), poses)


class Live:
    """A ground truth that grows as in a node: batches of 20 ms, queries, and forgetting."""

    def __init__(self, rate: int) -> None:
        """Start without samples."""
        self.ground_truth = GroundTruth(settings())
        self._rate = rate
        self.taken = 0

    def second(self, asked: int, batches: int = 50) -> None:
        """Take a second of samples, and answer ``asked`` queries as old as the lag."""
        samples = simulated(self.taken, self._rate, self._rate)
        self.taken += self._rate
        self.append(samples, self._rate // batches)
        now = int(samples.stamps[-1])
        if self.ground_truth.hyperparameters is not None:
            stamps = now - LAG - np.arange(asked)[::-1] * SECOND // 200
            self.ground_truth.posterior(stamps, np.minimum(stamps + LAG, now))
            self.ground_truth.forget(now - LAG - SECOND)

    def append(self, samples: Samples, batch: int) -> None:
        """Take samples in batches."""
        for start in range(0, len(samples), batch):
            self.ground_truth.append(samples[start : start + batch])


def sample_targets(rates: Sequence[int] = (10, 100, 1000), seconds: int = 60) -> Iterator[Target]:
    """The cost of a sample once the process is known, with its share of 20 queries a second.

    In bulk ten seconds at a time, as a file is fed; live in batches of 20 ms, each query as soon
    as the samples up to the lag after it are there.
    """
    for rate, aims in zip(rates, ((None, None), (4.0, None), (4.0, 8.0)), strict=False):
        for name, piece, aim in (
            ("in bulk", 10 * SECOND, aims[0]),
            ("live", SECOND // 50, aims[1]),
        ):
            cost = 1e6 * _cost(rate, seconds, piece)
            figure = f"a sample at {rate:,} Hz {name}, µs"
            if aim is None:
                yield Target(figure, "", f"{cost:.1f}", None)
            else:
                yield at_most(figure, cost, aim, ".1f")


def _cost(rate: int, seconds: int, piece: int) -> float:
    """Seconds of processor time a sample, in the second half of so many seconds of data."""
    ground_truth = GroundTruth(settings())
    samples = simulated(0, rate * seconds, rate)
    asked = np.arange(0, samples.stamps[-1] - LAG, SECOND // 20) + 1_234_567
    ready = samples.stamps[np.searchsorted(samples.stamps, asked + LAG)]
    taken, answered, spent = 0, 0, []
    for end in range(piece, seconds * SECOND + 1, piece):
        until, last = np.searchsorted(samples.stamps, end), int(np.searchsorted(ready, end))
        begin = time.process_time()
        if until > taken:
            ground_truth.append(samples[taken:until])
        if ground_truth.hyperparameters is not None and last > answered:
            queries = slice(answered, last)
            ground_truth.posterior(asked[queries], ready[queries])
            ground_truth.forget(int(asked[last - 1]))
        spent.append(time.process_time() - begin)
        taken, answered = until, last
    later = spent[len(spent) // 2 :]
    # Learning, which costs less and less a sample as a run goes on, is not in the median.
    typical = float(
        np.median(np.add.reduceat(later, np.arange(0, len(later), 10 * SECOND // piece)))
    )
    return typical / (10 * rate)


def resident() -> int:
    """Return the process's memory in bytes; 0 where the system does not say."""
    statm = Path("/proc/self/statm")
    pages = int(statm.read_text(encoding="ascii").split()[1]) if statm.exists() else 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _largest(states: Sequence[Sequence[int]]) -> int:
    """The largest sizes of all parts together: that all are largest at once is chance."""
    return int(np.max(states, axis=0).sum())


def hour_targets(rate: int = 1000, seconds: int = 3600, rounds: int = 40) -> Iterator[Target]:
    """Let ``seconds`` pass; compare the cost and the memory with those after a minute.

    While they pass, batches are of 100 ms, and a query is answered every ten seconds only.
    """
    minute = min(60, seconds // 2)
    often = max(minute // 30, 1)
    young, old = Live(rate), Live(rate)
    for passed in range(minute):
        young.second(int(passed % 10 == 9), 10)
    states: list[list[int]] = []
    residents = []
    for passed in range(seconds):
        old.second(int(passed % 10 == 9), 10)
        # Lessons keep more and more segments, and then half of them: a minute may miss the most.
        if passed % often == often - 1:
            states.append([len(pickle.dumps(part)) for part in vars(old.ground_truth).values()])
        if passed % minute == minute - 1:
            residents.append(resident())
    times = in_turn(rounds, lambda: old.second(20), lambda: young.second(20))
    what = f"after {seconds // 60} min over after 1 min"
    yield at_most(f"a sample with its share of 20 queries a second, {what}", ratio(times), 1.1)
    per_sample = float(np.median(times[:, 0])) / rate * 1e6
    yield Target("its cost, µs", "", f"{per_sample:.0f}", None)
    # Learning, which is over after a few minutes, is the hungriest.
    early = _largest(states[: max(minute, seconds // 6) // often])
    yield at_most(
        f"state in memory, largest of all {seconds // 60} min over that of the first sixth, part"
        " by part",
        _largest(states) / early,
        1.01,
        ".3f",
    )
    yield Target("the state, MB", "", f"{_largest(states) / 1e6:.2f}", None)
    grown = (residents[-1] - residents[len(residents) // 6]) / 1e6
    yield at_most("process's memory, growth after the first sixth, MB", grown, 5.0)


def run() -> Iterator[Table]:
    """Measure on EuRoC V1_02's first 30 s, and on a simulated hour."""
    title = f"Ground truth: an hour at 1 kHz, in batches of 20 ms (`{KERNEL}`)"
    yield targets("ground truth hour", title, [*hour_targets(), *sample_targets(seconds=200)])
    if not DATA.exists():
        raise SkippedError(f"the recordings are not there ({DATA.parent.name}/{DATA.name})")
    sklearn_process()
    samples = load("euroc_v102", 30 * SECOND)
    title = f"Ground truth: 30 s at 200 Hz beside scikit-learn (`{KERNEL}`)"
    found = [*query_targets(samples), *learning_targets(samples)]
    yield targets("ground truth scikit-learn", title, found)
