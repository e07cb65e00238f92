# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth without orientation: what the positions tell is right, all else is absent."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trajeval_ros as te
from trajeval_ros import se3
from trajeval_ros.commands import evaluate
from trajeval_ros.commands.simulate import write_files


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A short simulated run: ground truth and estimate."""
    return write_files(tmp_path_factory.mktemp("run"), 20.0, 3)


@pytest.fixture(scope="module")
def known(run: tuple[Path, Path]) -> float:
    result = te.evaluate(te.read_tum(run[0]), te.read_tum(run[1]))
    return float(result.summary["conventional"]["ate_translation_rmse"])


def rewritten(
    path: Path, to: Path, change: Callable[[list[str]], list[str]], head: str = ""
) -> str:
    rows = [line.split() for line in path.read_text().splitlines()[1:]]
    to.write_text(head + "".join(" ".join(change(row)) + "\n" for row in rows))
    return str(to)


WRITTEN: dict[str, tuple[Callable[[list[str]], list[str]], str]] = {
    "four columns": (lambda row: row[:4], ""),
    "no number": (lambda row: [*row[:4], *["nan"] * 4], ""),
    "zero": (lambda row: [*row[:4], *["0"] * 4], ""),
    "constant": (lambda row: [*row[:4], "0", "0", "0", "1"], ""),
    "named": (lambda row: [row[3], row[0], row[1], row[2]], "z t x y\n"),
    "as of OpenVINS": (
        lambda row: [*row[:4], "0 0 0 1 0 0 0 0 0 0 1e-6 0 0 1e-6 0 1e-6"],
        "",
    ),
    "in UTM": (
        lambda row: [row[0], str(float(row[1]) + 32_654_321), str(float(row[2]) + 5e6), row[3]],
        "",
    ),
}


@pytest.mark.parametrize("way", WRITTEN)
def test_the_positions_are_evaluated_and_orientations_are_left_out(
    way: str, run: tuple[Path, Path], known: float, tmp_path: Path, capsys: Any
) -> None:
    truth = rewritten(run[0], tmp_path / "truth.txt", *WRITTEN[way])
    assert evaluate.main(["tum", truth, str(run[1]), "--output", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "likely cause: the ground truth's orientation never changes" in out or (
        "positions only: figures that need orientations are left out" in out
    )
    assert "error: " not in out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["position_only"] is True
    assert summary["conventional"]["ate_translation_rmse"] == pytest.approx(known, rel=1e-3)
    assert summary["conventional"]["ate_rotation_rmse"] is None
    assert summary["conventional"]["re_rotation_rmse"] is None
    for kind in (summary, summary["window"]):
        assert kind["relative"]["log_likelihood"] == pytest.approx(
            kind["absolute"]["log_likelihood_first_order"], rel=1e-9
        )
    assert summary["relative"]["rotation_rmse"] is None
    model = summary["error_model"]
    assert not {"rotation", "scale", "clock_rate"} & set(model)
    assert set(model["extrinsic"]) == {"translation", "pose"}
    assert model["translation"]["jitter_std"]["value"] > 0.0
    assert "Kind of error jitter " in out
    # Nowhere is there a figure of a rotation.
    told = [line for line in out.splitlines() if not line.startswith("likely cause")]
    assert not re.search(r"rotation|\brad\b|[0-9] deg", "\n".join(told))
    del summary["parameters"], summary["likely_causes"]
    assert rotations(summary) == []
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"Rotation, (motion|noise)|ATE, rotation|<td[^>]*>[^<]*[0-9]°", page)


def rotations(figures: dict[str, Any], below: str = "") -> list[str]:
    """Figures of a rotation, by their names."""
    found = []
    for key, value in figures.items():
        if isinstance(value, dict):
            found += rotations(value, f"{below}{key}.")
        elif "rotation" in key and value is not None:
            found.append(f"{below}{key}")
    return found


def test_what_positions_do_not_tell_cannot_be_applied(
    run: tuple[Path, Path], tmp_path: Path, capsys: Any
) -> None:
    truth = rewritten(run[0], tmp_path / "truth.txt", lambda row: row[:4])
    assert evaluate.main(["tum", truth, str(run[1]), "--apply", "clock_offset,scale"]) == 1
    assert "the error model has no scale" in capsys.readouterr().err
    assert evaluate.main(["tum", truth, str(run[1]), "--apply", "clock_offset,extrinsic"]) == 0


def test_the_antenna_is_found_where_it_is(
    run: tuple[Path, Path], tmp_path: Path, capsys: Any
) -> None:
    read = te.read_tum(run[0])
    arm = np.array([0.4, -0.1, 0.8])
    antenna = read.poses[:, :3, 3] + read.poses[:, :3, :3] @ arm
    rows = np.column_stack([read.stamps * 1e-9, antenna])
    np.savetxt(tmp_path / "antenna.txt", rows, fmt="%.9f")
    files = ("tum", str(tmp_path / "antenna.txt"), str(run[1]))
    assert evaluate.main([*files, "--output", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found, std = (np.array(summary["lever_arm"][key]) for key in ("value", "std"))
    # The estimate drifts, and 20 s do not tell how far.
    assert np.abs(found - arm).max() < 0.05
    assert std.max() < 0.05
    without = summary["headline"]["without"]
    assert without["of"] == ["lever arm"]
    assert without["ate_translation_rmse"] < 0.3 * summary["conventional"]["ate_translation_rmse"]
    assert "Not its fault lever arm " in out
    (cause,) = (each for each in summary["likely_causes"] if each["code"] == "lever_arm")
    advice = cause["advice"].removeprefix("set ")
    assert evaluate.main([*files, "--output", str(tmp_path / "right"), "--set", advice]) == 0
    right = json.loads((tmp_path / "right" / "summary.json").read_text())
    assert right["conventional"]["ate_translation_rmse"] == pytest.approx(
        without["ate_translation_rmse"], rel=1e-3
    )
    assert all(each["code"] != "lever_arm" for each in right["likely_causes"])


def test_the_same_in_python(run: tuple[Path, Path], known: float, tmp_path: Path) -> None:
    truth = rewritten(run[0], tmp_path / "truth.txt", lambda row: row[:4])
    summary = te.evaluate(te.read_tum(truth), te.read_tum(run[1])).summary
    assert summary["position_only"] is True
    assert summary["conventional"]["ate_translation_rmse"] == pytest.approx(known, rel=1e-3)


def test_two_estimates_are_compared_by_their_positions(
    run: tuple[Path, Path], tmp_path: Path
) -> None:
    truth = te.read_tum(rewritten(run[0], tmp_path / "truth.txt", lambda row: row[:4]))
    estimate = te.read_tum(run[1])
    (comparison,) = te.evaluate(truth, {"a": estimate, "b": estimate}).comparison
    assert comparison.ate_translation is not None
    assert comparison.ate_rotation is None
    assert comparison.re_translation is None


@pytest.mark.parametrize("turns", [0.0, 1e-3])
def test_a_robot_that_never_turns(turns: float, tmp_path: Path, capsys: Any) -> None:
    """By its estimate it does, a little: an error. Where neither ever turns none is told."""
    rng = np.random.default_rng(0)
    stamps = 0.05 * np.arange(400)
    for name, scale, turn in (("truth", 1.0, 0.0), ("estimate", 1.01, turns)):
        x, y = scale * (stamps - 10.0) ** 2 / 50.0, stamps / 4.0
        z = turn * rng.normal(size=len(stamps))
        none = np.zeros(len(stamps))
        rows = np.column_stack([stamps, x, y, none, none, none, z, np.sqrt(1.0 - z**2)])
        np.savetxt(tmp_path / name, rows, fmt="%.9f")
    files = [str(tmp_path / name) for name in ("truth", "estimate")]
    assert evaluate.main(["tum", *files, "--output", str(tmp_path / "out")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert "position_only" not in summary
    assert summary["relative"]["log_likelihood"] is not None
    for name in ("ate_rotation_rmse", "re_rotation_rmse"):
        assert (summary["conventional"][name] is not None) == (turns > 0.0)


def test_the_modes_of_an_rtk_receiver_are_in_the_answer(tmp_path: Path) -> None:
    """Fixed, float, single, fixed again: as certain as each is, at coordinates of a country."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 180.0, 0.2)
    body = np.tile(np.eye(4), (len(t), 1, 1))
    turn = [0.1 * np.sin(0.7 * t), 0.1 * np.cos(0.5 * t), 2.0 * np.sin(0.2 * t)]
    way = [30.0 * np.sin(0.1 * t), 25.0 * np.sin(0.13 * t + 1.0), 1.5 * np.sin(0.2 * t)]
    body[:, :3, :3] = se3.exp_so3(np.stack(turn, axis=1))
    body[:, :3, 3] = np.stack(way, axis=1)
    mode = np.digitize(t, [60.0, 90.0, 120.0])
    std = np.array([0.02, 0.3, 5.0, 0.02])[mode]
    far = np.array([1e7, -1e7, 100.0])
    arm = np.array([0.3, -0.1, 0.8])
    antenna = (body[:, :3, :3] @ arm) + body[:, :3, 3] + far
    noise, none = std[:, None] * rng.normal(size=(len(t), 3)), np.zeros(len(t))
    variance = std**2
    turned = [none, none, none, none + 1.0, *[none] * 6]
    covariance = [variance, none, none, variance, none, variance]
    rows = np.column_stack([t + 1e9, antenna + noise, *turned, *covariance])
    np.savetxt(tmp_path / "truth.txt", rows, fmt="%.9f")

    truth = te.read_tum(tmp_path / "truth.txt")
    estimate = te.Trajectory(truth.stamps[5:-5], body[5:-5])
    found = te.evaluate(truth, estimate, ground_truth_use_covariance=True)
    assert found.summary["position_only"] is True
    error = found.poses.ground_truth[:, :3, 3] - antenna[5:-5]
    known = found.poses.covariance[:, [0, 1, 2], [0, 1, 2]]
    for which in range(4):
        # Not where the mode changes: there both tell.
        inside = np.isin(np.arange(5, len(t) - 5), np.flatnonzero(mode == which)[25:-25])
        ratio = (error[inside] ** 2 / known[inside]).mean()
        assert 0.5 < ratio < 1.6
        assert 0.2 < np.sqrt(np.median(known[inside])) / std[mode == which][0] < 1.0
    assert found.summary["relative"]["chi2_per_dof"] == pytest.approx(1.0, abs=0.3)
    arm_found, arm_std = (np.array(found.summary["lever_arm"][key]) for key in ("value", "std"))
    assert (np.abs(arm_found - arm) < 4.0 * arm_std).all()
    assert arm_std.max() < 0.05


def test_the_first_fix_is_no_start_of_an_estimator(tmp_path: Path, capsys: Any) -> None:
    """Fixes are about the first of them, and rarer than an estimate."""
    truth, estimate = write_files(tmp_path, 30.0, 0)
    rows = [line.split()[:4] for line in truth.read_text().splitlines()[1:]][::10]
    first = np.array(rows[0][1:], dtype=float)
    rng = np.random.default_rng(0)
    with (tmp_path / "fixes.txt").open("w") as file:
        for number, (stamp, *xyz) in enumerate(rows):
            at = np.array(xyz, dtype=float) - first
            at += 0.02 * (number > 0) * rng.normal(size=3)
            file.write(f"{stamp} {' '.join(f'{each:.6f}' for each in at)}\n")
    assert evaluate.main(["tum", str(tmp_path / "fixes.txt"), str(estimate)]) == 0
    out = capsys.readouterr().out
    assert "swapped" not in out
    assert "lever arm" not in out


DATA = Path(__file__).parents[2] / ".." / "shared" / "data"
RECORDED = DATA / "rover_georeferenced" / "groundtruth.txt"


@pytest.mark.skipif(not RECORDED.is_file(), reason="../shared/data is absent")
def test_a_recorded_run_is_itself_without_its_orientations(tmp_path: Path) -> None:
    """In UTM, against its own positions: no lever arm, no offset of the clock, no cause."""
    rows = [line.split()[:4] for line in RECORDED.read_text().splitlines() if line[0] != "#"]
    (tmp_path / "truth.txt").write_text("\n".join(" ".join(row) for row in rows) + "\n")
    found = te.evaluate(te.read_tum(tmp_path / "truth.txt"), te.read_tum(RECORDED))
    assert found.summary["position_only"] is True
    assert found.causes == ()
    assert found.summary["conventional"]["ate_translation_rmse"] < 1e-3
    assert np.linalg.norm(found.summary["lever_arm"]["value"]) < 1e-3
    assert abs(found.summary["error_model"]["clock_offset"]["value"]) < 1e-3


def test_one_pose_without_orientation_does_not_align_a_run(
    run: tuple[Path, Path], tmp_path: Path, capsys: Any
) -> None:
    truth = rewritten(run[0], tmp_path / "truth.txt", lambda row: row[:4])
    assert evaluate.main(["tum", truth, str(run[1]), "--align-origin", "--quiet"]) != 0
    assert "positions alone do not say how to turn an estimate" in capsys.readouterr().err
