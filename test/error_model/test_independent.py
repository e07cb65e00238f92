# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which poses count where the ground truth is sampled more rarely, and what is named then."""

import numpy as np
import pytest
from error_model.test_fit import DRIFT, nuisance_scores
from hypothesis import given
from hypothesis import strategies as st
from twins.runs import motion

from performance.error_model import drawn, erring
from trajeval_ros import se3
from trajeval_ros.error_model.at_samples import fit_independent
from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.independent import MOST, counted, independent
from trajeval_ros.error_model.nuisances import Nuisances, Truth
from trajeval_ros.error_model.process import Kind

SECOND = 1_000_000_000
DURATION = 90
SAMPLES = np.arange(DURATION + 1) * SECOND


def nearest_to(stamps, samples):
    return samples[np.abs(stamps[:, None] - samples).argmin(axis=1)]


@given(
    stamps=st.lists(st.integers(0, 3000), unique=True, min_size=1, max_size=80).map(sorted),
    interval=st.integers(1, 500),
)
def test_the_nearest_pose_of_each_sample_counts_where_there_are_many(stamps, interval):
    stamps, samples = np.array(stamps), np.arange(0, 4000, interval)
    nearest = nearest_to(stamps, samples)
    found = independent(stamps, nearest)
    distinct = np.unique(nearest)
    if len(stamps) <= MOST * len(distinct):
        np.testing.assert_array_equal(found, np.arange(len(stamps)))
        return
    np.testing.assert_array_equal(nearest[found], distinct)
    for sample, chosen in zip(distinct, stamps[found], strict=True):
        assert abs(chosen - sample) == np.abs(stamps[nearest == sample] - sample).min()


@given(
    samples=st.lists(st.integers(0, 12), max_size=60).map(sorted),
    cuts=st.lists(st.integers(0, 60), max_size=4).map(sorted),
)
def test_of_a_sample_two_poses_count_however_they_come(samples, cuts):
    nearest = np.array(samples, dtype=np.int64)
    expected = np.cumsum([i < MOST or samples[i - MOST] != s for i, s in enumerate(samples)])
    np.testing.assert_array_equal(counted(nearest), expected)
    parts, total = [], 0
    for part in np.split(nearest, np.minimum(cuts, len(nearest))):
        begin = sum(len(p) for p in parts)
        before = None
        if begin:
            last = int(nearest[begin - 1])
            before = last, int((nearest[:begin] == last).sum())
        found = total + counted(part, before)
        np.testing.assert_array_equal(found, expected[begin : begin + len(part)])
        total = int(found[-1]) if len(found) else total
        parts.append(part)


def spread(stamps):
    """Between samples of every second: how much of the error there is that of the interval."""
    share = stamps % SECOND / SECOND
    return 4.0 * share * (1.0 - share)


def rarely_sampled(stamps):
    """A ground truth that is known to a millimetre each second, and to 5 cm in between."""
    seconds, step = stamps * 1e-9, 1e-4
    twists = se3.log(se3.inverse(motion(seconds - step)) @ motion(seconds + step)) / (2 * step)
    std = np.hypot(1e-3, spread(stamps)[:, None] * np.repeat([0.05, 0.02], 3))
    covariances = np.einsum("ni,ij->nij", std**2, np.eye(6))
    return Truth(motion(seconds), covariances, twists, np.ones(len(stamps), dtype=np.bool_))


def seen(seed, nuisances):
    """An estimate at 20 Hz of a motion that differs from that by one error an interval."""
    rng = np.random.default_rng(seed)
    stamps = np.rint((np.arange(20 * DURATION) + rng.uniform()) / 20 * SECOND).astype(np.int64)
    when = nuisances.stamps(stamps)
    of_interval = rng.normal(size=(DURATION + 2, 6)) * np.repeat([0.05, 0.02], 3)
    of_sample = rng.normal(size=(DURATION + 2, 6)) * 1e-3
    between = (when % SECOND / SECOND)[:, None]
    number = when // SECOND
    error = (1.0 - between) * of_sample[number] + between * of_sample[number + 1]
    error += spread(when)[:, None] * of_interval[number]
    truth = motion(when * 1e-9) @ se3.exp(error)
    poses = erring(truth, drawn(rng, Kind.DRIFT, DRIFT, stamps * 1e-9, truth[:, :3, 3]))
    poses = se3.compose(poses, nuisances.extrinsic)
    poses[:, :3, 3] /= nuisances.scale
    return stamps, poses


@pytest.mark.parametrize(
    "nuisances",
    [
        Nuisances.none(),
        Nuisances(0.02, 1e-4, se3.exp(np.array([0.1, -0.05, 0.02, 0.05, 0.0, -0.1])), 1.02),
    ],
)
def test_between_rare_samples_nothing_is_named_that_is_not_there(nuisances):
    scores = []
    for seed in range(6):
        stamps, poses = seen(seed, nuisances)
        found = fit_independent(stamps, poses, nearest_to(stamps, SAMPLES), rarely_sampled)
        assert found is not None
        assert DURATION - 3 <= found.poses <= DURATION
        scores.append(nuisance_scores(found, nuisances))
    assert np.abs(scores).max() < 4.0
    assert 0.6 < np.std(scores) < 1.3


def test_what_the_ground_truth_says_between_rare_samples_does_not_matter():
    def turned_back(stamps):
        known = rarely_sampled(stamps)
        shift = known.twists * (0.3 * np.sin(2 * np.pi * stamps / SECOND))[:, None]
        return known._replace(poses=known.poses @ se3.exp(-shift), twists=-0.9 * known.twists)

    nuisances = Nuisances(0.02, 0.0, np.eye(4), 1.0)
    stamps, poses = seen(3, nuisances)
    nearest = nearest_to(stamps, SAMPLES)
    found = fit_independent(stamps, poses, nearest, turned_back)
    assert (np.abs(nuisance_scores(found, nuisances)) < 4.0).all()


def test_more_poses_to_a_sample_change_nothing_where_all_of_them_count():
    stamps, poses = seen(1, Nuisances.none())
    known = rarely_sampled(stamps)
    one, other = (
        fit_independent(stamps, poses, stamps, rarely_sampled, known, most=500),
        fit(stamps[::4], poses[::4], rarely_sampled),
    )
    np.testing.assert_allclose(one.nuisances.vector, other.nuisances.vector, rtol=1e-9, atol=1e-12)


def test_an_estimate_with_too_few_poses_around_the_samples_has_one_of_each():
    """In bursts of eight, between which no sample's stamp can be interpolated."""
    stamps, poses = seen(2, Nuisances.none())
    burst = (stamps % SECOND > 0.3 * SECOND) & (stamps % SECOND < 0.7 * SECOND)
    stamps, poses = stamps[burst], poses[burst]
    nearest = nearest_to(stamps, SAMPLES)
    found = fit_independent(stamps, poses, nearest, rarely_sampled)
    assert found is not None
    assert found.poses == len(np.unique(nearest))


def test_poses_stamped_on_arrival_are_interpolated_where_they_can_be():
    """Two of them within a millisecond make a cubic's weights, and its noise, huge."""
    stamps, poses = seen(4, Nuisances.none())
    late = stamps + np.rint(np.random.default_rng(0).exponential(0.02, len(stamps)) * SECOND)
    order = np.argsort(late)
    late = late[order].astype(np.int64)
    late = np.maximum.accumulate(late + np.arange(len(late)))
    found = fit_independent(late, poses[order], nearest_to(late, SAMPLES), rarely_sampled)
    assert found is not None
    assert found.stamps is None
    # They move at a metre a second, and turn at half a radian.
    for group, least in (("translation", 5e-3), ("rotation", 2e-3)):
        assert least < found.groups[group]["jitter_std"].value < 10.0 * least
