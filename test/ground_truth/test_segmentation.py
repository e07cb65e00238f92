# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the samples are cut into segments, when one closes, and how they hand over."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.ground_truths import (
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

from trajeval_ros import loops, se3
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.segmentation import Segmentation, SegmentShape


def segmented(samples, shape=SHAPE, edges=()):
    """The segmentation, and what has been closed."""
    segmentation = Segmentation(shape)
    closed = [s for batch in cut(samples, edges) for s in segmentation.append(batch)]
    return segmentation, closed


def still(seconds):
    return np.broadcast_to(np.eye(4), (len(seconds), 4, 4)).copy()


def spin(rate):
    """A body that spins at ``rate`` rad/s while it moves."""

    def path(seconds):
        poses = motion(seconds)
        turn = np.zeros((len(seconds), 3))
        turn[:, 2] = rate * np.asarray(seconds)
        poses[:, :3, :3] = se3.exp_so3(turn)
        return poses

    return path


def weights(segmentation, stamps):
    return np.array([blended.weight(stamps) for blended in segmentation])


def asked(samples, count=300, seed=0):
    """Stamps between the first and the last sample, the samples' own and their neighbours too."""
    rng = np.random.default_rng(seed)
    first, last = int(samples.stamps[0]), int(samples.stamps[-1])
    some = rng.integers(first, last + 1, count)
    every = np.concatenate([some, samples.stamps, samples.stamps - 1, samples.stamps + 1])
    return np.unique(np.clip(every, first, last))


@pytest.mark.skipif(not loops.there(), reason="not built, or switched off")
@given(
    times=patterns(),
    shape=shapes,
    rate=st.sampled_from([0.0, 0.7, 5.0]),
    edges=st.lists(st.integers(1, 200), max_size=2),
)
@settings(max_examples=40)
def test_the_loop_cuts_where_numpy_does(times, shape, rate, edges):
    samples = sampled(times, spin(rate))
    edges = sorted(edge for edge in edges if edge < len(samples))
    looped, closed = segmented(samples, shape, edges)
    with loops.left_out():
        expected, closed_in_numpy = segmented(samples, shape, edges)
    assert [len(each) for each in closed] == [len(each) for each in closed_in_numpy]
    for one, other in zip(looped, expected, strict=True):
        np.testing.assert_array_equal(one.segment.samples.stamps, other.segment.samples.stamps)
        np.testing.assert_allclose(
            one.segment.coordinates, other.segment.coordinates, rtol=1e-9, atol=1e-12
        )
    queries = asked(samples)
    np.testing.assert_allclose(
        weights(looped, queries), weights(expected, queries), rtol=0, atol=1e-9
    )


@given(times=patterns(), shape=shapes)
@settings(max_examples=40)
def test_the_segments_cover_all_samples_in_order(times, shape):
    samples = sampled(times)
    segmentation, closed = segmented(samples, shape)
    parts = [blended.segment for blended in segmentation]
    covered = np.zeros(len(samples), dtype=int)
    for part in parts:
        first = int(np.searchsorted(samples.stamps, part.start))
        here = slice(first, first + len(part))
        assert np.array_equal(part.samples.stamps, samples.stamps[here])
        assert np.array_equal(part.samples.poses, samples.poses[here])
        covered[here] += 1
    assert (covered >= 1).all()
    starts = [part.start for part in parts]
    assert starts == sorted(starts)
    assert parts[-1].samples.stamps[-1] == samples.stamps[-1]
    # Closed in order, once each, and never touched again.
    assert [s.start for s in closed] == starts[: len(closed)]
    assert len(parts) - len(closed) in (1, 2)
    assert segmentation.opened == len(parts)


@given(times=patterns(), shape=shapes, seed=st.integers(0, 999))
@settings(max_examples=40)
def test_the_weights_sum_to_one_everywhere(times, shape, seed):
    samples = sampled(times)
    segmentation, _ = segmented(samples, shape)
    stamps = asked(samples, seed=seed)
    share = weights(segmentation, stamps)
    np.testing.assert_allclose(share.sum(axis=0), 1.0, rtol=0, atol=1e-15)
    assert (share >= 0.0).all()
    assert ((share > 0.0).sum(axis=0) <= 2).all()
    # Who has weight has samples on both sides, all that there are around.
    for blended, own in zip(segmentation, share, strict=True):
        used = stamps[own > 0.0]
        own_stamps = blended.segment.samples.stamps
        assert (used >= own_stamps[0]).all()
        assert (used <= own_stamps[-1]).all()


@given(times=patterns(), shape=shapes)
@settings(max_examples=30)
def test_the_weights_are_continuous(times, shape):
    samples = sampled(times)
    segmentation, _ = segmented(samples, shape)
    stamps = samples.stamps[1:-1]
    before, here, after = (weights(segmentation, stamps + d) for d in (-1, 0, 1))
    # Within a nanosecond the progress changes by no more than that part of the interval.
    steps = 1.5 / np.diff(samples.stamps).astype(np.float64)
    assert (np.abs(after - here) <= steps[1:] + 1e-12).all()
    assert (np.abs(here - before) <= steps[:-1] + 1e-12).all()


@given(times=patterns(), shape=shapes, cuts=st.lists(st.integers(0, 200), max_size=6))
@settings(max_examples=30)
def test_batches_do_not_matter(times, shape, cuts):
    samples = sampled(times)
    edges = [min(c, len(samples)) for c in cuts]
    one, closed = segmented(samples, shape)
    other, also_closed = segmented(samples, shape, edges)
    assert [len(s) for s in closed] == [len(s) for s in also_closed]
    for a, b in itertools.zip_longest(one, other):
        assert np.array_equal(a.segment.samples.stamps, b.segment.samples.stamps)
        # The last digits may depend on where in memory an array lies.
        difference = np.abs(a.segment.coordinates - b.segment.coordinates)
        assert difference.max() < 1e-9
        assert a.index == b.index
    stamps = asked(samples, 50)
    np.testing.assert_allclose(weights(one, stamps), weights(other, stamps), rtol=0, atol=1e-9)


@given(times=patterns(), shape=shapes, share=st.floats(0.05, 1.0))
@settings(max_examples=30)
def test_a_weight_is_known_from_the_first_sample_after(times, shape, share):
    samples = sampled(times)
    known = max(2, round(share * len(samples)))
    full, _ = segmented(samples, shape)
    part, _ = segmented(samples[:known], shape)
    stamps = asked(samples[:known], 50)
    now, later = weights(part, stamps), weights(full, stamps)
    np.testing.assert_allclose(now, later[: len(now)], rtol=0, atol=1e-9)
    assert (later[len(now) :] == 0.0).all()


@pytest.mark.parametrize("rate", [2.0, 10.0, 100.0])
@pytest.mark.parametrize("overlap", [0.1, 0.5])
def test_a_segment_closes_with_its_duration_and_its_minimum_of_samples(rate, overlap):
    shape = SegmentShape(2 * SECOND, overlap, 8, 1000)
    _, closed = segmented(sampled(regular(40.0, rate), still), shape)
    assert len(closed) >= 4
    for segment in closed:
        span = (segment.samples.stamps[-1] - segment.start) / SECOND
        # No sooner than both, and no later than the next sample, the context before included.
        longest = max(2.0, 8.0 / rate) + (shape.lead + 4) / rate
        assert len(segment) >= 8
        assert span >= 2.0 - 1e-9
        assert span <= longest + 1e-9


@given(times=patterns(), shape=shapes)
@settings(max_examples=30)
def test_a_segment_never_exceeds_its_maximum(times, shape):
    segmentation, _ = segmented(sampled(times), shape)
    assert max(len(blended.segment) for blended in segmentation) <= shape.max_samples


def test_a_fast_stream_closes_by_the_maximum():
    shape = SegmentShape(2 * SECOND, 0.5, 8, 64)
    _, closed = segmented(sampled(regular(3.0, 1000.0), still), shape)
    assert {len(segment) for segment in closed} == {64}


@pytest.mark.parametrize("gap", [0.3, 5.0, 600.0])
def test_a_segment_spans_a_gap(gap):
    times = regular(10.0, 50.0)
    times = np.concatenate([times[times < 5.0], times[times >= 5.0] + gap])
    segmentation, _ = segmented(sampled(times))
    inside = at([5.0 + 0.01 * gap, 5.0 + 0.5 * gap, 4.99 + 0.99 * gap])
    share = weights(segmentation, inside)
    np.testing.assert_allclose(share.sum(axis=0), 1.0, atol=1e-15)
    for blended, own in zip(segmentation, share, strict=True):
        if (own > 0).any():
            stamps = blended.segment.samples.stamps
            assert stamps[0] < at(4.99)
            assert stamps[-1] > at(4.98 + gap)
            # On both sides enough to know where the motion goes.
            assert np.count_nonzero(stamps < inside[0]) >= 2


@pytest.mark.parametrize("rate", [1.0, 3.0, 8.0, 20.0])
def test_a_spinning_body_has_shorter_segments(rate):
    samples = sampled(regular(10.0, 100.0), spin(rate))
    segmentation, closed = segmented(samples)
    for segment in closed:
        angles = np.linalg.norm(segment.coordinates[:, 3:], axis=1)
        # Well within pi, where local coordinates wrap around; and so they grow steadily.
        assert angles.max() < 2.4 + rate / 100.0 + 0.05
        assert (np.diff(angles) > 0.5 * rate / 100.0 - 0.02).all()
    spans = [(s.samples.stamps[-1] - s.start) / SECOND for s in closed]
    assert max(spans) < 2.7 / rate + 0.1 or rate == 1.0
    share = weights(segmentation, asked(samples))
    np.testing.assert_allclose(share.sum(axis=0), 1.0, rtol=0, atol=1e-15)


@given(times=patterns(), shape=shapes, moment=st.floats(0.0, 1.0))
@settings(max_examples=30)
def test_what_is_forgotten_has_no_weight(times, shape, moment):
    samples = sampled(times)
    full, _ = segmented(samples, shape)
    stamps = asked(samples, 100)
    before = int(stamps[0] + moment * (stamps[-1] - stamps[0]))
    later = stamps[stamps >= before]
    expected = weights(full, later)
    full.forget(before)
    kept = weights(full, later)
    assert np.array_equal(kept, expected[len(expected) - len(kept) :])
    assert (expected[: len(expected) - len(kept)] == 0.0).all()
    # As much is dropped as can be: the oldest one retained is needed, or not closed.
    assert len(kept) <= 2 or (kept[0] > 0.0).any() or (kept[1] > 0.0).any()


def test_indices_count_on_when_segments_are_forgotten():
    samples = sampled(regular(20.0, 50.0))
    segmentation, _ = segmented(samples)
    starts = {blended.index: blended.segment.start for blended in segmentation}
    segmentation.forget(START + 10 * SECOND)
    kept = {blended.index: blended.segment.start for blended in segmentation}
    assert 0 < len(kept) < len(starts)
    assert kept.items() <= starts.items()
    assert max(kept) == max(starts) == segmentation.opened - 1


def test_nothing_and_one_sample():
    segmentation, closed = segmented(sampled(regular(1.0, 10.0))[:0])
    assert (list(segmentation), closed, segmentation.opened) == ([], [], 0)
    segmentation, closed = segmented(sampled(regular(1.0, 10.0))[:1])
    assert (len(list(segmentation)), closed, segmentation.opened) == (1, [], 1)


def test_a_hand_over_does_not_go_back_with_the_body():
    def swings(seconds):
        poses = still(seconds)
        turn = np.zeros((len(seconds), 3))
        turn[:, 2] = 1.9 * np.sin(4.0 * np.asarray(seconds))
        poses[:, :3, :3] = se3.exp_so3(turn)
        return poses

    samples = sampled(regular(12.0, 50.0), swings)
    at_once, _ = segmented(samples)
    one_by_one, _ = segmented(samples, edges=range(len(samples)))
    stamps = asked(samples)
    share = weights(one_by_one, stamps)
    np.testing.assert_allclose(share, weights(at_once, stamps), rtol=0, atol=1e-9)
    # Each segment's weight rises once and falls once.
    for own in share:
        signs = np.sign(np.diff(own))
        assert np.count_nonzero(np.diff(signs[signs != 0.0])) <= 1


@pytest.mark.parametrize(("rate", "speed"), [(1, 0.6), (5, 2.9), (10, 6.0), (2, 1.5), (1, 2.0)])
def test_a_body_that_turns_far_from_sample_to_sample_is_followed(rate, speed):
    def turning(times):
        poses = np.tile(np.eye(4), (len(times), 1, 1))
        poses[:, :3, :3] = se3.exp_so3(np.outer(speed * times, [0.0, 0.0, 1.0]))
        return poses

    times = regular(40.0, rate)
    truth = ground_truth(Samples(at(times), turning(times)), hyperparameters=None)
    truth.conclude()
    asked = np.linspace(5.0, 35.0, 301)
    error = se3.log_so3(
        np.swapaxes(turning(asked)[:, :3, :3], -1, -2) @ whole(truth, at(asked)).poses[:, :3, :3]
    )
    assert np.abs(error).max() < 0.01


@given(shapes, st.integers(1, 200), st.integers(2, 200))
@settings(deadline=None)
def test_segments_end_at_a_cut_and_weights_sum_to_one_beside_it(shape, before, after):
    seconds = np.concatenate([np.arange(before) * 0.05, 60.0 + np.arange(after) * 0.05])
    samples = sampled(seconds)
    segmentation = Segmentation(shape)
    closed = list(segmentation.append(samples[:before]))
    opened = segmentation.opened
    closed += list(segmentation.cut(samples[before:]))
    assert len(closed) >= opened
    edges = samples.stamps[before - 1], samples.stamps[before]
    for blended in segmentation:
        stamps = blended.segment.samples.stamps
        assert (stamps <= edges[0]).all() or (stamps >= edges[1]).all()
    stamps = asked(samples)
    beside = stamps[(stamps <= edges[0]) | (stamps >= edges[1])]
    np.testing.assert_allclose(weights(segmentation, beside).sum(axis=0), 1.0, atol=1e-12)
    for blended in segmentation:
        old = blended.segment.samples.stamps[0] <= edges[0]
        other = beside >= edges[1] if old else beside <= edges[0]
        assert (blended.weight(beside)[other] == 0.0).all()
