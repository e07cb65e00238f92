# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A session whose ground truth has no orientation."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twins.runs import FIXED, simulated

import trajeval_ros as te
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.runs.session import Session

SECOND = 1_000_000_000
FIGURES = ("relative", "absolute", "lever_arm", "window", "conventional", "coverage")


def test_its_report_has_no_notice_of_likelihoods(tmp_path: Path) -> None:
    made = simulated(1, 20.0, (50.0, 10.0))
    truth = made.ground_truth
    values = complete({"gp.hyperparameters": "fixed", "output.directory": str(tmp_path)})
    session = Session(values, {"ground truth": "/prism", "estimate": "/odometry"})
    session.note_without_orientation(0)
    unturned = np.tile([0.0, 0.0, 0.0, 1.0], (len(truth), 1))
    session.feed(PoseSamples(truth.stamps, truth.positions, unturned), made.estimate)
    session.finish_all()
    session.save(last=True)
    session.close()
    assert "first order does not hold" not in (tmp_path / "report.html").read_text("utf-8")


def test_on_a_straight_line_it_says_what_is_left_out() -> None:
    seconds = np.arange(0.0, 20.0, 0.1)
    positions = np.stack([seconds, 0.0 * seconds, 0.0 * seconds], axis=1)
    unturned = np.tile([0.0, 0.0, 0.0, 1.0], (len(seconds), 1))
    samples = PoseSamples(SECOND + np.rint(seconds * SECOND).astype(np.int64), positions, unturned)
    sources = {"ground truth": "/prism", "estimate": "/odometry"}
    session = Session(complete({"gp.hyperparameters": "fixed"}), sources)
    session.note_without_orientation(0)
    session.feed(samples, samples)
    notices = session.finish_all()["estimate"].notices
    (text,) = (each.text for each in notices if each.code == "alignment_undetermined")
    assert "along a line alone" in text
    assert "the lever arm is not told" in text
    assert "conventional rotation error" not in text


def without_orientation(samples: PoseSamples) -> PoseSamples:
    unturned = np.tile([0.0, 0.0, 0.0, 1.0], (len(samples), 1))
    return PoseSamples(samples.stamps, samples.positions, unturned)


def flat(figures: dict[str, Any], below: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in figures.items():
        if isinstance(value, dict):
            found |= flat(value, f"{below}{key}.")
        elif isinstance(value, list) and value and not isinstance(value[0], float):
            found |= flat({str(n): row for n, row in enumerate(value)}, f"{below}{key}.")
        else:
            found[f"{below}{key}"] = value
    return found


@pytest.mark.parametrize(
    ("gauge", "pieces", "declared"), [("se3", 40, True), ("se3", 3, False), ("sim3", 25, False)]
)
def test_live_is_as_in_a_file(gauge: str, pieces: int, declared: bool, tmp_path: Path) -> None:
    """Also where no message says that there is no orientation, and it shows only later."""
    made = simulated(1, 16.0, (50.0, 10.0), dropouts=((9.0, 10.5),))
    truth, values = without_orientation(made.ground_truth), {**FIXED, "gauge": gauge}
    values |= {"window.duration": 8.0, "output.directory": str(tmp_path)}
    sources = {"ground truth": "/prism", "estimate": "/odometry"}
    session = Session(complete(values), sources)
    if declared:
        session.note_without_orientation(0)
    found = []
    for n in range(pieces):
        parts = []
        for topic in (truth, made.estimate):
            begin, end = (len(topic) * k // pieces for k in (n, n + 1))
            parts.append(topic[begin:end])
        session.feed(*parts)
        found.append(session.advance(None))
        session.figures()
    found.append(session.finish())
    session.save(last=True)
    session.close()
    assert session.is_position_only()
    assert all(np.isnan(each.evaluations.relative_error[:, 3:]).all() for each in found[-2:])
    live = json.loads((tmp_path / "summary.json").read_text())

    trajectories = [
        te.Trajectory(each.stamps, np.column_stack([each.positions, each.quaternions]))
        for each in (truth, made.estimate)
    ]
    settings = {key.replace(".", "_"): value for key, value in values.items() if "out" not in key}
    file = te.evaluate(*trajectories, **settings).summary
    for part in FIGURES:
        mine, others = (flat({part: each[part]}) for each in (live, file))
        mine, others = (
            {k: v for k, v in each.items() if "error_model" not in k} for each in (mine, others)
        )
        assert mine.keys() == others.keys()
        for key, value in mine.items():
            wanted = others[key]
            if isinstance(value, float) or (isinstance(value, list) and value):
                close = 1e-7 if "std" in key or "covariance" in key else 1e-9
                wanted = pytest.approx(wanted, rel=close, abs=1e-9)
            assert value == wanted, key
    assert live["absolute"]["consistency"] < 1e-9
    assert live["relative"]["log_likelihood"] is not None
    assert live["lever_arm"] is not None
    # Of the model live has the poses, the ground truth as it was answered, and a file all of it.
    models = [each["error_model"] for each in (live, file)]
    assert models[0]["fit"] == "thinned"
    for name in ("clock_offset",):
        value, std = (models[0][name][key] for key in ("value", "std"))
        assert abs(value - models[1][name]["value"]) < std


def test_the_error_model_of_a_long_run_is_in_bounded_memory() -> None:
    made = simulated(2, 60.0, (20.0, 50.0))
    session = Session(complete(dict(FIXED)), {"ground truth": "/prism", "estimate": "/odometry"})
    session.note_without_orientation(0)
    session.feed(without_orientation(made.ground_truth), made.estimate)
    session.finish_all()
    while session.fit_error_model(last=True):
        pass
    models = session.error_models_of()
    assert 1000 < models["run"]["poses"] <= 2000 < len(made.estimate)
    assert 1000 < models["window"]["poses"] <= 2000
    assert "rotation" not in models["run"]
    session.reset()
    assert session.error_models_of() == {}
    assert session.is_position_only()
