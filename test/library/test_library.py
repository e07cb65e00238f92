# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``import trajeval_ros as te``: from arrays and files to figures, without ROS."""

import doctest
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from twins.runs import assert_same_summary

import trajeval_ros as te
from trajeval_ros.commands import evaluate as command
from trajeval_ros.commands.simulate import write_files
from trajeval_ros.commands.simulation import motion
from trajeval_ros.library.settings import parameters_of
from trajeval_ros.report.answers import answer
from trajeval_ros.runs import several

ROOT = Path(__file__).resolve().parents[2]


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_files(tmp_path_factory.mktemp("run"), 20.0, 3)


@pytest.fixture(scope="module")
def run(files: tuple[Path, Path]) -> tuple[te.Trajectory, te.Trajectory]:
    return te.read_tum(files[0]), te.read_tum(files[1])


@pytest.fixture(scope="module")
def result(run: tuple[te.Trajectory, te.Trajectory]) -> te.Result:
    return te.evaluate(*run)


def test_importing_it_loads_neither_ros_nor_numpy() -> None:
    done = python(
        "-c",
        "import sys, trajeval_ros;"
        "print([m for m in ('rclpy', 'numpy', 'scipy', 'matplotlib') if m in sys.modules])",
    )
    assert done.stdout.strip() == "[]", done.stderr


def test_evaluating_loads_no_ros(files: tuple[Path, Path]) -> None:
    done = python(
        "-c",
        "import sys, trajeval_ros as te;"
        "te.evaluate(te.read_tum(sys.argv[1]), te.read_tum(sys.argv[2]));"
        "print([m for m in sys.modules if m == 'rclpy' or m.endswith('_msgs')])",
        *map(str, files),
    )
    assert done.stdout.strip() == "[]", done.stderr


def test_every_public_name_is_there() -> None:
    assert sorted(te._HOMES) == te.__all__
    for name in te.__all__:
        assert getattr(te, name).__doc__
    assert set(te.__all__) <= set(dir(te))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = te.nothing


@pytest.mark.parametrize("name", sorted(set(te.__all__) - {"benchmark"}))
def test_every_public_name_has_an_example(name: str) -> None:
    """But for `benchmark`, whose page has one."""
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner(optionflags=flags)
    (example,) = finder.find(getattr(te, name), name)
    assert example.examples
    assert runner.run(example).failed == 0


def test_figures_are_those_of_the_command(
    result: te.Result, files: tuple[Path, Path], tmp_path: Path
) -> None:
    assert command.main(["tum", *map(str, files), "--output", str(tmp_path)]) == 0
    theirs = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    ours = json.loads(json.dumps(result.summary))
    assert_same_summary(ours["estimate"], theirs["estimate"])
    for family in ("relative", "absolute", "conventional"):
        for name, value in theirs[family].items():
            if isinstance(value, float):
                # What the running figures are known to depend on is how the input was cut: of 10^8
                # nats, in NumPy alone and on an old processor, by 2e-8.
                assert ours[family][name] == pytest.approx(value, rel=1e-6, abs=1e-9), name


def test_rows_sum_to_the_summary(result: te.Result) -> None:
    total = result.summary["relative"]["log_likelihood"]
    assert result.poses.log_likelihood.sum() == pytest.approx(total, rel=1e-9)
    assert len(result.poses) == result.summary["estimate"]["evaluated"]


def test_errors_are_those_the_ate_is_of(result: te.Result) -> None:
    conventional = result.summary["conventional"]
    for part in ("translation", "rotation"):
        errors = getattr(result.poses, f"ate_{part}")
        np.testing.assert_array_equal(np.isnan(errors), ~result.poses.sampled)
        rms = float(np.sqrt(np.nanmean(errors**2)))
        assert rms == pytest.approx(conventional[f"ate_{part}_rmse"], rel=1e-9)


def test_arrays_are_as_good_as_a_file(
    run: tuple[te.Trajectory, te.Trajectory], result: te.Result
) -> None:
    truth, estimate = (te.Trajectory(t.stamps, t.poses, name=t.name) for t in run)
    again = te.evaluate(truth, estimate)
    for family in ("relative", "conventional"):
        for name, value in result.summary[family].items():
            if isinstance(value, float):
                assert again.summary[family][name] == pytest.approx(value, rel=1e-6), name


def test_seconds_and_rows_of_seven_are_taken() -> None:
    rows = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]])
    made = te.Trajectory([0.1], rows)
    assert made.stamps.tolist() == [100_000_000]
    assert made.poses[0, :3, 3].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("stamps", "poses", "said"),
    [
        ([0.0], np.zeros((1, 3)), r"\(N, 4, 4\) or \(N, 7\)"),
        ([np.nan], np.eye(4)[None], "finite seconds"),
        ([0.0, 1.0], np.eye(4)[None], "positions must be"),
        ([0.0], 2.0 * np.eye(4)[None], r"poses\[0\] holds no rotation"),
        ([0.0], np.diag([1.0, 1.0, -1.0, 1.0])[None], r"poses\[0\] holds no rotation"),
        ([0.0], np.full((1, 4, 4), np.nan), "must be finite"),
    ],
)
def test_what_is_no_trajectory_is_refused(stamps: object, poses: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        te.Trajectory(stamps, poses)


def test_settings_are_the_parameters(run: tuple[te.Trajectory, te.Trajectory]) -> None:
    found = te.evaluate(*run, gauge="none", relative_delta=2.0)
    assert found.summary["gauge"] == "none"
    assert found.summary["conventional"]["re_delta"] == 2.0
    with pytest.raises(ValueError, match="unknown setting guage; did you mean gauge"):
        te.evaluate(*run, guage="none")
    with pytest.raises(ValueError, match=r"relative\.delta"):
        te.evaluate(*run, relative_delta=-1.0)
    with pytest.raises(ValueError, match="given twice"):
        te.evaluate(*run, **{"relative.delta": 1.0, "relative_delta": 1.0})


def test_what_cannot_be_evaluated_says_why(run: tuple[te.Trajectory, te.Trajectory]) -> None:
    truth, estimate = run
    later = te.Trajectory(estimate.stamps + 10**12, estimate.poses, name="late")
    with pytest.raises(ValueError, match=r"late: none of its .* poses could be evaluated"):
        te.evaluate(truth, later)


def test_two_are_compared(run: tuple[te.Trajectory, te.Trajectory], result: te.Result) -> None:
    truth, estimate = run
    noisy = estimate.poses
    noisy[:, :3, 3] += np.random.default_rng(2).normal(scale=0.2, size=(len(estimate), 3))
    both = te.evaluate(truth, {"good": estimate, "bad": te.Trajectory(estimate.stamps, noisy)})
    assert list(both) == ["good", "bad"]
    assert both["good"].summary["relative"] == pytest.approx(result.summary["relative"], rel=1e-9)
    (compared,) = both.comparison
    assert compared.re_translation is not None
    assert compared.re_translation.interval is not None
    assert compared.re_translation.interval[1] < 1.0
    assert "good's translation drifts" in both.sentences[0]
    with pytest.raises(ValueError, match="no estimate"):
        te.evaluate(truth, {})


def test_a_ground_truth_that_two_agree_against_is_a_cause_of_all() -> None:
    time = np.arange(0.0, 60.0, 0.1)
    poses = motion(time)
    wrong = poses.copy()
    moved = np.eye(4)
    moved[0, 3] = 0.5
    wrong[300:420] = wrong[300:420] @ moved
    rng = np.random.default_rng(3)
    estimates = {}
    for name in ("one", "other"):
        noisy = poses[5:-5].copy()
        noisy[:, :3, 3] += rng.normal(scale=0.005, size=(len(noisy), 3))
        estimates[name] = te.Trajectory(time[5:-5], noisy)
    both = te.evaluate(te.Trajectory(time, wrong), estimates)
    (cause,) = both.causes
    assert cause.code == "ground_truth_or_shared"
    assert "one and other agree" in cause.text
    assert "one and other agree" in both._repr_html_()
    assert both.defects == ()


def test_a_defect_of_the_comparison_costs_no_figures(
    run: tuple[te.Trajectory, te.Trajectory], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(several, "compare", lambda *arguments: 1 / 0)
    both = te.evaluate(run[0], {"one": run[1], "other": run[1]})
    assert both["one"].summary["conventional"]["ate_translation_rmse"] > 0.0
    assert both.comparison == ()
    (line,) = both.defects
    assert "the comparison failed: ZeroDivisionError" in line


def test_the_report_is_written_and_shown_inline(result: te.Result, tmp_path: Path) -> None:
    written = result.report(tmp_path / "report.html")
    page = written.read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>")
    shown = result._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert "<!doctype" not in shown  # escaped
    assert "ATE" in repr(result)


def test_a_printed_result_is_what_a_terminal_shows_first(result: te.Result) -> None:
    shown = str(result)
    assert "\n" in shown
    for _, text in answer(result.summary, parameters_of({})):
        for line in text.split("\n"):
            assert line.rstrip() in shown


def test_poses_as_a_table(result: te.Result) -> None:
    pytest.importorskip("pandas")
    table = result.poses.to_pandas()
    assert len(table) == len(result.poses)
    assert table.index.name == "stamp_ns"
    assert table["gt_tx"].to_numpy() == pytest.approx(result.poses.ground_truth[:, 0, 3])
    assert table["est_qw"].between(0.0, 1.0).all()


def test_ground_truth_answers_at_its_samples_and_not_beyond(
    run: tuple[te.Trajectory, te.Trajectory],
) -> None:
    truth = te.GroundTruth.fit(run[0])
    asked = run[0].stamps[100:110][::-1]
    found = truth.at(asked)
    assert np.abs(found.poses[:, :3, 3] - run[0].poses[100:110][::-1, :3, 3]).max() < 0.02
    assert (np.linalg.eigvalsh(found.covariances) > 0.0).all()
    with pytest.raises(ValueError, match="is known from"):
        truth.at([run[0].stamps[0] - 1])
    with pytest.raises(ValueError, match="too few"):
        te.GroundTruth.fit(te.Trajectory([0.0], np.eye(4)[None]))


def test_it_runs_as_a_module() -> None:
    assert python("-m", "trajeval_ros", "--version").stdout == f"trajeval_ros {te.__version__}\n"
    assert "evaluate" in python("-m", "trajeval_ros").stdout
    assert "GROUND_TRUTH" in python("-m", "trajeval_ros", "evaluate", "tum", "--help").stdout
    wrong = python("-m", "trajeval_ros", "fly")
    assert wrong.returncode == 2
    assert "no command 'fly'" in wrong.stderr


def test_poses_in_a_gap_of_the_ground_truth_are_not_compared(
    run: tuple[te.Trajectory, te.Trajectory], result: te.Result
) -> None:
    truth, estimate = run
    (compared,) = te.evaluate(truth, {"one": estimate, "other": estimate}).comparison
    assert compared.ate_translation is not None
    ate = result.summary["conventional"]["ate_translation_rmse"]
    assert compared.ate_translation.rmse_a == pytest.approx(ate, rel=1e-9)
    assert compared.ate_translation.ratio == 1.0


def test_the_page_runs(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pandas")
    (tmp_path / "run").symlink_to(files[0].parent)
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    assert len(blocks) > 4
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/python.md", "exec"), names)
    assert (tmp_path / "report.html").is_file()
    assert "fine's translation" in names["sentence"]  # type: ignore[operator]


@pytest.mark.slow
def test_the_notebook_runs_and_shows_the_report() -> None:
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(ROOT / "docs" / "notebook.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    shown = [
        output.data["text/html"]
        for cell in notebook.cells
        for output in cell.get("outputs", ())
        if "text/html" in output.get("data", {})
    ]
    assert any("<iframe srcdoc=" in page for page in shown)
