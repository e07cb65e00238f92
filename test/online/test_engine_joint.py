# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``likelihood.covariance: joint``, from the messages to the figures."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import kstest
from twins import joint_twin, likelihood_twin
from twins.runs import (
    FIXED,
    SECOND,
    Run,
    assert_same_summary,
    balance,
    handed_over,
    played,
    samples,
    simulated,
    where,
)

from trajeval_ros import se3
from trajeval_ros.ground_truth.trajectory import GroundTruth
from trajeval_ros.likelihood.absolute import absolute
from trajeval_ros.likelihood.figures import p_value
from trajeval_ros.likelihood.relative import relative
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.settings import settings_of
from trajeval_ros.online.whole_run import Poses, whole_run
from trajeval_ros.online.window import joint_covariance

JOINT = {**FIXED, "likelihood.covariance": "joint"}
RUN = ("stamps", "ground_truth", "covariance", "estimate", "sampled")


def results(parameters, run):
    """An engine that has seen all, what it evaluated, and the covariances with the poses before."""
    engine = Engine(parameters)
    engine.add_ground_truth(run.ground_truth)
    engine.add_estimate(run.estimate)
    parts = [engine.advance(), engine.finish()]
    parts = [part for part in parts if len(part.evaluations)]
    found = {
        name: np.concatenate([getattr(part.evaluations, name) for part in parts])
        for name in (*RUN, "log_likelihood", "chi2")
    }
    return engine, found, sum((part.cross for part in parts), ())


@pytest.fixture(scope="module")
def scene():
    run = simulated(3, 14.0, rates=(20.0, 10.0))
    return run, *results({**JOINT, "window.duration": 1000.0}, run)


def test_the_figures_are_those_of_the_dense_covariance(scene):
    _, engine, found, cross = scene
    summary = engine.summary()
    poses = (found["ground_truth"], found["covariance"], found["estimate"])
    v = joint_twin.from_rows(found["covariance"], cross)
    rows = likelihood_twin.block_rows(v, max(len(c) for c in cross))
    chi2, log_det = likelihood_twin.relative(poses[0], rows, poses[2])
    assert summary["relative"]["chi2"] == pytest.approx(chi2, rel=1e-6)
    assert summary["relative"]["log_det"] == pytest.approx(log_det, rel=1e-9)
    # The run is the window, here.
    for name in ("chi2", "log_det", "dof"):
        in_window = summary["window"]["relative"][name]
        assert in_window == pytest.approx(summary["relative"][name], rel=1e-9)
    best = absolute(poses[0], rows, poses[2])
    assert summary["window"]["absolute"]["chi2"] == pytest.approx(best.likelihood.chi2, rel=1e-7)
    assert summary["absolute"]["consistency"] < 1e-9
    assert summary["absolute"]["log_likelihood"] == pytest.approx(
        best.likelihood.log_likelihood, rel=0.02
    )
    shares = found["log_likelihood"]
    assert shares.sum() == pytest.approx(summary["relative"]["log_likelihood"], rel=1e-12)
    assert found["chi2"].sum() == pytest.approx(summary["relative"]["chi2"], rel=1e-12)
    run = Poses(*(found[name] for name in RUN), cross=tuple(cross))
    whole = whole_run(summary, run, settings_of(complete({})).evaluation)
    assert whole["absolute"]["log_likelihood_nonlinear"] == pytest.approx(
        best.likelihood.log_likelihood, rel=1e-9
    )


def test_it_is_another_figure_than_the_independent_one(scene):
    run, engine, *_ = scene
    independent, _ = handed_over({**FIXED, "window.duration": 1000.0}, run)
    mine, other = engine.figures()["relative"], independent.figures()["relative"]
    assert abs(mine["log_likelihood"] - other["log_likelihood"]) > 0.005 * abs(
        other["log_likelihood"]
    )
    assert mine["dof"] == other["dof"]
    # The correlated steps of the ground truth are known better than independent ones.
    assert mine["log_det"] < other["log_det"]


def test_the_window_is_a_window_of_the_joint_covariance():
    run = simulated(4, 20.0, rates=(20.0, 10.0))
    engine, found, cross = results({**JOINT, "window.duration": 5.0}, run)
    window = engine.summary()["window"]
    first = len(found["covariance"]) - window["poses"]
    assert window["poses"] == pytest.approx(51, abs=1)
    v = joint_twin.from_rows(found["covariance"], cross)[6 * first :, 6 * first :]
    rows = likelihood_twin.block_rows(v, window["poses"] - 1)
    chi2, log_det = likelihood_twin.relative(
        found["ground_truth"][first:], rows, found["estimate"][first:]
    )
    assert window["relative"]["chi2"] == pytest.approx(chi2, rel=1e-6)
    assert window["relative"]["log_det"] == pytest.approx(log_det, rel=1e-9)


@pytest.mark.parametrize("rates", [(50.0, 10.0), (2.0, 20.0)])
def test_the_order_of_arrival_does_not_matter(rates):
    run = simulated(5, 16.0, rates=rates)
    expected, _ = handed_over(JOINT, run)
    rng = np.random.default_rng(0)
    for period, delays in ((0.05, (0, 0)), (0.9, (SECOND // 3, 0)), (0.3, (0, SECOND // 2))):
        engine, _ = played(
            JOINT,
            run,
            period=period,
            delays=delays,
            cuts=lambda n: np.sort(rng.integers(0, n + 1, 2)),
            order=lambda n: n % 2,
        )
        assert_same_summary(engine.summary(), expected.summary())


def test_the_estimates_own_covariance_adds_to_each_pose(scene):
    run, _, found, cross = scene
    own = np.diag(np.repeat([0.02, 0.01], 3) ** 2)
    estimate = dataclasses.replace(
        run.estimate, covariances=np.tile(own, (len(run.estimate), 1, 1))
    )

    parameters = {**JOINT, "estimate.use_covariance": True}
    engine, added, same = results(parameters, Run(run.ground_truth, estimate))
    # A multiple of the identity for each group is the same about any axes.
    np.testing.assert_allclose(added["covariance"], found["covariance"] + own, atol=1e-15)
    for actual, expected in zip(same, cross, strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-18)
    covariance = joint_covariance(added["covariance"], same)
    likelihood = relative(added["ground_truth"], covariance, added["estimate"])
    assert engine.figures()["relative"]["chi2"] == pytest.approx(likelihood.chi2, rel=1e-9)


def test_a_ground_truth_with_covariances(scene):
    run, *_ = scene
    own = np.diag(np.repeat([0.003, 0.004], 3) ** 2)
    truth = dataclasses.replace(
        run.ground_truth, covariances=np.tile(own, (len(run.ground_truth), 1, 1))
    )
    parameters = {**JOINT, "ground_truth.use_covariance": True}
    engine, found, cross = results(parameters, Run(truth, run.estimate))
    assert engine.figures()["absolute"]["consistency"] < 1e-9
    assert np.linalg.eigvalsh(joint_twin.from_rows(found["covariance"], cross))[0] > 0.0


@pytest.mark.parametrize("chunk", [SECOND, 100 * SECOND])
def test_several_poses_of_a_batch_that_the_covariance_does_not_go_on_with(monkeypatch, chunk):
    run = simulated(3, 14.0, rates=(20.0, 10.0))
    wrong = run.estimate.stamps[[20, 40, 41, 90]]
    kept = ~np.isin(run.estimate.stamps, wrong)
    expected = Engine(JOINT)
    list(feed(expected, run.ground_truth, where(run.estimate, kept)))
    posterior = GroundTruth.posterior

    def overrelated(self, stamps, until, joint, twists):
        """Says of some poses that they are related more closely than any can be."""
        answer = posterior(self, stamps, until, joint, twists)
        factors = np.where(np.isin(stamps, wrong), 1e3, 1.0)
        cross = tuple(f * c for f, c in zip(factors, answer.cross, strict=True))
        return dataclasses.replace(answer, cross=cross)

    monkeypatch.setattr(GroundTruth, "posterior", overrelated)
    engine = Engine(JOINT)
    list(feed(engine, run.ground_truth, run.estimate, chunk))
    assert balance(engine).rejected == {"singular_covariance": len(wrong)}
    mine, theirs = engine.summary(), expected.summary()
    assert_same_summary({**mine, "estimate": {}}, {**theirs, "estimate": {}})


# Calibration


def sparse_scene():
    """Ground truth at 1 Hz of a small motion, and when a 20 Hz estimate is asked for."""
    rng = np.random.default_rng(8)
    stamps = 10**18 + SECOND * np.arange(16)
    path = se3.exp(0.05 * np.cumsum(rng.normal(size=(16, 6)), axis=0) * np.repeat([1, 0.3], 3))
    asked = 10**18 + SECOND + (SECOND // 20) * np.arange(200)
    parameters = {
        **FIXED,
        "gp.translation.signal_std": 0.1,
        "gp.translation.length_scale": 2.0,
        "gp.translation.noise_std": 1e-4,
        "gp.rotation.signal_std": 0.03,
        "gp.rotation.length_scale": 2.0,
        "gp.rotation.noise_std": 1e-4,
        "ground_truth.translation_std": 1e-5,
        "ground_truth.rotation_std": 1e-5,
        "ground_truth.max_gap": 2.0,
    }
    return parameters, samples(stamps, path), asked


def test_estimates_drawn_from_the_joint_posterior():
    parameters, truth, asked = sparse_scene()
    parameters["likelihood.covariance"] = "joint"
    still = samples(asked, np.tile(np.eye(4), (len(asked), 1, 1)))
    _, found, cross = results(parameters, Run(truth, still))
    v = joint_twin.from_rows(found["covariance"], cross)
    root = np.linalg.cholesky(v)
    rng = np.random.default_rng(2)
    covariances = {
        "joint": joint_covariance(found["covariance"], cross),
        "independent": found["covariance"],
    }
    chi2 = {name: [] for name in covariances}
    p_values = {name: [] for name in covariances}
    poses = found["ground_truth"]
    for _ in range(80):
        error = (root @ rng.normal(size=len(root))).reshape(-1, 6)
        estimate = poses @ se3.exp(error)
        for name, covariance in covariances.items():
            best = absolute(poses, covariance, estimate).likelihood
            chi2[name].append(best.chi2 / best.dof)
            p_values[name].append(p_value(best.chi2, best.dof))
    expected = np.sqrt(2.0 / (6 * len(poses) - 6))
    assert np.mean(chi2["joint"]) == pytest.approx(1.0, abs=4 * expected / np.sqrt(80))
    assert np.std(chi2["joint"]) == pytest.approx(expected, rel=0.35)
    assert kstest(p_values["joint"], "uniform").pvalue > 1e-3
    # The same estimates by the paper's covariance: right on average, wrong in spread.
    assert np.mean(chi2["independent"]) == pytest.approx(1.0, abs=0.1)
    assert np.std(chi2["independent"]) > 3.0 * expected
    assert kstest(p_values["independent"], "uniform").pvalue < 1e-10


def test_the_engine_s_own_figure_of_such_an_estimate():
    parameters, truth, asked = sparse_scene()
    still = samples(asked, np.tile(np.eye(4), (len(asked), 1, 1)))
    joint = {**parameters, "likelihood.covariance": "joint", "window.duration": 100.0}
    _, found, cross = results(joint, Run(truth, still))
    v = joint_twin.from_rows(found["covariance"], cross)
    rng = np.random.default_rng(3)
    error = (np.linalg.cholesky(v) @ rng.normal(size=len(v))).reshape(-1, 6)
    world = se3.exp(rng.normal(size=6))
    estimate = samples(asked, world @ found["ground_truth"] @ se3.exp(error))

    engine, _ = handed_over(joint, Run(truth, estimate))
    summary = engine.summary()
    deviation = np.sqrt(2.0 / summary["relative"]["dof"])
    for figure in (summary["relative"], summary["absolute"], summary["window"]["absolute"]):
        assert figure["chi2_per_dof"] == pytest.approx(1.0, abs=4 * deviation)
