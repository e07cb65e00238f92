# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small runs of two systems on two sequences, and clusters that are really there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.benchmarking.figures import FIGURES
from trajeval_ros.benchmarking.work import OK, Row
from trajeval_ros.commands.simulation import Poses, simulate

ROOT = Path(__file__).parents[2]
SYSTEMS, SEQUENCES, RUNS = ("vins", "orb_slam"), ("hall", "stairs", "yard"), 10


def made_rows(seed: int, larger: float = 1.0, spread: float = 0.08) -> list[Row]:
    """Runs that spread by 8 % about each sequence's own error; vins' errors are ``larger``."""
    generator = np.random.default_rng(seed)
    rows: list[Row] = []
    for system in SYSTEMS:
        for place, sequence in enumerate(SEQUENCES):
            for run in range(RUNS):
                factor = np.exp(generator.normal(0.0, spread, len(FIGURES)))
                factor *= larger if system == "vins" else 1.0
                row: Row = {"system": system, "sequence": sequence, "run": str(run), "status": OK}
                for figure, value in zip(FIGURES, factor.tolist(), strict=True):
                    if figure.ratios:
                        row[figure.column] = value * 0.02 * 10**place
                    elif figure.title == "Coverage":
                        row[figure.column] = 1.0
                    else:
                        row[figure.column] = 30.0 - 10.0 * float(np.log(value))
                rows.append(row)
    return rows


def write_tum(path: Path, poses: Poses) -> None:
    position, quaternion = se3.to_position_quaternion(poses.poses)
    rows = zip(poses.stamps.tolist(), np.hstack([position, quaternion]), strict=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        "".join(
            f"{stamp // 10**9}.{stamp % 10**9:09d} {' '.join(f'{v:.9f}' for v in values)}\n"
            for stamp, values in rows
        )
    )


def make_runs(root: Path, runs: int = 2) -> Path:
    """Write ground truths, estimates and the manifest; return the manifest's path."""
    for place, sequence in enumerate(("hall", "stairs")):
        made = simulate(9.0, 11 + place, dropouts=(), ground_truth_rate=50.0, estimate_rate=10.0)
        write_tum(root / f"ground_truth/{sequence}.txt", made.ground_truth)
        for system, std in (("vins", 0.002), ("wheels-2", 0.02)):
            for run in range(runs):
                generator = np.random.default_rng([place, len(system), run])
                noise = generator.normal(0.0, std, (len(made.estimate.stamps), 6))
                poses = se3.compose(made.estimate.poses, se3.exp(noise))
                path = root / f"results/{system}/{sequence}/{run}.txt"
                write_tum(path, Poses(made.estimate.stamps, poses))
    manifest = root / "manifest.yaml"
    manifest.write_text(
        "parameters: {relative.delta: 0.5}\n"
        "estimates: 'results/{system}/{sequence}/{run}.txt'\n"
        "sequences:\n"
        "  hall: {ground_truth: ground_truth/hall.txt}\n"
        "  stairs:\n"
        "    ground_truth: ground_truth/stairs.txt\n"
        "    parameters: {gauge: sim3}\n"
    )
    return manifest


@pytest.fixture(scope="session")
def client() -> Iterator[Any]:
    """Two processes of this machine."""
    pytest.importorskip("distributed")
    pytest.importorskip("pyarrow")
    from trajeval_ros.benchmarking.cluster import cluster

    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = str(ROOT)
    try:
        with cluster(workers=2) as made:
            yield made
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before
