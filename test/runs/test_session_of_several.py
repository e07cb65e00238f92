# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A session of several estimates, and the poses that it keeps to compare them."""

import json
import os

import numpy as np
import pytest
from twins.runs import FIXED, SECOND, assert_same_summary, simulated

from trajeval_ros.comparison.compare import read
from trajeval_ros.comparison.words import sentence
from trajeval_ros.files.output import OutputError
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.parameters import ParameterError, complete
from trajeval_ros.runs import several
from trajeval_ros.runs.beside import outcome_of
from trajeval_ros.runs.session import Session
from trajeval_ros.runs.several import NewestPoses, nats_per_second, newest_compared

NAMES = ("vins", "orb")
SOURCES = {"ground truth": "/ground_truth", "vins": "/vins", "orb": "/orb"}
FILES = ["poses.csv", "report.html", "summary.json"]


def session(**given):
    values = {name.replace("__", "."): value for name, value in given.items()}
    return Session(complete({**FIXED, "estimates": NAMES, **values}, NAMES), SOURCES)


@pytest.fixture(scope="module")
def two():
    """Two runs against one ground truth."""
    return [simulated(seed, 20.0, (50.0, 10.0)) for seed in (1, 2)]


def test_each_is_as_it_is_alone_and_all_are_in_one_summary(two, tmp_path):
    run = session(output__directory=str(tmp_path))
    run.feed(two[0].ground_truth, two[0].estimate, two[1].estimate)
    run.note_undecodable(0, 2)
    run.note_undecodable(2, 3)
    run.finish_all()
    assert run.save(last=True) == tmp_path
    run.close()
    assert sorted(os.listdir(tmp_path)) == ["orb", "report.html", "summary.json", "vins"]
    together = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert list(together) == ["ground_truth", "estimates", "comparison", "likely_causes"]
    assert together["ground_truth"]["rejected"]["undecodable"] == 2
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"<title>{', '.join(NAMES)}: trajectory evaluation</title>" in page
    assert 'id="translation"' in page
    for name, one in zip(NAMES, two, strict=True):
        assert sorted(os.listdir(tmp_path / name)) == FILES
        alone = json.loads((tmp_path / name / "summary.json").read_text(encoding="utf-8"))
        assert_same_summary(alone.pop("ground_truth"), together["ground_truth"])
        assert_same_summary(alone, together["estimates"][name])
        engine = Engine(FIXED)
        engine.add_ground_truth(two[0].ground_truth)
        engine.add_estimate(one.estimate)
        engine.finish()
        for part in ("relative", "absolute", "conventional"):
            assert_same_summary(alone[part], engine.summary()[part])
    assert together["estimates"]["orb"]["estimate"]["rejected"]["undecodable"] == 3
    (pair,) = together["comparison"]
    assert (pair["a"], pair["b"]) == NAMES
    assert pair["common"]["poses"] > 100


def test_a_folder_that_cannot_be_written_costs_itself_alone(two, tmp_path):
    (tmp_path / "vins").touch()
    run = session(output__directory=str(tmp_path))
    assert "vins" in run.error
    run.feed(two[0].ground_truth, two[0].estimate, two[1].estimate)
    run.finish_all()
    with pytest.raises(OutputError, match="vins"):
        run.save()
    assert set(FILES) <= set(os.listdir(tmp_path / "orb"))
    assert "vins" in json.loads((tmp_path / "summary.json").read_text())["estimates"]
    run.close()


def test_a_run_that_is_over_is_kept_whole(two, tmp_path):
    run = session(output__directory=str(tmp_path))
    run.feed(two[0].ground_truth, two[0].estimate, two[1].estimate)
    run.finish_all()
    assert run.archive() == tmp_path / "run_1"
    run.reset()
    run.save()
    run.close()
    assert sorted(os.listdir(tmp_path / "run_1")) == ["orb", "report.html", "summary.json", "vins"]
    kept = json.loads((tmp_path / "run_1" / "summary.json").read_text(encoding="utf-8"))
    assert kept["estimates"]["vins"]["estimate"]["evaluated"] > 100
    now = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert now["estimates"]["vins"]["estimate"]["evaluated"] == 0
    assert now["comparison"][0]["common"]["poses"] == 0


def test_the_folder_moves_for_all_or_for_none(two, tmp_path):
    run = session(output__directory=str(tmp_path / "old"))
    run.feed(two[0].ground_truth, two[0].estimate, two[1].estimate)
    run.finish_all()
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "orb").touch()
    with pytest.raises(ParameterError, match="orb"):
        run.change({"output.directory": str(tmp_path / "taken")})
    assert run.save() == tmp_path / "old"
    run.change({"output.directory": str(tmp_path / "new")})
    assert run.save(last=True) == tmp_path / "new"
    rows = (tmp_path / "new" / "vins" / "poses.csv").read_text(encoding="utf-8")
    assert rows.count("\n") > 100
    run.close()


@pytest.mark.parametrize("batch", [1, 7, 40])
def test_however_cut_the_newest_poses_are_kept(two, batch):
    engine = Engine(FIXED)
    engine.add_ground_truth(two[0].ground_truth)
    engine.add_estimate(two[0].estimate)
    found = engine.finish().evaluations
    kept, whole = NewestPoses("vins", 5, most=50), NewestPoses("orb", 0)
    for begin in range(0, len(found), batch):
        part = type(found)(
            *(getattr(found, f)[begin : begin + batch] for f in found.__dataclass_fields__)
        )
        kept.add(part)
        whole.add(part)
    sampled = found.stamps[found.sampled]
    assert kept.evaluated().stamps.tolist() == (sampled[-50:] + 5).tolist()
    assert kept.begin == sampled[-50] + 5
    assert whole.begin is None
    kept.clear()
    assert len(kept.evaluated()) == 0
    assert kept.begin is None


def test_what_one_has_forgotten_is_left_out_of_its_pairs_alone_and_that_is_said(two):
    engine = Engine(FIXED)
    engine.add_ground_truth(two[0].ground_truth)
    engine.add_estimate(two[0].estimate)
    found = engine.finish().evaluations
    fast, slow, other = (
        NewestPoses("fast", 0, most=50),
        NewestPoses("slow", 0),
        NewestPoses("other", 0),
    )
    for kept in (fast, slow, other):
        kept.add(found)
    stamps = found.stamps[found.sampled]
    pairs = newest_compared([fast, slow, other], engine.settings.evaluation, "block_t")
    common = {(one.a, one.b): one.coverage for one in pairs}
    # Not the whole of the slow one against the end of the fast one.
    assert common["fast", "slow"].common.poses == 50
    assert common["fast", "slow"].only_b.seconds == 0.0
    assert common["slow", "other"].common.poses == len(stamps)
    first, second, third = pairs
    assert first.since == second.since == stamps[-50]
    assert first.figures()["since_ns"] == stamps[-50]
    assert f"from {stamps[-50] * 1e-9:.3f} s on" in sentence(first)
    assert third.since is None
    assert " s on" not in sentence(third)
    assert read(first.figures()).since == stamps[-50]


def test_a_defect_in_a_sentence_costs_no_file(two, tmp_path, monkeypatch):
    monkeypatch.setattr(several, "sentences", lambda comparisons: 1 / 0)
    run = session(output__directory=str(tmp_path))
    run.feed(two[0].ground_truth, two[0].estimate, two[1].estimate)
    run.finish_all()
    assert run.save(last=True) == tmp_path
    run.close()
    together = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert together["comparison"][0]["common"]["poses"] > 100
    assert (tmp_path / "report.html").is_file()
    assert any("the words of the comparison failed" in line for line in run.defects)


def test_the_difference_in_nats_is_of_the_same_instants(two):
    engine = Engine(FIXED)
    engine.add_ground_truth(two[0].ground_truth)
    engine.add_estimate(two[0].estimate)
    found = engine.finish().evaluations
    one, other = NewestPoses("one", 0), NewestPoses("other", 0)
    for kept in (one, other):
        kept.add(found)
    (pair,) = newest_compared([one, other], engine.settings.evaluation, "block_t")
    poses, seconds = pair.coverage.common.poses, pair.coverage.common.seconds
    models = {
        "one": {"error_model": {"poses": poses, "nats_per_pose": 5.0}},
        "other": {"error_model": {"poses": poses, "nats_per_pose": 4.0}},
    }
    nats = nats_per_second(pair, models)
    assert nats["difference"] == pytest.approx(poses / seconds)
    assert nats["a"] == pytest.approx(5.0 * poses / seconds)
    models["other"]["error_model"]["poses"] = 2 * poses
    assert nats_per_second(pair, models) is None
    assert nats_per_second(pair, {**models, "other": {}}) is None


def test_a_defect_in_what_is_kept_to_compare_costs_no_figures(two, monkeypatch):
    def broken(self, evaluations):
        raise ZeroDivisionError("kept")

    monkeypatch.setattr(NewestPoses, "add", broken)
    run = session()
    run.feed(two[0].ground_truth, two[0].estimate, two[1].estimate)
    run.finish_all()
    assert run.figures("vins")["estimate"]["evaluated"] > 100
    assert any("kept" in line for line in run.defects)


def test_a_run_of_any_length_is_compared_in_bounded_memory():
    rng = np.random.default_rng(1)
    kept = NewestPoses("vins", 0, most=100)
    one = simulated(1, 5.0, (50.0, 20.0))
    engine = Engine(FIXED)
    engine.add_ground_truth(one.ground_truth)
    engine.add_estimate(one.estimate)
    found = engine.finish().evaluations
    for repetition in range(50):
        shift = repetition * 10 * SECOND + int(rng.integers(5))
        fields = {f: getattr(found, f) for f in found.__dataclass_fields__}
        kept.add(type(found)(**{**fields, "stamps": found.stamps + shift}))
        assert sum(map(len, kept._kept)) <= 200


def test_positions_alone_are_compared_by_positions_alone(two, monkeypatch):
    looked_at = []
    monkeypatch.setattr(
        "trajeval_ros.runs.session.causes_of_all", lambda each: looked_at.extend(each) or ()
    )
    run = session()
    run.note_without_orientation(0)
    run.feed(two[0].ground_truth, two[0].estimate, two[1].estimate)
    run.finish_all()
    (pair,) = run.comparisons()
    assert pair.ate_translation is not None
    assert (pair.ate_rotation, pair.re_translation, pair.re_rotation) == (None, None, None)
    run.causes_of_all()
    assert looked_at == []


def test_beside_a_comparison_is_of_what_there_was(two):
    run = session()
    half = len(two[0].ground_truth) // 2
    middle = int(two[0].ground_truth.stamps[half])
    first = [each.estimate[: int(np.searchsorted(each.estimate.stamps, middle))] for each in two]
    run.feed(two[0].ground_truth[:half], *first)
    run.advance_all(None)
    expected = run.comparisons("block_t")
    found = []
    work = run.comparison("block_t", lambda *both: found.append(both), pairs=True)
    alone = run.comparison("block_t", lambda *both: found.append(both), pairs=False)
    rest = [one.estimate[len(part) :] for one, part in zip(two, first, strict=True)]
    run.feed(two[0].ground_truth[half:], *rest)
    run.finish_all()
    work.take(outcome_of(work.do))
    alone.at_once()
    assert found == [(expected, ()), ((), ())]
    assert run.comparisons("block_t") != expected


def test_a_defect_of_a_comparison_beside_is_a_line(two, monkeypatch):
    run = session()
    run.feed(two[0].ground_truth, two[0].estimate, two[1].estimate)
    run.finish_all()
    monkeypatch.setattr("trajeval_ros.runs.session.newest_compared", lambda *given: 1 / 0)
    found = []
    run.comparison("block_t", lambda *both: found.append(both), pairs=True).at_once()
    assert found == [((), ())]
    (line,) = run.defects
    assert "ZeroDivisionError" in line
