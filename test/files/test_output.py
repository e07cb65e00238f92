# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The output folder: what is in it, when, and what a reader may rely on."""

import contextlib
import csv
import dataclasses
import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from trajeval_ros import se3
from trajeval_ros.files.output import COLUMNS, OutputError, OutputFolder
from trajeval_ros.online.results import Evaluations

Array = npt.NDArray[np.float64]

# INTERFACE: the columns as they are promised, spelt out.
PROMISED = (
    "stamp_ns,gt_tx,gt_ty,gt_tz,gt_qx,gt_qy,gt_qz,gt_qw,"
    "cov_00,cov_01,cov_02,cov_03,cov_04,cov_05,cov_11,cov_12,cov_13,cov_14,cov_15,"
    "cov_22,cov_23,cov_24,cov_25,cov_33,cov_34,cov_35,cov_44,cov_45,cov_55,"
    "est_tx,est_ty,est_tz,est_qx,est_qy,est_qz,est_qw,"
    "e_0,e_1,e_2,e_3,e_4,e_5,chi2,log_det,log_likelihood,sampled,ate_translation,ate_rotation"
)


def part(rows: Evaluations, which: slice) -> Evaluations:
    names = [field.name for field in dataclasses.fields(Evaluations)]
    return Evaluations(**{name: getattr(rows, name)[which] for name in names})


def make_rows(count: int, seed: int = 0) -> Evaluations:
    generator = np.random.default_rng(seed)
    roots = generator.normal(size=(count, 6, 6))
    error = generator.normal(size=(count, 6)) * 1e-3
    error[:1] = np.nan
    return Evaluations(
        stamps=np.int64(1403715529_112143517) + np.arange(count) * np.int64(49_999_999),
        ground_truth=se3.exp(generator.normal(size=(count, 6))),
        covariance=roots @ roots.swapaxes(-1, -2) * 1e-6,
        estimate=se3.exp(generator.normal(size=(count, 6))),
        relative_error=error,
        absolute_error=error,
        chi2=generator.normal(size=count) ** 2,
        log_det=generator.normal(size=count),
        log_likelihood=generator.normal(size=count),
        relative_log_likelihood=generator.normal(size=count),
        sampled=np.ones(count, dtype=bool),
        twist=np.zeros((count, 6)),
        nearest=np.zeros(count, dtype=np.int64),
    )


def read_rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "poses.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def stack(rows: list[dict[str, str]], *names: str) -> Array:
    return np.array([[float(row[name]) for name in names] for row in rows])


def test_columns_are_the_promised_ones(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as folder:
        folder.write({})
    assert (tmp_path / "poses.csv").read_text(encoding="utf-8") == PROMISED + "\n"
    assert ",".join(COLUMNS) == PROMISED


def test_rows_read_back_exactly(tmp_path: Path) -> None:
    rows = make_rows(5)
    with OutputFolder(tmp_path) as folder:
        folder.add(part(rows, slice(0, 2)))
        folder.add(part(rows, slice(2, 2)))
        folder.add(part(rows, slice(2, 5)))
        folder.write({})
    read = read_rows(tmp_path)
    assert [int(row["stamp_ns"]) for row in read] == rows.stamps.tolist()
    for name in ("chi2", "log_det", "log_likelihood"):
        assert stack(read, name)[:, 0].tolist() == getattr(rows, name).tolist()
    error_names = [f"e_{axis}" for axis in range(6)]
    assert [read[0][name] for name in error_names] == [""] * 6
    assert stack(read[1:], *error_names).tolist() == rows.relative_error[1:].tolist()
    for row, column in zip(*np.triu_indices(6), strict=True):
        expected = rows.covariance[:, row, column].tolist()
        assert stack(read, f"cov_{row}{column}")[:, 0].tolist() == expected
    for prefix, poses in (("gt", rows.ground_truth), ("est", rows.estimate)):
        position = stack(read, f"{prefix}_tx", f"{prefix}_ty", f"{prefix}_tz")
        assert position.tolist() == poses[:, :3, 3].tolist()
        quaternion = stack(read, *(f"{prefix}_q{axis}" for axis in "xyzw"))
        back = se3.from_position_quaternion(position, quaternion)
        np.testing.assert_allclose(back, poses, atol=1e-15)


def test_every_write_is_complete_to_that_moment(tmp_path: Path) -> None:
    rows = make_rows(7)
    with OutputFolder(tmp_path / "a" / "b") as folder:
        for end in range(1, 8):
            folder.add(part(rows, slice(end - 1, end)))
            folder.write({"estimate": {"evaluated": end}}, lambda summary: f"<p>{summary}</p>")
            assert len(read_rows(folder.path)) == end
            summary = json.loads((folder.path / "summary.json").read_text(encoding="utf-8"))
            assert summary == {"estimate": {"evaluated": end}}
            assert f"{end}" in (folder.path / "report.html").read_text(encoding="utf-8")
    assert sorted(path.name for path in folder.path.iterdir()) == [
        "poses.csv",
        "report.html",
        "summary.json",
    ]


def test_nothing_but_the_stream_before_the_first_write(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as folder:
        folder.add(make_rows(3))
        assert [path.suffix for path in tmp_path.iterdir()] == [".partial"]
    assert list(tmp_path.iterdir()) == []


def test_files_have_the_permissions_of_any_file(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    with OutputFolder(tmp_path) as folder:
        folder.write({})
    modes = {path.name: path.stat().st_mode for path in tmp_path.iterdir()}
    assert modes["poses.csv"] == modes["summary.json"] == modes["other"]


def test_clear_starts_over(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as folder:
        folder.add(make_rows(5, seed=1))
        folder.write({})
        folder.clear()
        assert len(read_rows(tmp_path)) == 5
        folder.add(make_rows(2, seed=2))
        folder.write({})
    read = read_rows(tmp_path)
    assert stack(read, "chi2")[:, 0].tolist() == make_rows(2, seed=2).chi2.tolist()


def test_move_takes_the_rows_along(tmp_path: Path) -> None:
    rows = make_rows(6)
    folder = OutputFolder(tmp_path / "old")
    folder.add(part(rows, slice(0, 4)))
    with folder.move(tmp_path / "new") as moved:
        moved.add(part(rows, slice(4, 6)))
        moved.write({})
    assert stack(read_rows(tmp_path / "new"), "chi2")[:, 0].tolist() == rows.chi2.tolist()
    assert list((tmp_path / "old").iterdir()) == []


def test_folder_that_was_removed_is_made_again(tmp_path: Path) -> None:
    with OutputFolder(tmp_path / "run") as folder:
        folder.add(make_rows(3))
        for path in folder.path.iterdir():
            path.unlink()
        folder.path.rmdir()
        folder.write({})
        assert len(read_rows(folder.path)) == 3


def test_folder_that_cannot_be_made_says_which(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"cannot write the output folder: .*file.*") as caught:
        OutputFolder(tmp_path / "file" / "run")
    assert "\n" not in str(caught.value)


def test_file_that_cannot_be_replaced_says_which(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as folder:
        (tmp_path / "summary.json").mkdir()
        with pytest.raises(OutputError, match=r"summary\.json"):
            folder.write({})
        assert not list(tmp_path.glob(".summary*"))
        (tmp_path / "summary.json").rmdir()
        folder.write({})


def test_a_nan_in_the_summary_is_refused(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as folder:
        with pytest.raises(ValueError, match="not JSON compliant"):
            folder.write({"chi2": float("nan")})
        assert not (tmp_path / "summary.json").exists()


@pytest.mark.parametrize("interrupts", [1, 2, 3])
def test_interrupts_are_raised_after_everything_is_written(tmp_path: Path, interrupts: int) -> None:
    calls: list[int] = []

    def render(summary: Any) -> str:
        calls.append(1)
        if len(calls) <= interrupts:
            raise KeyboardInterrupt
        return "whole"

    with OutputFolder(tmp_path) as folder:
        folder.add(make_rows(2))
        with pytest.raises(KeyboardInterrupt):
            folder.write({}, render)
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == "whole"
    assert sorted(os.listdir(tmp_path)) == ["poses.csv", "report.html", "summary.json"]


def test_summary_and_rows_are_safe_when_the_report_fails(tmp_path: Path) -> None:
    def render(summary: Any) -> str:
        raise RuntimeError("no picture")

    with OutputFolder(tmp_path) as folder:
        folder.add(make_rows(2))
        with pytest.raises(RuntimeError, match="no picture"):
            folder.write({}, render)
    assert sorted(os.listdir(tmp_path)) == ["poses.csv", "summary.json"]


def test_what_cannot_be_written_keeps_nothing_else_from_it(tmp_path: Path) -> None:
    (tmp_path / "summary.json").mkdir()
    with OutputFolder(tmp_path) as folder:
        folder.add(make_rows(2))
        with pytest.raises(OutputError) as caught:
            folder.write({}, lambda summary: "whole", last=True)
    assert list(caught.value.failures) == ["summary.json"]
    assert not caught.value.full
    assert len(read_rows(tmp_path)) == 2
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == "whole"


@pytest.mark.parametrize("count", [0, 5])
def test_the_last_rows_are_the_stream_itself(tmp_path: Path, count: int) -> None:
    (tmp_path / "other").touch()
    with OutputFolder(tmp_path) as folder:
        folder.add(make_rows(count))
        (stream,) = tmp_path.glob(".poses-*")
        inode = stream.stat().st_ino
        folder.write({}, last=True)
    assert (tmp_path / "poses.csv").stat().st_ino == inode
    assert (tmp_path / "poses.csv").stat().st_mode == (tmp_path / "other").stat().st_mode
    assert len(read_rows(tmp_path)) == count
    assert not list(tmp_path.glob(".*"))


def test_the_last_write_survives_a_folder_that_was_removed(tmp_path: Path) -> None:
    with OutputFolder(tmp_path / "run") as folder:
        folder.add(make_rows(3))
        shutil.rmtree(folder.path)
        folder.write({}, last=True)
        assert len(read_rows(folder.path)) == 3


LIMITED = """
import os, resource, sys
from test_output import make_rows, part, OutputError, OutputFolder
rows = make_rows(200)
with OutputFolder(sys.argv[1]) as folder:
    folder.add(part(rows, slice(0, 20)))
    room = os.stat(folder._stream.name).st_size + 100
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    try:
        folder.add(part(rows, slice(20, 150)))
    except OutputError as error:
        assert error.full
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    folder.add(part(rows, slice(150, 200)))
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    for last in (False, True):
        try:
            folder.write({"a": 1}, lambda summary: "x" * 2 * room, last=last)
        except OutputError as error:
            assert error.full
            print(*error.failures)
            print(*error.lines, sep="\\n", file=sys.stderr)
print(len(os.listdir("/proc/self/fd")))
"""


def python(code: str, *arguments: object) -> subprocess.Popen[str]:
    root = Path(__file__).resolve().parents[2]
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(root), str(Path(__file__).parent)])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_a_full_disk_loses_what_does_not_fit_and_that_is_named(tmp_path: Path) -> None:
    child = python(LIMITED, tmp_path)
    out, err = child.communicate()
    assert child.returncode == 0, err
    # The copy does not fit while the run goes on; the stream itself does at the end. Rows that
    # found no room have waited until there was some.
    assert out.splitlines()[:2] == ["poses.csv report.html", "report.html"]
    assert "report.html: File too large" in err
    assert "poses.csv: File too large" in err
    assert "lacks" not in err
    # Three standard ones, and the one that lists them.
    assert out.splitlines()[2] == "4"
    rows = make_rows(200)
    assert [int(row["stamp_ns"]) for row in read_rows(tmp_path)] == rows.stamps.tolist()
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8")) == {"a": 1}
    assert sorted(os.listdir(tmp_path)) == ["poses.csv", "summary.json"]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 200 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0:
        pytest.skip("only root may mount a small file system")
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", folder], capture_output=True
    )
    if mounted.returncode:
        pytest.skip(f"no small file system can be mounted: {mounted.stderr.decode().strip()}")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_the_summary_has_room_on_a_disk_that_the_rows_have_filled(small_disk: Path) -> None:
    rows = make_rows(2000)
    with OutputFolder(small_disk) as folder:
        for begin in range(0, 2000, 100):
            with contextlib.suppress(OutputError):
                folder.add(part(rows, slice(begin, begin + 100)))
        for last in (False, True):
            with pytest.raises(OutputError) as caught:
                folder.write({"text": "x" * 9000}, lambda summary: "x" * 300_000, last=last)
            assert caught.value.full
            assert list(caught.value.failures) == ["poses.csv", "report.html"]
    assert (
        len(json.loads((small_disk / "summary.json").read_text(encoding="utf-8"))["text"]) == 9000
    )
    kept = [int(row["stamp_ns"]) for row in read_rows(small_disk)]
    assert kept == rows.stamps[: len(kept)].tolist()
    lost = f"lacks {2000 - len(kept):,} poses"
    assert lost in caught.value.failures["poses.csv"]
    # All that fits: the summary takes the room that was kept for it.
    assert (small_disk / "poses.csv").stat().st_size > 150_000
    assert sorted(os.listdir(small_disk)) == ["poses.csv", "summary.json"]


def test_the_rows_have_the_room_of_the_summary_once_it_is_written(small_disk: Path) -> None:
    rows = make_rows(190)
    with OutputFolder(small_disk) as folder:
        for begin in range(0, 190, 50):
            with contextlib.suppress(OutputError):
                folder.add(part(rows, slice(begin, begin + 50)))
        with pytest.raises(OutputError, match="No space left"):
            folder.write({})
        folder.write({}, last=True)
    assert [int(row["stamp_ns"]) for row in read_rows(small_disk)] == rows.stamps.tolist()


def test_each_save_on_a_full_disk_writes_the_summary_as_it_is(small_disk: Path) -> None:
    rows = make_rows(2000)
    with OutputFolder(small_disk) as folder:
        for save in range(5):
            for begin in range(400 * save, 400 * save + 400, 100):
                with contextlib.suppress(OutputError):
                    folder.add(part(rows, slice(begin, begin + 100)))
            with contextlib.suppress(OutputError):
                folder.write({"save": save, "text": "x" * 9000})
            summary = json.loads((small_disk / "summary.json").read_text(encoding="utf-8"))
            assert summary["save"] == save


def test_rows_that_wait_are_bounded(small_disk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trajeval_ros.files.output._MOST_WAITING", 50_000)
    rows = make_rows(1000)
    with OutputFolder(small_disk) as folder:
        for begin in range(0, 1000, 100):
            with contextlib.suppress(OutputError):
                folder.add(part(rows, slice(begin, begin + 100)))
            assert len(folder._waiting) <= 50_000
        with pytest.raises(OutputError) as caught:
            folder.write({}, last=True)
    lost = 1000 - len(read_rows(small_disk))
    assert f"lacks {lost:,} poses" in caught.value.failures["poses.csv"]


KILLED = """
import sys, time
from test_output import make_rows, OutputFolder
def render(summary):
    print("rendering", flush=True)
    sys.stdin.read()
with OutputFolder(sys.argv[1]) as folder:
    folder.add(make_rows(4))
    folder.write({"run": 1}, lambda summary: "first")
    folder.write({"run": 2}, render)
"""


def test_a_killed_run_leaves_whole_files_and_the_next_one_tidies_up(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(root), str(Path(__file__).parent)])},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "rendering\n"
    while_it_lives = sorted(tmp_path.glob(".*.partial"))
    assert len(while_it_lives) == 2
    with OutputFolder(tmp_path):
        assert set(while_it_lives) < set(tmp_path.glob(".*.partial"))
    child.kill()
    child.communicate()
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == "first"
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8")) == {"run": 2}
    assert len(read_rows(tmp_path)) == 4
    with OutputFolder(tmp_path):
        assert not set(while_it_lives) & set(tmp_path.glob(".*.partial"))
    assert sorted(os.listdir(tmp_path)) == ["poses.csv", "report.html", "summary.json"]


def test_rows_that_find_no_room_wait_for_it(small_disk: Path) -> None:
    rows = make_rows(150)
    with OutputFolder(small_disk) as folder:
        (small_disk / "other").write_bytes(b"x" * 120_000)
        refused = 0
        for begin in range(0, 150, 10):
            try:
                folder.add(part(rows, slice(begin, begin + 10)))
            except OutputError:
                refused += 1
        assert refused > 0
        (small_disk / "other").unlink()
        folder.write({"a": 2}, last=True)
    assert json.loads((small_disk / "summary.json").read_text(encoding="utf-8")) == {"a": 2}
    assert [int(row["stamp_ns"]) for row in read_rows(small_disk)] == rows.stamps.tolist()


def test_rows_from_before_there_was_a_folder_are_counted(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as folder:
        folder.lack(7, "no room")
        folder.add(make_rows(3))
        with pytest.raises(OutputError) as caught:
            folder.write({}, last=True)
    assert list(caught.value.failures) == ["poses.csv"]
    assert "lacks 7 poses, which could not be written: no room" in str(caught.value)
    assert len(read_rows(tmp_path)) == 3


def test_the_rows_do_not_wait_for_their_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))

    rows = make_rows(20)
    alignment = {"pose": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "scale": 1.0}
    ate = {"ate_translation_rmse": 1.0, "ate_rotation_rmse": 1.0, "alignment": alignment}
    with OutputFolder(tmp_path) as folder:
        folder.add(rows)
        with monkeypatch.context() as patch:
            patch.setattr("trajeval_ros.files.output._overwrite", refuse)
            with pytest.raises(OutputError, match="lacks the absolute errors of its poses"):
                folder.write({"conventional": ate})
        assert len(read_rows(tmp_path)) == 20
        assert {row["ate_translation"] for row in read_rows(tmp_path)} == {""}
        folder.write({"conventional": ate}, last=True)
    expected = np.linalg.norm(rows.ground_truth[:, :3, 3] - rows.estimate[:, :3, 3], axis=1)
    np.testing.assert_allclose(stack(read_rows(tmp_path), "ate_translation")[:, 0], expected)
