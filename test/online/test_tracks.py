# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Several estimates in one engine: each has what it would have alone."""

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule
from twins.runs import FIXED, SECOND, START, assert_same_summary, motion, samples, simulated
from twins.sizes import held

from trajeval_ros import se3
from trajeval_ros.online import settings as settings_module
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.parameters import PARAMETERS, ParameterError, complete, table
from trajeval_ros.online.samples import PoseSamples

NAMES = ("first", "second", "third")
RATES = {"first": 8.0, "second": 3.0, "third": 20.0}
TRUTH_STEP = SECOND // 20
OFFSETS = {"first": 0.0, "second": -0.3, "third": 0.15}
EXTRINSIC = (0.1, 0.0, -0.2, 0.0, 0.0, 0.6, 0.8)


def parameters_of(name, own):
    """Those of an engine for one estimate, which is called as ever."""
    return {
        key.replace(f"{name}.", "estimate.", 1) if key != f"{name}.extrinsic" else "extrinsic": v
        for key, v in own.items()
        if key.partition(".")[0] not in set(NAMES) - {name}
    }


class Side:
    """One engine of all estimates beside an engine for each of them."""

    def __init__(self, parameters):
        self.together = Engine(parameters, NAMES)
        self.alone = {name: Engine(parameters_of(name, parameters)) for name in NAMES}

    def add_ground_truth(self, batch):
        self.together.add_ground_truth(batch)
        for engine in self.alone.values():
            engine.add_ground_truth(batch)

    def add_estimate(self, batch, name):
        self.together.add_estimate(batch, name)
        self.alone[name].add_estimate(batch)

    def advance(self, now):
        found = self.together.advance_all(now)
        for name, engine in self.alone.items():
            assert_same_results(found[name], engine.advance(now))

    def finish(self):
        found = self.together.finish_all()
        for name, engine in self.alone.items():
            assert_same_results(found[name], engine.finish())

    def reset(self):
        for engine in (self.together, *self.alone.values()):
            engine.reset()

    def reset_estimate(self, name):
        self.together.reset_estimate(name)
        self.alone[name].reset_estimate()

    def assert_same_figures(self):
        for name, engine in self.alone.items():
            assert self.together.notices(name) == engine.notices()
            assert_same_summary(self.together.summary(name), engine.summary(), 1e-12)


def assert_same_results(ours, theirs):
    assert ours.notices == theirs.notices
    assert len(ours.cross) == len(theirs.cross)
    for one, other in zip(ours.cross, theirs.cross, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-300)
    for field in type(theirs.evaluations).__dataclass_fields__:
        one, other = getattr(ours.evaluations, field), getattr(theirs.evaluations, field)
        # What is zero but for round-off is so against the size of the others.
        size = 1e-12 * np.nanmax(np.abs(other), initial=0.0) if other.dtype == float else 0.0
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=size, err_msg=field)


class Tracks(RuleBasedStateMachine):
    """Estimates come, go, lag, restart at the origin; the ground truth breaks; the clock ticks."""

    @initialize(learn=st.booleans(), joint=st.booleans(), gauge=st.sampled_from(["se3", "sim3"]))
    def start(self, learn, joint, gauge):
        self.side = Side(
            {
                **({} if learn else FIXED),
                "gauge": gauge,
                "window.duration": 3.0,
                "likelihood.covariance": "joint" if joint else "independent",
                **{f"{name}.time_offset": offset for name, offset in OFFSETS.items()},
                "second.extrinsic": EXTRINSIC,
                "third.use_covariance": True,
            }
        )
        self._restart()

    def _restart(self):
        self.now = self.truth = START
        self.times = dict.fromkeys(NAMES, START)
        self.origins = {name: np.eye(4) for name in NAMES}
        self.done = False

    def _estimate(self, name, until):
        step = round(SECOND / RATES[name])
        stamps = np.arange(self.times[name] + step, until + 1, step)
        if len(stamps):
            self.times[name] = int(stamps[-1])
        rng = np.random.default_rng(len(stamps))
        noise = se3.exp(0.01 * rng.normal(size=(len(stamps), 6)))
        poses = self.origins[name] @ motion((stamps - START) / SECOND) @ noise
        covariances = np.tile(1e-6 * np.eye(6), (len(stamps), 1, 1))
        return samples(stamps, poses, covariances)

    @rule(seconds=st.integers(1, 4), present=st.sets(st.sampled_from(NAMES)), tick=st.booleans())
    def go_on(self, seconds, present, tick):
        if self.done:
            return
        self.now += seconds * SECOND
        stamps = np.arange(self.truth + TRUTH_STEP, self.now + 1, TRUTH_STEP)
        self.truth = int(stamps[-1])
        self.side.add_ground_truth(samples(stamps, motion((stamps - START) / SECOND)))
        for name in sorted(present):
            self.side.add_estimate(self._estimate(name, self.now), name)
        if tick:
            self.side.advance(self.now)

    @rule(name=st.sampled_from(NAMES), seconds=st.integers(0, 3))
    def catch_up(self, name, seconds):
        """What was late comes now, or the future before its ground truth."""
        if not self.done:
            self.side.add_estimate(self._estimate(name, self.now + seconds * SECOND), name)

    @rule(name=st.sampled_from(NAMES))
    def leave_out(self, name):
        self.times[name] = max(self.times[name], self.now)

    @rule(seconds=st.sampled_from([1, 7, 40]))
    def silence(self, seconds):
        self.now += seconds * SECOND
        self.truth = self.now

    @rule(name=st.sampled_from(NAMES), behind=st.sampled_from([0, 2, 50]))
    def wrong_stamp(self, name, behind):
        if not self.done:
            stamp = np.array([self.times[name] - behind * SECOND])
            self.side.add_estimate(samples(stamp, motion(np.zeros(1))), name)

    @rule(name=st.sampled_from(NAMES), again=st.booleans())
    def at_the_origin(self, name, again):
        """An estimator starts again: its world is another; told, or not."""
        self.origins[name] = se3.inverse(motion((self.now - START) / SECOND))
        if again and not self.done:
            self.side.reset_estimate(name)

    @rule(late=st.sampled_from([-5, 0, 1, 60]), clock=st.booleans())
    def tick(self, late, clock):
        if not self.done:
            self.side.advance(self.now + late * SECOND if clock else None)

    @rule()
    def start_over(self):
        self.side.reset()
        self._restart()

    @rule()
    def finish(self):
        if not self.done:
            self.side.finish()
            self.done = True

    def teardown(self):
        if hasattr(self, "side"):
            self.side.assert_same_figures()


Tracks.TestCase.settings = settings(max_examples=12, stateful_step_count=20, deadline=None)


@pytest.fixture
def impatient(monkeypatch):
    """Estimates at a gap of 3 s do not wait for its end, and older ground truth is dropped."""
    monkeypatch.setattr(settings_module, "PATIENCE", 3 * SECOND)


@pytest.mark.usefixtures("impatient")
class TestTracks(Tracks.TestCase):
    """Run by pytest."""


def test_a_run_of_three_is_three_runs():
    side = Side({"third.time_offset": 0.15, "second.extrinsic": EXTRINSIC})
    runs = {name: simulated(3 + n, 30.0, (50.0, 5.0 + n)) for n, name in enumerate(NAMES)}
    truth = runs["first"].ground_truth
    for second in range(1, 31):
        until = START + second * SECOND
        part = (truth.stamps > until - SECOND) & (truth.stamps <= until)
        side.add_ground_truth(truth[slice(*np.flatnonzero(part)[[0, -1]] + [0, 1])])
        for name, run in runs.items():
            here = np.flatnonzero(
                (run.estimate.stamps > until - SECOND) & (run.estimate.stamps <= until)
            )
            side.add_estimate(run.estimate[here[0] : here[-1] + 1], name)
        side.advance(until)
    side.finish()
    side.assert_same_figures()
    for name in NAMES:
        assert side.together.health(name).estimate.used > 100


def fed(engine, seconds, present):
    """Feed motion second by second; ``present(name, second)``; yield what the engine holds."""
    for second in range(seconds):
        for add, rate, names in (
            (engine.add_ground_truth, 20, [None]),
            (engine.add_estimate, 5, [n for n in engine.names if present(n, second)]),
        ):
            times = second + np.arange(1, rate + 1) / rate
            batch = samples(START + np.rint(times * SECOND).astype(np.int64), motion(times))
            for name in names:
                add(batch) if name is None else add(batch, name)
        engine.advance_all(START + (second + 1) * SECOND)
        yield held(engine)


def test_a_dead_or_silent_track_holds_nothing_up():
    """The second never comes, the third dies: the first is scored as ever, memory stays bounded."""
    engine = Engine({**FIXED, "window.duration": 5.0}, NAMES)
    sizes = list(fed(engine, 200, lambda name, s: name == "first" or (name == "third" and s < 20)))
    assert max(sizes[100:]) < 1.2 * max(sizes[45:100])
    assert engine.health("first").estimate.pending <= 5
    assert engine.health("first").estimate.used >= 990
    assert engine.health("third").estimate.used == 100
    assert engine.health("third").estimate.pending == 0
    assert engine.health("second").estimate.received == 0
    # What is retained reaches back as far as the patience there is, and no further.
    stamps = engine._reference.ground_truth.stamps
    assert (stamps[-1] - stamps[0]) / SECOND < 31.0 + 70 / 20


def test_a_track_starts_over_alone():
    engine = Engine(FIXED, NAMES)
    for _ in fed(engine, 10, lambda name, second: True):
        pass
    engine.reset_estimate("second")
    assert engine.health("second").estimate.received == 0
    assert engine.health("first").estimate.received == 50
    assert engine.health("second").ground_truth.received == 200


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), "at least one"),
        (("vins", "vins"), "twice"),
        (("Vins",), "snake_case"),
        (("a/b",), "snake_case"),
        (("ground_truth",), "means something else"),
        (("gp", "vins"), "means something else"),
    ],
)
def test_names_are_checked(names, message):
    with pytest.raises(ParameterError, match=message):
        Engine({}, names)


def test_each_name_has_its_own_parameters():
    own = {p.removeprefix("estimate.") for p in PARAMETERS if p.startswith("estimate.")}
    names = table(("vins", "orb"))
    for name in ("vins", "orb"):
        assert {p.removeprefix(f"{name}.") for p in names if p.startswith(name)} == {
            *own,
            "extrinsic",
        }
    assert "extrinsic" not in names
    assert complete({"orb.time_offset": 2}, ("vins", "orb"))["vins.time_offset"] == 0.0
    with pytest.raises(ParameterError, match=r"unknown parameter estimate\.time_offset"):
        complete({"estimate.time_offset": 2}, ("vins", "orb"))


def test_which_of_several_is_said():
    engine = Engine({}, ("vins", "orb"))
    nothing = PoseSamples(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 4)))
    for ask in (engine.advance, engine.finish, engine.health, engine.summary):
        with pytest.raises(ValueError, match="which of the estimates vins, orb"):
            ask()
    with pytest.raises(ValueError, match="no estimate is called okvis"):
        engine.add_estimate(nothing, "okvis")
