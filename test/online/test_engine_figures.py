# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures: calibration, the standing self-check, invariances, and what options do to them."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import likelihood_twin as twin
from twins.runs import (
    FIXED,
    SECOND,
    Run,
    assert_same_summary,
    balance,
    handed_over,
    joined,
    leaves,
    motion,
    nanoseconds,
    play,
    played,
    poses_of,
    samples,
    simulated,
)

from trajeval_ros import se3
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.settings import settings_of
from trajeval_ros.online.whole_run import Poses, whole_run


@functools.cache
def scenario(seed=41, **parameters):
    run = simulated(seed, 10.0, dropouts=((4.0, 5.5),))
    engine, evaluations = handed_over({**FIXED, **parameters}, run)
    return run, engine, engine.summary(), evaluations


def perfect(evaluations, rng, world, factor=1.0):
    """Estimates that differ from the ground truth by a factor of its own posterior noise."""
    lower = np.linalg.cholesky(evaluations["covariance"])
    noise = factor * (lower @ rng.normal(size=(len(lower), 6, 1)))[..., 0]
    return samples(evaluations["stamps"], world @ evaluations["ground_truth"] @ se3.exp(noise))


def scores(parameters, run, evaluations, count=12, factor=1.0):
    """chi2 and dof, summed over perfect estimates: relative, absolute, absolute of the window."""
    rng = np.random.default_rng(43)
    sums = np.zeros((3, 2))
    for _ in range(count):
        world = np.eye(4) if parameters["gauge"] == "none" else se3.exp(rng.normal(size=6))
        if parameters["gauge"] == "yaw_translation":
            world[:3, :3] = se3.exp_so3(np.array([0.0, 0.0, rng.normal()]))
        estimate = perfect(evaluations, rng, world, factor)
        engine, found = handed_over(parameters, Run(run.ground_truth, estimate))
        assert len(found["stamps"]) == len(evaluations["stamps"])
        summary = engine.summary()
        parts = (summary["relative"], summary["absolute"], summary["window"]["absolute"])
        sums += [[part["chi2"], part["dof"]] for part in parts]
    return sums


@pytest.mark.parametrize(("gauge", "size"), [("se3", 6), ("yaw_translation", 4), ("none", 0)])
def test_a_perfect_estimate_scores_one(gauge, size):
    run = simulated(42, 20.0, dropouts=((8.0, 8.3), (15.0, 15.2)))
    parameters = {**FIXED, "gauge": gauge}
    _, evaluations = handed_over(parameters, run)
    sums, poses = scores(parameters, run, evaluations), len(evaluations["stamps"])
    assert poses > 195
    assert sums[:, 1].tolist() == [12 * 6 * (poses - 1), *[12 * (6 * poses - size)] * 2]
    for chi2, dof in sums:
        # Four standard deviations of a mean of so many squares, and what is of second order.
        assert chi2 / dof == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / dof) + 1e-3)


def test_twice_the_noise_scores_four():
    run = simulated(42, 10.0)
    parameters = {**FIXED, "gauge": "se3"}
    _, evaluations = handed_over(parameters, run)
    sums = scores(parameters, run, evaluations, count=4, factor=2.0)
    np.testing.assert_allclose(sums[:, 0] / sums[:, 1], 4.0, rtol=0.1)


def test_in_a_long_gap_the_absolute_figures_still_score_one():
    # The posterior is so wide there that the relative figure, which is of first order, fails; the
    # absolute ones use exact residuals.
    run = simulated(42, 20.0, dropouts=((8.0, 9.7),))
    parameters = {**FIXED, "gauge": "se3"}
    _, evaluations = handed_over(parameters, run)
    assert np.sqrt(evaluations["covariance"][:, 0, 0]).max() > 0.1
    (relative, _), *absolute = scores(parameters, run, evaluations)
    for chi2, dof in absolute:
        assert chi2 / dof == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / dof) + 2e-3)
    assert relative > 0


@given(seed=st.integers(0, 10_000), error=st.sampled_from([1e-3, 0.05, 1.0]))
@settings(max_examples=8)
def test_first_order_absolute_equals_relative(seed, error):
    engine, _ = handed_over(FIXED, simulated(seed, 6.0, dropouts=((2.0, 3.3),), error=error))
    summary = engine.summary()
    relative = summary["relative"]["log_likelihood"]
    assert summary["absolute"]["log_likelihood_first_order"] == pytest.approx(relative, rel=1e-9)
    window = summary["window"]
    assert window["absolute"]["log_likelihood_first_order"] == pytest.approx(
        window["relative"]["log_likelihood"], rel=1e-9
    )
    assert engine.health().consistency < 1e-9


def test_the_figures_are_those_of_dense_matrices():
    _, _, summary, evaluations = scenario()
    data = [evaluations[name][:60] for name in ("ground_truth", "covariance", "estimate")]
    chi2, log_det = twin.relative(*data)
    np.testing.assert_allclose(evaluations["chi2"][:60].sum(), chi2, rtol=1e-9)
    np.testing.assert_allclose(evaluations["log_det"][:60].sum(), log_det, rtol=1e-9)
    errors = twin.relative_errors(*(evaluations[n] for n in ("ground_truth", "estimate")))
    np.testing.assert_allclose(evaluations["relative_error"][1:], errors, rtol=0, atol=1e-12)
    assert np.isnan(evaluations["relative_error"][0]).all()
    np.testing.assert_allclose(
        summary["relative"]["translation_rmse"],
        np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean()),
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        summary["relative"]["rotation_rmse"],
        np.sqrt((errors[:, 3:] ** 2).sum(axis=1).mean()),
        rtol=1e-9,
    )


def test_the_parts_add_up():
    _, _, summary, evaluations = scenario()
    figures = [summary["relative"], summary["absolute"]]
    figures += [summary["window"]["relative"], summary["window"]["absolute"]]
    for part in figures:
        total = -0.5 * (part["chi2"] + part["log_det"] + part["dof"] * np.log(2 * np.pi))
        assert part["log_likelihood"] == pytest.approx(total, rel=1e-12)
        assert part["chi2_per_dof"] == pytest.approx(part["chi2"] / part["dof"])
        assert part["error_in_ground_truth_std"] == pytest.approx(np.sqrt(part["chi2_per_dof"]))
    relative = summary["relative"]
    assert evaluations["log_likelihood"].sum() == pytest.approx(relative["log_likelihood"])
    assert evaluations["relative_log_likelihood"][-1] == pytest.approx(relative["log_likelihood"])
    np.testing.assert_allclose(
        evaluations["relative_log_likelihood"], np.cumsum(evaluations["log_likelihood"]), rtol=1e-9
    )
    assert evaluations["chi2"].sum() == pytest.approx(relative["chi2"])
    assert evaluations["log_det"].sum() == pytest.approx(relative["log_det"])
    assert evaluations["chi2"][0] == evaluations["log_likelihood"][0] == 0.0
    conventional = summary["conventional"]
    distributions = conventional["distributions"]
    assert distributions["sampled_poses"] == conventional["poses"]
    for name in ("ate_translation", "ate_rotation", "re_translation", "re_rotation"):
        found = distributions[name]
        assert found["min"] < found["median"] < found["max"]
        square = found["mean"] ** 2 + found["std"] ** 2
        assert conventional[f"{name}_rmse"] == pytest.approx(np.sqrt(square))


def test_the_summary_is_plain_and_finite():
    for parameters in ({}, FIXED):
        for run in (simulated(1, 3.0), simulated(1, 0.5), simulated(1, 0.09)):
            for value in leaves(handed_over(parameters, run)[0].summary()).values():
                _assert_plain(value)
    for value in leaves(Engine({}).summary()).values():
        _assert_plain(value)


def _assert_plain(value):
    if isinstance(value, list):
        for item in value:
            _assert_plain(item)
        return
    assert value is None or type(value) in (int, float, str, bool, dict)
    assert not isinstance(value, float) or np.isfinite(value)


@given(seed=st.integers(0, 2**32 - 1), gauge=st.sampled_from(["se3", "sim3"]))
@settings(max_examples=8)
def test_the_estimate_s_world_does_not_matter(seed, gauge):
    run, _, expected, evaluations = scenario(gauge=gauge)
    rng = np.random.default_rng(seed)
    world = se3.exp(rng.normal(size=6) * np.repeat([10.0, 1.0], 3))
    moved = world @ poses_of(run.estimate)
    engine, found = handed_over(
        {**FIXED, "gauge": gauge}, Run(run.ground_truth, samples(run.estimate.stamps, moved))
    )
    for name in ("chi2", "log_det", "relative_error"):
        size = np.nanmax(np.abs(evaluations[name]))
        np.testing.assert_allclose(found[name], evaluations[name], rtol=0, atol=1e-9 * size)
    summary = engine.summary()
    # Of the errors, not of the alignment, which takes the world back.
    for part in ("relative", "conventional"):
        same, others = ({**each[part], "alignment": None} for each in (summary, expected))
        assert_same_summary(same, others, 1e-9)
    for part in ("chi2", "log_likelihood", "translation_rmse", "rotation_rmse"):
        assert summary["absolute"][part] == pytest.approx(expected["absolute"][part], rel=1e-6)
    # The window's is the optimum itself: the same from wherever one starts.
    for part in ("chi2", "log_likelihood"):
        actual = summary["window"]["absolute"][part]
        assert actual == pytest.approx(expected["window"]["absolute"][part], rel=1e-7)


def test_yaw_and_translation_of_the_world_do_not_matter_to_yaw_translation_but_tilt_does():
    run, _, expected, _ = scenario(gauge="yaw_translation")
    figures = []
    for turn in ([0.0, 0.0, 1.0], [0.1, 0.0, 0.0]):
        world = se3.exp(np.array([1.0, 2.0, 3.0, *turn]))
        moved = samples(run.estimate.stamps, world @ poses_of(run.estimate))
        engine, _ = handed_over({**FIXED, "gauge": "yaw_translation"}, Run(run.ground_truth, moved))
        figures.append(engine.summary()["window"]["absolute"]["chi2"])
    # The scenario's own world is tilted, so a yaw applied to the left of it leaves it as it is.
    assert figures[0] == pytest.approx(expected["window"]["absolute"]["chi2"], rel=1e-7)
    assert figures[1] != pytest.approx(expected["window"]["absolute"]["chi2"], rel=1e-2)


@pytest.mark.parametrize("offset", [-0.7, 0.25, 1e4])
def test_the_time_offset_is_added_to_the_estimate_s_stamps(offset):
    run, _, expected, evaluations = scenario()
    early = PoseSamples(
        run.estimate.stamps - round(offset * SECOND),
        run.estimate.positions,
        run.estimate.quaternions,
    )
    parameters = {**FIXED, "estimate.time_offset": offset}
    engine, found = handed_over(parameters, Run(run.ground_truth, early))
    assert_same_summary(engine.summary(), expected)
    # An evaluation carries the estimate's own stamp.
    assert np.array_equal(found["stamps"], evaluations["stamps"] - round(offset * SECOND))


def test_the_time_offset_live():
    run, _, expected, _ = scenario()
    early = PoseSamples(
        run.estimate.stamps - SECOND // 4, run.estimate.positions, run.estimate.quaternions
    )
    parameters = {**FIXED, "estimate.time_offset": 0.25}
    engine, _ = played(parameters, Run(run.ground_truth, early), delays=(0, SECOND // 4))
    assert_same_summary(engine.summary(), expected)


EXTRINSIC = np.array([0.1, -0.2, 0.05, *(np.array([0.1, 0.7, -0.3, 0.5]) / np.sqrt(0.84))])


def test_the_extrinsic_brings_the_estimate_into_the_ground_truth_s_body():
    run, _, expected, evaluations = scenario()
    body_camera = se3.from_position_quaternion(EXTRINSIC[:3], EXTRINSIC[3:])
    camera = samples(run.estimate.stamps, poses_of(run.estimate) @ body_camera)
    parameters = {**FIXED, "extrinsic": EXTRINSIC.tolist()}
    engine, found = handed_over(parameters, Run(run.ground_truth, camera))
    np.testing.assert_allclose(found["estimate"], evaluations["estimate"], rtol=0, atol=1e-13)
    for part in ("relative", "conventional"):
        assert_same_summary(engine.summary()[part], expected[part], 1e-9)
    window, other = engine.summary()["window"]["absolute"], expected["window"]["absolute"]
    assert window["log_likelihood"] == pytest.approx(other["log_likelihood"], rel=1e-7)
    # Without it, the figures are another matter.
    engine, _ = handed_over(FIXED, Run(run.ground_truth, camera))
    assert engine.summary()["relative"]["chi2"] > 2 * expected["relative"]["chi2"]


def fixed_axes(covariance, poses):
    """ROS's covariances of right perturbations, about the fixed axes of the parent frame."""
    turn = np.zeros((len(poses), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = poses[:, :3, :3]
    return turn @ covariance @ turn.swapaxes(1, 2)


def random_covariances(rng, count, size):
    factor = size * rng.normal(size=(count, 6, 6))
    return factor @ factor.swapaxes(1, 2)


@pytest.mark.parametrize("extrinsic", [None, EXTRINSIC], ids=["same body", "extrinsic"])
def test_the_estimate_s_covariance_is_added(extrinsic):
    run, _, _, evaluations = scenario()
    rng = np.random.default_rng(5)
    covariance = random_covariances(rng, len(run.estimate), 0.01)
    parameters = {**FIXED, "estimate.use_covariance": True}
    poses, transform = poses_of(run.estimate), np.eye(4)
    if extrinsic is not None:
        parameters["extrinsic"] = extrinsic.tolist()
        transform = se3.from_position_quaternion(extrinsic[:3], extrinsic[3:])
    adjoint = se3.adjoint(se3.inverse(transform))
    own = adjoint @ covariance @ adjoint.T
    published = poses @ transform
    topic = samples(run.estimate.stamps, published, fixed_axes(own, published))
    _, found = handed_over(parameters, Run(run.ground_truth, topic))
    used = covariance[np.isin(run.estimate.stamps, found["stamps"])]
    np.testing.assert_allclose(
        found["covariance"], evaluations["covariance"] + used, rtol=0, atol=1e-12
    )
    # And not, where it is not asked for.
    _, found = handed_over(
        {**parameters, "estimate.use_covariance": False}, Run(run.ground_truth, topic)
    )
    np.testing.assert_allclose(found["covariance"], evaluations["covariance"], rtol=0, atol=1e-15)


def test_the_ground_truth_s_covariance_makes_it_less_sure():
    run, _, _, evaluations = scenario()
    poses = poses_of(run.ground_truth)
    loud = np.zeros((len(poses), 6, 6))
    loud[:, :3, :3] = 0.05**2 * np.eye(3)
    parameters = {**FIXED, "ground_truth.use_covariance": True}
    traces = {}
    for name, covariance in (("zero", 0.0 * loud), ("loud", fixed_axes(loud, poses))):
        topic = samples(run.ground_truth.stamps, poses, covariance)
        _, found = handed_over(parameters, Run(topic, run.estimate))
        diagonal = np.diagonal(found["covariance"], axis1=1, axis2=2)
        traces[name] = diagonal[:, :3].sum(axis=1), diagonal[:, 3:].sum(axis=1)
    usual = np.diagonal(evaluations["covariance"], axis1=1, axis2=2)
    # Not the same to round-off: with noise of their own, the coordinates have scales of their own.
    np.testing.assert_allclose(traces["zero"][0], usual[:, :3].sum(axis=1), rtol=0.3)
    quiet = np.arange(len(usual)) < 30  # away from the gap
    assert (traces["loud"][0][quiet] > 20 * traces["zero"][0][quiet]).all()
    np.testing.assert_allclose(traces["loud"][1], traces["zero"][1], rtol=1e-6)


def test_the_window_holds_the_last_poses():
    run, _, summary, evaluations = scenario(**{"window.duration": 3.0})
    end = evaluations["stamps"][-1]
    kept = evaluations["stamps"] >= end - 3 * SECOND
    window = summary["window"]
    assert window["poses"] == np.count_nonzero(kept)
    assert window["duration"] == pytest.approx((end - evaluations["stamps"][kept][0]) / SECOND)
    data = [evaluations[n][kept] for n in ("ground_truth", "covariance", "estimate")]
    chi2, log_det = twin.relative(*data)
    assert window["relative"]["chi2"] == pytest.approx(chi2, rel=1e-8)
    assert window["relative"]["log_det"] == pytest.approx(log_det, rel=1e-8)
    assert len(run.estimate) > np.count_nonzero(kept) + 50


def test_a_window_set_while_it_runs_takes_effect_with_the_next_pose():
    run, _, whole, _ = scenario()
    engine = Engine(FIXED)
    engine.add_ground_truth(run.ground_truth)
    engine.add_estimate(run.estimate[:-1])
    engine.advance()
    assert engine.summary()["window"]["poses"] > 60
    engine.set("window.duration", 2)
    assert engine.parameters["window.duration"] == 2.0
    engine.add_estimate(run.estimate[-1:])
    engine.finish()
    assert 18 <= engine.summary()["window"]["poses"] <= 21
    assert engine.summary()["relative"] == pytest.approx(whole["relative"], rel=1e-12)


def test_the_whole_run_s_nonlinear_figure():
    _, _, summary, evaluations = scenario()
    names = ("stamps", "ground_truth", "covariance", "estimate", "sampled")
    poses = Poses(*(evaluations[name] for name in names))
    whole = whole_run(summary, poses, settings_of(complete({})).evaluation)
    # The window, of thirty seconds, holds this run.
    assert whole["absolute"]["log_likelihood_nonlinear"] == pytest.approx(
        summary["window"]["absolute"]["log_likelihood_nonlinear"], rel=1e-12
    )
    rest = {k: v for k, v in whole["absolute"].items() if k != "log_likelihood_nonlinear"}
    assert rest == summary["absolute"]


def test_a_loop_closure_of_a_hundred_metres():
    run, _, before, _ = scenario()
    jumped = run.estimate.positions.copy()
    jumped[50:] += 100.0
    estimate = PoseSamples(run.estimate.stamps, jumped, run.estimate.quaternions)
    engine, found = handed_over(FIXED, Run(run.ground_truth, estimate))
    summary = engine.summary()
    assert balance(engine).used == before["estimate"]["evaluated"]
    assert engine.health().consistency < 1e-9
    # One step is wrong by it, and the others are what they were.
    size = np.linalg.norm(found["relative_error"][:, :3], axis=1)
    assert np.count_nonzero(size > 10.0) == 1
    assert summary["conventional"]["ate_translation_rmse"] > 10.0


def test_an_estimate_that_starts_again_at_the_origin():
    run, _, _, _ = scenario()
    poses = poses_of(run.estimate)
    poses[50:] = se3.inverse(poses[50]) @ poses[50:]
    engine, _ = handed_over(FIXED, Run(run.ground_truth, samples(run.estimate.stamps, poses)))
    assert engine.summary()["relative"]["chi2_per_dof"] > 10
    assert engine.health().consistency < 1e-9


def test_each_lesson_is_announced_once():
    run = simulated(44, 20.0)
    engine = Engine({})
    notices = []
    for i in range(0, len(run.ground_truth), 100):
        engine.add_ground_truth(run.ground_truth[i : i + 100])
        notices += engine.advance().notices
    engine.add_estimate(run.estimate)
    notices += engine.finish().notices
    assert {n.code for n in notices} == {"hyperparameters_learned"}
    assert {n.level for n in notices} == {"info"}
    texts = [n.text for n in notices]
    assert len(set(texts)) == len(texts) > 1
    assert not any("\n" in text for text in texts)
    assert engine.notices() == (notices[-1],)
    assert engine.health().hyperparameters is not None


def test_what_holds_in_the_end_does_not_depend_on_the_batches():
    run = simulated(44, 35.0)
    found = set()
    for chunk in (SECOND, 10 * SECOND, 100 * SECOND):
        engine = Engine({})
        list(feed(engine, run.ground_truth, run.estimate, chunk))
        found.add(engine.notices())
    assert [notice.code for notice in found.pop()] == ["hyperparameters_learned"]
    assert not found


@pytest.mark.parametrize("covariance", ["independent", "joint"])
def test_asking_for_figures_on_the_way_changes_none(covariance):
    run = simulated(46, 8.0, dropouts=((3.0, 4.2),))
    parameters = {**FIXED, "likelihood.covariance": covariance, "window.duration": 3.0}
    asked, left_alone = Engine(parameters), Engine(parameters)
    for engine in (asked, left_alone):
        for _ in feed(engine, run.ground_truth, run.estimate, SECOND // 20):
            if engine is asked:
                engine.summary()
    assert_same_summary(asked.summary(), left_alone.summary())


@pytest.mark.parametrize("has_clock", [True, False])
def test_where_poses_come_a_few_at_a_time_no_notice_is_lost(has_clock):
    run = simulated(47, 14.0)
    whole, live = Engine({}), Engine({})
    expected = list(feed(whole, run.ground_truth, run.estimate))
    found = []
    topics = ((run.ground_truth, live.add_ground_truth), (run.estimate, live.add_estimate))
    begin, end = run.ground_truth.stamps[[0, -1]].tolist()
    for now in range(begin, end + 1, SECOND // 20):
        for arriving, add in topics:
            first, last = np.searchsorted(arriving.stamps, [now, now + SECOND // 20])
            add(arriving[first:last])
        clock = now + SECOND // 20 if has_clock else None
        found.append(live.advance_all(clock, 500)["estimate"])
    assert any(each.notices for each in found)  # not all at the end
    ended = whole.finish(), live.finish()
    codes = [
        {notice.code for each in (*results, last) for notice in each.notices}
        for results, last in zip((expected, found), ended, strict=True)
    ]
    assert codes[0] == codes[1] == {"hyperparameters_learned"}
    assert live.notices() == whole.notices()


def test_results_carry_the_running_figures():
    run, _, summary, evaluations = scenario()
    engine = Engine(FIXED)
    engine.add_ground_truth(run.ground_truth)
    nothing = engine.advance()
    assert nothing.absolute_log_likelihood is None
    assert nothing.alignment is None
    engine.add_estimate(run.estimate)
    engine.advance()
    result = engine.finish()
    assert result.absolute_log_likelihood == pytest.approx(summary["absolute"]["log_likelihood"])
    pose = se3.to_position_quaternion(result.alignment.pose)
    np.testing.assert_allclose(
        np.concatenate(pose), summary["absolute"]["alignment"]["pose"], atol=1e-12
    )
    aligned = result.alignment.apply(evaluations["estimate"])
    distance = np.linalg.norm(aligned[:, :3, 3] - evaluations["ground_truth"][:, :3, 3], axis=1)
    assert np.sqrt((distance**2).mean()) == pytest.approx(
        summary["absolute"]["translation_rmse"], rel=1e-9
    )


def test_a_run_without_error_is_not_perfect_but_zero():
    times = np.arange(0.0, 6.0, 0.02)
    estimate = np.arange(0.51, 5.5, 0.1)
    run = Run(
        samples(nanoseconds(times), motion(times)), samples(nanoseconds(estimate), motion(estimate))
    )
    engine, _ = handed_over(FIXED, run)
    summary = engine.summary()
    assert summary["relative"]["chi2_per_dof"] < 0.05
    assert summary["conventional"]["ate_translation_rmse"] < 2e-4


def test_live_with_learning_is_deterministic():
    run = simulated(45, 14.0)
    first, _ = played({}, run)
    second, _ = played({}, run)
    assert_same_summary(first.summary(), second.summary())
    engine = Engine({})
    play(engine, run, [run.ground_truth.stamps[-1]])
    engine.reset()
    # What was learned belongs to the run.
    assert engine.health().hyperparameters is None


@pytest.mark.parametrize("first", [True, False])
def test_messages_with_and_without_covariances(first):
    parameters = {**FIXED, "estimate.use_covariance": True, "ground_truth.use_covariance": True}
    run = simulated(3, 5.0)
    engine = Engine(parameters)
    for add, topic in (
        (engine.add_ground_truth, run.ground_truth),
        (engine.add_estimate, run.estimate),
    ):
        half = len(topic) // 2
        full = PoseSamples(
            topic.stamps,
            topic.positions,
            topic.quaternions,
            np.tile(np.eye(6) * 1e-4, (len(topic), 1, 1)),
        )
        a, b = (full, topic) if first else (topic, full)
        add(a[:half])
        add(b[half:])
    found = joined([engine.advance().evaluations, engine.finish().evaluations])
    std = np.sqrt(found["covariance"][:, 0, 0])
    quiet, loud = (std[30:], std[:20]) if first else (std[:20], std[30:])
    assert loud.min() > 0.01 > quiet.max()
    balance(engine)
