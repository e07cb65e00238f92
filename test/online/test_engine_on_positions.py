# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth without orientation, through the engine: what is told holds in simulation."""

import numpy as np
import pytest
from twins.runs import FIXED, assert_same_summary, poses_of, samples, simulated

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.samples import PoseSamples

ARM = np.array([0.25, -0.1, 0.6])
RUN = simulated(5, 18.0, (20.0, 8.0), dropouts=((9.0, 10.5),))


def positions_of(topic):
    unturned = np.tile([0.0, 0.0, 0.0, 1.0], (len(topic), 1))
    return PoseSamples(topic.stamps, topic.positions, unturned)


def scored(estimate, parameters=FIXED):
    """The engine and the evaluations of an estimate against the positions, in two batches."""
    engine = Engine(parameters)
    engine.note_without_orientation(None)
    engine.add_ground_truth(positions_of(RUN.ground_truth))
    engine.add_estimate(estimate[:50])
    found = [engine.advance()]
    engine.add_estimate(estimate[50:])
    return engine, [*found, engine.advance(), engine.finish()]


def test_in_simulation_it_is_calibrated():
    """Estimates that err by the ground truth's own posterior: they cannot be told from it."""
    rng = np.random.default_rng(0)
    _, found = scored(RUN.estimate)
    stamps, truth, covariance = (
        np.concatenate([getattr(each.evaluations, name) for each in found])
        for name in ("stamps", "ground_truth", "covariance")
    )
    root = np.linalg.cholesky(covariance[:, :3, :3])
    turned = poses_of(RUN.estimate)[np.isin(RUN.estimate.stamps, stamps), :3, :3]
    ratios, scores = [], []
    for _ in range(14):
        body = np.tile(np.eye(4), (len(stamps), 1, 1))
        body[:, :3, :3] = turned
        antenna = truth[:, :3, 3] + (root @ rng.normal(size=(len(stamps), 3, 1)))[..., 0]
        body[:, :3, 3] = antenna - turned @ ARM
        engine, _ = scored(samples(stamps, body))
        summary = engine.summary()
        assert summary["absolute"]["consistency"] < 1e-9
        ratios.append(summary["relative"]["chi2_per_dof"])
        arm, std = (np.array(summary["lever_arm"][key]) for key in ("value", "std"))
        scores.append((arm - ARM) / std)
        assert (np.abs(arm - ARM) < 0.05).all()
    assert abs(np.mean(ratios) - 1.0) < 3.0 * np.std(ratios) / np.sqrt(len(ratios)) + 0.01
    assert (np.abs(scores) < 2.5).mean() > 0.95


def test_nothing_of_an_orientation_is_told():
    engine, found = scored(RUN.estimate)
    assert engine.is_position_only()
    summary = engine.summary()
    rotation = {}

    def walk(figures, below=""):
        for key, value in figures.items():
            if isinstance(value, dict):
                walk(value, f"{below}{key}.")
            elif "rotation" in key and value is not None:
                rotation[f"{below}{key}"] = value

    walk({key: value for key, value in summary.items() if key != "ground_truth"})
    assert rotation == {}
    for results in found:
        assert results.position_only
        assert np.isnan(results.evaluations.absolute_error[:, 3:]).all()
        assert np.isfinite(results.evaluations.absolute_error[:, :3]).all()
        assert np.isnan(results.evaluations.chi2).all()
    first = np.concatenate([each.evaluations.relative_error for each in found])
    assert np.isnan(first[0]).all()
    assert np.isfinite(first[1:, :3]).all()
    total = found[-1].evaluations.relative_log_likelihood
    known = [each.evaluations.relative_log_likelihood for each in found if len(each.evaluations)]
    assert len(total) == 0 or np.isfinite(total[-1])
    assert known[-1][-1] == pytest.approx(summary["relative"]["log_likelihood"], rel=1e-9)


def test_an_orientation_is_one_as_soon_as_it_changes():
    engine = Engine(FIXED)
    engine.add_ground_truth(RUN.ground_truth)
    engine.add_estimate(RUN.estimate)
    engine.finish()
    assert not engine.is_position_only()
    assert "position_only" not in engine.summary()


def test_an_estimate_without_orientation_does_not_touch_the_others():
    parameters = {**FIXED, "estimates": ["point", "body"]}
    engine, alone = Engine(parameters, ("point", "body")), Engine(FIXED)
    engine.note_without_orientation("point")
    for each in (engine, alone):
        each.add_ground_truth(RUN.ground_truth)
    engine.add_estimate(positions_of(RUN.estimate), "point")
    engine.add_estimate(RUN.estimate, "body")
    alone.add_estimate(RUN.estimate)
    engine.finish_all()
    alone.finish()
    assert engine.is_position_only("point")
    assert not engine.is_position_only("body")
    assert_same_summary(engine.figures("body"), alone.figures())
    engine.reset_estimate("point")
    assert engine.is_position_only("point")
