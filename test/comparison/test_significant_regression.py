# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Worse than before: seldom said of what has not changed, and said of what has."""

from typing import Any

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.comparison.compare import Evaluated, compare
from trajeval_ros.comparison.regression import (
    NEGLIGIBLE,
    Change,
    decided,
    lost_seconds,
    paired,
    unpaired,
)

RATE, COUNT = 20, 4000


def truth() -> Any:
    t = np.arange(COUNT) / RATE
    steps = np.stack(
        (5 * np.sin(0.3 * t), 5 * np.cos(0.4 * t), np.sin(0.2 * t), 0 * t, 0 * t, 0.1 * t), axis=1
    )
    return se3.exp(steps)


TRUTH = truth()


def run(rng: np.random.Generator, scale: float = 1.0, name: str = "now") -> Evaluated:
    noise = scale * rng.normal(size=(COUNT, 6)) * [0.01, 0.01, 0.01, 0.002, 0.002, 0.002]
    stamps = np.arange(COUNT, dtype=np.int64) * (10**9 // RATE)
    return Evaluated(name, stamps, TRUTH, se3.compose(TRUTH, se3.exp(noise)))


def is_worse(now: Evaluated, before: Evaluated) -> bool:
    changes = paired(compare(now, before, method="block_t"))
    assert [change.name for change in changes] == [
        "ate_translation",
        "ate_rotation",
        "re_translation",
        "re_rotation",
    ]
    return any(change.worse for change in changes)


def test_what_has_not_changed_is_hardly_ever_worse() -> None:
    rng = np.random.default_rng(5)
    runs = 40
    worse = sum(is_worse(run(rng), run(rng)) for _ in range(runs))
    # The gate is meant to be wrong in one of twenty: more than 6 of 40 come in one of 300.
    assert worse <= 6


def test_a_tenth_more_noise_is_worse_and_a_tenth_less_is_not() -> None:
    rng = np.random.default_rng(6)
    for _ in range(4):
        before = run(rng)
        assert is_worse(run(rng, 1.1), before)
        assert not is_worse(run(rng, 0.9), before)
        assert not is_worse(before, before)


def change(now: float, p_value: float | None) -> Change:
    return Change("ate_translation", now, 1.0, None, p_value)


def test_of_more_figures_each_must_be_surer() -> None:
    # One-sided, 5 % over all that can be judged.
    assert decided([change(1.1, 0.09)])[0].worse
    assert not decided([change(1.1, 0.09), change(1.0, 1.0)])[0].worse
    assert decided([change(1.1, 0.09), change(1.0, None)])[0].worse
    assert decided([change(1.1, 0.024), *[change(1.0, 1.0)] * 3])[0].worse
    assert not decided([change(1.1, 0.026), *[change(1.0, 1.0)] * 3])[0].worse


def test_what_is_negligible_or_better_is_not_worse() -> None:
    assert not decided([change(1.0 + 0.9 * NEGLIGIBLE, 0.0)])[0].worse
    assert decided([change(1.0 + 1.1 * NEGLIGIBLE, 0.0)])[0].worse
    assert not decided([change(0.5, 0.0)])[0].worse


def model(jitter: float, drift: float | None = None, share: float = 0.05) -> dict[str, Any]:
    figures = {"jitter_std": {"value": jitter, "std": share * jitter}}
    if drift is not None:
        figures["drift_std"] = {"value": drift, "std": share * drift}
    return {"error_model": {"translation": figures, "rotation": {}}}


def test_without_poses_the_error_models_are_compared() -> None:
    (found,) = unpaired(model(0.012), model(0.010))
    # 18 % apart, and 7 % uncertain.
    assert found.interval is not None
    assert found.interval[0] == pytest.approx(1.2 / np.exp(1.96 * 0.05 * 2**0.5), rel=1e-4)
    assert found.worse
    assert not unpaired(model(0.010), model(0.012))[0].worse
    assert not unpaired(model(0.012, share=0.2), model(0.010, share=0.2))[0].worse
    names = [each.name for each in unpaired(model(0.01, 0.02), model(0.01, 0.02))]
    assert names == ["translation.jitter_std", "translation.drift_std"]
    # Told by other parameters, jitter is another figure.
    assert unpaired(model(0.01, 0.02), model(0.01)) == ()
    assert unpaired({}, model(0.01)) == ()
    zero = {"error_model": {"translation": {"jitter_std": {"value": 0.0, "std": None}}}}
    (found,) = unpaired(zero, model(0.01))
    assert (found.p_value, found.worse) == (None, False)
    # Beside nothing there is no ratio, but a difference.
    zero["error_model"]["translation"]["jitter_std"]["std"] = 0.001
    assert not unpaired(zero, model(0.01))[0].worse
    assert unpaired(model(0.01), zero)[0].worse
    assert not unpaired(model(0.0001), zero)[0].worse


def walking(rng: np.random.Generator, scale: float, name: str) -> Evaluated:
    """Odometry whose heading drifts: its ATE is one walk."""
    heading = np.cumsum(scale * rng.normal(size=COUNT)) * 1e-4
    steps = np.zeros((COUNT, 6))
    steps[:, 0], steps[:, 5] = 1.0 / RATE, heading
    forward = np.tile(np.eye(4), (COUNT, 1, 1))
    forward[:, 0, 3] = np.arange(COUNT) / RATE
    estimate = se3.exp(np.zeros((COUNT, 6)))
    estimate[:, :2, 3] = np.cumsum(np.stack((np.cos(heading), np.sin(heading)), 1), axis=0) / RATE
    estimate[:, :3, :3] = se3.exp_so3(np.stack((0 * heading, 0 * heading, heading), axis=1))
    stamps = np.arange(COUNT, dtype=np.int64) * (10**9 // RATE)
    return Evaluated(name, stamps, forward, estimate)


def ate_of(changes: Any) -> Change:
    return next(change for change in changes if change.name == "ate_translation")


def test_an_ate_that_is_one_walk_is_judged_as_one() -> None:
    rng = np.random.default_rng(7)
    changes = []
    for _ in range(60):
        pair = compare(walking(rng, 1.0, "now"), walking(rng, 1.0, "before"), method="block_t")
        changes.append(ate_of(paired(pair, ["ate_translation"])))
    walks = [change for change in changes if change.reason == "one_walk"]
    assert len(walks) > 40
    assert all(change.interval is not None for change in walks)
    # One of twenty: more than 7 of 60 come in one of a hundred.
    assert sum(change.worse for change in walks) <= 7
    # A map that is no longer corrected: thirty times the walk.
    lost = compare(walking(rng, 30.0, "now"), walking(rng, 1.0, "before"), method="block_t")
    assert ate_of(paired(lost)).worse


def test_what_was_exact_and_is_no_longer_is_worse() -> None:
    rng = np.random.default_rng(8)
    exact = Evaluated("before", run(rng).stamps, TRUTH, TRUTH)
    assert all(change.worse for change in paired(compare(run(rng), exact)))
    assert not any(change.worse for change in paired(compare(exact, exact)))
    assert not any(change.worse for change in paired(compare(exact, run(rng))))


def test_what_is_no_longer_covered() -> None:
    stamps = np.arange(0, 100 * 10**9, 10**8, dtype=np.int64)
    assert lost_seconds(stamps, stamps) == 0.0
    assert lost_seconds(stamps[:-5], stamps) == 0.0
    assert lost_seconds(stamps[:500], stamps) == pytest.approx(50.0, abs=0.1)
    # Half as many poses a second cover as much.
    assert lost_seconds(stamps[::2], stamps) == 0.0
    assert lost_seconds(stamps, stamps[:500]) == 0.0


def test_what_may_be_zero_is_no_ratio() -> None:
    """A jitter of next to nothing, known to a millimetre, has no logarithm worth the name."""
    nothing = model(1e-9)
    nothing["error_model"]["translation"]["jitter_std"]["std"] = 1e-3
    (found,) = unpaired(model(1e-3), nothing)
    assert found.interval is None
    assert found.reason == "zero"
    assert not found.worse
    assert unpaired(model(0.05), nothing)[0].worse
