# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How well the ground truth's process knows what it does not know.

Real ground truth is thinned, and the samples left out are predicted from those that remain: by the
process with each kernel, and by what other tools do (nearest sample, line, cubic spline).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline, Slerp
from scipy.stats import chi2

from trajeval_ros import se3
from trajeval_ros.files.tum import read_tum
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.segmentation import SegmentShape
from trajeval_ros.ground_truth.trajectory import GroundTruth, Settings

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SEQUENCES = ("tum_fr1_xyz", "tum_fr2_desk", "euroc_v102", "euroc_mh04")
RATES = (20, 10, 5, 2, 1)
KERNELS = ("matern52", "matern32", "squared_exponential")
DURATION = 40_000_000_000
FLOOR = 1e-5
LAG = 300_000_000
SHAPE = SegmentShape(2_000_000_000, 0.5, 8, 256)
_MOST_HELD_OUT = 3000


@dataclass(frozen=True)
class Cell:
    """One sequence at one rate: the samples kept, and those to predict."""

    sequence: str
    rate: int
    kept: Samples
    held_out: Samples


@dataclass(frozen=True)
class Score:
    """Errors in m and rad; the last three None for a method without uncertainty."""

    position_rmse: float
    rotation_rmse: float
    log_density: float | None = None
    anees: float | None = None
    coverage: float | None = None


def load(sequence: str, duration: int = DURATION) -> Samples:
    """Return the first ``duration`` (ns) of a sequence's ground truth."""
    trajectory = read_tum(DATA / sequence / "groundtruth.txt")
    stamps, first = np.unique(trajectory.stamps, return_index=True)
    poses = se3.from_position_quaternion(trajectory.positions[first], trajectory.quaternions[first])
    wanted = stamps - stamps[0] <= duration
    return Samples(stamps[wanted], poses[wanted])


def cells(sequence: str, rates: tuple[int, ...] = RATES) -> Iterator[Cell]:
    """Thin a sequence to each of ``rates`` (Hz)."""
    samples = load(sequence)
    usual = int(np.median(np.diff(samples.stamps)))
    for rate in rates:
        interval = 1_000_000_000 // rate
        kept = [0]
        for i, stamp in enumerate(samples.stamps):
            if stamp - samples.stamps[kept[-1]] >= interval - usual // 2:
                kept.append(i)
        mask = np.zeros(len(samples), dtype=np.bool_)
        mask[kept] = True
        index = np.arange(len(samples))
        after = np.searchsorted(kept, index)
        inside = ~mask & (after > 0) & (after < len(kept))
        # A drop-out is not the thinning's doing.
        width = np.diff(samples.stamps[kept])[np.clip(after - 1, 0, len(kept) - 2)]
        held = np.flatnonzero(inside & (width < 2 * interval))
        held = held[:: max(1, len(held) // _MOST_HELD_OUT)]
        yield Cell(
            sequence,
            rate,
            Samples(samples.stamps[mask], samples.poses[mask]),
            Samples(samples.stamps[held], samples.poses[held]),
        )


def score_process(cell: Cell, kernel: str, lag: int | None) -> Score:
    """Predict with the process as the evaluator has it; ``lag`` None: with all data."""
    ground_truth = GroundTruth(Settings(kernel, None, FLOOR, FLOOR, SHAPE))
    ground_truth.append(cell.kept)
    ground_truth.conclude()
    stamps, kept = cell.held_out.stamps, cell.kept.stamps
    last = np.full(len(stamps), len(kept) - 1)
    if lag is not None:
        last = np.minimum(np.searchsorted(kept, stamps + lag), len(kept) - 1)
    posterior = ground_truth.posterior(stamps, kept[last])
    hyperparameters = ground_truth.hyperparameters
    assert hyperparameters is not None
    noise = np.repeat(
        [hyperparameters.translation.noise_std**2, hyperparameters.rotation.noise_std**2], 3
    )
    covariance = posterior.covariances + np.diag(noise)
    error = se3.log(se3.compose(se3.inverse(posterior.poses), cell.held_out.poses))
    square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    log_det = np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    position, rotation = _errors(posterior.poses, cell)
    return Score(
        position,
        rotation,
        float(np.mean(-0.5 * (square + log_det))),
        float(square.mean() / 6.0),
        float((square <= chi2.ppf(0.95, 6)).mean()),
    )


def _errors(poses: Array, cell: Cell) -> tuple[float, float]:
    truth = cell.held_out.poses
    distance = np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=-1)
    turn = se3.log_so3(np.swapaxes(poses[:, :3, :3], -1, -2) @ truth[:, :3, :3])
    return float(np.sqrt(np.mean(distance**2))), float(np.sqrt(np.mean(np.sum(turn**2, axis=-1))))


def score_interpolation(cell: Cell, method: str) -> Score:
    """Predict with the nearest sample, linearly, or by a cubic spline."""
    origin = cell.kept.stamps[0]
    known, asked = ((stamps - origin) * 1e-9 for stamps in (cell.kept.stamps, cell.held_out.stamps))
    rotations = Rotation.from_matrix(cell.kept.poses[:, :3, :3])
    positions = cell.kept.poses[:, :3, 3]
    poses = np.tile(np.eye(4), (len(asked), 1, 1))
    if method == "nearest":
        middle = 0.5 * (known[1:] + known[:-1])
        poses = cell.kept.poses[np.searchsorted(middle, asked)]
    elif method == "linear":
        poses[:, :3, 3] = np.stack([np.interp(asked, known, p) for p in positions.T], axis=-1)
        poses[:, :3, :3] = Slerp(known, rotations)(asked).as_matrix()
    else:
        poses[:, :3, 3] = CubicSpline(known, positions)(asked)
        poses[:, :3, :3] = RotationSpline(known, rotations)(asked).as_matrix()
    return Score(*_errors(poses, cell))


def typical_factor(anees: list[float]) -> float:
    """``exp`` of the root mean square of ``log ANEES``: 1 is calibrated."""
    return float(np.exp(np.sqrt(np.mean(np.log(anees) ** 2))))
