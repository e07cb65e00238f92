# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate`` as its users run it: a real process, its exit code, its output, its files."""

import csv
import html
import json
import math
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands.simulate import write_files
from trajeval_ros.files.output import COLUMNS
from trajeval_ros.online.parameters import PARAMETERS

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"


def evaluate(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """As a user would; on stderr without how far it is, which a slow machine says and no other."""
    result = subprocess.run(
        [sys.executable, "-m", "trajeval_ros.commands.evaluate", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        **options,
    )
    result.stderr = without_progress(result.stderr)
    return result


def without_progress(said: str) -> str:
    return re.sub(r".*: [\d,]+ of [\d,]+ \w+.*, [\d,]+ \w+/s.*\n", "", said)


def summary_of(folder: Path) -> Any:
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


def refused(result: subprocess.CompletedProcess[str], code: int = 1) -> str:
    """Check that the run was refused with one clear line, and return the line."""
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("evaluate: error: ")
    return lines[0].removeprefix("evaluate: error: ")


def data_file(directory: str, name: str) -> Path:
    path = DATA / directory / f"{name}.txt"
    if not path.is_file():
        pytest.skip(f"the real data is not here: {path}")
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A short simulated run: ground truth and estimate."""
    return write_files(tmp_path_factory.mktemp("run"), 20.0, 3)


@pytest.fixture
def edited(run: tuple[Path, Path], tmp_path: Path) -> Callable[[Callable[[list[str]], None]], Path]:
    """Return a function that writes the estimate with its lines changed."""

    def write(change: Callable[[list[str]], None]) -> Path:
        lines = run[1].read_text(encoding="utf-8").splitlines()
        change(lines)
        path = tmp_path / "edited.txt"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    return write


@pytest.fixture(scope="module")
def evaluated(
    run: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[subprocess.CompletedProcess[str], Path]:
    output = tmp_path_factory.mktemp("output") / "a folder" / "run"
    return evaluate("tum", *run, "--output", output), output


def test_run_ends_well_and_says_where_the_files_are(
    evaluated: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    result, output = evaluated
    assert result.returncode == 0, result.stderr
    assert str(output) in result.stdout
    for figure in ("log-likelihood", "chi2/dof", "ATE", "RE", "Estimate", "Ground truth"):
        assert figure in result.stdout
    assert sorted(os.listdir(output)) == ["poses.csv", "report.html", "summary.json"]


def remarks(result: subprocess.CompletedProcess[str]) -> list[str]:
    """Return what follows the figures."""
    said = ("info: ", "warning: ", "likely cause: ")
    return [line for line in result.stdout.splitlines() if line.startswith(said)]


def test_the_remarks_do_not_depend_on_the_output(
    evaluated: tuple[subprocess.CompletedProcess[str], Path], run: tuple[Path, Path]
) -> None:
    found = remarks(evaluated[0])
    assert any(line.startswith("info: learned ") for line in found)
    assert found == remarks(evaluate("tum", *run))
    page = (evaluated[1] / "report.html").read_text(encoding="utf-8")
    assert all(html.escape(line.split(": ", 1)[1]) in page for line in found)


def test_the_remarks_on_a_strained_run(tmp_path: Path) -> None:
    pair = [data_file("tum_fr2_desk", name) for name in ("groundtruth", "orb")]
    found = remarks(evaluate("tum", *pair))
    assert any("first order does not hold" in line for line in found)
    assert found == remarks(evaluate("tum", *pair, "--output", tmp_path))


def test_rows_sum_to_the_summary(
    evaluated: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    _, output = evaluated
    summary = summary_of(output)
    with (output / "poses.csv").open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        assert tuple(reader.fieldnames or ()) == COLUMNS
        rows = list(reader)
    assert len(rows) == summary["estimate"]["evaluated"]
    relative = summary["relative"]
    for name in ("chi2", "log_det", "log_likelihood"):
        total = math.fsum(float(row[name]) for row in rows)
        assert total == pytest.approx(relative[name], rel=1e-9)
    assert relative["log_likelihood"] == pytest.approx(
        -0.5 * (relative["chi2"] + relative["log_det"] + relative["dof"] * math.log(2 * math.pi)),
        rel=1e-12,
    )
    assert relative["dof"] == 6 * (len(rows) - 1)


def test_relative_errors_are_those_of_the_poses(
    evaluated: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    _, output = evaluated
    with (output / "poses.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))

    def poses(prefix: str) -> Any:
        position = [[float(row[f"{prefix}_t{axis}"]) for axis in "xyz"] for row in rows]
        quaternion = [[float(row[f"{prefix}_q{axis}"]) for axis in "xyzw"] for row in rows]
        return se3.from_position_quaternion(position, quaternion)

    truth, estimate = poses("gt"), poses("est")
    steps = se3.compose(se3.inverse(estimate[:-1]), estimate[1:])
    expected = se3.log(
        se3.compose(se3.inverse(se3.compose(se3.inverse(truth[:-1]), truth[1:])), steps)
    )
    error = np.array([[float(row[f"e_{axis}"]) for axis in range(6)] for row in rows[1:]])
    np.testing.assert_allclose(error, expected, atol=1e-12)


def test_every_message_is_accounted_for(
    evaluated: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    summary = summary_of(evaluated[1])
    estimate, truth = summary["estimate"], summary["ground_truth"]
    assert estimate["received"] == (
        estimate["evaluated"] + estimate["pending"] + sum(estimate["rejected"].values())
    )
    assert estimate["pending"] == 0
    assert truth["received"] == truth["used"] + sum(truth["rejected"].values())


def test_nothing_is_written_without_output(run: tuple[Path, Path], tmp_path: Path) -> None:
    result = evaluate("tum", *run, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert list(tmp_path.iterdir()) == []


# All others go through the engine, in test_engine_real_data.
@pytest.mark.parametrize(("directory", "name"), [("tum_fr1_xyz", "rgbdslam"), ("kitti_00", "orb")])
def test_real_pairs_agree_with_evo(directory: str, name: str, tmp_path: Path) -> None:
    truth, estimate = data_file(directory, "groundtruth"), data_file(directory, name)
    result = evaluate("tum", truth, estimate, "--output", tmp_path)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "poses.csv").is_file()
    summary = summary_of(tmp_path)
    reference = json.loads((DATA / "reference_evo.json").read_text(encoding="utf-8"))["results"]
    ate = reference[directory][name]["se3"]["ape_trans_rmse_m"]
    # kitti_00's ground truth is at 10 Hz like its estimates, so evo associates the same stamps.
    assert summary["conventional"]["ate_translation_rmse"] == pytest.approx(ate, rel=0.03)


# -- bad input -----------------------------------------------------------------------------------


def test_missing_file(run: tuple[Path, Path], tmp_path: Path) -> None:
    line = refused(evaluate("tum", run[0], tmp_path / "nothing.txt"))
    assert "nothing.txt" in line
    assert "no such file" in line


def test_empty_file(run: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "empty.txt").touch()
    assert "empty.txt: there is nothing in it" in refused(
        evaluate("tum", tmp_path / "empty.txt", run[1])
    )


def test_file_of_words(run: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "words.txt"
    path.write_text("# a comment\nonce upon a time there was a robot\n", encoding="utf-8")
    assert "words.txt, row 2: 'once' is not a number" in refused(evaluate("tum", run[0], path))


def test_wrong_number_of_columns(edited: Any, run: tuple[Path, Path]) -> None:
    def shorten(lines: list[str]) -> None:
        lines[7] = lines[7].rpartition(" ")[0]

    assert "edited.txt, row 8: 7 columns" in refused(evaluate("tum", run[0], edited(shorten)))


def test_no_overlap_names_both_ranges(edited: Any, run: tuple[Path, Path]) -> None:
    def shift(lines: list[str]) -> None:
        lines[1:] = [line.replace("17500000", "18500000", 1) for line in lines[1:]]

    line = refused(evaluate("tum", run[0], edited(shift)))
    assert "do not overlap in time" in line
    assert "1750000000.0" in line
    assert "1850000000.3" in line


def test_output_that_cannot_be_written(run: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    line = refused(evaluate("tum", *run, "--output", tmp_path / "file"))
    assert "cannot write the output folder" in line


def test_a_full_disk_costs_what_does_not_fit(run: tuple[Path, Path], tmp_path: Path) -> None:
    limit = resource.RLIMIT_FSIZE, (30_000, resource.RLIM_INFINITY)
    result = evaluate(
        "tum", *run, "--output", tmp_path / "out", preexec_fn=lambda: resource.setrlimit(*limit)
    )
    assert result.returncode == 1
    assert "ATE" in result.stdout
    assert f"Written: summary.json in {tmp_path / 'out'}" in result.stdout
    poses, report = result.stderr.splitlines()
    assert re.match(r"evaluate: error: .*poses\.csv lacks [\d,]+ poses.*File too large", poses)
    assert re.match(r"evaluate: error: cannot write .*report\.html: File too large", report)
    assert sorted(os.listdir(tmp_path / "out")) == ["poses.csv", "summary.json"]


def replaced(line: str, column: int, text: str) -> str:
    words = line.split()
    words[column] = text
    return " ".join(words)


def test_bad_poses_are_counted_by_reason(
    edited: Any, run: tuple[Path, Path], tmp_path: Path
) -> None:
    def unnormalized(line: str) -> str:
        words = line.split()
        return " ".join([*words[:4], *(repr(1.1 * float(word)) for word in words[4:])])

    def spoil(lines: list[str]) -> None:
        rows = {
            101: lambda line: replaced(line, 0, "nan"),
            111: lambda line: replaced(line, 2, "nan"),
            121: lambda line: " ".join([*line.split()[:4], "0 0 0 0"]),
            131: unnormalized,
            132: unnormalized,
            # Far back, beyond any reordering on a network.
            201: lambda line: replaced(line, 0, lines[50].split()[0][:-3] + "999"),
            251: lambda line: replaced(line, 0, lines[249].split()[0]),
        }
        for row, change in rows.items():
            lines[row - 1] = change(lines[row - 1])

    result = evaluate("tum", run[0], edited(spoil), "--output", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    account = summary_of(tmp_path / "out")
    reasons = {
        "non_finite": (2, 101),
        "zero_quaternion": (1, 121),
        "unnormalized_quaternion": (2, 131),
        "out_of_order": (1, 201),
        "superseded": (1, 250),
    }
    for reason, (count, row) in reasons.items():
        assert account["estimate"]["rejected"][reason] == count
        assert re.search(
            rf"{count} {reason}, the first in \S*edited\.txt, row {row}\b", result.stdout
        )
    received = len(run[1].read_text(encoding="utf-8").splitlines()) - 1
    assert account["estimate"]["received"] == received


# -- usage ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("gauge=se4", "gauge must be one of"),
        ("window.duration=-3", "window.duration must be at least"),
        ("window.duration=long", "window.duration must be a number"),
        ("segment.min_samples=2.5", "segment.min_samples must be an integer"),
        ("windowduration=3", "unknown parameter windowduration; did you mean window.duration?"),
        ("delta=3", "unknown parameter delta; did you mean relative.delta?"),
        ("gauge", "--set takes name=value"),
        ("extrinsic=[1, 2]", "extrinsic must be seven finite numbers"),
    ],
)
def test_wrong_parameters_are_refused_by_name(
    assignment: str, message: str, run: tuple[Path, Path]
) -> None:
    assert message in refused(evaluate("tum", *run, "--set", assignment), code=2)


def test_parameters_from_the_nodes_file(run: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "evaluator.yaml"
    path.write_text(
        "/**:\n"
        "  ros__parameters:\n"
        "    use_sim_time: true\n"
        "    qos_overrides:\n"
        "      /estimate.subscription.depth: 5\n"
        "    gauge: yaw_translation\n"
        "    window:\n"
        "      duration: 1e1\n"
        "    relative.delta: 2\n"
        "evaluator:\n"
        "  ros__parameters:\n"
        "    relative.delta: 0.5\n"
        "another_node:\n"
        "  ros__parameters:\n"
        "    whatever: 3\n",
        encoding="utf-8",
    )
    result = evaluate(
        "tum", *run, "--params", path, "--set", "gauge=none", "--output", tmp_path / "out"
    )
    assert result.returncode == 0, result.stderr
    summary = summary_of(tmp_path / "out")
    assert summary["gauge"] == "none"
    assert "last 10 s" in result.stdout
    assert "over 0.5 s" in result.stdout


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1, 2", "is not YAML"),
        ("just words", "does not hold a mapping"),
        ("a: &a\n  b: *a\n", "is nested too deeply"),
        ("{" * 2000, "is nested too deeply"),
        ("gauge: 2001-99-99", "is not YAML: month must be"),
        ("window:\n  length: 3\n", "unknown parameter window.length"),
        ("other:\n  ros__parameters:\n    a: 1\n", "parameters for other only, not for evaluator"),
    ],
)
def test_bad_parameter_files(
    text: str, message: str, run: tuple[Path, Path], tmp_path: Path
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text, encoding="utf-8")
    line = refused(evaluate("tum", *run, "--params", path), code=2)
    assert message in line
    assert "bad.yaml" in line


@pytest.mark.parametrize(
    ("columns", "code"),
    [(slice(4, 8), "orientation never changes"), (slice(1, 8), "stays at one pose")],
)
def test_an_estimate_that_nobody_filled_in_is_evaluated_and_said(
    edited: Any, run: tuple[Path, Path], tmp_path: Path, columns: slice, code: str
) -> None:
    def spoil(lines: list[str]) -> None:
        empty = ["0", "0", "0", "0", "0", "0", "0", "1"]
        for i, line in enumerate(lines):
            fields = line.split()
            if not line.startswith("#"):
                fields[columns] = empty[columns]
                lines[i] = " ".join(fields)

    result = evaluate("tum", run[0], edited(spoil), "--output", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert f"likely cause: the estimate's {code}" in result.stdout or (
        f"likely cause: the estimate {code}" in result.stdout
    )
    assert "ATE" in result.stdout
    assert "error:" not in result.stdout
    assert sorted(os.listdir(tmp_path / "out")) == ["poses.csv", "report.html", "summary.json"]


def test_no_arguments_is_wrong_usage() -> None:
    result = evaluate()
    assert result.returncode == 2
    assert "usage: evaluate" in result.stderr


def test_help_names_every_format() -> None:
    result = evaluate("--help")
    assert result.returncode == 0
    for word in ("tum", "euroc", "kitti", "exit codes"):
        assert word in result.stdout


def test_a_reader_that_leaves_is_no_error(run: tuple[Path, Path]) -> None:
    command = f"{sys.executable} -m trajeval_ros.commands.evaluate tum {run[0]} {run[1]} | head -1"
    result = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert (result.returncode, without_progress(result.stderr)) == (0, "")


# -- the other formats ---------------------------------------------------------------------------


def test_euroc_and_kitti_give_what_tum_gives(
    run: tuple[Path, Path],
    evaluated: tuple[subprocess.CompletedProcess[str], Path],
    tmp_path: Path,
) -> None:
    truth = np.loadtxt(run[0])
    stamps = [line.split()[0] for line in run[0].read_text(encoding="utf-8").splitlines()[1:]]
    euroc = tmp_path / "data.csv"
    euroc.write_text(
        "#timestamp [ns], p_x, p_y, p_z, q_w, q_x, q_y, q_z\n"
        + "".join(
            f"{stamp.replace('.', '')},{','.join(map(repr, row[[1, 2, 3, 7, 4, 5, 6]].tolist()))}\n"
            for stamp, row in zip(stamps, truth, strict=True)
        ),
        encoding="utf-8",
    )
    result = evaluate("euroc", euroc, run[1], "--output", tmp_path / "euroc")
    assert result.returncode == 0, result.stderr
    relative = [summary_of(folder)["relative"] for folder in (tmp_path / "euroc", evaluated[1])]
    assert relative[0] == pytest.approx(relative[1], rel=1e-9)

    for path in run:
        rows = np.loadtxt(path)
        poses = se3.from_position_quaternion(rows[:, 1:4], rows[:, 4:])
        np.savetxt(tmp_path / path.name, poses[:, :3].reshape(-1, 12))
    np.savetxt(tmp_path / "times.txt", np.arange(10.0))
    line = refused(
        evaluate(
            "kitti",
            tmp_path / run[0].name,
            tmp_path / run[1].name,
            "--times",
            tmp_path / "times.txt",
        )
    )
    assert "10 stamps for the" in line


def test_kitti(tmp_path: Path) -> None:
    seconds = np.arange(0.0, 20.0, 0.1)
    angle = 0.3 * seconds
    poses = se3.exp(
        np.stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle, 0 * angle, angle], axis=1)
    )
    noise = np.random.default_rng(0).normal(size=(len(seconds), 6)) * 0.01
    for name, stack in (("gt", poses), ("est", se3.compose(poses, se3.exp(noise)))):
        np.savetxt(tmp_path / f"{name}.txt", stack[:, :3].reshape(-1, 12))
    np.savetxt(tmp_path / "times.txt", seconds)
    result = evaluate(
        "kitti", tmp_path / "gt.txt", tmp_path / "est.txt", "--times", tmp_path / "times.txt"
    )
    assert result.returncode == 0, result.stderr
    assert f"{len(seconds):,} received" in result.stdout


def test_the_clock_that_was_set_wrongly_is_found_and_applied(
    run: tuple[Path, Path], tmp_path: Path
) -> None:
    wrong = ("tum", *run, "--set", "estimate.time_offset=0.02")
    found = evaluate(*wrong, "--output", tmp_path / "wrong")
    assert found.returncode == 0, found.stderr
    lines = found.stdout.splitlines()
    assert lines[2].startswith("How good      ATE (aligned by se3) ")
    kind = next(i for i, line in enumerate(lines) if line.startswith("Kind of error jitter "))
    fault = next(i for i, line in enumerate(lines) if line.startswith("Not its fault clock -"))
    assert kind < fault
    assert lines[fault + 1].startswith("              Without: ATE ")
    model = json.loads((tmp_path / "wrong" / "summary.json").read_text())["error_model"]
    clock = model["clock_offset"]
    assert abs(clock["value"] + 0.02) < 4.0 * clock["std"]

    applied = evaluate(*wrong, "--apply", "clock_offset,extrinsic", "--output", tmp_path / "right")
    assert applied.returncode == 0, applied.stderr
    assert "Applied       clock_offset: ATE " in applied.stdout
    # What is within doubt is none of the estimate's faults that were found, and stays.
    assert "extrinsic, within doubt, left as it was" in " ".join(applied.stdout.split())
    figures = [
        json.loads((tmp_path / name / "summary.json").read_text()) for name in ("wrong", "right")
    ]
    pose = [each["parameters"]["extrinsic"] for each in figures]
    assert pose[0] == pose[1]
    again = json.loads((tmp_path / "right" / "summary.json").read_text())["error_model"]
    # A search that begins elsewhere may weigh outliers differently.
    assert abs(again["clock_offset"]["value"]) < 0.5 * again["clock_offset"]["std"]
    assert "What kind of error" in (tmp_path / "right" / "report.html").read_text(encoding="utf-8")


def test_what_cannot_be_applied_is_refused(run: tuple[Path, Path]) -> None:
    result = evaluate("tum", *run, "--apply", "clock_offset,colour")
    assert result.returncode == 2
    assert "'colour' is none of clock_offset, extrinsic, scale" in result.stderr


def test_help_has_examples_and_every_parameter_with_its_default() -> None:
    assert "examples:" in evaluate("--help").stdout
    shown = evaluate("tum", "--help").stdout
    for name in PARAMETERS:
        assert f"  {name}=" in shown
    assert "  gauge=se3 (of se3, none, yaw_translation, sim3)" in shown


def test_a_report_needs_no_matplotlib(run: tuple[Path, Path], tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['matplotlib'] = None;"
        "from trajeval_ros.commands.evaluate import main; sys.exit(main(sys.argv[1:]))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, "tum", *run, "--output", tmp_path / "out"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert result.returncode == 0, result.stderr
    assert 'id="translation"' in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
