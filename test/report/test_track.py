# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report's memory: bounded, exact in its totals, and no peak lost."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import se3
from trajeval_ros.online.results import Evaluations, Results
from trajeval_ros.report.track import Track


def make_poses(count: int) -> Evaluations:
    generator = np.random.default_rng(count)
    error = generator.normal(size=(count, 6))
    error[:1] = np.nan
    poses = se3.exp(generator.normal(size=(count, 6)))
    return Evaluations(
        stamps=np.arange(count, dtype=np.int64) * 50_000_000,
        ground_truth=poses,
        covariance=np.broadcast_to(np.eye(6), (count, 6, 6)),
        estimate=poses,
        relative_error=error,
        absolute_error=generator.normal(size=(count, 6)),
        chi2=generator.normal(size=count) ** 2,
        log_det=generator.normal(size=count),
        log_likelihood=generator.normal(size=count),
        relative_log_likelihood=generator.normal(size=count).cumsum(),
        sampled=np.ones(count, dtype=bool),
        twist=np.zeros((count, 6)),
    )


def part(poses: Evaluations, which: slice) -> Results:
    names = [field.name for field in dataclasses.fields(Evaluations)]
    return Results(
        evaluations=Evaluations(**{name: getattr(poses, name)[which] for name in names}),
        notices=(),
        absolute_log_likelihood=float(which.stop),
        alignment=None,
    )


def filled(poses: Evaluations, cuts: list[int], capacity: int) -> Track:
    track = Track(capacity)
    edges = [0, *sorted(cut % (len(poses.stamps) + 1) for cut in cuts), len(poses.stamps)]
    for start, end in itertools.pairwise(edges):
        track.add(part(poses, slice(start, end)))
    return track


@given(
    count=st.integers(0, 300), cuts=st.lists(st.integers(0, 400)), capacity=st.sampled_from([4, 16])
)
def test_totals_are_exact_and_peaks_survive(count: int, cuts: list[int], capacity: int) -> None:
    poses = make_poses(count)
    buckets = filled(poses, cuts, capacity).buckets()
    assert len(buckets) <= 2 * capacity + 1
    if count == 0:
        assert len(buckets) == 0
        return
    assert buckets["count"][-1] == count
    ends = buckets["count"] - 1
    np.testing.assert_array_equal(buckets["last_stamp"], poses.stamps[ends])
    np.testing.assert_allclose(buckets["relative_chi2"], np.cumsum(poses.chi2)[ends], rtol=1e-12)
    np.testing.assert_array_equal(
        buckets["relative_log_likelihood"], poses.relative_log_likelihood[ends]
    )
    error = np.linalg.norm(poses.absolute_error[:, :3], axis=-1)
    for start, end, bucket in zip([0, *(ends[:-1] + 1)], ends + 1, buckets, strict=True):
        worst = start + np.argmax(error[start:end])
        assert bucket["stamp"] == poses.stamps[worst]
        assert bucket["absolute_translation_error"] == pytest.approx(error[worst], rel=1e-12)
        np.testing.assert_array_equal(bucket["estimate"], poses.estimate[worst])
        relative = np.linalg.norm(poses.relative_error[start:end, 3:], axis=-1)
        if np.all(np.isnan(relative)):
            assert np.isnan(bucket["relative_rotation_error"])
        else:
            assert bucket["relative_rotation_error"] == np.nanmax(relative)


def test_chunking_does_not_matter() -> None:
    poses = make_poses(1000)
    at_once = filled(poses, [], 32).buckets()
    # (the absolute log-likelihood is known once a call of the engine)
    one_by_one = filled(poses, list(range(1000)), 32).buckets()
    assert len(at_once) == len(one_by_one)
    for name in set(at_once.dtype.names) - {"absolute_log_likelihood"}:
        np.testing.assert_allclose(at_once[name], one_by_one[name], rtol=1e-12)


def test_buckets_are_of_equal_count() -> None:
    buckets = filled(make_poses(1000), [], 32).buckets()
    assert set(np.diff(buckets["count"])[:-1]) == {16}
