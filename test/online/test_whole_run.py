# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures over sub-trajectories, as the summary has them."""

import json
from typing import Any

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands.figures import no_drift
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.settings import EvaluationSettings, settings_of
from trajeval_ros.online.whole_run import Poses, drift

COUNT = 600


def poses(speed: float, scale: float = 1.0, noise: float = 0.01) -> Poses:
    """A minute at 10 Hz, straight on with a slow turn."""
    rng = np.random.default_rng(3)
    turn = 0.01 * np.arange(COUNT) / 10.0
    truth = se3.exp(np.column_stack([np.zeros((COUNT, 3)), np.zeros((COUNT, 2)), turn]))
    truth[:, 0, 3] = speed * np.arange(COUNT) / 10.0
    truth[:, :3, 3] += 0.001 * rng.normal(size=(COUNT, 3))
    estimate = se3.compose(truth, se3.exp(noise * rng.normal(size=(COUNT, 6)) * [1, 1, 1, 0, 0, 0]))
    estimate[:, :3, 3] *= scale
    covariance = np.tile(np.diag([1e-6] * 3 + [1e-8] * 3), (COUNT, 1, 1))
    stamps = np.arange(COUNT, dtype=np.int64) * 100_000_000
    return Poses(stamps, truth, covariance, estimate, np.ones(COUNT, dtype=bool))


def settings(**parameters: Any) -> EvaluationSettings:
    return settings_of(complete(parameters)).evaluation


def test_a_drive() -> None:
    found = drift(poses(4.0), settings())
    assert found["path_length"] == pytest.approx(240.0, abs=2.0)
    assert [each["length"] for each in found["kitti"]["lengths"]] == [100.0, 200.0]
    # Noise of a centimetre at either end, over 100 m and 200 m.
    assert 0.00005 < found["kitti"]["translation"] < 0.0004
    assert [round(box["length"]) for box in found["sub_trajectories"]] == [24, 48, 72, 96, 120]
    assert found["all_pairs"]["pairs"] == COUNT - 10
    assert found["all_pairs"]["re_translation_rmse"] == pytest.approx(0.01 * 6**0.5, rel=0.1)
    json.dumps(found, allow_nan=False)
    assert no_drift(found) == ""
    single = drift(poses(4.0), settings(), spread=False)
    assert single == {**found, "sub_trajectories": []}


def test_a_walk_shorter_than_the_shortest() -> None:
    found = drift(poses(1.0), settings())
    assert found["kitti"] is None
    assert len(found["sub_trajectories"]) == 5
    assert "m long, and it takes 100 m and more" in no_drift(found)


def test_standing() -> None:
    found = drift(poses(0.0), settings())
    assert (found["path_length"], found["kitti"], found["sub_trajectories"]) == (
        None,
        None,
        [],
    )
    # What has nothing to do with a path is there.
    assert found["all_pairs"]["pairs"] == COUNT - 10
    assert "not known beyond the ground truth's noise" in no_drift(found)


def test_its_own_metre() -> None:
    right = drift(poses(4.0), settings())
    found = drift(poses(4.0, scale=0.5), settings(gauge="sim3"))
    for part in ("translation", "rotation"):
        assert found["kitti"][part] == pytest.approx(right["kitti"][part], rel=0.01)
    unscaled = drift(poses(4.0, scale=0.5), settings())
    assert unscaled["kitti"]["translation"] == pytest.approx(0.5, rel=0.02)


def test_gaps_are_left_out() -> None:
    whole = poses(4.0)
    known = np.arange(COUNT) % 3 != 0
    found = drift(
        Poses(whole.stamps, whole.ground_truth, whole.covariance, whole.estimate, known),
        settings(**{"relative.unit": "f", "relative.delta": 5}),
    )
    assert found["all_pairs"]["pairs"] == known.sum() - 5
    nothing = Poses(
        whole.stamps, whole.ground_truth, whole.covariance, whole.estimate, np.zeros(COUNT, bool)
    )
    assert drift(nothing, settings())["all_pairs"] is None
