# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The relative errors of a run are evo's, of the poses that ``poses.csv`` has."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands import evaluate
from trajeval_ros.commands.simulate import write_files

metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return [str(path) for path in write_files(tmp_path_factory.mktemp("run"), 30.0, 5)]


def evaluated(run: list[str], output: Path, **settings: object) -> tuple[Any, list[Any]]:
    """The summary, and evo's ground truth and estimate of the poses outside gaps."""
    from evo.core.trajectory import PosePath3D

    given = [f"--set={name.replace('_', '.')}={value}" for name, value in settings.items()]
    assert evaluate.main(["tum", *run, "--output", str(output), *given]) == 0
    rows = np.genfromtxt(output / "poses.csv", delimiter=",", names=True)
    rows = rows[rows["sampled"] == 1]
    paths = []
    for prefix in ("gt", "est"):
        columns = [rows[f"{prefix}_{axis}"] for axis in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")]
        values = np.stack(columns, axis=1)
        poses = se3.from_position_quaternion(values[:, :3], values[:, 3:])
        paths.append(PosePath3D(poses_se3=list(poses)))
    return json.loads((output / "summary.json").read_text()), paths


@pytest.mark.parametrize(("delta", "unit"), [(1, "f"), (7, "f"), (2, "m")])
def test_relative_errors(run: list[str], delta: int, unit: str, tmp_path: Path) -> None:
    summary, paths = evaluated(run, tmp_path, relative_delta=delta, relative_unit=unit)
    for figures, every in ((summary["conventional"], False), (summary["drift"]["all_pairs"], True)):
        for relation, key in (
            (metrics.PoseRelation.translation_part, "re_translation_rmse"),
            (metrics.PoseRelation.rotation_angle_rad, "re_rotation_rmse"),
        ):
            evo_unit = metrics.Unit.frames if unit == "f" else metrics.Unit.meters
            rpe = metrics.RPE(relation, float(delta), evo_unit, all_pairs=every)
            rpe.process_data(tuple(paths))
            expected = rpe.get_statistic(metrics.StatisticsType.rmse)
            assert figures[key] == pytest.approx(expected, rel=1e-9)
            assert figures["pairs"] == len(rpe.error)


def test_a_fraction_of_a_frame_is_wrong_usage(
    run: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--set", "relative.delta=1.5", "--set", "relative.unit=f"]
    assert evaluate.main(["tum", *run, *given]) == 2
    assert "relative.delta must be a whole number of frames, got 1.5" in capsys.readouterr().err
