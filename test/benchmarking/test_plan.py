# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How runs are cut into tasks."""

from pathlib import Path

import pytest

from trajeval_ros.benchmarking import plan
from trajeval_ros.benchmarking.manifest import Manifest, Run, Sequence, Source
from trajeval_ros.benchmarking.plan import Planned, tasks


def cut(folder: Path, sizes: list[int], workers: int) -> list[list[str]]:
    """The runs' names by task, of files of so many bytes."""
    runs = []
    for number, size in enumerate(sizes):
        path = folder / f"{number}.txt"
        path.write_bytes(b" " * size)
        runs.append(Run("one", "all", str(number), Source(str(path))))
    sequence = Sequence("all", Source("truth.txt"), {}, tuple(runs))
    planned = {"all": [Planned(run, "", "", "", run.run) for run in runs]}
    manifest = Manifest(folder, (sequence,))
    return [[each.key for each in one.runs] for one in tasks(manifest, planned, workers)]


def test_each_worker_has_two_tasks_where_there_are_so_many(tmp_path: Path) -> None:
    assert [len(part) for part in cut(tmp_path, [10] * 8, 2)] == [2, 2, 2, 2]
    assert [len(part) for part in cut(tmp_path, [10] * 3, 2)] == [1, 1, 1]
    assert [len(part) for part in cut(tmp_path, [10] * 200, 2)] == [50, 50, 50, 50]
    assert [len(part) for part in cut(tmp_path, [10] * 120, 1)] == [50, 50, 20]


def test_long_runs_are_fewer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "_MOST_BYTES", 100)
    found = cut(tmp_path, [60, 40, 10, 500, 10, 90], 1)
    assert found == [["0", "1"], ["2"], ["3"], ["4", "5"]]


def test_files_that_are_gone_are_none_and_a_folder_is_what_it_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "_MOST_BYTES", 100)
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "one.db3").write_bytes(b" " * 80)
    sources = [Source(str(tmp_path / "gone.txt")), Source(str(bag), topic="/odom")] * 2
    runs = [Run("one", "all", str(number), each) for number, each in enumerate(sources)]
    planned = {"all": [Planned(run, "", "", "", run.run) for run in runs]}
    sequence = Sequence("all", Source("truth.txt"), {}, tuple(runs))
    found = tasks(Manifest(tmp_path, (sequence,)), planned, 1)
    assert [len(one.runs) for one in found] == [2, 2]
