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


def run(seed, noise=0.01, drift=0.01, wrong=(), offset=(0.0, 0.0, 0.0), world=False):
    """An estimate of a flight; the ground truth's body is moved by `offset` in shares of it.

    Or, `world`, the ground truth itself.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.5, DURATION, 0.1)
    truth = motion(t)
    walk = np.cumsum(drift * np.sqrt(0.1) * rng.normal(size=(len(t), 6)), axis=0)
    walk[:, 3:] *= 0.1
    error = np.concatenate([noise * rng.normal(size=(len(t), 3)), np.zeros((len(t), 3))], axis=1)
    estimate = se3.exp(0.2 * np.arange(6.0) * seed) @ se3.exp(walk) @ truth @ se3.exp(error)
    moved = np.eye(4)
    moved[:3, 3] = offset
    known = truth.copy()
    for begin, end in wrong:
        rows = (t >= begin * DURATION) & (t < end * DURATION)
        known[rows] = moved @ known[rows] if world else known[rows] @ moved
    return Evaluated(f"run_of_{seed}", np.rint(t * SECOND).astype(np.int64), known, estimate)


def shares(found):
    return np.array(found.stretches) / SECOND / DURATION


@pytest.mark.parametrize("moved", [(0.4, 0.6), (0.8, 1.0), (0.0, 0.2)])
def test_a_mocap_body_that_was_moved_is_named_with_its_stretch(moved):
    size = 0.5
    wrong = {"wrong": [moved], "offset": (size, 0.0, 0.0)}
    found = shared_error([run(1, **wrong), run(2, **wrong)])
    assert not found.whole
    # To a stretch, and a step.
    np.testing.assert_allclose(shares(found), [moved], atol=0.11)
    assert 0.1 * size < found.truth_std < 2.0 * size
    assert found.ratio > 8.0
    assert {found.a, found.b} == {"run_of_1", "run_of_2"}


def test_two_bad_stretches_are_two_and_the_good_part_between_is_none():
    bad = [(0.2, 0.35), (0.7, 0.85)]
    wrong = {"wrong": bad, "offset": (0.5, 0.0, 0.0)}
    pair = [run(1, **wrong), run(2, **wrong)]
    np.testing.assert_allclose(shares(shared_error(pair)), bad, atol=0.08)
    (cause,) = causes_of_all(pair)
    assert cause.text.count("from ") == 2
    assert " s and from " in cause.text


def test_a_ground_truth_that_leaps_and_comes_back_is_off_between():
    wrong = {"wrong": [(0.3, 0.7)], "offset": (0.7, 0.0, -0.7), "world": True}
    found = shared_error([run(1, **wrong), run(2, **wrong)])
    np.testing.assert_allclose(shares(found), [(0.3, 0.7)], atol=0.08)


def calibrated_wrongly(one):
    """A scale, camera axes, a lever arm and a late clock."""
    sensor = se3.exp(np.array([0.3, -0.2, 0.4, 1.2, -1.2, 1.2]))
    late = 2  # poses of 0.1 s
    estimate = one.estimate @ sensor
    estimate[:, :3, 3] *= 0.7
    return Evaluated(
        one.name, one.stamps[late:], one.ground_truth[late:], estimate[: len(one) - late]
    )


def test_what_a_calibration_would_put_right_is_theirs():
    assert shared_error([calibrated_wrongly(run(seed)) for seed in (1, 2)]) is None


def test_a_wrong_stretch_is_found_beside_a_wrong_calibration():
    bad = [(0.4, 0.6)]
    wrong = {"wrong": bad, "offset": (0.7, 0.0, 0.0)}
    found = shared_error([calibrated_wrongly(run(seed, **wrong)) for seed in (1, 2)])
    np.testing.assert_allclose(shares(found), bad, atol=0.11)


def test_a_ground_truth_without_orientation_says_nothing():
    pair = [run(1), run(2)]
    for one in pair:
        one.ground_truth[:, :3, :3] = np.eye(3)
    assert shared_error(pair) is None


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
    wrong = {"wrong": [(0.4, 0.6)], "offset": (0.5, 0.0, 0.0)}
    one = run(1, **wrong)
    assert (
        shared_error([one, Evaluated("copy", one.stamps, one.ground_truth, one.estimate)]) is None
    )


def test_the_cause_has_the_stretch_and_the_figures():
    wrong = {"wrong": [(0.4, 0.6)], "offset": (0.5, 0.0, 0.0)}
    pair = [run(1, **wrong), run(2, **wrong)]
    (cause,) = causes_of_all(pair)
    found = shared_error(pair)
    ((begin, end),) = found.stretches
    assert cause.code == "ground_truth_or_shared"
    assert f"from {begin * 1e-9:.3f} s to {end * 1e-9:.3f} s" in cause.text
    assert "run_of_1 and run_of_2 agree" in cause.text
    assert f"{found.from_truth:.3g} m" in cause.text
    assert causes_of_all([run(1), run(2)]) == ()


def test_of_three_the_pair_that_agrees_is_named():
    wrong = {"wrong": [(0.4, 0.6)], "offset": (0.5, 0.0, 0.0)}
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


def read(name):
    """Each estimate of a recording with the ground truth between its samples."""
    import trajeval_ros as te

    folder = RECORDINGS / name
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    truth = te.read_tum(folder / meta["groundtruth"]["file"])
    pairs = []
    for estimate, described in meta["estimates"].items():
        read = te.read_tum(folder / described["file"])
        # Not within gaps of the ground truth, where a straight line would be wrong.
        after = np.searchsorted(truth.stamps, read.stamps).clip(1, len(truth.stamps) - 1)
        inside = (read.stamps >= truth.stamps[after - 1]) & (read.stamps <= truth.stamps[after])
        inside &= truth.stamps[after] - truth.stamps[after - 1] < 0.3 * SECOND
        stamps, poses, after = read.stamps[inside], read.poses[inside], after[inside]
        share = (stamps - truth.stamps[after - 1]) / (truth.stamps[after] - truth.stamps[after - 1])
        before = truth.poses[after - 1]
        step = se3.log(se3.compose(se3.inverse(before), truth.poses[after]))
        known = se3.compose(before, se3.exp(share[:, None] * step))
        pairs.append(Evaluated(estimate, stamps, known, poses))
    return pairs


@pytest.mark.parametrize("name", recordings())
def test_no_pair_of_real_estimates_is_a_false_alarm(name):
    assert shared_error(read(name)) is None


@pytest.mark.parametrize("body", [False, True])
def test_seventy_centimetres_are_found_beside_real_estimates(body):
    if "euroc_mh04" not in recordings():
        pytest.skip("MH_04 is not at hand")
    pair = read("euroc_mh04")
    moved = np.eye(4)
    moved[0, 3] = 0.7
    begin, end = edges = pair[0].stamps[[400, 600]]
    for one in pair:
        rows = (one.stamps >= begin) & (one.stamps < end)
        good = one.ground_truth[rows]
        one.ground_truth[rows] = good @ moved if body else moved @ good
    for first, last in shared_error(pair).stretches:
        assert ((first < edges) & (edges < last)).any()
