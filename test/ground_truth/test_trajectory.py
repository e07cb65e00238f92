# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth as a whole: blending, continuity, what it knows when, and its symmetries."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from twins.ground_truths import (
    GIVEN,
    SHAPE,
    at,
    cut,
    ground_truth,
    patterns,
    regular,
    sampled,
    shapes,
    whole,
)
from twins.runs import SECOND, START, motion

from trajeval_ros import se3
from trajeval_ros.ground_truth.segment import Asked, Samples, answers
from trajeval_ros.ground_truth.segmentation import Segmentation


def queries(samples, count=60, seed=0):
    rng = np.random.default_rng(seed)
    return np.sort(rng.integers(samples.stamps[0], samples.stamps[-1] + 1, count))


def std(posterior):
    return np.sqrt(np.diagonal(posterior.covariances, axis1=1, axis2=2))


def with_gap(begin=4.0, end=8.0, duration=12.0, rate=50.0):
    times = regular(duration, rate)
    return sampled(times[(times <= begin) | (times >= end)])


def assert_equal(actual, expected, rotation=1e-12, covariance=1e-9):
    np.testing.assert_allclose(actual.poses, expected.poses, rtol=0, atol=rotation)
    size = np.abs(expected.covariances).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(
        actual.covariances / size, expected.covariances / size, rtol=0, atol=covariance
    )


# Blending


@given(times=patterns(), shape=shapes)
@settings(max_examples=20)
def test_the_answer_is_the_weighted_one_of_the_segments(times, shape):
    samples = sampled(times)
    truth = ground_truth(samples, shape=shape)
    segmentation = Segmentation(shape)
    list(segmentation.append(samples))
    stamps = queries(samples, 40)
    until = np.full(len(stamps), samples.stamps[-1])
    answer = whole(truth, stamps)
    for i, stamp in enumerate(stamps):
        poses, covariances, weights = [], [], []
        for blended in segmentation:
            weight = blended.weight(stamps[i : i + 1])[0]
            if weight > 0.0:
                blended.segment.begin(truth._process(blended.index))
                blended.segment.advance()
                (epoch,) = blended.segment.epochs
                here = slice(i, i + 1)
                answered = answers([Asked(blended.segment, epoch, stamps[here], until[here])])
                poses.append(answered.poses[0])
                covariances.append(answered.covariances[0])
                weights.append(weight)
        expected = poses[0]
        if len(poses) == 2:
            step = se3.log(np.linalg.solve(poses[0], poses[1]))
            expected = poses[0] @ se3.exp(weights[1] * step)
        np.testing.assert_allclose(answer.poses[i], expected, rtol=0, atol=1e-9)
        expected = sum(w * c for w, c in zip(weights, covariances, strict=True))
        size = np.abs(expected).max()
        np.testing.assert_allclose(answer.covariances[i], expected, rtol=0, atol=1e-6 * size)
        assert stamp >= samples.stamps[0]


@given(times=patterns(), shape=shapes)
@settings(max_examples=20)
def test_mean_and_covariance_have_no_jump(times, shape):
    # Within a microsecond even what is continuous may change as much.
    times = times[np.diff(times, prepend=-1.0) > 1e-3]
    assume(len(times) > 2)
    samples = sampled(times)
    truth = ground_truth(samples, shape=shape)
    # At every sample, which is where anything begins or ends, a nanosecond before and after: what
    # is smooth or has a kink has a second difference of the size of a nanosecond's motion.
    stamps = samples.stamps[1:-1][:200]
    before, here, after = (whole(truth, stamps + d) for d in (-1, 0, 1))
    jump = np.abs(after.poses - 2.0 * here.poses + before.poses)
    speed = np.abs(after.poses - before.poses).max()
    assert jump.max() < 1e-9 + speed
    assert speed < 1e-6
    size = np.abs(here.covariances).max(axis=(1, 2), keepdims=True)
    steps = 1e-9 * (1.0 / (np.diff(times)[:-1] + 1e-9) + 1.0 / (np.diff(times)[1:] + 1e-9))
    for other in (before, after):
        change = np.abs(other.covariances - here.covariances) / size
        # Relative: what the interval's part of a nanosecond allows, and round-off.
        assert (change.max(axis=(1, 2)) < 1e-7 + 20 * steps[:200]).all()


def test_there_is_something_to_jump_between():
    # So that the test above can fail: the segments themselves differ by far more.
    samples = sampled(regular(6.0, 20.0))
    segmentation = Segmentation(SHAPE)
    list(segmentation.append(samples))
    first, second = list(segmentation)[:2]
    stamps = np.array([second.incoming.begin + SECOND // 7])
    process = ground_truth(samples)._process(0)
    asked = []
    for segment in (first.segment, second.segment):
        segment.begin(process)
        segment.advance()
        asked.append(Asked(segment, segment.epochs[0], stamps, samples.stamps[-1:]))
    found = [answers([each]) for each in asked]
    assert np.abs(found[0].poses - found[1].poses).max() > 1e-6
    first, second = (np.trace(answer.covariances[0]) for answer in found)
    assert abs(first / second - 1.0) > 1e-4


# What is known when


@given(times=patterns(), shape=shapes, share=st.floats(0.1, 1.0))
@settings(max_examples=30)
def test_a_truncated_answer_is_that_of_a_ground_truth_of_the_truncated_data(times, shape, share):
    samples = sampled(times)
    known = max(2, round(share * len(samples)))
    stamps = queries(samples[:known], 30)
    until = np.full(len(stamps), samples.stamps[known - 1])
    truncated = ground_truth(samples, shape=shape).posterior(stamps, until)
    fresh = ground_truth(samples[:known], shape=shape).posterior(stamps, until)
    # The samples stop, the arithmetic does not: the same digits but for the layout in memory.
    assert_equal(truncated, fresh, 1e-9, 1e-6)


def test_each_query_has_its_own_truncation():
    samples = with_gap()
    truth = ground_truth(samples)
    stamps = queries(samples, 50)
    after = np.searchsorted(samples.stamps, stamps + 3 * SECOND // 10)
    until = samples.stamps[np.minimum(after, len(samples) - 1)]
    together = truth.posterior(stamps, until)
    for i in range(0, 50, 7):
        alone = ground_truth(samples).posterior(stamps[i : i + 1], until[i : i + 1])
        np.testing.assert_allclose(together.poses[i], alone.poses[0], rtol=0, atol=1e-13)
        np.testing.assert_allclose(
            together.covariances[i], alone.covariances[0], rtol=1e-9, atol=1e-16
        )


@given(times=patterns(), cuts=st.lists(st.integers(0, 300), max_size=8), seed=st.integers(0, 99))
@settings(max_examples=20)
def test_batches_of_samples_and_of_queries_do_not_matter(times, cuts, seed):
    samples = sampled(times)
    stamps = queries(samples, 40, seed)
    at_once = whole(ground_truth(samples), stamps)
    truth = ground_truth()
    for batch in cut(samples, [min(c, len(samples)) for c in cuts]):
        truth.append(batch)
        if len(truth.stamps) > 1:
            # Asking in between leaves no trace.
            whole(truth, truth.stamps[-2:])
    parts = [whole(truth, stamps[a : a + 7]) for a in range(0, 40, 7)]
    poses = np.concatenate([p.poses for p in parts])
    covariances = np.concatenate([p.covariances for p in parts])
    np.testing.assert_allclose(poses, at_once.poses, rtol=0, atol=1e-12)
    size = np.abs(at_once.covariances).max(axis=(1, 2), keepdims=True)
    assert (np.abs(covariances - at_once.covariances) <= 1e-9 * size).all()
    assert np.array_equal(np.concatenate([p.sampled for p in parts]), at_once.sampled)


@given(
    times=patterns(), shape=shapes, moments=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=4)
)
@settings(max_examples=20)
def test_forgetting_changes_no_later_answer(times, shape, moments):
    samples = sampled(times)
    expected, truth = ground_truth(samples, shape=shape), ground_truth(shape=shape)
    begin = int(samples.stamps[0])
    for batch, moment in zip(cut(samples, [len(samples) // 2]), [*moments, 1.0], strict=False):
        truth.append(batch)
        if not len(truth.stamps):
            continue
        begin = max(begin, int(begin + moment * (truth.stamps[-1] - begin)))
        truth.forget(begin)
    assert truth.begin is None or truth.begin <= begin
    if len(truth.stamps) < 2:
        return
    stamps = queries(samples, 40)
    stamps = stamps[(stamps >= begin) & (stamps <= truth.stamps[-1])]
    until = np.full(len(stamps), truth.stamps[-1])
    after, before = truth.posterior(stamps, until), expected.posterior(stamps, until)
    np.testing.assert_allclose(after.poses, before.poses, rtol=0, atol=1e-12)
    np.testing.assert_allclose(after.covariances, before.covariances, rtol=1e-9, atol=1e-15)
    assert np.array_equal(after.sampled, before.sampled)
    assert np.array_equal(after.nearest, before.nearest)
    nearest = samples.stamps[np.abs(stamps[:, None] - samples.stamps).argmin(axis=1)]
    assert np.array_equal(after.nearest, nearest)


def test_forgetting_forgets():
    samples = sampled(regular(60.0, 50.0))
    truth = ground_truth(samples)
    truth.forget(START + 50 * SECOND)
    assert len(truth.stamps) < 0.25 * len(samples)
    assert truth.begin == START + 50 * SECOND
    with pytest.raises(ValueError, match="before the retained"):
        whole(truth, [START + 10 * SECOND])
    # And it does not come back.
    truth.forget(START + 20 * SECOND)
    assert truth.begin == START + 50 * SECOND


# Symmetries


@given(times=patterns(), shift=st.integers(-(10**18), 10**18), kernel=st.sampled_from(range(3)))
@settings(max_examples=20)
def test_a_shift_in_time_changes_nothing(times, shift, kernel):
    kernel = ("matern52", "matern32", "squared_exponential")[kernel]
    samples = sampled(times)
    later = Samples(samples.stamps + shift, samples.poses)
    stamps = queries(samples)
    here = whole(ground_truth(samples, kernel=kernel), stamps)
    there = whole(ground_truth(later, kernel=kernel), stamps + shift)
    # All times are relative to a segment, in whole nanoseconds.
    np.testing.assert_allclose(there.poses, here.poses, rtol=0, atol=1e-13)
    np.testing.assert_allclose(there.covariances, here.covariances, rtol=1e-9, atol=1e-15)


def random_pose(seed, metres=10.0):
    rng = np.random.default_rng(seed)
    return se3.exp(rng.normal(size=6) * np.repeat([metres, 1.0], 3))


@given(times=patterns(), shape=shapes, seed=st.integers(0, 999))
@settings(max_examples=20)
def test_a_change_of_the_world_moves_the_answer_and_leaves_the_covariance(times, shape, seed):
    samples, world = sampled(times), random_pose(seed)
    stamps = queries(samples)
    here = whole(ground_truth(samples, shape=shape), stamps)
    moved = Samples(samples.stamps, world @ samples.poses)
    there = whole(ground_truth(moved, shape=shape), stamps)
    # Round-off of ten metres, times what an extrapolation into minutes makes of it.
    np.testing.assert_allclose(there.poses, world @ here.poses, rtol=0, atol=1e-9)
    size = np.abs(here.covariances).max(axis=(1, 2), keepdims=True)
    assert (np.abs(there.covariances - here.covariances) <= 1e-6 * size).all()


@given(times=patterns(), seed=st.integers(0, 999))
@settings(max_examples=20)
def test_a_turn_of_the_body_turns_the_covariance_by_the_adjoint(times, seed):
    # Exact, as the three axes share their hyperparameters, and the body's origin stays.
    samples, turn = sampled(times), random_pose(seed, 0.0)
    turn[:3, 3] = 0.0
    stamps = queries(samples)
    here = whole(ground_truth(samples), stamps)
    there = whole(ground_truth(Samples(samples.stamps, samples.poses @ turn)), stamps)
    np.testing.assert_allclose(there.poses, here.poses @ turn, rtol=0, atol=1e-9)
    adjoint = se3.adjoint(se3.inverse(turn))
    expected = adjoint @ here.covariances @ adjoint.T
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    assert (np.abs(there.covariances - expected) <= 1e-6 * size).all()


def test_a_lever_arm_moves_the_mean_to_within_its_uncertainty():
    # Not exact: the process is one of the body's origin, and another point of the body moves
    # differently. The orientation does not know of it.
    samples, lever = sampled(regular(10.0, 50.0)), np.eye(4)
    lever[:3, 3] = [0.3, -0.2, 0.1]
    stamps = queries(samples)
    here = whole(ground_truth(samples), stamps)
    there = whole(ground_truth(Samples(samples.stamps, samples.poses @ lever)), stamps)
    expected = here.poses @ lever
    np.testing.assert_allclose(there.poses[:, :3, :3], expected[:, :3, :3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        there.covariances[:, 3:, 3:], here.covariances[:, 3:, 3:], rtol=1e-9, atol=1e-15
    )
    adjoint = se3.adjoint(se3.inverse(lever))
    allowed = np.sqrt(
        np.trace((adjoint @ here.covariances @ adjoint.T)[:, :3, :3], axis1=1, axis2=2)
    )
    distance = np.linalg.norm((there.poses - expected)[:, :3, 3], axis=1)
    assert (distance < 2.0 * allowed).all()


# Uncertainty


@given(times=patterns(), shape=shapes, noise=st.sampled_from([1e-5, 1e-3, 0.1]))
@settings(max_examples=30)
def test_covariances_are_positive_definite(times, shape, noise):
    samples = sampled(times, std=(noise, noise))
    given = type(GIVEN)(
        *(type(g)(g.components, noise) for g in (GIVEN.translation, GIVEN.rotation))
    )
    truth = ground_truth(samples, given, shape)
    stamps = np.concatenate([queries(samples), samples.stamps])
    answer = whole(truth, stamps)
    assert np.isfinite(answer.poses).all()
    assert (np.linalg.eigvalsh(answer.covariances) > 0.0).all()
    skew = answer.covariances - answer.covariances.swapaxes(1, 2)
    assert np.abs(skew).max() <= 1e-12 * np.abs(answer.covariances).max()
    rotations = answer.poses[:, :3, :3]
    np.testing.assert_allclose(
        rotations @ rotations.swapaxes(1, 2), np.broadcast_to(np.eye(3), rotations.shape), atol=1e-9
    )


def test_noise_along_an_axis_of_the_body_is_uncertainty_along_it():
    # Each sample says itself how well it is known: badly along the body's x, and about its z.
    def path(seconds):
        poses = motion(seconds)
        poses[:, :3, :3] = se3.exp_so3(np.array([0.3, -0.9, 0.5]))
        return poses

    samples = sampled(regular(6.0, 20.0), path)
    loud = np.zeros((len(samples), 6, 6))
    loud[:, 0, 0], loud[:, 5, 5] = 0.2**2, 0.1**2
    known = Samples(samples.stamps, samples.poses, loud)
    size = std(whole(ground_truth(known), at(np.linspace(1.0, 5.0, 41))))
    assert (size[:, 0] > 5.0 * np.maximum(size[:, 1], size[:, 2])).all()
    assert (size[:, 5] > 5.0 * np.maximum(size[:, 3], size[:, 4])).all()


def test_in_a_gap_the_uncertainty_rises_to_the_size_of_the_motion_and_falls():
    samples = with_gap(4.0, 10.0, 14.0)
    truth = ground_truth(samples)
    stamps = at(np.linspace(4.0, 10.0, 241))
    size = std(whole(truth, stamps))
    for part in (slice(0, 3), slice(3, 6)):
        norm = np.sqrt((size[:, part] ** 2).mean(axis=1))
        top = int(np.argmax(norm))
        assert abs(top - 120) < 25
        assert (np.diff(norm[: top + 1]) > -1e-3 * norm.max()).all()
        assert (np.diff(norm[top:]) < 1e-3 * norm.max()).all()
        # Without a jump on the way: no step is more than a few times the even one.
        assert np.abs(np.diff(norm)).max() < 6 * norm.max() / 120
        assert norm.max() > 50 * norm[[0, -1]].max()
        assert 0.2 < norm.max() < 2.0
    # The truth lies within it.
    answer = whole(truth, stamps)
    error = np.linalg.norm((answer.poses - motion((stamps - START) / SECOND))[:, :3, 3], axis=1)
    assert (error < 4.0 * np.linalg.norm(size[:, :3], axis=1)).all()


def test_a_longer_gap_is_more_uncertain():
    tops = []
    for length in (0.1, 0.5, 1.5, 4.0):
        truth = ground_truth(with_gap(4.0, 4.0 + length))
        tops.append(std(whole(truth, at([4.0 + 0.5 * length])))[0])
    assert (np.diff(tops, axis=0) > 0.0).all()


@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("axis", [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
def test_a_spinning_body(rate, axis):
    def path(seconds):
        poses = motion(seconds)
        poses[..., :3, :3] = se3.exp_so3(rate * np.multiply.outer(seconds, axis))
        return poses

    truth = ground_truth(sampled(regular(6.0, 100.0), path, std=(1e-4, 1e-4)))
    stamps = at(np.random.default_rng(0).uniform(0.1, 5.9, 300))
    answer = whole(truth, stamps)
    expected = path((stamps - START) / SECOND)
    turned = se3.log_so3(expected[:, :3, :3].swapaxes(1, 2) @ answer.poses[:, :3, :3])
    assert np.linalg.norm(turned, axis=1).max() < 0.01
    assert np.linalg.norm((answer.poses - expected)[:, :3, 3], axis=1).max() < 0.005
    assert (np.linalg.eigvalsh(answer.covariances) > 0.0).all()


@pytest.mark.parametrize("rate", [5.0, 20.0, 100.0])
def test_between_exact_samples_the_motion_is_found(rate):
    truth = ground_truth(sampled(regular(10.0, rate), std=(0.0, 0.0)))
    stamps = at(np.random.default_rng(0).uniform(0.5, 9.5, 200))
    answer = whole(truth, stamps)
    expected = motion((stamps - START) / SECOND)
    error = se3.log(se3.inverse(expected) @ answer.poses)
    limit = {5.0: 0.02, 20.0: 2e-3, 100.0: 1e-3}[rate]
    assert np.abs(error).max() < limit


def draw(rng, times, group, count=3):
    """The process itself, by a dense Cholesky factor: values at ``times``, and noisy ones."""
    u = np.abs(times[:, None] - times)
    covariance = np.zeros_like(u)
    for component in group.components:
        a = np.sqrt(5.0) * u / component.length_scale
        covariance += component.std**2 * (1.0 + a + a * a / 3.0) * np.exp(-a)
    lower = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(times)))
    values = lower @ rng.normal(size=(len(times), count))
    return values, values + group.noise_std * rng.normal(size=values.shape)


def test_it_is_as_sure_as_it_should_be_of_its_own_process():
    # Small rotations, so that the process in local coordinates is the one drawn.
    rng = np.random.default_rng(7)
    given = type(GIVEN)(
        GIVEN.translation,
        type(GIVEN.rotation)((type(GIVEN.rotation.components[0])(0.02, 1.5),), 1e-3),
    )
    squares = []
    for _ in range(12):
        times = np.sort(rng.uniform(0.0, 12.0, 320))
        values, noisy = zip(
            draw(rng, times, given.translation), draw(rng, times, given.rotation), strict=True
        )
        poses = np.zeros((2, len(times), 4, 4))
        for pose, (position, rotation) in zip(poses, (values, noisy), strict=True):
            pose[:, :3, 3], pose[:, :3, :3] = position, se3.exp_so3(rotation)
            pose[:, 3, 3] = 1.0
        known = np.arange(len(times)) % 4 != 3
        known[[0, -1]] = True
        truth = ground_truth(Samples(at(times[known]), poses[1][known]), given)
        answer = whole(truth, at(times[~known]))
        error = se3.log(se3.inverse(answer.poses) @ poses[0][~known])
        squares.append(
            np.einsum("ni,nij,nj->n", error, np.linalg.inv(answer.covariances), error) / 6.0
        )
    anees = np.mean(squares)
    assert 0.85 < anees < 1.15


# Learning


def test_it_learns_when_it_must_and_not_before():
    truth = ground_truth(hyperparameters=None)
    with pytest.raises(ValueError, match="not known"):
        truth.posterior(at([0.5]), at([1.0]))
    samples = sampled(regular(40.0, 50.0))
    learned = None
    for begin in range(0, len(samples), 50):
        truth.append(samples[begin : begin + 50])
        learned = truth.hyperparameters
        if learned is not None:
            break
    assert learned is not None
    assert 2 * SECOND < truth.stamps[-1] - START < 20 * SECOND


def test_a_short_run_learns_at_its_end():
    samples = sampled(regular(1.5, 50.0))
    truth = ground_truth(samples, None)
    assert truth.hyperparameters is None
    truth.conclude()
    learned = truth.hyperparameters
    assert learned is not None
    truth.conclude()
    assert truth.hyperparameters is learned
    stamps = queries(samples)
    error = whole(truth, stamps).poses - motion((stamps - START) / SECOND)
    assert np.abs(error).max() < 0.02


def test_given_hyperparameters_stay():
    truth = ground_truth(sampled(regular(30.0, 50.0)))
    truth.conclude()
    assert truth.hyperparameters == GIVEN


def stands_first(seconds, until=20.0):
    return motion(np.maximum(np.asarray(seconds) - until, 0.0))


@pytest.mark.parametrize("trap", ["stands", "jitter", "rates", "outliers", "never moves"])
def test_learning_survives(trap):
    rng = np.random.default_rng(3)
    times, path = regular(35.0, 40.0), motion
    if trap == "stands":
        path = stands_first
    elif trap == "jitter":
        times = np.sort(times + rng.uniform(-0.012, 0.012, len(times)) + 0.1)
    elif trap == "rates":
        times = np.concatenate([regular(15.0, 100.0), 15.1 + regular(15.0, 8.0)])
    elif trap == "never moves":

        def path(seconds):
            return np.broadcast_to(np.eye(4), (len(seconds), 4, 4))

    samples = sampled(times, path, std=(0.001, 0.001))
    if trap == "outliers":
        for i in rng.integers(0, len(samples), 5):
            samples.poses[i, :3, 3] += rng.normal(size=3)
    truth = ground_truth(samples, None, floor=5e-4)
    truth.conclude()
    stamps = at(rng.uniform(times[0], times[-1], 300))
    answer = whole(truth, stamps)
    assert (np.linalg.eigvalsh(answer.covariances) > 0.0).all()
    expected = path((stamps - START) / SECOND)
    error = se3.log(se3.inverse(expected) @ answer.poses)
    assert np.median(np.abs(error)) < 5e-3
    if trap != "outliers":
        square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(answer.covariances), error) / 6.0
        # Neither lost nor absurdly sure of itself.
        assert 0.02 < square.mean() < 5.0


def test_learning_does_not_depend_on_batches():
    samples = sampled(regular(70.0, 20.0))
    at_once, one_by_one = ground_truth(samples, None), ground_truth(hyperparameters=None)
    for i in range(0, len(samples), 7):
        one_by_one.append(samples[i : i + 7])
    found, expected = one_by_one.hyperparameters, at_once.hyperparameters
    for part in ("translation", "rotation"):
        assert getattr(found, part).named == pytest.approx(getattr(expected, part).named, rel=1e-9)
    stamps = queries(samples)
    assert_equal(whole(one_by_one, stamps), whole(at_once, stamps))


# Gaps as such


def test_what_counts_as_sampled():
    truth = ground_truth(with_gap(4.0, 8.0))
    assert whole(truth, at([1.0, 3.99, 4.0, 8.0, 9.0])).sampled.all()
    assert not whole(truth, at([4.01, 6.0, 7.99])).sampled.any()
    # At a low rate as usual there is no gap.
    slow = ground_truth(sampled(regular(60.0, 1.0)))
    assert whole(slow, at([0.5, 30.5, 59.5])).sampled[1:].all()


def test_no_query_no_answer():
    answer = whole(ground_truth(sampled(regular(3.0, 50.0))), np.empty(0, dtype=np.int64))
    assert answer.poses.shape == (0, 4, 4)
    assert answer.covariances.shape == (0, 6, 6)
    assert answer.sampled.shape == (0,)


def test_twist_is_the_derivative_of_the_pose():
    shape = SHAPE._replace(overlap=0.3)
    truth = ground_truth(sampled(regular(12, 50)), shape=shape)
    # Away from hand-overs, whose change of weights is no motion.
    handovers = [b.incoming for b in truth._segmentation if b.incoming is not None]
    stamps = at(np.linspace(1.0, 11.0, 200))
    inside = [(stamps > h.begin) & (stamps < h.end) for h in handovers]
    stamps = stamps[~np.any(inside, axis=0)]
    until = np.full(len(stamps), truth.stamps[-1])
    twists = truth.posterior(stamps, until, twists=True).twists
    step = 20_000
    later, earlier = (whole(truth, stamps + sign * step).poses for sign in (1, -1))
    expected = se3.log(se3.inverse(earlier) @ later) / (2e-9 * step)
    assert len(stamps) > 20
    np.testing.assert_allclose(twists.means, expected, rtol=0, atol=1e-6)
    assert (np.linalg.eigvalsh(twists.covariances) > 0).all()


@pytest.mark.parametrize(("still", "expected"), [(0.0, 0), (20.0, 1)])
def test_when_its_process_changed_is_remembered(still, expected):
    seconds = np.arange(0.0, 40.0, 0.02)
    poses = motion(np.maximum(seconds - still, 0.0))
    poses = poses @ se3.exp(1e-3 * np.random.default_rng(0).normal(size=(len(seconds), 6)))
    truth = ground_truth(Samples(at(seconds), poses, None), None, floor=5e-4)
    truth.conclude()
    fit = truth.fit
    assert len(fit.anew) == expected
    assert (fit.adapted > 0) == bool(expected)
    for stamp in fit.anew:
        # As soon as it moves.
        assert still < (stamp - START) / SECOND < still + 0.5


def test_segments_that_begin_unlike_those_before_them_do_not_depend_on_batches():
    # Closed together, they are conditioned together, as though each began like the one before.
    seconds = np.arange(0.0, 60.0, 0.02)
    noise = np.random.default_rng(0).normal(size=(len(seconds), 6))
    noise *= np.where(seconds % 14.0 > 7.0, 2e-2, 1e-3)[:, None]
    samples = Samples(at(seconds), motion(seconds) @ se3.exp(noise), None)
    process = ground_truth(samples[:600], None)._process(0)
    at_once, one_by_one = ground_truth(samples, process), ground_truth(hyperparameters=process)
    for i in range(0, len(samples), 7):
        one_by_one.append(samples[i : i + 7])
    assert at_once.fit == one_by_one.fit
    assert at_once.fit.adapted > 3
    stamps = queries(samples)
    assert_equal(whole(one_by_one, stamps), whole(at_once, stamps))


def test_nothing_is_modelled_across_a_cut():
    seconds = np.arange(0.0, 20.0, 0.05)
    whole_run = sampled(seconds)
    place = 200
    late = Samples(whole_run.stamps[place:], whole_run.poses[place:].copy())
    late.poses[:, :3, 3] += 1e3
    cut_run = ground_truth()
    cut_run.append(whole_run[:place])
    cut_run.append(late, [int(late.stamps[0])])
    for samples in (whole_run[:place], late):
        alone = ground_truth()
        alone.append(samples)
        seconds = np.linspace(0.0, (samples.stamps[-1] - samples.stamps[0]) * 1e-9, 57)
        asked = samples.stamps[0] + np.floor(seconds * 1e9).astype(np.int64)
        until = np.full(len(asked), whole_run.stamps[-1])
        expected = alone.posterior(asked, np.minimum(until, samples.stamps[-1]))
        found = cut_run.posterior(asked, until)
        np.testing.assert_allclose(found.poses, expected.poses, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(found.covariances, expected.covariances, rtol=1e-6)
        assert not cut_run.is_cut(asked).any()
    between = (whole_run.stamps[place - 1] + whole_run.stamps[place]) // 2
    assert cut_run.is_cut(np.array([between])).all()


# Rest


def test_segments_that_rest_answer_as_before():
    """Learned, from rest to motion, so that segments change their process on the way."""
    times = regular(60.0, 50.0)

    def stops_and_goes(seconds):
        return motion(np.maximum(seconds - 12.0, 0.0))

    samples = sampled(times, stops_and_goes)
    awake, resting = (ground_truth(hyperparameters=None) for _ in range(2))
    for begin in range(0, len(samples), 250):
        for truth in (awake, resting):
            truth.append(samples[begin : begin + 250])
        resting.rest(int(samples.stamps[begin]), 500)
    segments = [blended.segment for blended in resting._segmentation]
    assert any(len(blended.segment.epochs) > 1 for blended in awake._segmentation)
    # The newest 500 of 3,001 samples.
    assert 0.7 < np.mean([segment.rests for segment in segments]) < 0.9
    stamps = queries(samples, 300)
    for _ in range(2):
        expected, found = (
            truth.posterior(stamps, stamps + SECOND // 5, twists=True) for truth in (awake, resting)
        )
        # Not to the bit: how a product of matrices is summed may hang on where in memory they lie.
        np.testing.assert_allclose(found.poses, expected.poses, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(found.covariances, expected.covariances, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(found.twists.means, expected.twists.means, rtol=1e-9, atol=1e-12)
    assert all(segment.begun for segment in segments)
    assert np.mean([segment.rests for segment in segments]) > 0.7
