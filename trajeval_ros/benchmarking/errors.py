# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The errors of runs over time, thinned so that runs of a sequence can be laid over one another."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.comparison.compare import Evaluated

ERRORS = "errors.csv"
_BINS = 200
_SECOND = 1_000_000_000

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Errors:
    """The position errors of a run under ATE's alignment, RMS in bins ``step`` seconds wide.

    ``values`` (n,), m, from the ground truth's first sample to its last, so that the bins of all
    runs of a sequence are the same; NaN where no pose was evaluated. ``key``: the run's.
    """

    key: str
    step: float
    values: Array


def errors_of(
    key: str, truth: npt.NDArray[np.int64], evaluated: Evaluated, alignment: object
) -> Errors | None:
    """Thin a run's errors. ``truth``: the ground truth's stamps, ns; ``alignment``: ATE's.

    None where there is no pose, or no alignment.
    """
    if not len(evaluated.stamps) or not isinstance(alignment, dict):
        return None
    pose = np.array(alignment["pose"], dtype=np.float64)
    similarity = Similarity(se3.from_position_quaternion(pose[:3], pose[3:]), alignment["scale"])
    positions = similarity.apply(evaluated.estimate)[:, :3, 3]
    squares = np.sum((positions - evaluated.ground_truth[:, :3, 3]) ** 2, axis=1)
    begin, span = int(truth.min()), max(int(np.ptp(truth)), 1)
    place = np.clip((evaluated.stamps - begin) * _BINS // span, 0, _BINS - 1)
    counts = np.bincount(place, minlength=_BINS)
    sums = np.bincount(place, squares, minlength=_BINS)
    values = np.full(_BINS, math.nan)
    values[counts > 0] = np.sqrt(sums[counts > 0] / counts[counts > 0])
    return Errors(key, span / _BINS / _SECOND, values)


class ErrorsFile:
    """``errors.csv``: a line a run, its key, the width of a bin (s), and the errors (m)."""

    def __init__(self, folder: Path, errors: Iterable[Errors] = ()) -> None:
        """``errors``: those to begin with; the file is written anew with them."""
        self.path = folder / ERRORS
        folder.mkdir(parents=True, exist_ok=True)
        new = self.path.with_suffix(".csv.new")
        with new.open("w", encoding="ascii") as file:
            file.writelines(map(_line, errors))
        new.replace(self.path)

    def add(self, errors: Iterable[Errors]) -> None:
        """Append those of runs that are done."""
        with self.path.open("a", encoding="ascii") as file:
            file.writelines(map(_line, errors))


def _line(one: Errors) -> str:
    texts = ("" if math.isnan(value) else f"{value:.5g}" for value in one.values.tolist())
    return f"{one.key},{one.step:.9g},{','.join(texts)}\n"


def read_errors(folder: Path, keys: Iterable[str]) -> Iterator[Errors]:
    """Read those of the ``keys`` that are there; what cannot be read costs its picture alone.

    One that is there twice is read twice: the later one is right.
    """
    wanted = set(keys)
    with contextlib.suppress(OSError), (folder / ERRORS).open("rb") as file:
        yield from (one for _, one in _lines(file) if one.key in wanted)


class StoredErrors:
    """``errors.csv`` of a benchmark, of which the runs that are asked for are read, no others."""

    def __init__(self, folder: Path) -> None:
        """Go through the file once, for where each run's line begins; the later one is right."""
        self._path = folder / ERRORS
        self._places: dict[str, int] = {}
        with contextlib.suppress(OSError), self._path.open("rb") as file:
            self._places = {one.key: place for place, one in _lines(file)}

    def of(self, keys: Iterable[str]) -> list[Errors]:
        """Those of the ``keys`` that are there, in their order."""
        places = [self._places[key] for key in keys if key in self._places]
        found = []
        with contextlib.suppress(OSError), self._path.open("rb") as file:
            for place in places:
                file.seek(place)
                one = _parsed(file.readline())
                found += [] if one is None else [one]
        return found


def _lines(file: BinaryIO) -> Iterator[tuple[int, Errors]]:
    """The runs of a file, and where the line of each begins."""
    place = 0
    for line in file:
        one = _parsed(line)
        if one is not None:
            yield place, one
        place += len(line)


def _parsed(line: bytes) -> Errors | None:
    """A run's errors; None of what is none, such as a last line that is cut off."""
    text = line.decode("ascii", errors="replace")
    key, _, rest = text.partition(",")
    cells = rest.strip().split(",")
    if not text.endswith("\n") or len(cells) != 1 + _BINS:
        return None
    try:
        numbers = [float(cell) if cell else math.nan for cell in cells]
    except ValueError:
        return None
    return Errors(key, numbers[0], np.array(numbers[1:]))


@dataclass(frozen=True)
class Band:
    """Over ``runs``, at ``seconds`` (n,): first quartile, median and third of the errors (n, 3), m.

    NaN where fewer than half of the runs have a pose.
    """

    seconds: Array
    quartiles: Array
    runs: int


def band(errors: Iterable[Errors], runs: int) -> Band | None:
    """The band of runs of one sequence, of which there are ``runs``; None if none has errors."""
    chosen = list(errors)
    if not chosen:
        return None
    values = np.array([one.values for one in chosen])
    enough = 2 * np.count_nonzero(np.isfinite(values), axis=0) >= runs
    shown = np.full((values.shape[1], 3), math.nan)
    if enough.any():
        shown[enough] = np.nanquantile(values[:, enough], [0.25, 0.5, 0.75], axis=0).T
    seconds = (np.arange(values.shape[1]) + 0.5) * chosen[0].step
    return Band(np.asarray(seconds), shown, runs)
