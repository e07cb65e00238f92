# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmarks from manifest to files, on processes that are killed on the way."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarking.conftest import ROOT, make_runs

import trajeval_ros as te
from trajeval_ros.benchmarking import cluster
from trajeval_ros.benchmarking.errors import read_errors
from trajeval_ros.benchmarking.figures import FIGURES
from trajeval_ros.benchmarking.grids import heading, number
from trajeval_ros.benchmarking.grids import summary as summary_grids
from trajeval_ros.benchmarking.manifest import read_manifest
from trajeval_ros.benchmarking.plan import Task, plan, tasks
from trajeval_ros.benchmarking.results import Results, brief, read_csv, read_results
from trajeval_ros.benchmarking.table import compare
from trajeval_ros.benchmarking.whole import OutputExistsError, run
from trajeval_ros.benchmarking.work import LOST, OK, Outcome, Row, failed, outcomes_of, scores_of
from trajeval_ros.commands import benchmark, simulate
from trajeval_ros.runs import offline

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

Done = tuple[Path, list[Row]]
HALL = "ground_truth/hall.txt"


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, client: Any) -> Done:
    """A benchmark without trouble, but for one file that is no trajectory."""
    folder = tmp_path_factory.mktemp("benchmark")
    manifest = make_runs(folder)
    (folder / "results/vins/hall/bad.txt").write_text("no trajectory\n")
    return manifest, evaluated(manifest, folder / "out", client)


def evaluated(manifest: Path, out: Path, client: Any, *, resume: bool = False) -> list[Row]:
    """The whole rows, after every other way to them has been compared with the files."""
    brief_ones = run(read_manifest(manifest), out, client, resume=resume)
    rows = read_results(out)
    assert brief_ones == [brief(row) for row in rows]
    return rows


def figures(row: Row) -> dict[str, float]:
    return {
        name: value
        for name, value in row.items()
        if isinstance(value, float) and name != "wall_time"
    }


def assert_same(rows: list[Row], others: list[Row]) -> None:
    """Every row there once, and equal, however the runs were cut into tasks."""
    assert [row["key"] for row in rows] == [row["key"] for row in others]
    for row, other in zip(rows, others, strict=True):
        assert row["status"] == other["status"]
        assert figures(row) == pytest.approx(figures(other), rel=1e-6, abs=1e-9)


def test_a_run_that_fails_costs_itself_alone(done: Done) -> None:
    _, rows = done
    assert len(rows) == 9
    (bad,) = [row for row in rows if row["status"] != OK]
    assert (bad["system"], bad["sequence"], bad["run"]) == ("vins", "hall", "bad")
    assert "bad.txt, row 1" in str(bad["error"])


def test_rows_are_those_of_single_evaluations(done: Done) -> None:
    manifest, rows = done
    for sequence, gauge in (("hall", "se3"), ("stairs", "sim3")):
        truth = te.read_tum(manifest.parent / f"ground_truth/{sequence}.txt")
        estimate = te.read_tum(manifest.parent / f"results/wheels-2/{sequence}/1.txt")
        summary = te.evaluate(truth, estimate, gauge=gauge, relative_delta=0.5).summary
        (row,) = [
            r for r in rows if (r["system"], r["sequence"], r["run"]) == ("wheels-2", sequence, "1")
        ]
        for part in ("ate_translation_rmse", "ate_rotation_rmse", "re_translation_rmse"):
            assert row[f"conventional.{part}"] == pytest.approx(
                summary["conventional"][part], rel=1e-9
            )
        jitter = summary["error_model"]["translation"]["jitter_std"]["value"]
        assert row["error_model.translation.jitter_std.value"] == pytest.approx(jitter, rel=1e-6)
        assert row["parameters.gauge"] == gauge


def test_bags_give_the_rows_of_the_files_that_they_were_made_of(
    done: Done, tmp_path: Path, client: Any
) -> None:
    """The ground truth in a bag of its own, each run in another: a file that is none beside."""
    pytest.importorskip("rosbags", reason="needs the extra bags")
    from twins.bags import write_bag

    source, rows = done
    write_bag(tmp_path / "hall", {"/mocap": te.read_tum(source.parent / HALL).data})
    for system in ("vins", "wheels-2"):
        estimate = te.read_tum(source.parent / f"results/{system}/hall/0.txt").data
        (tmp_path / "runs" / system).mkdir(parents=True)
        write_bag(tmp_path / f"runs/{system}/hall_0", {"/odom": estimate, "/other": estimate})
    write_bag(tmp_path / "runs/vins/hall_1", {"/other": estimate})
    manifest = tmp_path / "manifest.yaml"
    manifest.write_text(
        "parameters: {relative.delta: 0.5}\n"
        "estimates: {pattern: 'runs/{system}/{sequence}_{run}', topic: /odom}\n"
        "sequences: {hall: {ground_truth: hall, topic: /mocap}}\n"
    )
    found = evaluated(manifest, tmp_path / "out", client)
    good = [row for row in found if row["status"] == OK]
    assert [(row["system"], row["run"]) for row in good] == [("vins", "0"), ("wheels-2", "0")]
    for row in good:
        (other,) = [
            each
            for each in rows
            if (each["system"], each["sequence"], each["run"]) == (row["system"], "hall", "0")
        ]
        # A bag's stamps are whole nanoseconds, and so are the file's.
        assert figures(row) == pytest.approx(figures(other), rel=1e-6, abs=1e-9)
        assert row["estimate_sha256"] != other["estimate_sha256"]
    (bad,) = [row for row in found if row["status"] != OK]
    assert bad["run"] == "1"
    assert "/odom" in str(bad["error"])
    # Content decides, of a folder as of a file; and so does the topic.
    again = evaluated(manifest, tmp_path / "out", client, resume=True)
    assert [row["wall_time"] for row in again] == [row["wall_time"] for row in found]
    manifest.write_text(manifest.read_text().replace("/odom", "/other"))
    others = evaluated(manifest, tmp_path / "out", client, resume=True)
    assert [row["status"] for row in others] == [OK, OK, OK]


def test_the_processes_of_the_own_cluster_keep_no_profile(client: Any) -> None:
    """It grows by 10 MB a minute."""
    import dask

    kept = client.run(dask.config.get, "distributed.worker.profile.enabled")
    assert set(kept.values()) == {False}


DATA = ROOT / ".." / "shared" / "data" / "euroc_mh04"


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data is absent")
def test_tables_of_a_recording_are_those_of_single_evaluations(tmp_path: Path, client: Any) -> None:
    """Forty seconds of two systems, with noisy copies as repetitions: equal to the digit."""
    text = (DATA / "groundtruth.txt").read_text().splitlines(keepends=True)
    (tmp_path / "truth.txt").write_text("".join(text[:9000]))
    runs = {}
    for system in ("pl_vio", "vins_mono"):
        poses = np.loadtxt(DATA / f"{system}.txt")[:400]
        (tmp_path / f"{system}/mh04").mkdir(parents=True)
        for run_ in range(2):
            noise = np.random.default_rng(run_).normal(0.0, 1e-3, (len(poses), 3))
            copy = np.hstack([poses[:, :1], poses[:, 1:4] + noise, poses[:, 4:]])
            runs[system, str(run_)] = tmp_path / f"{system}/mh04/{run_}.txt"
            np.savetxt(runs[system, str(run_)], copy, fmt="%.9f")
    manifest = tmp_path / "manifest.yaml"
    manifest.write_text(
        "estimates: '{system}/{sequence}/{run}.txt'\nsequences: {mh04: {ground_truth: truth.txt}}\n"
    )
    rows = evaluated(manifest, tmp_path / "out", client)
    truth = te.read_tum(tmp_path / "truth.txt")
    singles = {name: te.evaluate(truth, te.read_tum(path)).summary for name, path in runs.items()}
    whole = {name: dict(scalars(summary)) for name, summary in singles.items()}
    compared = 0
    for row in rows:
        single = whole[str(row["system"]), str(row["run"])]
        for column, value in row.items():
            if isinstance(value, float) and not column.startswith(("parameters.", "wall_time")):
                assert value == pytest.approx(single[column], rel=1e-6, abs=1e-9), column
                compared += 1
    assert compared > 4 * 100
    (table, *_) = summary_grids(compare(rows))
    for name, entries in table.rows[1:]:
        (figure,) = [each for each in FIGURES if heading(each) == name]
        for system, entry in zip(table.columns, entries, strict=True):
            values = [whole[system, run_][figure.column] for run_ in "01"]
            assert entry.text.rstrip("†") == number(float(np.median(values)) * figure.factor)


def scalars(part: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    for name, value in part.items():
        if isinstance(value, dict):
            yield from scalars(value, f"{prefix}{name}.")
        elif isinstance(value, int | float):
            yield f"{prefix}{name}", float(value)


def test_files_have_every_row(done: Done) -> None:
    manifest, rows = done
    folder = manifest.parent / "out"
    keys = [row["key"] for row in rows]
    assert [row["key"] for row in read_results(folder)] == keys
    assert sorted(str(row["key"]) for row in read_csv(folder / "results.csv")) == sorted(
        map(str, keys)
    )
    assert {path.name for path in folder.iterdir()} == {
        *("results.csv", "results.parquet", "tables.md", "tables.tex", "tables.html"),
        *("errors.csv", "report.html"),
    }


def test_resuming_does_what_is_left_and_what_has_changed(
    done: Done, client: Any, tmp_path: Path
) -> None:
    manifest, rows = done
    out = tmp_path / "out"
    shutil.copytree(manifest.parent / "out", out)
    with pytest.raises(OutputExistsError):
        run(read_manifest(manifest), out, client)
    # One was never done, one was lost with its worker, one is of another file.
    kept = [dict(row) for row in rows if row["system"] != "vins" or row["run"] != "0"]
    kept[0]["status"], kept[1]["key"] = LOST, "of other contents"
    marked = [row["key"] for row in kept[2:]]
    for row in kept[2:]:
        row["wall_time"] = -1.0
    Results(out, kept)
    again = evaluated(manifest, out, client, resume=True)
    assert_same(again, rows)
    assert [row["key"] for row in again if row["wall_time"] == -1.0] == marked


def test_in_python_it_is_a_frame(done: Done, client: Any, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    manifest, rows = done
    shutil.copytree(manifest.parent / "out", tmp_path / "out")
    frame = te.benchmark(manifest, tmp_path / "out", client, resume=True)
    assert list(frame["key"]) == [row["key"] for row in rows]
    assert frame["conventional.ate_translation_rmse"].notna().sum() == 8


def test_no_estimate_s_name_is_a_parameter(done: Done) -> None:
    manifest, _ = done
    sequence = read_manifest(manifest).sequences[0]
    parameters = {**sequence.parameters, "estimate.time_offset": 0.01}
    truth = te.read_tum(sequence.ground_truth.path).data
    estimates = [te.read_tum(run.source.path).data for run in sequence.runs if run.run == "0"]
    offsets = [
        scored.summary["parameters"]["estimate.time_offset"]
        for scored in scores_of(parameters, truth, estimates)
    ]
    assert offsets == [0.01, 0.01]


def test_a_figure_that_a_defect_costs_is_said_in_the_row(
    done: Done, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("of a defect")

    monkeypatch.setattr(offline, "with_headline", broken)
    found = read_manifest(done[0])
    task = tasks(found, {**plan(found), "stairs": []}, 1)[0]
    rows = [outcome.row for outcome in outcomes_of(task) if outcome.row["status"] == OK]
    assert rows
    assert all("the headline" in str(row["defects"]) for row in rows)
    assert all(row["defects"] is None for row in done[1])


@contextlib.contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    started = subprocess.Popen(
        [sys.executable, "-m", *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield started
    finally:
        started.kill()
        started.wait()


def wait_for(path: Path, lines: int, patience: float = 240.0) -> None:
    end = time.monotonic() + patience
    while not path.is_file() or path.read_text().count("\n") < lines:
        assert time.monotonic() < end, f"{path} has not come"
        time.sleep(0.02)


@pytest.mark.slow
def test_after_kills_every_row_is_there_once(done: Done, tmp_path: Path) -> None:
    """A scheduler and two workers as processes: a worker is killed, then the client."""
    manifest, rows = done
    address, out = tmp_path / "scheduler.json", tmp_path / "out"
    worker = ("distributed.cli.dask_worker", "--scheduler-file", str(address), "--no-nanny")
    worker += ("--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path))
    with contextlib.ExitStack() as stack:
        stack.enter_context(
            process(
                *("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"),
                *("--no-dashboard", "--scheduler-file", str(address)),
            )
        )
        wait_for(address, 1)
        first = stack.enter_context(process(*worker))
        stack.enter_context(process(*worker))
        found = re.search(r"tcp://[0-9.:]+", address.read_text())
        assert found is not None
        asked = (str(manifest), "--output", str(out), "--scheduler", found[0])
        client = stack.enter_context(process("trajeval_ros", "benchmark", *asked))
        # The header and a row: the rest is under way.
        wait_for(out / "results.csv", 2)
        first.send_signal(signal.SIGKILL)
        client.send_signal(signal.SIGKILL)
        client.wait()
        before = {row["key"]: row for row in read_csv(out / "results.csv")}
        assert before
        assert benchmark.main([*asked, "--resume"]) == 0
    again = read_results(out)
    assert_same(again, rows)
    kept = [row for row in again if before.get(row["key"], {}).get("status") == OK]
    assert all(row["wall_time"] == before[row["key"]]["wall_time"] for row in kept)


def test_a_scheduler_that_is_not_there_is_said(
    done: Done, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Not the ten seconds that a busy network may need.
    monkeypatch.setattr(cluster, "PATIENCE", 0.5)
    manifest, _ = done
    asked = [str(manifest), "--output", str(tmp_path / "o"), "--scheduler", "tcp://127.0.0.1:9"]
    assert benchmark.main(asked) == 1
    assert "no scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err


def test_an_output_that_is_no_folder_is_one_line(
    done: Done, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest, _ = done
    (tmp_path / "file").touch()
    asked = [str(manifest), "--output", str(tmp_path / "file"), "--workers", "1"]
    assert benchmark.main(asked) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert said == f"benchmark: error: cannot write {tmp_path / 'file'}: File exists"


@pytest.mark.slow
def test_the_page_s_commands_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``docs/benchmark.md`` from top to bottom, in an empty folder."""
    text = (ROOT / "docs/benchmark.md").read_text()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    mains = {"benchmark": benchmark.main, "simulate": simulate.main}
    ran = 0
    for block in re.findall(r"^```sh\n(.*?)^```", text, re.M | re.S):
        for line in block.splitlines():
            program, *rest = shlex.split(line)
            if program in mains:
                assert mains[program](rest) == 0, capsys.readouterr().err
                ran += 1
            else:
                subprocess.run([program, *rest], check=True)
    assert ran > 4
    assert Path("new/tables.md").is_file()
    assert Path("benchmark.xml").is_file()
    (example,) = re.findall(r"^```yml\n(.*?)^```", text, re.M | re.S)
    Path("example.yaml").write_text(example)
    for name in ("gt/hall.csv", "gt/stairs.txt", "bags/vins/hall/1.txt", "bags/vins/stairs/1.txt"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text("0.0 0 0 0 0 0 0 1\n")
    assert len(read_manifest("example.yaml").runs) == 2


def deadly(task: Task) -> list[Outcome]:
    """In place of the work: a run that kills whoever takes it, as one without memory does."""
    if any(one.run.run == "bad" for one in task.runs):
        os.kill(os.getpid(), signal.SIGKILL)
    return [Outcome(failed(one, "not evaluated here")) for one in task.runs]


@pytest.mark.slow
def test_a_run_that_kills_its_workers_costs_itself_alone(
    done: Done, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import dask

    manifest, rows = done
    monkeypatch.setattr(cluster, "evaluate", partial(cluster.evaluate, work=deadly))
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        cluster.cluster(workers=1) as own,
    ):
        found = run(read_manifest(manifest), tmp_path / "out", own)
    assert [row["key"] for row in found] == [row["key"] for row in rows]
    (lost,) = [row for row in found if row["status"] == LOST]
    assert lost["run"] == "bad"
    assert lost["error"] == "every worker died that evaluated it"


@pytest.mark.slow
def test_a_scheduler_that_dies_is_said_and_what_is_done_is_kept(
    done: Done, tmp_path: Path, client: Any
) -> None:
    manifest, rows = done
    address, out = tmp_path / "scheduler.json", tmp_path / "out"
    worker = ("distributed.cli.dask_worker", "--scheduler-file", str(address), "--no-nanny")
    worker += ("--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path))
    with contextlib.ExitStack() as stack:
        scheduler = stack.enter_context(
            process(
                *("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"),
                *("--no-dashboard", "--scheduler-file", str(address)),
            )
        )
        wait_for(address, 1)
        stack.enter_context(process(*worker))
        found = re.search(r"tcp://[0-9.:]+", address.read_text())
        assert found is not None
        command = started("benchmark", str(manifest), "--output", str(out), "--scheduler", found[0])
        stack.callback(command.kill)
        wait_for(out / "results.csv", 2)
        scheduler.kill()
        _, said = command.communicate(timeout=240)
    assert command.returncode == 1
    assert "benchmark: error: the scheduler is gone; --resume goes on" in said
    resumed_as(out, manifest, rows, client)


@pytest.mark.slow
def test_ctrl_c_loses_no_more_than_what_was_under_way(
    done: Done, tmp_path: Path, client: Any
) -> None:
    """The signal goes to the workers as well, as a terminal sends it."""
    manifest, rows = done
    out = tmp_path / "out"
    command = started("benchmark", str(manifest), "--output", str(out), "--workers", "1")
    try:
        wait_for(out / "results.csv", 2)
        os.killpg(command.pid, signal.SIGINT)
        _, said = command.communicate(timeout=240)
    finally:
        command.kill()
    assert command.returncode == 130
    assert "runs are done; --resume goes on with them" in said
    assert "Traceback" not in said
    resumed_as(out, manifest, rows, client)


def started(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "trajeval_ros", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def resumed_as(out: Path, manifest: Path, rows: list[Row], client: Any) -> None:
    """What is there is kept as it is, and with the rest it is a run without trouble."""
    before = {row["key"]: row["wall_time"] for row in read_csv(out / "results.csv")}
    assert 0 < len(before) < len(rows)
    again = evaluated(manifest, out, client, resume=True)
    assert_same(again, rows)
    assert {row["key"]: row["wall_time"] for row in again if row["key"] in before} == before
    assert len(list(read_errors(out, [str(row["key"]) for row in rows]))) == len(rows) - 1
