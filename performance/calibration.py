# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How well the ground truth's process knows what it does not know.

Real ground truth is thinned, and the samples left out are predicted from those that remain: by the
process with each kernel, and by what other tools do (nearest sample, line, cubic spline).

The hyperparameters are learned from all that remain, and once more as a node does, on the way, the
samples coming in small batches. Only the instrument's accuracy is not the default: it is out of the
way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline, Slerp
from scipy.stats import chi2

from performance.tables import (
    Picture,
    SkippedError,
    Table,
    Target,
    at_least,
    at_most,
    targets,
)
from trajeval_ros import se3
from trajeval_ros.files.tum import read_tum
from trajeval_ros.ground_truth import likelihood, regression, trajectory
from trajeval_ros.ground_truth.kernels import Matern52
from trajeval_ros.ground_truth.lessons import Lessons
from trajeval_ros.ground_truth.models import MODELS, OneKernel
from trajeval_ros.ground_truth.process import Process
from trajeval_ros.ground_truth.segment import Samples
from trajeval_ros.ground_truth.segmentation import Segmentation, SegmentShape
from trajeval_ros.ground_truth.trajectory import GroundTruth, Settings

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SEQUENCES = ("tum_fr1_xyz", "tum_fr2_desk", "euroc_v102", "euroc_mh04")
RATES = (20, 10, 5, 2, 1)
INTERPOLATIONS = ("nearest", "linear", "spline")
KERNELS = ("matern52", "matern32", "squared_exponential")
PLAIN = "plain Matérn 5/2"
ON_THE_WAY = "`matern52`, learned on the way"
PROCESSES = (*KERNELS, PLAIN, ON_THE_WAY)
SIMPLE = ("matern32", "squared_exponential", PLAIN)
DURATION = 40_000_000_000
FLOOR = 1e-5
LAG = 300_000_000
SHAPE = SegmentShape(2_000_000_000, 0.5, 8, 256)
_MOST_HELD_OUT = 3000
_BATCH = 7
_RATES_WITH_TARGETS = (20, 10, 5, 2)


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
    return read(DATA / sequence / "groundtruth.txt", duration)


def read(path: Path, duration: int = DURATION) -> Samples:
    """Return the first ``duration`` (ns) of a file in TUM's format."""
    trajectory = read_tum(path)
    stamps, first = np.unique(trajectory.stamps, return_index=True)
    poses = se3.from_position_quaternion(trajectory.positions[first], trajectory.quaternions[first])
    wanted = stamps - stamps[0] <= duration
    return Samples(stamps[wanted], poses[wanted])


def cells(sequence: str, rates: tuple[int, ...] = RATES) -> Iterator[Cell]:
    """Thin a sequence to each of ``rates`` (Hz)."""
    return cells_of(sequence, load(sequence), rates)


def cells_of(sequence: str, samples: Samples, rates: tuple[int, ...]) -> Iterator[Cell]:
    """Thin ``samples`` to each of ``rates`` (Hz)."""
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


@contextmanager
def plain() -> Iterator[None]:
    """Offer ``PLAIN``, too: one kernel, white noise, maximum likelihood, no scale per segment.

    Infinitely many degrees of freedom make the scale one, and the likelihood Gaussian.
    """
    offered = {**MODELS, PLAIN: OneKernel(Matern52())}
    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(trajectory, "MODELS", offered))
        for module in (likelihood, regression):
            stack.enter_context(mock.patch.object(module, "DEGREES_OF_FREEDOM", 1e8))
        yield


def fitted(samples: Samples, process: str, batch: int = _BATCH) -> GroundTruth:
    """Return the ground truth after all samples have been handed over, ``batch`` at a time."""
    if process == ON_THE_WAY:
        return conditioned(samples, None, batch=batch)
    return conditioned(samples, learned(samples, process), process, batch)


def conditioned(
    samples: Samples, process: Process | None, kernel: str = KERNELS[0], batch: int = _BATCH
) -> GroundTruth:
    """Return the ground truth with the ``process`` as learned before; None: on the way."""
    ground_truth = GroundTruth(Settings(kernel, process, FLOOR, FLOOR, SHAPE))
    for start in range(0, len(samples), batch):
        ground_truth.append(samples[start : start + batch])
    ground_truth.conclude()
    return ground_truth


def learned(samples: Samples, kernel: str) -> Process | None:
    """Learn from all segments at once, before the first prediction."""
    segmentation = Segmentation(SHAPE)
    for _ in segmentation.append(samples):
        pass
    lessons = Lessons(trajectory.MODELS[kernel], (FLOOR, FLOOR))
    return lessons.learn([blended.segment for blended in segmentation])


def score_process(cell: Cell, process: str, lag: int | None) -> Score:
    """Predict with the process as the evaluator has it; ``lag`` (ns) None: with all data."""
    return score(cell, fitted(cell.kept, process), lag)


def score(cell: Cell, ground_truth: GroundTruth, lag: int | None) -> Score:
    """Predict with what ``ground_truth`` has learned; ``lag`` (ns) None: with all data."""
    posterior = ground_truth.posterior(cell.held_out.stamps, until(cell, lag), twists=True)
    assert posterior.twists is not None
    hyperparameters = ground_truth.hyperparameters
    assert hyperparameters is not None
    noise = np.repeat(
        [hyperparameters.translation.noise_std**2, hyperparameters.rotation.noise_std**2], 3
    )
    fit = ground_truth.fit
    along = (0.0 if fit is None else fit.stamp_std) * posterior.twists.means
    covariance = posterior.covariances + np.diag(noise) + along[:, :, None] * along[:, None]
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


def until(cell: Cell, lag: int | None) -> Stamps:
    """Stamp of the last sample that answers each held-out one; (n,)."""
    stamps, kept = cell.held_out.stamps, cell.kept.stamps
    last = np.full(len(stamps), len(kept) - 1)
    if lag is not None:
        last = np.minimum(np.searchsorted(kept, stamps + lag), len(kept) - 1)
    return np.asarray(kept[last])


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


@dataclass(frozen=True)
class Measured:
    """A cell's scores: by method for interpolations, by process and lag rule for processes."""

    sequence: str
    rate: int
    interpolations: Mapping[str, Score]
    all_data: Mapping[str, Score]
    live: Mapping[str, Score]


def measure(cell: Cell) -> Measured:
    """Score everything on one cell."""
    all_data, live = {}, {}
    for process in PROCESSES:
        with plain() if process == PLAIN else ExitStack():
            ground_truth = fitted(cell.kept, process)
            all_data[process] = score(cell, ground_truth, None)
            live[process] = score(cell, ground_truth, LAG)
    interpolations = {method: score_interpolation(cell, method) for method in INTERPOLATIONS}
    return Measured(cell.sequence, cell.rate, interpolations, all_data, live)


def batch_error(cell: Cell) -> float:
    """Return the largest difference that batches make, in poses and covariances; it should be 0."""
    answers = [
        fitted(cell.kept, ON_THE_WAY, batch).posterior(cell.held_out.stamps, until(cell, LAG))
        for batch in (1, _BATCH, len(cell.kept))
    ]
    differences = [
        np.abs(getattr(answer, name) - getattr(answers[0], name)).max()
        for answer in answers[1:]
        for name in ("poses", "covariances")
    ]
    return float(max(differences))


Cells = Sequence[Measured]
Known = Callable[[Measured], Mapping[str, Score]]
_PAGE = "calibration.md"


def with_all_data(cell: Measured) -> Mapping[str, Score]:
    """Return the scores of the processes that know all samples."""
    return cell.all_data


def with_lag(cell: Measured) -> Mapping[str, Score]:
    """Return the scores of the processes that know the samples up to the lag."""
    return cell.live


PROTOCOLS: Mapping[str, tuple[Known, str]] = {
    "all samples": (with_all_data, KERNELS[0]),
    "up to 0.3 s later": (with_lag, KERNELS[0]),
    "likewise, learned on the way": (with_lag, ON_THE_WAY),
}
"""What the default knows when it answers, and how it has learned."""


def figure(cells: Cells, known: Known, process: str, name: str) -> Array:
    """Return one figure of a process over the cells; (cells,)."""
    return np.array([getattr(known(cell)[process], name) for cell in cells], dtype=np.float64)


def beside_spline(cells: Cells, known: Known, process: str, name: str) -> float:
    """Return the geometric mean over the cells of an RMSE over the spline's."""
    spline = [getattr(cell.interpolations["spline"], name) for cell in cells]
    return float(np.exp(np.mean(np.log(figure(cells, known, process, name) / spline))))


def overview(cells: Cells, known: Known, name: str, title: str, page: str | None = _PAGE) -> Table:
    """Return the figures of each process over all of ``cells``."""
    rows = []
    for process in PROCESSES:
        anees = figure(cells, known, process, "anees")
        rows.append(
            (
                f"`{process}`" if process in KERNELS else process,
                f"{beside_spline(cells, known, process, 'position_rmse'):.2f}",
                f"{beside_spline(cells, known, process, 'rotation_rmse'):.2f}",
                f"{-figure(cells, known, process, 'log_density').mean():.1f}",
                f"{typical_factor(list(anees)):.2f}",
                f"{anees.min():.2f} to {anees.max():.2f}",
                f"{100 * figure(cells, known, process, 'coverage').mean():.0f} %",
            )
        )
    header = (
        "process",
        "position RMSE / spline's",
        "rotation RMSE / spline's",
        "negative log density, nats",
        "typical ANEES factor",
        "ANEES",
        "95 % holds",
    )
    return Table(name, title, header, tuple(rows), page)


def aims(cells: Cells, known: Known, process: str) -> list[Target]:
    """Return a process's figures beside what they should be."""
    anees = figure(cells, known, process, "anees")
    coverage = float(figure(cells, known, process, "coverage").mean())
    density = figure(cells, known, process, "log_density")
    simple = {p: float(figure(cells, known, p, "log_density").mean()) for p in SIMPLE}
    best = max(simple, key=lambda p: simple[p])
    above = float((density - figure(cells, known, "squared_exponential", "log_density")).min())
    return [
        at_most("typical ANEES factor", typical_factor(list(anees)), 1.5),
        at_most("largest ANEES", float(anees.max()), 2.5),
        Target("mean coverage", "0.92 to 0.97", f"{coverage:.3f}", 0.92 <= coverage <= 0.97),
        at_most(
            "position RMSE / spline's", beside_spline(cells, known, process, "position_rmse"), 1.15
        ),
        at_least(
            f"nats above the best simple choice ({best})", float(density.mean()) - simple[best], 1.5
        ),
        at_least("nats above the squared exponential, worst cell", above, 0.0),
    ]


def aims_of_all(cells: Cells) -> Table:
    """Return the default's figures beside the aims, one column for each of `PROTOCOLS`."""
    columns = [aims(cells, known, process) for known, process in PROTOCOLS.values()]
    rows = tuple(
        (
            row[0].figure,
            row[0].aim,
            *(t.measured if t.met else f"**{t.measured}**" for t in row),
        )
        for row in zip(*columns, strict=True)
    )
    title = "20 to 2 Hz, the default beside its aims; what is missed is bold"
    return Table("calibration targets", title, ("figure", "aim", *PROTOCOLS), rows, _PAGE)


def single_cells(cells: Cells) -> Iterator[Table]:
    """Return the figures of every cell, which are printed and on no page."""
    header: tuple[str, ...] = ("sequence", "Hz")
    rows = []
    for cell in cells:
        scores = [cell.interpolations[m] for m in INTERPOLATIONS] + [cell.live[k] for k in KERNELS]
        rows.append(
            (
                cell.sequence,
                str(cell.rate),
                *(f"{1e3 * s.position_rmse:.2f}" for s in scores),
                *(f"{1e3 * s.rotation_rmse:.2f}" for s in scores),
            )
        )
    names = (*INTERPOLATIONS, *(f"`{kernel}`" for kernel in KERNELS))
    header += tuple(f"{name}, {unit}" for unit in ("mm", "mrad") for name in names)
    title = "Errors at the samples left out, RMS"
    yield Table("calibration errors", title, header, tuple(rows), None)
    kinds: dict[str, Callable[[Score], str]] = {
        "negative log density, nats": lambda s: f"{-(s.log_density or 0.0):.1f}",
        "ANEES": lambda s: f"{s.anees:.2f}",
        "95 % holds": lambda s: f"{100 * (s.coverage or 0.0):.0f} %",
    }
    names = tuple(f"`{p}`" if p in KERNELS else p for p in PROCESSES)
    for name, (kind, words) in zip(("density", "anees", "coverage"), kinds.items(), strict=True):
        rows = [
            (cell.sequence, str(cell.rate), *(words(cell.live[p]) for p in PROCESSES))
            for cell in cells
        ]
        title = f"{kind}, with the samples up to 0.3 s later"
        header = ("sequence", "Hz", *names)
        yield Table(f"calibration {name}", title, header, tuple(rows), None)


def run() -> Iterator[Table | Picture]:
    """Measure all cells."""
    if not DATA.exists():
        raise SkippedError(f"the recordings are not there ({DATA.parent.name}/{DATA.name})")
    measured = [measure(cell) for sequence in SEQUENCES for cell in cells(sequence)]
    yield from single_cells(measured)
    main = [cell for cell in measured if cell.rate in _RATES_WITH_TARGETS]
    title = "20 to 2 Hz, with all samples"
    yield overview(main, with_all_data, "calibration all data", title, page=None)
    title = "20 to 2 Hz, with the samples up to 0.3 s later"
    yield overview(main, with_lag, "calibration lag", title)
    slow = [cell for cell in measured if cell.rate not in _RATES_WITH_TARGETS]
    yield overview(slow, with_lag, "calibration slow", "1 Hz, with the samples up to 0.3 s later")
    yield aims_of_all(main)
    first = next(iter(cells(SEQUENCES[0], (10,))))
    largest = batch_error(first)
    same = at_most("largest difference that batches of 1, 7 or all make", largest, 1e-12, ".0e")
    yield targets("calibration batches", "The answer does not depend on batches", [same], None)
    yield Picture("images/calibration.png", lambda path: picture(measured, path))


_COLORS = {KERNELS[0]: "#1f5fa8", "squared_exponential": "#d1495b", PLAIN: "#e0a030"}
_GREYS = {"nearest": "#c3c9ce", "linear": "#8d979f", "spline": "#3d464d"}


def picture(measured: Cells, path: Path) -> None:
    """Draw error, ANEES and coverage over the rate, one line a sequence.

    Raises SkippedError without matplotlib.
    """
    try:
        import matplotlib as mpl

        mpl.use("Agg")
        import matplotlib.pyplot as plt
        from PIL import Image
    except ImportError as error:
        raise SkippedError("the picture wants matplotlib (the extra report)") from error
    drawing, axes = plt.subplots(3, 1, figsize=(8.0, 8.5), sharex=True, layout="constrained")
    accuracy, honesty, coverage = axes
    for sequence in dict.fromkeys(cell.sequence for cell in measured):
        row = [cell for cell in measured if cell.sequence == sequence]
        rates = [cell.rate for cell in row]
        for method, color in _GREYS.items():
            rmse = [1e3 * cell.interpolations[method].position_rmse for cell in row]
            accuracy.loglog(rates, rmse, color=color, label=method)
        for process, color in _COLORS.items():
            style: dict[str, Any] = {"color": color, "label": process}
            accuracy.loglog(rates, 1e3 * figure(row, with_lag, process, "position_rmse"), **style)
            honesty.loglog(rates, figure(row, with_lag, process, "anees"), ".-", **style)
            coverage.semilogx(rates, figure(row, with_lag, process, "coverage"), ".-", **style)
    honesty.axhspan(0.5, 2.0, color="#5b6770", alpha=0.12, linewidth=0)
    coverage.axhline(0.95, color="#5b6770", linewidth=1)
    accuracy.set_ylabel("position error, RMS (mm)")
    honesty.set_ylabel("ANEES (1: calibrated)")
    honesty.set_yticks([0.25, 0.5, 1.0, 2.0, 4.0], ["1/4", "1/2", "1", "2", "4"])
    coverage.set_ylabel("share in the 95 % region")
    coverage.set_xlabel("ground truth thinned to (Hz)")
    coverage.set_xticks(RATES, [str(rate) for rate in RATES])
    for axis in axes:
        axis.minorticks_off()
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25)
    handles, labels = accuracy.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    accuracy.legend(unique.values(), unique.keys(), frameon=False, fontsize=9)
    drawing.savefig(path, dpi=110)
    plt.close(drawing)
    # Fewer colours: it looks the same, and is a third as large.
    with Image.open(path) as image:
        fewer = image.convert("RGB").quantize(96)
    fewer.save(path, optimize=True)
