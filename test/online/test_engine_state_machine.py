# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever happens in whatever order: every message is accounted for, and memory is bounded."""

import gc
import tracemalloc

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from twins.runs import FIXED, SECOND, START, balance, leaves, motion, samples
from twins.sizes import held

from trajeval_ros.online import settings as settings_module
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.samples import PoseSamples

FAULTS = (
    *("nan", "inf", "zero quaternion", "long quaternion", "far", "zero stamp", "negative"),
    *("repeated", "behind", "ahead", "far ahead", "a year ahead", "covariance"),
)
TRUTH_STEP, ESTIMATE_STEP = SECOND // 20, SECOND // 8


@pytest.fixture
def impatient(monkeypatch):
    """Estimates at a gap of 3 s do not wait for its end, and older ground truth is dropped."""
    monkeypatch.setattr(settings_module, "PATIENCE", 3 * SECOND)


class AnyInput(RuleBasedStateMachine):
    """The two topics run on, break, jump and repeat themselves; the clock ticks."""

    @initialize(
        learn=st.booleans(),
        gauge=st.sampled_from(["se3", "none", "sim3", "yaw_translation"]),
        covariances=st.booleans(),
        offset=st.sampled_from([0.0, -0.3]),
    )
    def start(self, learn, gauge, covariances, offset):
        self.engine = Engine(
            {
                **({} if learn else FIXED),
                "gauge": gauge,
                "window.duration": 3.0,
                "estimate.time_offset": offset,
                "estimate.use_covariance": covariances,
                "ground_truth.use_covariance": covariances,
            }
        )
        self.times = {"truth": START, "estimate": START + SECOND // 50}
        self.now = START
        self.sent = {"truth": 0, "estimate": 0}
        self.evaluated = 0
        self.done = False

    def _batch(self, topic, count):
        step = TRUTH_STEP if topic == "truth" else ESTIMATE_STEP
        stamps = self.times[topic] + step * np.arange(1, count + 1)
        if count:
            self.times[topic] = int(stamps[-1])
            self.now = max(self.now, int(stamps[-1]))
        return samples(stamps, motion((stamps - START) / SECOND))

    def _send(self, topic, batch):
        if self.done:
            return
        add = self.engine.add_ground_truth if topic == "truth" else self.engine.add_estimate
        add(batch)
        self.sent[topic] += len(batch)

    @rule(topic=st.sampled_from(["truth", "estimate"]), count=st.integers(0, 40))
    def messages(self, topic, count):
        self._send(topic, self._batch(topic, count))

    @rule(count=st.integers(1, 60))
    def both(self, count):
        self._send("truth", self._batch("truth", count))
        self._send("estimate", self._batch("estimate", count * ESTIMATE_STEP // SECOND + 1))

    @rule(
        topic=st.sampled_from(["truth", "estimate"]),
        count=st.integers(1, 6),
        fault=st.sampled_from(FAULTS),
        row=st.integers(0, 5),
    )
    def bad_messages(self, topic, count, fault, row):
        batch, row = self._batch(topic, count), row % count
        stamps, position, quaternion = (
            a.copy() for a in (batch.stamps, batch.positions, batch.quaternions)
        )
        covariances = np.tile(1e-4 * np.eye(6), (count, 1, 1))
        if fault == "nan":
            quaternion[row, 2] = np.nan
        elif fault == "inf":
            position[row, 0] = np.inf
        elif fault.endswith("quaternion"):
            quaternion[row] *= 0.0 if fault.startswith("zero") else 1.5
        elif fault == "far":
            position[row] = 1e300
        elif fault == "covariance":
            covariances[row, 1, 1] = -1.0
        else:
            stamps[row] = {
                "zero stamp": 0,
                "negative": -5,
                "repeated": stamps[row - 1],
                "behind": stamps[row] - 3 * SECOND,
                "ahead": stamps[row] + 2 * SECOND,
                "far ahead": stamps[row] + 100 * SECOND,
                "a year ahead": stamps[row] + 31_536_000 * SECOND,
            }[fault]
        self._send(topic, PoseSamples(stamps, position, quaternion, covariances))

    @rule(
        topic=st.sampled_from(["truth", "estimate", "both"]), lead=st.sampled_from([1, 7, 40, 4000])
    )
    def silence(self, topic, lead):
        for name in ("truth", "estimate"):
            if topic in (name, "both"):
                self.times[name] += lead * SECOND
        self.now = max(self.now, *self.times.values())

    @rule(metres=st.sampled_from([1.0, 100.0, 1e6]))
    def loop_closure(self, metres):
        batch = self._batch("estimate", 4)
        self._send(
            "estimate", PoseSamples(batch.stamps, batch.positions + metres, batch.quaternions)
        )

    @rule(late=st.sampled_from([-5, 0, 1, 3, 60]), clock=st.booleans())
    def tick(self, late, clock):
        if not self.done:
            results = self.engine.advance(self.now + late * SECOND if clock else None)
            self._check(results)

    @rule()
    def reset(self):
        # The stamps may go on, or start again: bags loop.
        self.engine.reset()
        self.sent = {"truth": 0, "estimate": 0}
        self.times = {"truth": START, "estimate": START + SECOND // 50}
        self.now, self.evaluated, self.done = START, 0, False

    @rule()
    def finish(self):
        if not self.done:
            self._check(self.engine.finish())
            self.done = True
            health = self.engine.health()
            assert health.estimate.pending == health.ground_truth.pending == 0

    def _check(self, results):
        evaluations = results.evaluations
        self.evaluated += len(evaluations)
        assert (np.diff(evaluations.stamps) > 0).all()
        assert np.isfinite(evaluations.chi2).all()
        assert np.isfinite(evaluations.ground_truth).all()
        assert (np.linalg.eigvalsh(evaluations.covariance) > 0).all()
        assert np.isnan(evaluations.relative_error).any() == (
            len(evaluations) > 0 and self.evaluated == len(evaluations)
        )

    @invariant()
    def every_message_is_accounted_for(self):
        if not hasattr(self, "engine"):
            return
        counts = balance(self.engine)
        assert counts.received == self.sent["estimate"]
        assert counts.used == self.evaluated
        assert self.engine.health().ground_truth.received == self.sent["truth"]

    def teardown(self):
        if hasattr(self, "engine"):
            for value in leaves(self.engine.summary()).values():
                if isinstance(value, float):
                    assert np.isfinite(value)


AnyInput.TestCase.settings = settings(max_examples=12, stateful_step_count=20)


@pytest.mark.usefixtures("impatient")
class TestAnyInput(AnyInput.TestCase):
    """Run by pytest."""


def long_run(engine, seconds, chunk=20, rates=(50, 10), topics=("truth", "estimate"), clock=True):
    """Feed motion in chunks; yield what the engine holds after each."""
    for begin in range(0, seconds, chunk):
        for topic, rate, add in zip(
            ("truth", "estimate"),
            rates,
            (engine.add_ground_truth, engine.add_estimate),
            strict=True,
        ):
            if topic in topics:
                times = begin + np.arange(1, chunk * rate + 1) / rate
                add(samples(START + np.rint(times * SECOND).astype(np.int64), motion(times)))
        engine.advance(START + (begin + chunk) * SECOND if clock else None)
        yield held(engine)


def test_memory_is_flat_over_a_long_run():
    engine = Engine(FIXED)
    sizes = list(long_run(engine, 500))
    assert max(sizes[5:]) < 1.2 * max(sizes[5:10])
    assert balance(engine).pending <= 10
    assert max(sizes) < 60e6


@pytest.mark.slow
def test_memory_is_flat_to_the_byte():
    engine = Engine({**FIXED, "window.duration": 5.0})
    tracemalloc.start()
    try:
        traced = []
        for _ in long_run(engine, 480, chunk=30, rates=(10, 2)):
            gc.collect()
            traced.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert max(traced[9:]) < 1.1 * max(traced[3:9]) + 50_000


def test_one_topic_alone_does_not_fill_the_memory():
    engine = Engine(FIXED)
    sizes = list(long_run(engine, 1600, topics=("truth",)))
    half = len(sizes) // 2
    assert max(sizes[half:]) < 1.1 * max(sizes[:half])
    engine = Engine(FIXED)
    empty = held(engine)
    sizes = list(long_run(engine, 800, topics=("estimate",)))
    assert max(sizes) < empty + 100_000
    assert balance(engine).pending <= 10 * 3


def test_unset_stamps_do_not_fill_the_memory():
    engine = Engine(FIXED)
    zeros = samples(np.zeros(3), motion(np.zeros(3)))
    engine.add_estimate(zeros)
    sizes = []
    for size in long_run(engine, 1600, topics=("truth",)):
        engine.add_estimate(zeros)
        sizes.append(size)
    half = len(sizes) // 2
    assert max(sizes[half:]) < 1.1 * max(sizes[:half])


def test_a_robot_that_stands_still_does_not_fill_the_memory():
    engine = Engine({"relative.unit": "m"})
    sizes = []
    for begin in range(0, 300, 10):
        for rate, add in ((20, engine.add_ground_truth), (5, engine.add_estimate)):
            times = begin + np.arange(1, 10 * rate + 1) / rate
            still = np.broadcast_to(np.eye(4), (len(times), 4, 4))
            add(samples(START + np.rint(times * SECOND).astype(np.int64), still))
        engine.advance(START + (begin + 10) * SECOND)
        sizes.append(held(engine))
    assert max(sizes[15:]) < 1.2 * max(sizes[8:15])
    assert balance(engine).used > 1400
