# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Everything that the first screen shows can be computed again from what is written."""

import csv
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from twins.runs import assert_same_summary

from trajeval_ros import __version__, se3
from trajeval_ros.commands import evaluate
from trajeval_ros.commands.simulate import write_files
from trajeval_ros.files.tum import read_tum
from trajeval_ros.online.parameters import PARAMETERS

Array = npt.NDArray[np.float64]

RTOL = 1e-9


def run(folder: Path, files: tuple[Path, Path], *options: str) -> dict[str, Any]:
    arguments = ["tum", *map(str, files), "--output", str(folder), *options]
    assert evaluate.main(arguments) == 0
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return summary


class Rows:
    """``poses.csv``."""

    def __init__(self, path: Path) -> None:
        with path.open(newline="", encoding="utf-8") as file:
            self.rows = list(csv.DictReader(file))

    def __getitem__(self, name: str) -> Array:
        return np.array([float(row[name] or "nan") for row in self.rows])

    def poses(self, whose: str) -> Array:
        position = np.stack([self[f"{whose}_t{axis}"] for axis in "xyz"], axis=1)
        quaternion = np.stack([self[f"{whose}_q{axis}"] for axis in "xyzw"], axis=1)
        return se3.from_position_quaternion(position, quaternion)

    def stamps(self) -> npt.NDArray[np.int64]:
        return np.array([int(row["stamp_ns"]) for row in self.rows])


def rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def aligned(alignment: dict[str, Any], estimate: Array) -> Array:
    pose = np.array(alignment["pose"])
    moved = estimate.copy()
    moved[:, :3, 3] *= alignment["scale"]
    return np.asarray(se3.from_position_quaternion(pose[:3], pose[3:]) @ moved)


def errors(truth: Array, moved: Array) -> tuple[Array, Array]:
    translation = np.linalg.norm(truth[:, :3, 3] - moved[:, :3, 3], axis=1)
    turn = se3.log_so3(truth[:, :3, :3].swapaxes(1, 2) @ moved[:, :3, :3])
    return translation, np.linalg.norm(turn, axis=1)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    truth, estimate = write_files(tmp_path_factory.mktemp("simulated"), 25.0, 3)
    # A tracker that is lost for four seconds, and dies two before the end.
    lines = estimate.read_text(encoding="utf-8").splitlines()
    poses = [line for line in lines if not line.startswith("#")]
    first = float(poses[0].split()[0])
    kept = [
        line
        for line in poses
        if not 10.0 < float(line.split()[0]) - first < 14.0 and float(line.split()[0]) < first + 22
    ]
    estimate.write_text("\n".join(kept) + "\n", encoding="utf-8")
    return truth, estimate


@pytest.mark.parametrize("gauge", ["se3", "sim3", "yaw_translation"])
def test_errors_and_their_alignments(tmp_path: Path, files: tuple[Path, Path], gauge: str) -> None:
    summary = run(tmp_path, files, "--set", f"gauge={gauge}")
    rows = Rows(tmp_path / "poses.csv")
    truth, estimate = rows.poses("gt"), rows.poses("est")
    conventional = summary["conventional"]
    sampled = rows["sampled"] == 1
    assert 0 < np.count_nonzero(~sampled) < len(sampled), "there are poses in gaps, and others"

    # ATE is the root mean square of its columns, and they follow from the alignment.
    translation, rotation = errors(truth, aligned(conventional["alignment"], estimate))
    for name, recomputed in (("translation", translation), ("rotation", rotation)):
        column = rows[f"ate_{name}"]
        np.testing.assert_array_equal(np.isnan(column), ~sampled)
        np.testing.assert_allclose(column[sampled], recomputed[sampled], rtol=1e-9, atol=1e-12)
        assert rms(column) == pytest.approx(conventional[f"ate_{name}_rmse"], rel=RTOL)

    # RE: from the first pose to the first one at least a step later, and on from there.
    stamps = rows.stamps()[sampled]
    truth, moved = truth[sampled], aligned(conventional["alignment"], estimate)[sampled]
    pairs, begin = [], 0
    for end, stamp in enumerate(stamps.tolist()):
        if stamp - stamps[begin] >= 1e9 * conventional["re_delta"]:
            pairs.append((begin, end))
            begin = end
    first, last = np.array(pairs).T
    steps = [np.linalg.inv(poses[first]) @ poses[last] for poses in (truth, moved)]
    turn = se3.log_so3(steps[0][:, :3, :3].swapaxes(1, 2) @ steps[1][:, :3, :3])
    assert conventional["pairs"] == len(pairs)
    assert rms(np.linalg.norm(steps[0][:, :3, 3] - steps[1][:, :3, 3], axis=1)) == pytest.approx(
        conventional["re_translation_rmse"], rel=1e-8
    )
    assert rms(np.linalg.norm(turn, axis=1)) == pytest.approx(
        conventional["re_rotation_rmse"], rel=1e-8
    )


def test_errors_at_a_sparse_ground_truths_instants(
    tmp_path: Path, files: tuple[Path, Path]
) -> None:
    """From the rows and the ground truth's own samples, by the rule that the documentation has."""
    lines = [line for line in files[0].read_text().splitlines() if not line.startswith("#")]
    sparse = tmp_path / "sparse.txt"
    sparse.write_text("\n".join(lines[::80]) + "\n", encoding="utf-8")
    summary = run(tmp_path / "out", (sparse, files[1]))
    conventional = summary["conventional"]
    assert conventional["at"] == "ground_truth"
    rows = Rows(tmp_path / "out" / "poses.csv")
    poses, stamps = rows.poses("est"), rows.stamps()
    known = read_tum(sparse)
    samples = se3.from_position_quaternion(known.positions, known.quaternions)
    truth, estimate = [], []
    for n in range(1, len(known)):
        instant, gap = known.stamps[n], known.stamps[n] - known.stamps[n - 1]
        after = int(np.searchsorted(stamps, instant))
        if not 0 < after < len(stamps) or stamps[after] - stamps[after - 1] > 0.5 * gap:
            continue
        share = (instant - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
        step = se3.log(np.linalg.inv(poses[after - 1]) @ poses[after])
        estimate.append(poses[after - 1] @ se3.exp(share * step))
        truth.append(samples[n])
    assert conventional["poses"] == len(truth)
    translation, rotation = errors(
        np.array(truth), aligned(conventional["alignment"], np.array(estimate))
    )
    assert rms(translation) == pytest.approx(conventional["ate_translation_rmse"], rel=RTOL)
    assert rms(rotation) == pytest.approx(conventional["ate_rotation_rmse"], rel=RTOL)


def test_likelihoods_are_the_sums_of_their_columns(
    tmp_path: Path, files: tuple[Path, Path]
) -> None:
    summary = run(tmp_path, files)
    rows = Rows(tmp_path / "poses.csv")
    relative = summary["relative"]
    for name in ("chi2", "log_det", "log_likelihood"):
        assert float(rows[name].sum()) == pytest.approx(relative[name], rel=RTOL)
    dof = 6 * (len(rows.rows) - 1)
    assert relative["dof"] == dof
    assert relative["chi2_per_dof"] == pytest.approx(float(rows["chi2"].sum()) / dof, rel=RTOL)
    steps = np.stack([rows[f"e_{axis}"] for axis in range(6)], axis=1)[1:]
    expected = np.sqrt(np.mean(np.sum(steps[:, :3] ** 2, axis=1)))
    assert relative["translation_rmse"] == pytest.approx(float(expected), rel=RTOL)


def test_coverage_is_that_of_the_files(tmp_path: Path, files: tuple[Path, Path]) -> None:
    summary = run(tmp_path, files)
    truth, estimate = (
        np.loadtxt(summary["inputs"][name]["path"]) for name in ("ground_truth", "estimate")
    )
    found = summary["coverage"]
    duration = truth[-1, 0] - truth[0, 0]
    inner = estimate[:, 0]
    steps = np.diff(inner)
    lost = steps[steps > 1.0].sum() + (truth[-1, 0] - inner[-1])
    assert found["duration"] == pytest.approx(duration, abs=1e-6)
    assert found["lost_time"] == pytest.approx(lost, abs=1e-6)
    assert found["time"] == pytest.approx(1.0 - lost / duration, abs=1e-6)
    assert found["losses"] == 2
    assert found["longest_loss"]["duration"] == pytest.approx(steps.max(), abs=1e-6)
    assert found["longest_loss"]["seconds_from_start"] == pytest.approx(
        inner[np.argmax(steps)] - truth[0, 0], abs=1e-6
    )
    path = np.linalg.norm(np.diff(truth[:, 1:4], axis=0), axis=1).sum()
    assert found["path_length"] == pytest.approx(path, rel=0.02)
    assert 0.0 < found["distance"] < 1.0


def test_a_summary_says_of_what_it_is_and_can_be_made_again(
    tmp_path: Path, files: tuple[Path, Path]
) -> None:
    options = ("--set", "gauge=yaw_translation", "--set", "estimate.time_offset=0.01")
    summary = run(tmp_path / "first", files, *options)
    assert summary["version"] == __version__
    given = summary["inputs"].pop("arguments")
    assert given == ["tum", *map(str, files), "--output", str(tmp_path / "first"), *options]
    for name, path in zip(("ground_truth", "estimate"), files, strict=True):
        content = path.read_bytes()
        assert summary["inputs"][name] == {
            "path": str(path),
            "bytes": len(content),
            "sha256": hashlib.sha256(content).hexdigest(),
        }
    assert set(summary["parameters"]) == set(PARAMETERS)
    assert summary["parameters"]["gauge"] == "yaw_translation"
    assignments: list[str] = []
    for name, value in summary["parameters"].items():
        text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
        assignments += ["--set", f"{name}={text}"]
    again = run(tmp_path / "second", files, *assignments)
    again["inputs"].pop("arguments")
    assert_same_summary(again, summary)
