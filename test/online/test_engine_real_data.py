# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Real pairs through the engine: the conventional figures are evo's, a real gap is known as one."""

import functools
import json

import numpy as np
import pytest
from twins.runs import SECOND, balance, joined, leaves
from twins.trajectories import DATA, METRIC_PAIRS

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.samples import PoseSamples


def topic(path):
    if not path.exists():
        pytest.skip(f"no {path.parent.name}/{path.name} beside the repository (shared/data)")
    rows = np.loadtxt(path)
    with open(path, encoding="utf-8") as file:
        words = [line.split()[0] for line in file if line.strip() and not line.startswith("#")]
    return PoseSamples(np.array([_nanoseconds(w) for w in words]), rows[:, 1:4], rows[:, 4:8])


def _nanoseconds(text):
    """Exact: decimals beyond the ninth are cut."""
    if "e" in text.lower():
        return round(float(text) * SECOND)
    whole, _, part = text.partition(".")
    return int(whole) * SECOND + int((part + "0" * 9)[:9])


@functools.cache
def scored(dataset, estimate, max_gap=1.0):
    truth, other = (
        topic(DATA / dataset / "groundtruth.txt"),
        topic(DATA / dataset / f"{estimate}.txt"),
    )
    engine = Engine({"ground_truth.max_gap": max_gap})
    evaluations = joined([r.evaluations for r in feed(engine, truth, other, 5 * SECOND)])
    return truth, other, engine, evaluations


@functools.cache
def evo():
    path = DATA / "reference_evo.json"
    if not path.exists():
        pytest.skip("no reference_evo.json beside the repository (shared/data)")
    return json.loads(path.read_text())["results"]


@pytest.mark.parametrize(("dataset", "estimate"), METRIC_PAIRS)
def test_a_real_pair(dataset, estimate):
    expected = evo()[dataset][estimate]["se3"]["ape_trans_rmse_m"]
    _, other, engine, evaluations = scored(dataset, estimate)
    counts, summary = balance(engine), engine.summary()
    assert counts.received == len(other)
    assert counts.pending == 0
    assert counts.used > 0.7 * len(other)
    for value in leaves(summary).values():
        assert not isinstance(value, float) or np.isfinite(value)
    ate = summary["conventional"]["ate_translation_rmse"]
    assert ate == pytest.approx(expected, rel=0.03)
    assert engine.health().consistency < 1e-9
    assert summary["absolute"]["log_likelihood_first_order"] == pytest.approx(
        summary["relative"]["log_likelihood"], rel=1e-9
    )
    assert (np.linalg.eigvalsh(evaluations["covariance"]) > 0).all()
    # The answer never strays from the samples around by more than the motion between them.
    assert (np.abs(evaluations["ground_truth"][:, 3]) == [0, 0, 0, 1]).all()


def edges(truth):
    """The samples before and after the longest interval, s."""
    longest = int(np.argmax(np.diff(truth.stamps)))
    return truth.stamps[longest : longest + 2]


def test_inside_the_real_gap_there_is_no_ground_truth_by_default():
    truth, other, engine, evaluations = scored("tum_fr2_desk", "orb")
    begin, end = edges(truth)
    assert (end - begin) / SECOND == pytest.approx(11.99, abs=0.01)
    inside = (other.stamps > begin + SECOND) & (other.stamps < end - SECOND)
    # There are two gaps of two seconds besides.
    after = np.searchsorted(truth.stamps, other.stamps)
    around = truth.stamps[[after - 1, np.minimum(after, len(truth) - 1)]]
    nearest = np.abs(around - other.stamps).min(axis=0)
    assert balance(engine).rejected == {"no_ground_truth": np.count_nonzero(nearest > SECOND)}
    assert np.count_nonzero(inside) > 250
    assert not np.isin(other.stamps[inside], evaluations["stamps"]).any()


def test_with_a_longer_max_gap_they_are_scored_with_the_uncertainty_of_the_motion():
    truth, other, engine, evaluations = scored("tum_fr2_desk", "orb", 20.0)
    assert balance(engine).rejected == {}
    assert balance(engine).used == len(other)
    begin, end = edges(truth)
    stamps = evaluations["stamps"]
    std = np.sqrt(np.diagonal(evaluations["covariance"], axis1=1, axis2=2))
    outside = (stamps < begin - SECOND) | (stamps > end + SECOND)
    middle = np.abs(stamps - (begin + end) // 2) < SECOND
    usual = np.median(std[outside], axis=0)
    grown = std[middle].mean(axis=0)
    # The motion of twelve seconds on this desk: of the order of a metre and of a radian.
    assert (grown > 50 * usual).all()
    assert (grown[:3] > 0.1).all()
    assert (grown[:3] < 20.0).all()
    assert (grown[3:] > 0.05).all()
    # The camera has really been within three of these standard deviations of the answer.
    aligned = engine.advance().alignment.apply(evaluations["estimate"])
    error = (aligned - evaluations["ground_truth"])[middle, :3, 3]
    assert (np.linalg.norm(error, axis=1) < 3 * np.linalg.norm(std[middle, :3], axis=1)).all()
    # And the conventional figures are not those of the gap.
    without = scored("tum_fr2_desk", "orb")[2].summary()["conventional"]
    within = engine.summary()["conventional"]
    assert within["ate_translation_rmse"] == pytest.approx(
        without["ate_translation_rmse"], rel=0.01
    )


def test_the_uncertainty_rises_and_falls_smoothly():
    truth, _, _, evaluations = scored("tum_fr2_desk", "orb", 20.0)
    begin, end = edges(truth)
    inside = (evaluations["stamps"] > begin) & (evaluations["stamps"] < end)
    std = np.sqrt(np.diagonal(evaluations["covariance"][inside], axis1=1, axis2=2))
    for size in (std[:, :3].max(axis=1), std[:, 3:].max(axis=1)):
        top = int(np.argmax(size))
        # Not in the middle: the motion before may be livelier than the motion after.
        assert 0.1 * len(size) < top < 0.9 * len(size)
        rising, falling = np.diff(size[: top + 1]), np.diff(size[top:])
        assert (rising > -0.02 * size.max()).all()
        assert (falling < 0.02 * size.max()).all()
        # No step is a jump, but at the lag before the end, where the next sample is added.
        assert np.sort(np.abs(np.diff(size)))[-2] < 0.1 * size.max()
