# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs for the tests of the engine: a motion, what is published of it, and ways of playing it."""

import itertools
from dataclasses import dataclass

import numpy as np

from trajeval_ros import se3
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.samples import PoseSamples

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
# Given hyperparameters, where learning them is not what is tested.
FIXED = {
    "gp.hyperparameters": "fixed",
    "gp.translation.signal_std": 1.0,
    "gp.translation.length_scale": 1.5,
    "gp.translation.noise_std": 0.002,
    "gp.rotation.signal_std": 0.8,
    "gp.rotation.length_scale": 1.5,
    "gp.rotation.noise_std": 0.003,
}


def motion(seconds):
    """A smooth flight, T_world_body; (..., 4, 4)."""
    s = np.asarray(seconds, dtype=np.float64)[..., None]
    position = np.concatenate(
        [2.0 * np.sin(0.7 * s), 1.5 * np.sin(0.9 * s + 0.4), 1.0 + 0.5 * np.cos(0.5 * s)], axis=-1
    )
    turn = np.concatenate([0.4 * np.sin(0.8 * s), 0.3 * np.cos(1.1 * s), 0.5 * s], axis=-1)
    poses = np.zeros((*position.shape[:-1], 4, 4))
    poses[..., :3, :3] = se3.exp_so3(turn)
    poses[..., :3, 3] = position
    poses[..., 3, 3] = 1.0
    return poses


def nanoseconds(seconds):
    return START + np.rint(np.asarray(seconds) * SECOND).astype(np.int64)


def samples(stamps, poses, covariances=None):
    """Poses (n, 4, 4) as a topic carries them."""
    position, quaternion = se3.to_position_quaternion(poses)
    return PoseSamples(np.asarray(stamps, dtype=np.int64), position, quaternion, covariances)


def poses_of(topic):
    return se3.from_position_quaternion(topic.positions, topic.quaternions)


def where(topic, mask):
    """Some of a topic's messages."""
    return PoseSamples(topic.stamps[mask], topic.positions[mask], topic.quaternions[mask])


def stamped(topic, stamps):
    """A topic's messages with other stamps."""
    return PoseSamples(stamps, topic.positions, topic.quaternions)


@dataclass(frozen=True)
class Run:
    """What the two topics carry, each in the order of its arrival."""

    ground_truth: PoseSamples
    estimate: PoseSamples


def simulated(seed, duration, rates=(50.0, 10.0), dropouts=(), std=(0.002, 0.003), error=0.02):
    """Ground truth with noise, jitter and dropouts (from, to), and a drifting estimate.

    The estimate has a world and a clock phase of its own.
    """
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, duration, 1.0 / rates[0])
    times = times + rng.uniform(-0.2, 0.2, len(times)) / rates[0]
    for begin, end in dropouts:
        times = times[(times < begin) | (times > end)]
    noise = rng.normal(size=(len(times), 6)) * np.repeat(std, 3)
    truth = samples(nanoseconds(times), motion(times) @ se3.exp(noise))
    times = np.arange(0.0317, duration, 1.0 / rates[1])
    drift = np.cumsum(rng.normal(size=(len(times), 6)), axis=0) * 0.3 * error / np.sqrt(rates[1])
    noise = rng.normal(size=(len(times), 6)) * error * 0.5
    world = se3.exp(rng.normal(size=6))
    estimate = world @ se3.exp(drift) @ motion(times) @ se3.exp(noise)
    return Run(truth, samples(nanoseconds(times), estimate))


def play(engine, run, ticks, delays=(0, 0), cuts=None, order=None):
    """Play a run live: at each tick (ns) what has arrived is handed over, then the clock tells.

    ``delays`` (ns): how much later than its stamp each topic's messages arrive, a number or one a
    message. ``cuts(count)``: where a batch is cut. ``order(n)``: which topic goes first.
    Returns the evaluations. The engine is finished.
    """
    arrivals = [
        np.maximum.accumulate(topic.stamps + delay)
        for topic, delay in zip((run.ground_truth, run.estimate), delays, strict=True)
    ]
    taken, found = [0, 0], []
    for n, now in enumerate(ticks):
        pieces = []
        for i, add in enumerate((engine.add_ground_truth, engine.add_estimate)):
            until = int(np.searchsorted(arrivals[i], now, side="right"))
            topic = (run.ground_truth, run.estimate)[i]
            inner = [taken[i] + c for c in cuts(until - taken[i])] if cuts else []
            edges = [taken[i], *inner, until]
            pieces.append([(add, topic[a:b]) for a, b in itertools.pairwise(edges)])
            taken[i] = until
        first = order(n) if order else 0
        queues = [pieces[first], pieces[1 - first]]
        # One batch of each in turn.
        while queues[0] or queues[1]:
            for queue in queues:
                if queue:
                    add, batch = queue.pop(0)
                    add(batch)
        found.append(engine.advance(int(now)).evaluations)
    assert taken == [len(run.ground_truth), len(run.estimate)], "the ticks end too early"
    found.append(engine.finish().evaluations)
    return joined(found)


def played(parameters, run, period=0.5, delays=(0, 0), **how):
    """The engine and the evaluations of a run played live with ticks ``period`` seconds apart."""
    engine = Engine(parameters)
    first = min(int(t.stamps.min()) for t in (run.ground_truth, run.estimate) if len(t))
    last = max(
        int(np.max(t.stamps + d))
        for t, d in zip((run.ground_truth, run.estimate), delays, strict=True)
        if len(t)
    )
    step = round(period * SECOND)
    return engine, play(engine, run, np.arange(first, last + step, step), delays, **how)


def handed_over(parameters, run):
    """The engine and the evaluations of a run handed over at once."""
    engine = Engine(parameters)
    engine.add_ground_truth(run.ground_truth)
    engine.add_estimate(run.estimate)
    first = engine.advance().evaluations
    return engine, joined([first, engine.finish().evaluations])


def joined(evaluations):
    """Evaluations one after another, as a dict of arrays."""
    return {
        name: np.concatenate([getattr(e, name) for e in evaluations])
        for name in type(evaluations[0]).__dataclass_fields__
    }


def balance(engine):
    """Assert that every message is accounted for; return the estimate's counts."""
    health = engine.health()
    for topic in (health.estimate, health.ground_truth):
        assert min(topic.used, topic.pending, topic.received, *topic.rejected.values(), 0) == 0
        assert topic.received == topic.used + topic.pending + sum(topic.rejected.values())
    return health.estimate


def leaves(value, path=""):
    """A summary's values by their paths."""
    if isinstance(value, dict):
        return {
            p: v for key, item in value.items() for p, v in leaves(item, f"{path}/{key}").items()
        }
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return leaves(dict(enumerate(value)), path)
    return {path: value}


def assert_same_summary(actual, expected, relative=1e-9):
    """Counts, texts and nothings equal; numbers within ``relative``; lists against their size."""
    actual, expected = leaves(actual), leaves(expected)
    assert list(actual) == list(expected)
    for path, value in expected.items():
        if path.endswith("/consistency") and value is not None:
            # Itself a round-off.
            assert actual[path] < 1e-9
            assert value < 1e-9
        elif isinstance(value, list) and not any(isinstance(entry, str) for entry in value):
            size = np.abs(value).max(initial=0.0)
            np.testing.assert_allclose(
                actual[path], value, rtol=0, atol=relative * size, err_msg=path
            )
        elif isinstance(value, float):
            np.testing.assert_allclose(actual[path], value, rtol=relative, atol=0, err_msg=path)
        else:
            assert actual[path] == value, path
