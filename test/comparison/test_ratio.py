# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ratios of RMSEs: what they are, and that their intervals and p-values mean what they say."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import lfilter
from twins.runs import assert_same_summary

from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.comparison.ratio import Method, Reason, best_method, ratio_of

Array = npt.NDArray[np.float64]

METHODS: list[Method] = ["stationary_bootstrap", "block_t"]
RATE = 20
COUNT = 200 * RATE


@pytest.fixture(params=METHODS)
def method(request: pytest.FixtureRequest) -> Method:
    if request.param == "stationary_bootstrap":
        pytest.importorskip("arch")
    found: Method = request.param
    return found


def noise(rng: np.random.Generator, seconds: float, count: int = COUNT) -> Array:
    """Lengths (count,) of a vector of noise of unit variance that forgets within `seconds`."""
    white = rng.normal(size=(count + 2000, 3))
    keep = math.exp(-1.0 / (seconds * RATE)) if seconds else 0.0
    coloured = lfilter([math.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)
    return np.asarray(np.linalg.norm(coloured[-count:], axis=-1))


def walk_aligned(rng: np.random.Generator) -> Array:
    """ATE of an estimate that drifts as a random walk, aligned."""
    t = np.arange(COUNT) / RATE
    truth = np.stack((20 * np.sin(0.1 * t), 20 * np.cos(0.13 * t), 3 * np.sin(0.07 * t)), axis=1)
    estimate = truth + 0.02 * np.cumsum(rng.normal(size=(COUNT, 3)), axis=0)
    moved = align_positions(estimate, truth, "se3").transform_positions(estimate)
    return np.asarray(np.linalg.norm(moved - truth, axis=-1))


def test_ratio_is_that_of_the_rmses(method: Method) -> None:
    rng = np.random.default_rng(1)
    a, b = rng.uniform(size=(2, 500))
    found = ratio_of(a, b, "m", method)
    assert found.rmse_a == pytest.approx(math.sqrt(np.mean(a**2)), rel=1e-12)
    assert found.ratio == pytest.approx(found.rmse_a / found.rmse_b, rel=1e-12)
    assert found.interval is not None
    assert found.interval[0] < found.ratio < found.interval[1]
    assert found.errors == 500
    assert found.method == method


def test_exchange_inverts(method: Method) -> None:
    rng = np.random.default_rng(2)
    a, b = noise(rng, 0.3), 1.1 * noise(rng, 0.3)
    one, other = ratio_of(a, b, "m", method), ratio_of(b, a, "m", method)
    assert one.ratio is not None
    assert one.interval is not None
    assert other.interval is not None
    assert other.ratio == pytest.approx(1.0 / one.ratio, rel=1e-12)
    assert other.interval == pytest.approx((1 / one.interval[1], 1 / one.interval[0]), rel=1e-9)
    assert other.p_value == pytest.approx(one.p_value, rel=1e-9)


@pytest.mark.parametrize("unit", [1e-160, 1e-9, 1e9, 1e160])
def test_unit_of_length_changes_nothing(unit: float, method: Method) -> None:
    rng = np.random.default_rng(3)
    a, b = noise(rng, 0.0), noise(rng, 0.0)
    plain, scaled = ratio_of(a, b, "m", method), ratio_of(unit * a, unit * b, "m", method)
    assert scaled.rmse_a == pytest.approx(unit * plain.rmse_a, rel=1e-12)
    assert scaled.interval == pytest.approx(plain.interval, rel=1e-9)


def test_same_input_same_figures(method: Method) -> None:
    a, b = np.random.default_rng(4).uniform(size=(2, 300))
    one, again = (ratio_of(a, b, "rad", method)._asdict() for _ in range(2))
    assert_same_summary(again, one)


def test_equal_errors_are_equal(method: Method) -> None:
    a = np.random.default_rng(5).uniform(size=100)
    found = ratio_of(a, a.copy(), "m", method)
    assert (found.ratio, found.interval, found.p_value) == (1.0, (1.0, 1.0), 1.0)


def test_a_multiple_is_known_exactly(method: Method) -> None:
    a = np.random.default_rng(6).uniform(size=100)
    found = ratio_of(a, 2.0 * a, "m", method)
    assert found.interval == pytest.approx((0.5, 0.5), rel=1e-12)
    assert found.p_value == 0.0


@pytest.mark.parametrize(
    ("a", "b", "ratio", "reason"),
    [
        (np.ones(19), np.arange(19.0), pytest.approx(111.0**-0.5), Reason.TOO_FEW),
        (np.ones(1), np.ones(1), 1.0, Reason.TOO_FEW),
        (np.zeros(50), np.ones(50), 0.0, Reason.ZERO),
        (np.ones(50), np.zeros(50), None, Reason.ZERO),
        (np.zeros(50), np.zeros(50), None, Reason.ZERO),
    ],
)
def test_where_nothing_can_be_told(
    a: Array, b: Array, ratio: float | None, reason: Reason, method: Method
) -> None:
    found = ratio_of(a, b, "m", method)
    assert (found.ratio, found.interval, found.p_value, found.reason) == (ratio, None, None, reason)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (np.ones(3), np.ones(4)),
        (np.ones(0), np.ones(0)),
        (np.ones((3, 1)), np.ones((3, 1))),
        (np.array([1.0, np.nan]), np.ones(2)),
    ],
)
def test_refuses(a: Array, b: Array) -> None:
    with pytest.raises(ValueError, match="errors must"):
        ratio_of(a, b, "m", "block_t")


@pytest.mark.parametrize("count", [20, 21, 40, 127, 128, 129, 300])
def test_short_runs_have_finite_intervals(count: int, method: Method) -> None:
    for seed in range(20):
        a, b = np.random.default_rng([count, seed]).exponential(size=(2, count))
        found = ratio_of(a, b, "m", method)
        if found.reason is None:
            assert found.interval is not None
            assert found.p_value is not None
            assert 0.0 < found.interval[0] < found.interval[1] < math.inf
            assert 0.0 <= found.p_value <= 1.0


def test_without_arch_the_simpler_interval_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "arch", None)
    assert best_method() == "block_t"
    a, b = np.random.default_rng(7).uniform(size=(2, 100))
    assert ratio_of(a, b, "m").method == "block_t"


# White noise, and noise that is remembered for a fiftieth of the run.
@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.0, 4.0])
def test_equals_come_out_different_as_often_as_said(seconds: float, method: Method) -> None:
    different = 0
    for seed in range(400):
        rng = np.random.default_rng([int(seconds), seed])
        found = ratio_of(noise(rng, seconds), noise(rng, seconds), "m", method)
        different += found.p_value is not None and found.p_value < 0.05
    assert 0.025 * 400 <= different <= 0.08 * 400


def test_ten_per_cent_more_noise_is_found(method: Method) -> None:
    found = 0
    for seed in range(20):
        rng = np.random.default_rng([10, seed])
        ratio = ratio_of(noise(rng, 0.2), 1.1 * noise(rng, 0.2), "m", method)
        assert ratio.p_value is not None
        assert ratio.ratio is not None
        found += ratio.p_value < 0.05 and ratio.ratio < 1.0
    assert found >= 15


def test_shared_error_is_taken_out(method: Method) -> None:
    """What both share, the ground truth's error, hides nothing: that is what pairing is for."""
    rng = np.random.default_rng(11)
    shared = noise(rng, 2.0)
    a, b = shared + 0.1 * noise(rng, 0.0), shared + 0.12 * noise(rng, 0.0)
    paired = ratio_of(a, b, "m", method)
    apart = ratio_of(a, np.roll(b, COUNT // 2), "m", method)
    assert paired.interval is not None
    assert apart.interval is not None
    assert np.ptp(paired.interval) < 0.3 * np.ptp(apart.interval)


def test_a_single_walk_has_no_interval(method: Method) -> None:
    """Two that drift alike differ by chance on every run: most are said to be one walk."""
    withheld = different = 0
    for seed in range(100):
        rng = np.random.default_rng([12, seed])
        found = ratio_of(walk_aligned(rng), walk_aligned(rng), "m", method)
        withheld += found.reason is Reason.ONE_WALK
        different += found.p_value is not None and found.p_value < 0.05
    assert withheld >= 80
    assert different <= 10
