# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error model as a status of ``~/metrics``, and back."""

from typing import Any

import pytest

from trajeval_ros.report.answers import leading
from trajeval_ros.runs.statuses import error_model_entries, error_models_of


def figure(value: float, std: float | None = 0.001) -> dict[str, float | None]:
    return {"value": value, "std": std}


def model(kind: str, std: float | None = 0.001) -> dict[str, Any]:
    part = {
        "drift": {"jitter_std": figure(0.01), "long_run_drift": figure(0.02, std)},
        "wander": {
            "jitter_std": figure(0.01),
            "wander_std": figure(0.02, std),
            "wander_time": figure(3.0, 0.5),
        },
    }[kind]
    return {
        "model": kind,
        "translation": part,
        "rotation": part,
        "clock_offset": figure(0.02),
        "clock_offset_by": {"translation": figure(0.01), "rotation": figure(0.03)},
        "clock_rate": figure(1e-5, 1e-6),
        "extrinsic": {
            "translation": {"value": [0.1, 0.0, -0.2], "std": [0.01, 0.02, 0.03]},
            "rotation": {"value": [0.0, 0.3, 0.0], "std": [0.01, 0.02, 0.03]},
            "length": figure(0.22, 0.02),
            "length_nats": 60.5,
            "angle": figure(0.3, 0.02),
            "angle_nats": 112.5,
            "pose": [0.0] * 7,
        },
        "scale": figure(1.01, 0.002),
        "covariance": [[1.0]],
        "unobserved": [],
        "poses": 100,
        "log_likelihood": 12.5,
        "nats_per_pose": 3.0,
        "nats_per_pose_uncorrected": 1.0,
        "chi2_per_dof": 1.0,
        "whiteness": {"translation": [0.01, 0.02], "rotation": [0.03]},
        "jumps": [{"stamp": 1, "translation": 0.1, "rotation": 0.1}],
        "clock_changes": [],
        "fit": "blocks",
    }


def read(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


@pytest.mark.parametrize("kind", ["drift", "wander"])
@pytest.mark.parametrize("std", [0.001, None])
def test_what_the_status_has_comes_back(kind: str, std: float | None) -> None:
    models = {"run": model(kind, std), "window": model("drift")}
    models["run"] |= {
        "stamp_std": figure(0.01),
        "stamp_nats": 30.0,
        "stamp_errors": {"translation": 0.02, "rotation": 0.03},
    }
    entries = {key: read(value) for key, value in error_model_entries(models).items()}
    found = error_models_of(entries)
    assert found.keys() == models.keys()
    for part, before in models.items():
        after = found[part]
        for name in ("translation", "rotation", "clock_offset", "clock_offset_by", "scale"):
            assert after[name] == before[name]
        for group in ("translation", "rotation", "length", "length_nats", "angle", "angle_nats"):
            assert after["extrinsic"][group] == before["extrinsic"][group]
        assert after["model"] == before["model"]
        assert after["chi2_per_dof"] == 1.0
        assert after["jumps"] == 1.0
        assert leading(after) == leading(before)


def test_a_window_alone_is_a_window() -> None:
    entries = error_model_entries({"window": model("drift")})
    assert error_models_of(entries).keys() == {"window"}
    assert error_models_of({}) == {}
