# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report's memory: bounded, exact in its totals, and no peak lost."""

import dataclasses
import itertools

import numpy as np
import numpy.typing as npt
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import se3
from trajeval_ros.online.results import Evaluations, Results
from trajeval_ros.report.track import Track

Array = npt.NDArray[np.float64]


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
        nearest=np.zeros(count, dtype=np.int64),
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
    kept = filled(poses, cuts, capacity).poses()
    assert len(kept) <= 2 * capacity + 4
    if count == 0:
        assert len(kept) == 0
        return
    rows = kept["count"] - 1
    assert rows[0] == 0
    assert rows[-1] == count - 1
    assert np.all(np.diff(rows) > 0)
    # Each is as the run stood at that pose.
    np.testing.assert_array_equal(kept["stamp"], poses.stamps[rows])
    np.testing.assert_array_equal(kept["estimate"], poses.estimate[rows])
    np.testing.assert_allclose(kept["relative_chi2"], np.cumsum(poses.chi2)[rows], rtol=1e-12)
    np.testing.assert_array_equal(
        kept["relative_log_likelihood"], poses.relative_log_likelihood[rows]
    )
    for part, name in ((slice(3), "translation"), (slice(3, None), "rotation")):
        error = np.linalg.norm(poses.absolute_error[:, part], axis=-1)
        np.testing.assert_allclose(kept[f"absolute_{name}_error"], error[rows], rtol=1e-12)
        assert np.argmax(error) in rows


@given(count=st.integers(1, 300), capacity=st.sampled_from([4, 16]))
def test_of_each_stretch_the_largest_errors_stay(count: int, capacity: int) -> None:
    poses = make_poses(count)
    rows = set((filled(poses, [], capacity).poses()["count"] - 1).tolist())
    size = 2
    while 2 * (count // size) >= 2 * capacity:
        size *= 2
    for part in (slice(3), slice(3, None)):
        error = np.linalg.norm(poses.absolute_error[:, part], axis=-1)
        for begin in range(0, count - size + 1, size):
            assert begin + int(np.argmax(error[begin : begin + size])) in rows


@given(
    runs=st.lists(
        st.tuples(st.sampled_from([1, 2, 70]), *2 * [st.sampled_from([0.0, 1.0, 2.0, np.nan])]),
        max_size=12,
    ),
    cuts=st.lists(st.integers(0, 1000)),
    capacity=st.sampled_from([2, 4]),
)
def test_of_a_stretch_that_is_not_whole_no_more_than_may_be_kept_is(
    runs: list[tuple[int, float, float]], cuts: list[int], capacity: int
) -> None:
    # Several poses in a row have the same errors.
    sizes = [each for count, *each in runs for _ in range(count)]
    poses = make_poses(len(sizes))
    errors = np.zeros((len(sizes), 6))
    errors[:, [0, 3]] = np.array(sizes).reshape(-1, 2)
    track = filled(dataclasses.replace(poses, absolute_error=errors), cuts, capacity)
    found = track.poses()["count"] - 1
    assert len(track._pending) <= 4
    # Two of each stretch, and of each two stretches, once these are too many.
    kept, size = [], 2
    waiting = list(range(len(sizes)))
    while len(waiting) >= size:
        kept += largest(errors, waiting[:size])
        waiting = waiting[size:]
        if len(kept) == 2 * capacity:
            kept = [row for i in range(0, len(kept), 4) for row in largest(errors, kept[i : i + 4])]
            size *= 2
    rest = largest(errors, waiting) if len(waiting) > 2 else waiting
    ends = [0, len(sizes) - 1] if sizes else []
    assert found.tolist() == sorted({*kept, *rest, *ends})


def largest(errors: Array, rows: list[int]) -> list[int]:
    """The two of these rows that are kept, the slow way."""
    size = {row: np.nan_to_num(errors[row, [0, 3]], nan=-1.0) for row in rows}
    first, second = (max(rows, key=lambda row: size[row][part]) for part in (0, 1))
    if first == second:
        second = min((row for row in rows if row != first), key=lambda row: size[row][0])
    return sorted((first, second))


def test_chunking_does_not_matter() -> None:
    poses = make_poses(1000)
    at_once = filled(poses, [], 32).poses()
    # (the absolute log-likelihood is known once a call of the engine)
    one_by_one = filled(poses, list(range(1000)), 32).poses()
    assert len(at_once) == len(one_by_one)
    for name in set(at_once.dtype.names) - {"absolute_log_likelihood"}:
        np.testing.assert_allclose(at_once[name], one_by_one[name], rtol=1e-12)


def test_as_many_stay_in_each_part_of_the_run() -> None:
    rows = filled(make_poses(1000), [], 32).poses()["count"] - 1
    assert set(np.histogram(rows, bins=np.arange(0, 993, 32))[0].tolist()) <= {2, 3}


def test_a_few_poses_all_stay() -> None:
    for count in range(1, 8):
        assert filled(make_poses(count), [], 4).poses()["count"].tolist() == list(
            range(1, count + 1)
        )
