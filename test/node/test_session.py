# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run without ROS: what tells the time, the accounts, and changes of parameters."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import data
import numpy as np
import pytest

from trajeval_ros.files.output import OutputError
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.node import evaluator
from trajeval_ros.node.clock import StampClock
from trajeval_ros.online.parameters import ParameterError, complete
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.report import Report
from trajeval_ros.runs.offline import Scoring, score
from trajeval_ros.runs.session import Session
from trajeval_ros.runs.statuses import error_model_entries

YEAR = 365 * 86_400 * data.SECOND
SOURCES = {"ground truth": "/ground_truth", "estimate": "/estimate"}


def session(**parameters: Any) -> Session:
    given = {name.replace("__", "."): value for name, value in parameters.items()}
    return Session(complete({"gp.hyperparameters": "fixed", **given}), SOURCES)


def live(run: Session, truth: PoseSamples, estimate: PoseSamples, offset: int = 0) -> Any:
    """Feed message by message as it comes, on time, and return the account before the end.

    ``offset`` (ns) is how much later than its stamp, on the ROS clock, an estimate comes.
    """
    clock = StampClock()
    due = np.concatenate([truth.stamps, estimate.stamps + offset])
    # A stray stamp comes between its neighbours, not in a year.
    due = np.where(due > due[0] + YEAR // 2, np.roll(due, 1) + 1, due)
    for i in np.argsort(due, kind="stable").tolist():
        now = int(due[i]) + 5 * data.SECOND
        k = i - len(truth)
        if k < 0:
            run.feed(truth[i : i + 1], None)
        else:
            run.feed(None, estimate[k : k + 1])
        clock.note(run.newest_stamps(), now)
        run.advance(clock.now(now))
    return run.summary()["estimate"]


@pytest.mark.parametrize(("rate", "duration"), [(1.0, 40.0), (5.0, 10.0)])
def test_a_stamp_from_the_future_does_not_decide_slow_estimates(
    rate: float, duration: float
) -> None:
    parameters = {"ground_truth__max_gap": 2.0}
    truth, estimate = data.run(duration, ground_truth_rate=rate, estimate_rate=rate)
    good = live(session(**parameters), truth, estimate)
    assert good["evaluated"] > 30
    for stray, topic in enumerate(("ground_truth", "estimate")):
        streams = [truth, estimate]
        stamps = streams[stray].stamps.copy()
        stamps[len(stamps) // 2] += YEAR
        streams[stray] = replace(streams[stray], stamps=stamps)
        run = session(**parameters)
        account = live(run, *streams)
        assert run.summary()[topic]["rejected"] == {"stamp_jump": 1}
        assert account["evaluated"] == good["evaluated"] - stray


def test_the_time_is_that_of_the_ground_truth() -> None:
    truth, estimate = data.run(5.0, ground_truth_rate=50.0)
    expected = live(session(), truth, estimate)["evaluated"]
    assert expected > 0
    for offset in (-3600, 3600):
        moved = replace(estimate, stamps=estimate.stamps - offset * data.SECOND)
        run = session(estimate__time_offset=float(offset))
        account = live(run, truth, moved, offset * data.SECOND)
        assert account["evaluated"] == expected
        assert run.newest_stamps() == [truth.stamps[-1], estimate.stamps[-1]]


def test_what_cannot_be_read_is_in_the_accounts() -> None:
    run = session()
    truth, estimate = data.run(3.0)
    run.feed(truth, estimate)
    run.note_undecodable(0, 1)
    run.note_undecodable(1, 2)
    summary: Any = run.summary()
    health = run.health()
    for account, topic, samples, count in (
        (summary["ground_truth"], health.ground_truth, truth, 1),
        (summary["estimate"], health.estimate, estimate, 2),
    ):
        assert account["received"] == topic.received == len(samples) + count
        assert account["rejected"] == topic.rejected == {"undecodable": count}
    run.reset()
    assert run.health().estimate.received == 0
    assert run.summary()["estimate"]["rejected"] == {}


def test_a_change_is_whole_or_not_at_all(tmp_path: Path) -> None:
    run = session(output__directory=str(tmp_path / "old"))
    before = run.engine.parameters
    (tmp_path / "file").write_text("in the way")
    for changes in (
        {"output.directory": str(tmp_path / "new"), "window.duration": -1.0},
        {"output.directory": str(tmp_path / "new"), "gauge": "none"},
        {"window.duration": 7.0, "output.directory": str(tmp_path / "file" / "out")},
    ):
        with pytest.raises(ParameterError):
            run.change(changes)
        assert run.engine.parameters == before
    assert not (tmp_path / "new").exists()
    assert run.save() == tmp_path / "old"
    run.change({"window.duration": 7.0, "output.directory": str(tmp_path / "new")})
    assert run.engine.parameters["window.duration"] == 7.0
    assert run.save() == tmp_path / "new"
    assert "the last 7 s" in (tmp_path / "new" / "report.html").read_text(encoding="utf-8")
    run.close()


def test_the_report_has_the_notices_that_hold(tmp_path: Path) -> None:
    run = session(output__directory=str(tmp_path), gp__hyperparameters="auto")
    truth, estimate = data.run(20.0)
    for samples in (truth[: len(truth) // 2], truth[len(truth) // 2 :]):
        run.feed(samples, None)
        run.advance(None)
    run.feed(None, estimate)
    run.finish()
    run.save()
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    (learned,) = [n for n in run.engine.notices() if n.code == "hyperparameters_learned"]
    assert page.count("learned translation") == page.count(learned.text) == 1
    run.close()


def test_rows_from_before_there_was_a_folder_are_said_to_be_missing(tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    run = session(output__directory=str(tmp_path / "out"))
    assert run.error is not None
    truth, estimate = data.run(20.0)
    half = len(estimate) // 2
    run.feed(truth, estimate[:half])
    first = len(run.advance(None).evaluations)
    assert first > 0
    (tmp_path / "out").unlink()
    run.feed(None, estimate[half:])
    second = len(run.finish().evaluations)
    with pytest.raises(OutputError, match=rf"poses\.csv lacks {first} poses"):
        run.save(last=True)
    assert (tmp_path / "out" / "poses.csv").read_text(encoding="utf-8").count("\n") == second + 1
    assert (tmp_path / "out" / "report.html").exists()
    run.close()


def test_likely_causes_are_saved(tmp_path: Path) -> None:
    run = session(output__directory=str(tmp_path))
    truth, estimate = data.run(30.0)
    # w before x, y, z.
    shuffled = replace(estimate, quaternions=np.roll(estimate.quaternions, 1, axis=1))
    run.feed(truth, shuffled)
    run.finish()
    run.save()
    causes = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["likely_causes"]
    assert [cause["code"] for cause in causes] == ["quaternion_order"]
    assert all(set(cause) == {"code", "text", "advice"} for cause in causes)
    assert [cause.code for cause in run.causes] == ["quaternion_order"]
    run.reset()
    assert run.causes == ()
    run.close()


def whole_file(samples: PoseSamples) -> Trajectory:
    return Trajectory(
        samples.stamps, samples.positions, samples.quaternions, np.arange(len(samples)), "file"
    )


def test_the_windows_error_model_is_the_files(tmp_path: Path) -> None:
    truth, estimate = data.run(25.0)
    run = session(output__directory=str(tmp_path / "live"), window__duration=10.0)
    live(run, truth, estimate)
    while run.fit_error_model():
        pass
    status = error_model_entries(run.error_models)
    assert float(status["window_clock_offset_std"]) > 0.0
    assert float(status["extrinsic_translation_value_x"]) == pytest.approx(0.0, abs=1.0)
    run.finish()
    run.save(last=True)
    assert not run.fit_error_model()
    found = json.loads((tmp_path / "live" / "summary.json").read_text())
    scored = score(
        run.engine.parameters,
        whole_file(truth),
        {"estimate": Scoring(whole_file(estimate), Report(run.engine.parameters, {}))},
    )["estimate"].summary
    assert found["error_model"]["fit"] == "blocks"
    assert scored["error_model"]["fit"] == "whole"
    for key in ("clock_offset", "scale"):
        ours, files = (each["window"]["error_model"][key]["value"] for each in (found, scored))
        assert ours == pytest.approx(files, rel=1e-9, abs=1e-9)
        whole, blocks = scored["error_model"][key], found["error_model"][key]
        assert abs(whole["value"] - blocks["value"]) < 3.0 * blocks["std"]


def test_a_fit_says_what_it_was_due_for_however_late() -> None:
    run, late = session(), session()
    for each in (run, late):
        each.feed(*data.run(6.0))
        each.advance(None)
    assert run.fit_error_model()
    due = late.fit_due()
    assert due is not None
    late.feed(*data.run(12.0))
    late.advance(None)
    assert late.error_models == {}
    due.at_once()
    assert late.error_models == run.error_models
    # What came meanwhile is due now.
    assert late.fit_error_model()
    assert late.error_models["window"]["poses"] > run.error_models["window"]["poses"]


def test_a_reset_forgets_the_error_model() -> None:
    run = session()
    live(run, *data.run(5.0))
    while run.fit_error_model():
        pass
    assert "window" in run.error_models
    run.feed(*data.run(7.0))
    run.advance(None)
    due = run.fit_due()
    assert due is not None
    run.reset()
    assert run.error_models == {}
    assert not run.fit_error_model()
    due.at_once()
    assert run.error_models == {}


def test_a_defect_in_the_search_for_causes_costs_the_causes_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*arguments: object, **named: object) -> None:
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr("trajeval_ros.report.report.likely_causes", broken)
    run = session(output__directory=str(tmp_path))
    run.feed(*data.run(5.0))
    run.finish()
    run.look_for_causes()
    assert run.save() == tmp_path
    (line,) = run.defects
    assert line.startswith("the search for likely causes failed: ZeroDivisionError: a defect (")
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["likely_causes"] == []
    assert summary["estimate"]["evaluated"] > 0
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count("a defect") == 1
    run.close()


def test_an_archive_keeps_what_was_written_and_not_what_comes_later(tmp_path: Path) -> None:
    run = session(output__directory=str(tmp_path))
    # A file that cannot be written keeps the others neither from the folder nor from the archive.
    (tmp_path / "report.html").mkdir()
    run.feed(*data.run(5.0))
    run.finish()
    with pytest.raises(OutputError, match=r"report\.html"):
        run.archive()
    kept = tmp_path / "run_1"
    assert sorted(path.name for path in kept.iterdir()) == ["poses.csv", "summary.json"]
    rows = (kept / "poses.csv").read_text(encoding="utf-8")
    assert rows.count("\n") > 50
    (tmp_path / "report.html").rmdir()
    run.reset()
    # The end of a run without a pose does not take the place of one that has some.
    assert run.save(last=True) is None
    run.feed(*data.run(3.0))
    run.finish()
    assert run.save(last=True) == tmp_path
    run.close()
    assert (kept / "poses.csv").read_text(encoding="utf-8") == rows
    assert 1 < (tmp_path / "poses.csv").read_text(encoding="utf-8").count("\n") < rows.count("\n")
    assert sorted(path.name for path in tmp_path.glob("run_*")) == ["run_1"]


def evaluated_in(folder: Path) -> int:
    text = (folder / "summary.json").read_text(encoding="utf-8")
    return int(json.loads(text)["estimate"]["evaluated"])


def test_an_earlier_process_s_results_are_kept_beside_ours(tmp_path: Path) -> None:
    counts = []
    for duration in (6.0, 4.0, 5.0):
        run = session(output__directory=str(tmp_path))
        run.feed(*data.run(duration))
        run.finish()
        # Saved again and again, it is one run.
        assert run.save() == tmp_path
        assert run.save(last=True) == tmp_path
        run.close()
        counts.append(evaluated_in(tmp_path))
    assert sorted(path.name for path in tmp_path.glob("run_*")) == ["run_1", "run_2"]
    assert [evaluated_in(tmp_path / f"run_{n}") for n in (1, 2)] == counts[:2]
    assert counts[1] < counts[2] < counts[0]


def test_a_run_without_a_pose_writes_only_where_there_is_nothing(tmp_path: Path) -> None:
    run = session(output__directory=str(tmp_path))
    truth, estimate = data.run(3.0)
    run.feed(None, estimate)
    run.finish()
    assert run.archive() is None
    # Its account says why there is none.
    assert run.save(last=True) == tmp_path
    assert evaluated_in(tmp_path) == 0
    run.reset()
    run.feed(truth, estimate)
    run.finish()
    assert run.save(last=True) == tmp_path
    run.close()
    assert evaluated_in(tmp_path) > 0


def test_the_summary_says_of_what_topics_it_is(tmp_path: Path) -> None:
    run = session(output__directory=str(tmp_path))
    run.feed(*data.run(3.0))
    run.finish()
    run.save(last=True)
    run.close()
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert set(summary["inputs"]) == {"ground_truth", "estimate"}
    assert all(set(each) == {"topic"} for each in summary["inputs"].values())
    assert summary["parameters"]["gp.hyperparameters"] == "fixed"
    assert summary["coverage"]["time"] == 1.0


# Fast batches for half a second, slow ones until the queue must be empty.
@pytest.mark.parametrize(("seconds", "longest"), [(0.001, 0.5), (0.3, 7.8)])
def test_the_end_does_not_wait_for_publishers_that_go_on(
    seconds: float, longest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr(evaluator.time, "monotonic", lambda: now)
    monitor = SimpleNamespace(messages=0)

    def process() -> None:
        nonlocal now
        monitor.messages += evaluator.BATCH
        now += seconds

    evaluator.Evaluator._take_all(SimpleNamespace(_monitor=monitor, _process=process))
    assert monitor.messages >= evaluator.QUEUE_DEPTH
    assert now == pytest.approx(longest, abs=0.01)
