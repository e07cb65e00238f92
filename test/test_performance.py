# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmarks run, on inputs too small to say anything."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from performance import __main__ as entry
from performance import (
    benchmark,
    calibration,
    clocks,
    commands,
    ground_truth,
    likelihoods,
    recordings,
    tables,
)
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.files.tum import read_tum
from trajeval_ros.ground_truth.segment import Samples

needs_sklearn = pytest.mark.skipif(
    importlib.util.find_spec("sklearn") is None, reason="scikit-learn is not installed"
)


def verdicts(found: Iterator[tables.Target], *names: str) -> dict[str, bool | None]:
    """Verdicts of the targets whose names contain one of ``names``."""
    return {t.figure: t.met for t in found if any(name in t.figure for name in names)}


@pytest.fixture(scope="module")
def samples() -> Samples:
    return ground_truth.simulated(0, 1200, 100)


@pytest.fixture(scope="module")
def cell(samples: Samples) -> calibration.Cell:
    kept = np.arange(1200) % 10 == 0
    held = ~kept & (np.arange(1200) < 1190)
    return calibration.Cell(
        "simulated",
        10,
        Samples(samples.stamps[kept], samples.poses[kept]),
        Samples(samples.stamps[held], samples.poses[held]),
    )


@pytest.fixture(scope="module")
def measured(cell: calibration.Cell) -> calibration.Measured:
    return calibration.measure(cell)


def test_calibration(measured: calibration.Measured) -> None:
    assert set(measured.live) == set(calibration.PROCESSES)
    nearest = measured.interpolations["nearest"].position_rmse
    for score in (*measured.live.values(), *measured.all_data.values()):
        assert 0.0 < score.position_rmse < nearest
        assert score.anees is not None
        assert 0.01 < score.anees < 100.0
    made = list(calibration.single_cells([measured]))
    made.append(calibration.overview([measured], calibration.with_lag, "a", "title"))
    made.append(calibration.aims_of_all([measured]))
    for table in made:
        assert {len(row) for row in table.rows} == {len(table.header)}


def test_recordings(cell: calibration.Cell, samples: Samples) -> None:
    first, last = recordings.sources()[0], recordings.sources()[-1]
    measured = [recordings.measure(replace(cell, sequence=row["name"])) for row in (first, last)]
    for table in (recordings.overview(measured), recordings.kinds(measured)):
        assert {len(row) for row in (*table.rows, *table.further)} == {len(table.header)}
        assert {row["half"] for row in (first, last)} <= {x for row in table.rows for x in row}
    half = recordings.halved("simulated", samples)
    assert not set(half.kept.stamps) & set(half.held_out.stamps)
    assert half.held_out.stamps[-1] < half.kept.stamps[-1]
    assert [row[0] for row in recordings.single_cells(measured).rows] == [
        first["name"],
        last["name"],
    ]


def test_a_process_that_is_known_is_calibrated_in_its_own_world(cell: calibration.Cell) -> None:
    found = recordings.in_own_world(cell)
    assert set(found) == {"known", *recordings.WAYS.values()}
    assert 0.8 < found["known"] < 1.25


def test_plain_is_not_the_default(cell: calibration.Cell) -> None:
    with calibration.plain():
        plain = calibration.score_process(cell, calibration.PLAIN, None)
    assert plain != calibration.score_process(cell, "matern52", None)


def test_batches_make_no_difference(cell: calibration.Cell) -> None:
    assert calibration.batch_error(cell) < 1e-9


def test_picture(measured: calibration.Measured, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("PIL")
    path = tmp_path / "picture.png"
    calibration.picture([measured], path)
    assert 0 < path.stat().st_size < 200_000


def ape(truth: Trajectory, estimate: Trajectory) -> float:
    """The mean distance of positions of the same row, of each estimate that has a sample."""
    apart = truth.positions[::5] - estimate.positions
    return float(np.linalg.norm(apart, axis=1).mean())


@needs_sklearn
def test_scikit_learn_gives_the_same_answers(samples: Samples) -> None:
    found = ground_truth.query_targets(samples[:300], rounds=1, count=20, refitted=2)
    assert verdicts(found, "poses, m or rad", "deviations, m or rad") == {
        "largest difference of the poses, m or rad": True,
        "of the standard deviations, m or rad": True,
    }


def test_an_hour() -> None:
    found = verdicts(ground_truth.hour_targets(50, 24, 2), "state in memory, largest")
    assert len(found) == 1


def test_a_sample() -> None:
    found = list(ground_truth.sample_targets((20, 50), seconds=24))
    assert len(found) == 4


def test_a_long_run_is_what_it_says(tmp_path: Path) -> None:
    truth, estimate = (read_tum(name) for name in commands.long_run(tmp_path, 70))
    assert len(truth) == 7000
    assert len(estimate) == 1400
    found = ape(truth, estimate)
    assert 1e-4 < found < 0.1


def test_window() -> None:
    found = likelihoods.window_targets(count=50, rounds=1)
    assert list(verdicts(found, "difference").values()) == [True]


def test_run() -> None:
    found = verdicts(likelihoods.length_targets(200, 2000, rounds=2), "state of all running")
    assert len(found) == 1


def test_commands_are_timed() -> None:
    times = commands.seconds([["true"]])
    assert times.shape == (3,)
    assert (times >= 0.0).all()
    with pytest.raises(tables.SkippedError, match="false"):
        commands.seconds([["false"]])


def test_a_worker_s_memory_does_not_grow_by_the_run() -> None:
    found = list(benchmark.memory_targets(80))
    # A run's poses and answers are a hundred times as much.
    assert float(found[0].measured) < 20.0


def test_a_ratio_is_a_median() -> None:
    assert clocks.ratio(np.array([[2.0, 1.0], [30.0, 10.0], [800.0, 100.0]])) == 3.0


def test_every_benchmark_can_be_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert entry.main(["--list"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in entry.NAMES)
    for name in entry.NAMES:
        assert importlib.util.find_spec(f"performance.{name}") is not None


def test_unknown_names_are_refused() -> None:
    with pytest.raises(SystemExit):
        entry.main(["nothing"])


def test_a_table_goes_to_its_place() -> None:
    table = tables.Table("x", "title", ("a", "b"), (("1", "2"),), "page.md")
    text = "before\n<!-- begin x -->\nold\n<!-- end x -->\nafter"
    new = tables.written(text, table)
    assert "| 1 | 2 |" in new
    assert "old" not in new
    assert tables.written(new, table) == new
    with pytest.raises(ValueError, match="no place"):
        tables.written("nothing", table)
