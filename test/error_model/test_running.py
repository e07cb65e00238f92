# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of a window and of blocks: the same however poses come, in bounded memory; clock changes."""

from dataclasses import replace

import numpy as np
import pytest
from error_model.test_fit import DRIFT, ask, estimate

from trajeval_ros import loops
from trajeval_ros.error_model.blocks import NO_BLOCKS
from trajeval_ros.error_model.changes import Stretch, clock_changes, joined
from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.nuisances import Nuisances
from trajeval_ros.error_model.process import Kind
from trajeval_ros.error_model.recorded import Recorded
from trajeval_ros.error_model.running import Due, Poses, RunningErrorModel, fit_poses

SECOND = 1_000_000_000
OFFSET = Nuisances(0.02, 0.0, np.eye(4), 1.0)


def poses(stamps, found):
    truth = ask(stamps)
    return Poses(Recorded(stamps, truth.poses, truth.covariances, truth.twists), found, stamps)


def running(whole, pieces, window=10 * SECOND):
    model = RunningErrorModel(window)
    begin = 0
    for end in [*pieces, len(whole)]:
        model.add(whole[begin:end])
        begin = end
        while fitted(model, model.block_due()):
            pass
    fitted(model, model.window_due())
    return model


def fitted(model, due):
    if due is not None:
        model.take(due, due.fit())
    return due is not None


def test_between_records_the_answer_is_that_of_the_motion():
    stamps = np.arange(0, 10 * SECOND, SECOND // 20)
    record = poses(stamps, np.tile(np.eye(4), (200, 1, 1))).truth
    asked = stamps[:-1] + 17_000_000
    found, expected = record.at(asked), ask(asked)
    assert found.valid.all()
    np.testing.assert_allclose(found.poses, expected.poses, atol=2e-5)
    exact = record.at(stamps)
    assert exact.valid.all()
    np.testing.assert_allclose(exact.poses, record.poses, atol=1e-12)
    assert not record.at(stamps[[0]] - 1).valid.any()
    assert not record.at(stamps[[-1]] + 1).valid.any()


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@pytest.mark.parametrize("near", [0.0, 0.05])
@pytest.mark.parametrize("count", [1, 2, 90])
def test_answers_by_records_are_those_of_numpy_alone(near, count):
    rng = np.random.default_rng(3)
    stamps = np.cumsum(rng.choice([SECOND // 50, SECOND // 5], count, p=[0.8, 0.2]))
    record = poses(stamps, np.tile(np.eye(4), (count, 1, 1))).truth
    covariances = rng.normal(size=(count, 6, 6))
    record = record._replace(covariances=covariances @ covariances.swapaxes(1, 2))
    asked = np.sort(rng.integers(stamps[0] - SECOND, stamps[-1] + SECOND, 400))
    asked = np.sort(np.concatenate([asked, stamps[::3]]))
    found = record.at(asked, near)
    with loops.left_out():
        expected = record.at(asked, near)
    np.testing.assert_array_equal(found.valid, expected.valid)
    assert found.valid.any()
    assert not found.valid.all()
    for name in ("poses", "covariances", "twists"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)


def test_a_fit_by_records_is_that_with_the_ground_truth_asked_anew():
    stamps, found = estimate(Kind.DRIFT, DRIFT, OFFSET)
    by_record, anew = fit_poses(poses(stamps, found)), fit(stamps, found, ask)
    off = by_record.nuisances.vector - anew.nuisances.vector
    assert (np.abs(off) < 0.3 * anew.std).all()


def test_a_block_is_fitted_as_a_window_without_the_clocks_of_its_parts():
    stretch = poses(*estimate(Kind.DRIFT, DRIFT, OFFSET, count=600))
    window, block = Due(stretch).fit().model, Due(stretch, NO_BLOCKS).fit().model
    assert len(window.clock_by_group) == 2
    assert len(window.clock_stretches) > 2
    assert (block.clock_by_group, block.clock_stretches, block.clock_changes) == ((), (), ())
    np.testing.assert_allclose(block.nuisances.vector, window.nuisances.vector, rtol=1e-9)
    np.testing.assert_allclose(block.covariance, window.covariance, rtol=1e-9)
    assert block.log_likelihood == pytest.approx(window.log_likelihood, rel=1e-9)


def test_how_poses_are_cut_into_batches_changes_nothing():
    whole = poses(*estimate(Kind.DRIFT, DRIFT, OFFSET, count=900))
    one, other = running(whole, []), running(whole, [1, 7, 399, 400, 402, 750])
    for first, second in ((one.window, other.window), (one.run, other.run)):
        np.testing.assert_allclose(
            first.nuisances.vector, second.nuisances.vector, rtol=1e-9, atol=1e-12
        )
        assert first.log_likelihood == pytest.approx(second.log_likelihood, rel=1e-9)
    # Of the 201 poses of ten seconds, the last lies beyond what is recorded, by the offset.
    assert one.window.poses == 200


def test_neither_where_the_ground_truth_is_rare():
    stamps, found = estimate(Kind.DRIFT, DRIFT, OFFSET, count=2400)
    whole = poses(stamps, found)
    samples = np.arange(0, int(stamps[-1]) + SECOND, SECOND // 2)
    nearest = samples[np.abs(stamps[:, None] - samples).argmin(axis=1)]
    whole = replace(whole, nearest=nearest)
    one, other = running(whole, []), running(whole, [1, 7, 399, 400, 402, 1750])
    # Of each half second, two poses count towards a block.
    assert one.blocks == other.blocks == 2
    assert one.run.poses == other.run.poses
    assert 190 < one.run.poses < 205
    np.testing.assert_allclose(
        one.run.nuisances.vector, other.run.nuisances.vector, rtol=1e-9, atol=1e-12
    )
    assert abs(one.run.nuisances.clock_offset - 0.02) < 4.0 * one.run.std[0]


def test_blocks_together_say_what_the_whole_says():
    stamps, found = estimate(Kind.DRIFT, DRIFT, OFFSET, count=1700)
    run = running(poses(stamps, found), [800]).run
    assert run.poses == 1600
    whole = fit(stamps, found, ask)
    assert abs(run.nuisances.clock_offset - 0.02) < 4.0 * run.std[0]
    assert 0.8 * whole.std[0] < run.std[0] < 3.0 * whole.std[0]
    drift = run.groups["translation"]["drift_std"]
    assert abs(drift.value - 1e-2) < 4.0 * drift.std


def test_the_run_asked_for_at_the_end_is_the_one_told_block_by_block():
    whole = poses(*estimate(Kind.DRIFT, DRIFT, OFFSET, count=1300))
    told, asked = RunningErrorModel(10 * SECOND), RunningErrorModel(10 * SECOND)
    for model, with_run in ((told, True), (asked, False)):
        model.add(whole)
        while (due := model.block_due()) is not None:
            model.take(due, due.fit(with_run=with_run))
    assert told.blocks == asked.blocks == 3
    np.testing.assert_allclose(
        told.run.nuisances.vector, asked.run.nuisances.vector, rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(told.run.covariance, asked.run.covariance, rtol=1e-9)


def test_blocks_that_wait_too_long_are_lost_and_counted():
    whole = poses(*estimate(Kind.DRIFT, DRIFT, count=2500))
    model = RunningErrorModel(10 * SECOND)
    model.add(whole)
    assert model.lost == 3
    assert model.run is None


def test_a_clock_that_jumps_is_said_with_its_time():
    stamps, found = estimate(Kind.DRIFT, DRIFT, OFFSET, count=1600)
    late = stamps.copy()
    late[800:] -= 12_000_000
    (change,) = fit(late, found, ask).clock_changes
    assert abs(0.5 * (change.begin + change.end) - late[800]) < 6 * SECOND
    assert abs(change.after - change.before - 0.012) < 4.0 * change.std
    assert fit(stamps, found, ask).clock_changes == ()


def stretches(offsets, std=1e-3):
    return [Stretch(i * SECOND, (i + 1) * SECOND - 1, o, std) for i, o in enumerate(offsets)]


def test_no_stretches_have_no_changes():
    assert clock_changes([]) == ()


def test_stretches_are_joined_by_weight():
    rng = np.random.default_rng(2)
    parts = [
        Stretch(i * SECOND, (i + 1) * SECOND - 1, o, s)
        for i, (o, s) in enumerate(zip(rng.normal(size=47), rng.uniform(0.5, 2.0, 47), strict=True))
    ]
    found = joined([*parts[:5], Stretch(5 * SECOND, 5 * SECOND, 9.0, np.inf), *parts[5:]], 20)
    assert len(found) == 16
    assert (found[0].begin, found[-1].end) == (parts[0].begin, parts[-1].end)
    weight = np.array([part.std**-2 for part in parts[:3]])
    assert found[0].offset == pytest.approx(weight @ [p.offset for p in parts[:3]] / weight.sum())
    assert found[0].std == pytest.approx(weight.sum() ** -0.5)
    # However they are joined, all together say the same.
    (whole,) = joined(found, 1)
    assert whole.offset == pytest.approx(joined(parts, 1)[0].offset)
    assert [each.offset for each in joined(parts, 47)] == pytest.approx([p.offset for p in parts])
    assert joined([], 20) == ()


def test_a_steady_rate_and_noise_are_no_changes():
    rng = np.random.default_rng(0)
    for _ in range(200):
        noise = rng.normal(size=30) * 1e-3
        assert clock_changes(stretches(noise)) == ()
        assert clock_changes(stretches(noise + 1e-3 * np.arange(30))) == ()


def test_an_offset_that_changes_smoothly_has_no_step():
    rng = np.random.default_rng(4)
    slow = 3e-3 * np.cos(np.linspace(0.0, 2.5, 14))
    for _ in range(50):
        assert clock_changes(stretches(slow + rng.normal(size=14) * 5e-4, 5e-4)) == ()


@pytest.mark.parametrize("count", [8, 14, 40])
def test_a_step_is_told_from_what_is_smooth(count):
    rng = np.random.default_rng(5)
    step = np.where(np.arange(count) < count // 2, 0.0, 8e-3)
    found = [
        clock_changes(stretches(step + rng.normal(size=count) * 5e-4, 5e-4)) for _ in range(50)
    ]
    places = [[change.begin for change in each] for each in found]
    assert places.count([count // 2 * SECOND - 1]) >= 49


def test_two_changes_are_found_where_they_are():
    rng = np.random.default_rng(1)
    level = np.repeat([0.0, 0.05, -0.01], [10, 7, 9])
    first, second = clock_changes(stretches(level + rng.normal(size=26) * 1e-3))
    assert (first.begin, second.begin) == (10 * SECOND - 1, 17 * SECOND - 1)
    assert (first.before, first.after) == pytest.approx((0.0, 0.05), abs=2e-3)
    assert (second.before, second.after) == pytest.approx((0.05, -0.01), abs=2e-3)


@pytest.mark.parametrize("count", [5, 20, 60])
def test_stretches_that_only_scatter_have_no_change(count):
    rng = np.random.default_rng(3)
    alarms = 0
    for _ in range(1000):
        std = 0.01 * np.exp(0.5 * rng.normal(size=count))
        offsets = 1.5 * std * rng.normal(size=count)
        begins = 5 * SECOND * np.arange(count)
        known = zip(begins.tolist(), offsets.tolist(), std.tolist(), strict=True)
        alarms += bool(clock_changes([Stretch(b, b + 5 * SECOND, o, s) for b, o, s in known]))
    assert alarms <= 3
