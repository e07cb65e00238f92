# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The latest whole trajectory, scored by what the ground truth answered to its poses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twins.runs import assert_same_summary

from trajeval_ros import se3
from trajeval_ros.alignment.umeyama import align_positions
from trajeval_ros.files.output import LATEST_PATH
from trajeval_ros.files.tum import read_tum
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.results import NO_EVALUATIONS, Evaluations
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.online.settings import settings_of
from trajeval_ros.report.after_closure import after_closure
from trajeval_ros.runs import latest_path
from trajeval_ros.runs.beside import outcome_of
from trajeval_ros.runs.latest_path import LatestPath, on_positions, scored
from trajeval_ros.runs.session import Session

SECOND = 1_000_000_000
SETTINGS = settings_of(complete({}))
PARTS = (SETTINGS.evaluation, SETTINGS.estimates["estimate"])


def motion(count: int) -> Any:
    t = np.arange(count) * 0.1
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = se3.exp_so3(np.stack([0.1 * np.sin(t), 0.2 * np.cos(t), 0.1 * t], axis=1))
    poses[:, :3, 3] = np.stack([5 * np.sin(0.3 * t), 3 * np.cos(0.2 * t), 0.5 * np.sin(t)], axis=1)
    return poses


def run(count: int) -> tuple[Any, Any, Any]:
    """Stamps, ground truth, and an estimate that drifts."""
    truth = motion(count)
    twist = np.array([0.2, -0.1, 0.1, 0.0, 0.0, 0.02])
    drift = se3.exp(np.linspace(0.0, 1.0, count)[:, None] * twist)
    return SECOND + np.arange(count) * SECOND // 10, truth, drift @ truth


def evaluated(stamps: Any, truth: Any, estimate: Any) -> Evaluations:
    """Evaluations with only what is looked at here."""
    filler = {
        name: np.zeros((len(stamps), *getattr(NO_EVALUATIONS, name).shape[1:]))
        for name in NO_EVALUATIONS.__slots__
    }
    filler |= {"stamps": stamps, "ground_truth": truth, "estimate": estimate}
    return Evaluations(**{**filler, "sampled": np.ones(len(stamps), dtype=np.bool_)})


def test_before_and_after() -> None:
    """Of the same poses; a path that lacks some, and has others, too."""
    stamps, truth, drifted = run(300)
    world = se3.exp(np.array([1.0, 2.0, 3.0, 0.3, 0.2, 0.1]))
    path = PoseSamples(stamps[100:] + 0, *se3.to_position_quaternion(world @ truth[100:]))
    found = scored(path, [evaluated(stamps[:250], truth[:250], drifted[:250])], *PARTS)
    assert found is not None
    assert (found["poses"], found["scored"]) == (200, 150)
    assert found["ate_translation_rmse"] == pytest.approx(0.0, abs=1e-9)
    assert found["re_rotation_rmse"] == pytest.approx(0.0, abs=1e-7)
    rmse = align_positions(drifted[100:250, :3, 3], truth[100:250, :3, 3], "se3").rmse
    assert found["online"]["ate_translation_rmse"] == pytest.approx(rmse, rel=1e-9)
    said = after_closure(found)
    assert said is not None
    assert said.startswith(f"online ATE {rmse:.3g} m, after closure ")
    assert said.endswith("(150 of the latest path's 200 poses)")
    positions = on_positions(found)
    assert positions is not None
    assert positions["online"]["ate_translation_rmse"] is not None
    assert positions["online"]["re_translation_rmse"] is None


def test_however_batches_are_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latest_path, "MOST_POSES", 64)
    stamps, truth, drifted = run(500)
    path = PoseSamples(stamps, *se3.to_position_quaternion(truth))
    found = []
    for size in (1, 7, 100, 500):
        parts = [slice(at, at + size) for at in range(0, 500, size)]
        data = [evaluated(stamps[p], truth[p], drifted[p]) for p in parts]
        found.append(scored(path, data, *PARTS))
    assert found[0] is not None
    assert found[0]["scored"] == 63  # every 8th
    for one in found[1:]:
        assert_same_summary(one, found[0])


def test_poses_that_are_none_are_left_out() -> None:
    stamps, truth, drifted = run(50)
    positions, quaternions = se3.to_position_quaternion(truth)
    positions[3, 1], quaternions[7] = np.nan, 0.0
    found = scored(
        PoseSamples(stamps, positions, quaternions), [evaluated(stamps, truth, drifted)], *PARTS
    )
    assert found is not None
    assert (found["poses"], found["scored"]) == (50, 48)


def test_nothing_to_score_by() -> None:
    stamps, truth, drifted = run(5)
    latest = LatestPath(*PARTS)
    assert not latest.score()
    latest.add(evaluated(stamps, truth, drifted))
    assert not latest.score()
    latest.take(PoseSamples(stamps + 1, *se3.to_position_quaternion(truth)))
    assert latest.score()
    assert latest.figures is not None
    assert latest.figures["scored"] == 0
    assert after_closure(latest.figures) is None
    assert not latest.score()


def test_beside_it_is_of_what_there_was_and_of_its_run_alone() -> None:
    stamps, truth, drifted = run(50)
    path = PoseSamples(stamps, *se3.to_position_quaternion(truth))
    latest = LatestPath(*PARTS)
    latest.take(path)
    latest.add(evaluated(stamps[:30], truth[:30], drifted[:30]))
    due = latest.due()
    assert due is not None
    assert latest.due() is None
    latest.add(evaluated(stamps[30:], truth[30:], drifted[30:]))
    due.take(outcome_of(due.do))
    assert latest.figures is not None
    assert latest.figures["scored"] == 30
    due = latest.due()
    assert due is not None
    outcome = outcome_of(due.do)
    latest.clear()
    due.take(outcome)
    assert latest.figures is None


def test_a_session_writes_it_and_it_can_be_computed_again(tmp_path: Path) -> None:
    stamps, truth, drifted = run(200)
    values = complete({"gp.hyperparameters": "fixed", "output.directory": str(tmp_path)})
    session = Session(values, {"ground truth": "/ground_truth", "estimate": "/path"})
    online = PoseSamples(stamps, *se3.to_position_quaternion(drifted))
    path = PoseSamples(stamps, *se3.to_position_quaternion(truth))
    session.take_path(1, path)
    session.feed(path, online)
    session.advance_all(None)
    session.finish_all()
    assert session.score_latest_paths()
    assert not session.score_latest_paths()
    session.save(last=True)
    session.close()
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    found = summary["latest_path"]
    assert found["scored"] == summary["estimate"]["evaluated"]
    assert found["online"]["ate_translation_rmse"] == pytest.approx(
        summary["conventional"]["ate_translation_rmse"], rel=1e-9
    )
    written = read_tum(tmp_path / LATEST_PATH)
    assert np.array_equal(written.stamps, stamps)
    rows = np.genfromtxt(tmp_path / "poses.csv", delimiter=",", names=True, dtype=None)
    known = np.stack([rows[f"gt_t{axis}"] for axis in "xyz"], axis=1)
    place = np.searchsorted(written.stamps, rows["stamp_ns"])
    again = align_positions(written.positions[place], known, "se3").rmse
    assert found["ate_translation_rmse"] == pytest.approx(again, rel=1e-6, abs=1e-9)


def test_against_positions_alone_a_session_has_its_positions_alone() -> None:
    stamps, truth, drifted = run(200)
    sources = {"ground truth": "/prism", "estimate": "/path"}
    session = Session(complete({"gp.hyperparameters": "fixed"}), sources)
    session.note_without_orientation(0)
    session.take_path(1, PoseSamples(stamps, *se3.to_position_quaternion(drifted)))
    positions, turned = se3.to_position_quaternion(truth)
    unturned = np.tile([0.0, 0.0, 0.0, 1.0], (len(turned), 1))
    session.feed(
        PoseSamples(stamps, positions, unturned),
        PoseSamples(stamps, *se3.to_position_quaternion(drifted)),
    )
    session.finish_all()
    assert session.score_latest_paths()
    found = session.latest_path_of()
    assert found is not None
    for figures in (found, found["online"]):
        assert figures["ate_translation_rmse"] > 0.0
        for name in ("ate_rotation_rmse", "re_translation_rmse", "re_rotation_rmse"):
            assert figures[name] is None
