# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate --rerun``: read back with Rerun's own reader, it holds what ``poses.csv`` does."""

import csv
import os
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_evaluate import evaluate, summary_of

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.runs.rrd import RUN, STAMP
from trajeval_ros.runs.trail import DEVIATIONS

NAMES = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")


def read(path: Path) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, Any], list[str]]:
    """By entity: what has times, column by column; what has none; the names of the views."""
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed")
    reader = chunk.RrdReader(path)
    timed: dict[str, dict[str, Any]] = {}
    static: dict[str, Any] = defaultdict(dict)
    for each in reader.stream():
        batch = each.to_record_batch()
        columns = {n: batch.column(n) for n in batch.schema.names if not n.startswith("rerun.")}
        if each.is_static:
            static[each.entity_path] |= {n: c.to_pylist()[0] for n, c in columns.items()}
            continue
        assert each.entity_path not in timed
        timed[each.entity_path] = {
            name: np.array(column.cast("int64").to_pylist())
            if name in (RUN, STAMP)
            else np.array([row[0] for row in column.to_pylist()], np.float64)
            for name, column in columns.items()
        }
    (blueprint,) = reader.blueprints()
    views = [
        batch.column("ViewBlueprint:display_name").to_pylist()[0][0]
        for each in reader.stream(store=blueprint)
        for batch in [each.to_record_batch()]
        if "ViewBlueprint:display_name" in batch.schema.names
    ]
    return timed, static, views


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "poses.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def numbers(rows: list[dict[str, str]], *names: str) -> np.ndarray:
    return np.array([[float(row[name]) for name in names] for row in rows])


@pytest.fixture(scope="module")
def one(paths: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    folder = tmp_path_factory.mktemp("one")
    recording = folder / "recordings" / "run.rrd"
    result = evaluate("tum", *paths, "--output", folder, "--rerun", recording)
    assert result.returncode == 0, result.stderr
    assert f"Written: {recording}" in result.stdout
    assert os.listdir(recording.parent) == ["run.rrd"]
    return folder


def test_errors_and_poses_are_those_of_the_table(one: Path) -> None:
    timed, _, _ = read(one / "recordings" / "run.rrd")
    rows = [row for row in rows_of(one) if row["ate_translation"].strip()]
    stamps = np.array([int(row["stamp_ns"]) for row in rows])
    for part, factor in (("translation", 1.0), ("rotation", np.degrees(1.0))):
        series = timed[f"/errors/{part}/estimate"]
        # NaN breaks the line where there is nothing for long.
        there = np.isfinite(series["Scalars:scalars"])
        np.testing.assert_array_equal(series[STAMP][there], stamps)
        np.testing.assert_allclose(series[RUN][there], stamps - stamps[0], atol=1000)
        expected = factor * numbers(rows, f"ate_{part}")[:, 0]
        np.testing.assert_allclose(series["Scalars:scalars"][there], expected, rtol=1e-9)
    alignment = summary_of(one)["conventional"]["alignment"]
    pose = np.array(alignment["pose"])
    world = Similarity(se3.from_position_quaternion(pose[:3], pose[3:]), alignment["scale"])
    estimate = numbers(rows, *(f"est_{name}" for name in NAMES))
    aligned = world.apply(se3.from_position_quaternion(estimate[:, :3], estimate[:, 3:]))
    truth = numbers(rows, *(f"gt_{name}" for name in NAMES))
    for entity, positions in (("estimate", aligned[:, :3, 3]), ("ground_truth", truth[:, :3])):
        shown = timed[f"/world/{entity}/pose"]
        np.testing.assert_array_equal(shown[STAMP], stamps)
        # The viewer's numbers have 32 bits.
        np.testing.assert_allclose(shown["Transform3D:translation"], positions, atol=1e-5)


def test_ellipsoids_are_the_ground_truths_covariance(one: Path) -> None:
    timed, _, _ = read(one / "recordings" / "run.rrd")
    shown = timed["/world/ground_truth/uncertainty"]
    rows = {int(row["stamp_ns"]): row for row in rows_of(one)}
    assert len(shown[STAMP]) > 100
    for number in range(0, len(shown[STAMP]), 20):
        row = rows[int(shown[STAMP][number])]
        truth = [float(row[f"gt_{name}"]) for name in NAMES]
        turned = se3.from_position_quaternion(np.array(truth[:3]), np.array(truth[3:]))[:3, :3]
        body = np.array(
            [
                [float(row[f"cov_{min(i, j)}{max(i, j)}"]) for j in range(3)]
                for i in range(3)
            ]
        )  # fmt: skip
        axes = se3.from_position_quaternion(np.zeros(3), shown["Ellipsoids3D:quaternions"][number])[
            :3, :3
        ]
        half = shown["Ellipsoids3D:half_sizes"][number] / DEVIATIONS
        expected = turned @ body @ turned.T
        np.testing.assert_allclose(
            axes @ np.diag(half**2) @ axes.T, expected, atol=1e-4 * np.trace(expected)
        )
        np.testing.assert_allclose(shown["Ellipsoids3D:centers"][number], truth[:3], atol=1e-5)


def test_the_blueprint_has_the_map_the_errors_and_the_answer(one: Path) -> None:
    _, static, views = read(one / "recordings" / "run.rrd")
    assert sorted(views) == [
        "Absolute error, m",
        "Absolute error, °",
        "Answer",
        "Error over 1 s, m",
        "Map",
    ]
    said = static["/said"]["TextDocument:text"][0]
    assert said.startswith("# estimate\n\n- **How good**: ATE ")
    assert "- **Kind of error**: jitter " in said
    assert "ATE, RMSE" in said
    for entity in ("estimate", "ground_truth"):
        assert static[f"/world/{entity}/path"]["LineStrips3D:strips"][0]


def test_several_have_entities_of_their_names(paths: tuple[Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    truth, estimate = paths
    sparse = tmp_path / "sparse.txt"
    lines = estimate.read_text(encoding="utf-8").splitlines()
    sparse.write_text("\n".join(lines[::2]) + "\n", encoding="utf-8")
    result = evaluate("tum", truth, estimate, sparse, "--rerun", tmp_path / "run.rrd")
    assert result.returncode == 0, result.stderr
    timed, static, _ = read(tmp_path / "run.rrd")
    names = {entity.split("/")[3] for entity in timed if entity.startswith("/errors/translation")}
    assert names == {"estimate", "sparse", "ground_truth"}
    titles = {static[f"/errors/translation/{name}"]["SeriesLines:names"][0] for name in names}
    assert titles == {"estimate", "sparse", "ground truth, 2 σ"}
    assert "ATE" in static["/said"]["TextDocument:text"][0].splitlines()[0]


def test_a_recording_that_cannot_be_written_leaves_nothing(
    paths: tuple[Path, Path], tmp_path: Path
) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    taken = tmp_path / "run.rrd"
    taken.mkdir()
    result = evaluate("tum", *paths, "--rerun", taken)
    assert result.returncode == 1
    assert result.stderr == f"evaluate: error: cannot write {taken}: Is a directory\n"
    assert "ATE" in result.stdout
    assert os.listdir(tmp_path) == ["run.rrd"]
    assert os.listdir(taken) == []


def test_without_the_library_one_line(
    paths: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    from trajeval_ros.commands import evaluate as command

    monkeypatch.setitem(sys.modules, "rerun", None)
    assert command.main(["tum", *map(str, paths), "--rerun", str(tmp_path / "run.rrd")]) == 1
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert line.startswith("evaluate: error: --rerun: writing it needs the library rerun-sdk (")
    assert line.endswith("): pip install rerun-sdk")
    assert said.out == ""
    assert os.listdir(tmp_path) == []
