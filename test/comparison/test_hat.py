# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two estimates against a ground truth that is wrong, or right."""

import json
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands.simulation import motion
from trajeval_ros.comparison.common import Evaluated
from trajeval_ros.comparison.hat import shared_error
from trajeval_ros.runs.several import causes_of_all

SECOND = 1_000_000_000
DURATION = 120.0
RECORDINGS = Path(__file__).resolve().parents[2].parent / "shared" / "data"


def run(seed, noise=0.01, drift=0.01, moved=(0.0, 0.0), offset=(0.0, 0.0, 0.0)):
    """An estimate of a flight; the ground truth's body is moved by `offset` for a share of it."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.5, DURATION, 0.1)
    truth = motion(t)
    walk = np.cumsum(drift * np.sqrt(0.1) * rng.normal(size=(len(t), 6)), axis=0)
    walk[:, 3:] *= 0.1
    error = np.concatenate([noise * rng.normal(size=(len(t), 3)), np.zeros((len(t), 3))], axis=1)
    world = se3.exp(0.2 * np.arange(6.0) * seed)
    estimate = world @ se3.exp(walk) @ truth @ se3.exp(error)
    wrong = (t >= moved[0] * DURATION) & (t < moved[1] * DURATION)
    body = np.eye(4)
    body[:3, 3] = offset
    known = truth.copy()
    known[wrong] = known[wrong] @ body
    return Evaluated(f"run_of_{seed}", np.rint(t * SECOND).astype(np.int64), known, estimate)


@pytest.mark.parametrize("moved", [(0.4, 0.6), (0.8, 1.0), (0.0, 0.2)])
def test_a_mocap_body_that_was_moved_is_named_with_its_stretch(moved):
    size = 0.5
    wrong = {"moved": moved, "offset": (size, 0.0, 0.0)}
    found = shared_error([run(1, **wrong), run(2, **wrong)])
    assert not found.whole
    begin, end = found.begin / SECOND / DURATION, found.end / SECOND / DURATION
    # To a stretch, and a step.
    assert begin == pytest.approx(moved[0], abs=0.11)
    assert end == pytest.approx(moved[1], abs=0.11)
    assert 0.1 * size < found.truth_std < 2.0 * size
    assert found.ratio > 8.0
    assert {found.a, found.b} == {"run_of_1", "run_of_2"}


def test_a_wrong_ground_truth_throughout_is_named_for_the_whole_run():
    rng = np.random.default_rng(0)
    first, second = run(1), run(2)
    count = len(first)
    known = first.ground_truth.copy()
    known[:, :3, 3] += rng.normal(size=(count, 3)) * 0.5
    found = shared_error([Evaluated(e.name, e.stamps, known, e.estimate) for e in (first, second)])
    assert found.whole
    # A displacement has the noise of both its ends.
    assert found.truth_std == pytest.approx(0.5 * np.sqrt(6.0), rel=0.15)


@pytest.mark.parametrize("seed", range(20))
def test_estimates_that_err_independently_are_no_reason(seed):
    assert shared_error([run(2 * seed + 1), run(2 * seed + 2, noise=0.02, drift=0.02)]) is None


def test_one_output_twice_says_nothing():
    one = run(1)
    other = Evaluated("copy", one.stamps, one.ground_truth, one.estimate)
    assert shared_error([one, other]) is None
    wrong = {"moved": (0.4, 0.6), "offset": (0.5, 0.0, 0.0)}
    one = run(1, **wrong)
    assert (
        shared_error([one, Evaluated("copy", one.stamps, one.ground_truth, one.estimate)]) is None
    )


def test_the_cause_has_the_stretch_and_the_figures():
    wrong = {"moved": (0.4, 0.6), "offset": (0.5, 0.0, 0.0)}
    pair = [run(1, **wrong), run(2, **wrong)]
    (cause,) = causes_of_all(pair)
    assert causes_of_all(pair, "sim3") == ()
    found = shared_error(pair)
    assert cause.code == "ground_truth_or_shared"
    assert f"from {found.begin * 1e-9:.3f} s to {found.end * 1e-9:.3f} s" in cause.text
    assert "run_of_1 and run_of_2 agree" in cause.text
    assert f"{found.from_truth:.3g} m" in cause.text
    assert causes_of_all([run(1), run(2)]) == ()


def test_of_three_the_pair_that_agrees_is_named():
    wrong = {"moved": (0.4, 0.6), "offset": (0.5, 0.0, 0.0)}
    found = shared_error([run(1, **wrong), run(2, noise=1.0, **wrong), run(3, **wrong)])
    assert (found.a, found.b) == ("run_of_1", "run_of_3")


@pytest.mark.parametrize("count", [0, 1, 30])
def test_too_little_is_no_reason(count):
    index = np.arange(count)
    assert shared_error([run(1)[index], run(2)[index]]) is None
    assert shared_error([run(1)]) is None


def recordings():
    found = []
    for path in sorted(RECORDINGS.glob("*/meta.json")):
        meta = json.loads(path.read_text(encoding="utf-8"))
        if len(meta.get("estimates", {})) > 1:
            found.append(path.parent.name)
    return found or [pytest.param("none", marks=pytest.mark.skip("no recordings at hand"))]


@pytest.mark.parametrize("name", recordings())
def test_no_pair_of_real_estimates_is_a_false_alarm(name):
    import trajeval_ros as te

    folder = RECORDINGS / name
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    truth = te.read_tum(folder / meta["groundtruth"]["file"])
    pairs = []
    for estimate, described in meta["estimates"].items():
        read = te.read_tum(folder / described["file"])
        inside = (read.stamps > truth.stamps[0]) & (read.stamps < truth.stamps[-1])
        stamps, poses = read.stamps[inside], read.poses[inside]
        after = np.searchsorted(truth.stamps, stamps)
        share = (stamps - truth.stamps[after - 1]) / (truth.stamps[after] - truth.stamps[after - 1])
        before = truth.poses[after - 1]
        step = se3.log(se3.compose(se3.inverse(before), truth.poses[after]))
        known = se3.compose(before, se3.exp(share[:, None] * step))
        pairs.append(Evaluated(estimate, stamps, known, poses))
    assert shared_error(pairs) is None
