# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two estimates of one run: what they have in common, their errors, the sentence."""

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import se3
from trajeval_ros.comparison.common import Evaluated, Extent, coverage, pair_nearest
from trajeval_ros.comparison.compare import Comparison, compare
from trajeval_ros.comparison.errors import errors_of, steps
from trajeval_ros.comparison.ratio import Ratio, Reason
from trajeval_ros.comparison.words import sentence, sentences
from trajeval_ros.conventional.running import RunningConventional

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
SECOND = 1_000_000_000


def ns(seconds: npt.ArrayLike) -> Stamps:
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def truth_at(stamps: Stamps) -> Array:
    t = stamps * 1e-9
    zero = np.zeros_like(t)
    position = np.stack((3 * np.sin(0.5 * t), 2 * np.cos(0.7 * t), np.sin(0.3 * t)), axis=-1)
    turn = np.stack((0.3 * np.sin(t), zero, 0.5 * t), axis=-1)
    poses = se3.exp(np.concatenate((np.zeros_like(position), turn), axis=-1))
    poses[:, :3, 3] = position
    return poses


def estimate_of(
    name: str, stamps: Stamps, noise: float, seed: int, scale: float = 1.0
) -> Evaluated:
    rng = np.random.default_rng(seed)
    truth = truth_at(stamps)
    world = se3.exp(rng.normal(size=6))
    poses = world @ truth @ se3.exp(noise * rng.normal(size=(len(stamps), 6)))
    poses[:, :3, 3] *= scale
    return Evaluated(name, stamps, truth, poses)


RUN = ns(np.arange(0, 60, 0.1))


# Pairs


def pairs_one_by_one(a: Stamps, b: Stamps) -> list[tuple[int, int]]:
    """The definition, in a loop."""
    interval = max(float(np.median(np.diff(s))) if len(s) > 1 else 0.0 for s in (a, b))
    found = []
    for i, stamp in enumerate(a):
        j = int(np.argmin(np.abs(b - stamp)))
        if int(np.argmin(np.abs(a - b[j]))) == i and 2 * abs(b[j] - stamp) <= interval:
            found.append((i, j))
    return found


STAMPS = st.sets(st.integers(-40, 200), min_size=1, max_size=30).map(
    lambda stamps: np.array(sorted(stamps), dtype=np.int64)
)


@given(STAMPS, STAMPS)
def test_pairs_are_each_others_nearest(a: Stamps, b: Stamps) -> None:
    index_a, index_b = pair_nearest(a, b)
    assert list(zip(index_a.tolist(), index_b.tolist(), strict=True)) == pairs_one_by_one(a, b)
    assert np.all(np.diff(index_a) > 0)
    assert np.all(np.diff(index_b) > 0)


def test_different_rates_pair_at_the_lower_one() -> None:
    fast, slow = ns(np.arange(0, 10, 0.005)), ns(np.arange(0.002, 10, 0.1))
    index_fast, index_slow = pair_nearest(fast, slow)
    assert index_slow.tolist() == list(range(len(slow)))
    assert np.abs(fast[index_fast] - slow).max() <= ns(0.0025)


def test_nothing_pairs_with_nothing() -> None:
    none = np.empty(0, dtype=np.int64)
    assert [len(index) for index in pair_nearest(none, RUN)] == [0, 0]


# Coverage


def test_coverage_says_what_one_alone_covers() -> None:
    a = RUN
    b = RUN[(ns(10) <= RUN) & (ns(20) >= RUN) | (ns(30) <= RUN)]
    index_a, _ = pair_nearest(a, b)
    found = coverage(a, b, len(index_a))
    assert found.common.poses == len(b)
    assert found.common.seconds == pytest.approx(10.0 + 29.9, abs=1e-6)
    assert found.only_a.seconds == pytest.approx(10.0 + 10.0, abs=1e-6)
    assert found.only_a.poses == len(a) - len(b)
    assert found.only_b == Extent(0, 0.0)


def test_a_lower_rate_or_a_lost_frame_covers_as_much() -> None:
    fast, slow = ns(np.arange(0, 10.001, 0.005)), ns(np.arange(0, 10.001, 0.1))
    slow = np.delete(slow, 50)
    found = coverage(fast, slow, 0)
    assert found.only_a == found.only_b == Extent(0, 0.0)
    assert found.common.seconds == pytest.approx(10.0)


@given(STAMPS, STAMPS)
def test_coverage_is_symmetric(a: Stamps, b: Stamps) -> None:
    one, other = coverage(a * SECOND, b * SECOND, 0), coverage(b * SECOND, a * SECOND, 0)
    assert (one.common, one.only_a, one.only_b) == (other.common, other.only_b, other.only_a)


# Errors


@pytest.mark.parametrize("gauge", ["se3", "yaw_translation", "sim3", "none"])
def test_errors_are_the_conventional_ones(gauge: str) -> None:
    estimate = estimate_of("a", RUN, 0.02, 1, scale=0.5)
    begin, end = steps(estimate, 1.0, "s")
    found = errors_of(estimate, begin, end, gauge, 1.0, "s")  # type: ignore[arg-type]
    running = RunningConventional(gauge, 1.0, "s")  # type: ignore[arg-type]
    running.update(estimate.stamps, estimate.ground_truth, estimate.estimate)
    known = running.figures()
    assert found.ate_translation is not None
    assert rms(found.ate_translation) == pytest.approx(known.ate_translation_rmse, rel=1e-9)
    if known.ate_rotation_rmse is None:
        assert found.ate_rotation is None
    else:
        assert found.ate_rotation is not None
        assert rms(found.ate_rotation) == pytest.approx(known.ate_rotation_rmse, rel=1e-9)
    # Of all steps, those that the conventional figure takes: from where the last one ended.
    chosen = np.arange(0, len(begin), 10)
    assert found.re_translation is not None
    assert rms(found.re_translation[chosen]) == pytest.approx(known.re_translation_rmse, rel=1e-9)
    assert rms(found.re_rotation[chosen]) == pytest.approx(known.re_rotation_rmse, rel=1e-9)
    # Of figures that were there already, in other pieces, they are the same.
    halves = RunningConventional(gauge, 1.0, "s")  # type: ignore[arg-type]
    for half in (slice(70), slice(70, None)):
        halves.update(estimate.stamps[half], estimate.ground_truth[half], estimate.estimate[half])
        halves.figures()
    again = errors_of(estimate, begin, end, gauge, 1.0, "s", halves.figures())  # type: ignore[arg-type]
    for one, other in zip(found, again, strict=True):
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-12)


def rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def test_steps_end_at_the_first_pose_a_step_later_and_leave_gaps_out() -> None:
    stamps = RUN[(ns(20) > RUN) | (ns(25) <= RUN)]
    begin, end = steps(estimate_of("a", stamps, 0.0, 1), 1.0, "s")
    assert set(np.diff([stamps[begin], stamps[end]], axis=0).ravel()) == {SECOND}
    assert len(begin) == len(stamps) - 20


def test_no_step_ends_where_it_begins() -> None:
    begin, end = steps(estimate_of("a", ns(np.arange(50) * 1e-9), 0.0, 1), 1e-9, "s")
    assert np.all(end - begin == 1)
    assert len(steps(estimate_of("a", RUN, 0.0, 1), 1e-9, "s")[0]) == 0


def test_steps_in_metres_are_along_the_ground_truth() -> None:
    estimate = estimate_of("a", RUN, 0.0, 1, scale=7.0)
    begin, end = steps(estimate, 2.0, "m")
    path = np.concatenate(
        ([0.0], np.cumsum(np.linalg.norm(np.diff(estimate.ground_truth[:, :3, 3], axis=0), axis=1)))
    )
    walked = path[end] - path[begin]
    assert len(begin) > 100
    assert walked.min() >= 2.0
    assert (path[end - 1] - path[begin]).max() < 2.0


# Comparison


def test_the_better_one_is_named_with_its_interval() -> None:
    found = compare(estimate_of("one", RUN, 0.02, 1), estimate_of("other", RUN, 0.04, 2))
    assert found.re_translation is not None
    assert found.re_translation.ratio == pytest.approx(0.5, abs=0.05)
    text = sentence(found)
    assert text.startswith("one's translation drifts ")
    assert "its rotation drifts " in text
    assert text.endswith("both cover 60 s")
    back = sentence(compare(estimate_of("other", RUN, 0.04, 2), estimate_of("one", RUN, 0.02, 1)))
    assert back == text


def test_each_is_aligned_over_what_both_cover() -> None:
    """Where a alone covers the rest of the run, what it does there is not held against it."""
    a, b = estimate_of("a", RUN, 0.02, 1), estimate_of("b", RUN[:300], 0.02, 2)
    off = a.estimate.copy()
    off[310:, :3, 3] += 100.0
    found = compare(a, b)
    with_rest = compare(dataclasses.replace(a, estimate=off), b)
    assert with_rest == found
    assert sentence(found).startswith("a alone covers 30 s; ")


def test_without_common_poses_it_says_so() -> None:
    found = compare(estimate_of("a", RUN, 0.02, 1), estimate_of("b", RUN + ns(100), 0.02, 2))
    assert found.ate_translation is None
    assert found.re_rotation is None
    assert sentence(found) == "a and b have no poses in common"


def test_of_several_pairs_each_says_which_it_is() -> None:
    a, b, c = (estimate_of(name, RUN[:100], 0.02, seed) for seed, name in enumerate("abc"))
    pairs = [compare(a, b), compare(a, c)]
    assert sentences(pairs[:1]) == [sentence(pairs[0])]
    assert sentences(pairs) == [f"a vs b: {sentence(pairs[0])}", f"a vs c: {sentence(pairs[1])}"]


@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_a_few_poses_are_too_few(count: int) -> None:
    found = compare(estimate_of("a", RUN[:count], 0.02, 1), estimate_of("b", RUN[:count], 0.02, 2))
    assert found.coverage.common.poses == count
    for ratio in (found.ate_translation, found.ate_rotation, found.re_translation):
        assert ratio is None or ratio.reason is Reason.TOO_FEW
    assert "both cover" in sentence(found)


def test_figures_are_plain_values() -> None:
    import json

    found = compare(estimate_of("a", RUN, 0.02, 1), estimate_of("b", RUN, 0.02, 2)).figures()
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["common"] == {"poses": 600, "seconds": pytest.approx(59.9)}
    ratio = found["ate_translation"]
    assert isinstance(ratio, dict)
    assert {"ratio", "interval", "p_value"} <= set(ratio)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"stamps": RUN[:-1]}, "must be"),
        ({"stamps": RUN * 1e-9}, "int64"),
        ({"stamps": RUN[::-1]}, "increase"),
        ({"estimate": np.full((600, 4, 4), np.nan)}, "finite"),
    ],
)
def test_refuses_what_cannot_be_compared(change: dict[str, Array], reason: str) -> None:
    good = estimate_of("mine", RUN, 0.02, 1)
    with pytest.raises(ValueError, match=f"mine: .*{reason}"):
        dataclasses.replace(good, **change)


# The sentence


def ratio(value: float, low: float, high: float, p_value: float) -> Ratio:
    return Ratio(value, 1.0, "m", 900, value, (low, high), p_value, "block_t", 9.0)


def test_the_sentence_is_one_to_repeat() -> None:
    comparison = Comparison(
        a="pl_vio",
        b="vins_mono",
        coverage=coverage(RUN, RUN[:300], 300),
        ate_translation=None,
        ate_rotation=None,
        re_translation=ratio(1.0 / 0.96, 1.0 / 0.99, 1.0 / 0.93, 0.01),
        re_rotation=ratio(1.01, 0.9, 1.1, 0.8),
    )
    assert sentence(comparison) == (
        "pl_vio alone covers 30 s; vins_mono's translation drifts 4 % less (95 %: 1 to 7 %),"
        " rotation drift no difference to be told; both cover 30 s"
    )
