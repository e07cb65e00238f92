# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Text files: a good run in one of the formats, with damage to poses, words and bytes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fuzz import oracle
from trajeval_ros import se3
from trajeval_ros.commands.simulation import Poses, simulate

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Rows = list[list[str]]
SECOND = 1_000_000_000

_WORDS: tuple[str, ...] = (
    "nan",
    "-nan",
    "inf",
    "1e308",
    "-1e400",
    "1e-320",
    "",
    "abc",
    "1_0",
    "0x10",
    "1;5",
    "-0",
)
_WORDS += ("9223372036854775807", "-9223372036854775809", "1e30", "٣", "\ufeff1", "\0", '"1"')


@dataclass(frozen=True)
class Track:
    """``stamps`` (n,) ns as doubles, ``positions`` (n, 3), ``quaternions`` (n, 4) x y z w."""

    stamps: Array
    positions: Array
    quaternions: Array

    def rows(self, index: Index) -> Track:
        """Return the rows of these numbers."""
        return Track(self.stamps[index], self.positions[index], self.quaternions[index])

    def held(self, lower: float, upper: float) -> Index:
        """Return the stamps as whole numbers within bounds, 0 for NaN."""
        return np.clip(np.nan_to_num(self.stamps), lower, upper).astype(np.int64)


@lru_cache(maxsize=8)
def good_run(seed: int, seconds: float = 12.0) -> tuple[Track, Track]:
    """Return ground truth at 40 Hz and an estimate at 5 Hz, without damage."""
    made = simulate(
        seconds,
        seed,
        ground_truth_rate=40.0,
        estimate_rate=5.0,
        dropouts=((0.6, 1.5),) if seed % 2 else (),
        start=1000 * SECOND if seed % 3 else 1_750_000_000 * SECOND,
    )
    return _track(made.ground_truth), _track(made.estimate)


def _track(made: Poses) -> Track:
    return Track(made.stamps.astype(np.float64), *se3.to_position_quaternion(made.poses))


def damaged(rng: np.random.Generator, track: Track) -> Track:
    """Return the track with one thing wrong with its stamps, its poses or their order."""
    n = len(track.stamps)
    if not n:
        return track
    span = slice(*np.sort(rng.integers(0, n + 1, 2)).tolist())
    few = rng.integers(0, n, rng.integers(1, 6))
    change = (_reordered, _restamped, _turned, _moved)[rng.integers(4)]
    copy = Track(track.stamps.copy(), track.positions.copy(), track.quaternions.copy())
    with np.errstate(all="ignore"):
        return change(rng, copy, span, few)


def _reordered(rng: np.random.Generator, track: Track, span: slice, few: Index) -> Track:
    order = np.arange(len(track.stamps))
    match rng.integers(5):
        case 0:
            order = np.delete(order, span)
        case 1:
            order = np.insert(order, span.start, order[span])
        case 2:
            order[span] = rng.permutation(order[span])
        case 3:
            order = order[::-1]
        case _:
            order = order[: rng.choice([1, 2, 3, span.start])]
    return track.rows(order)


def _restamped(rng: np.random.Generator, track: Track, span: slice, few: Index) -> Track:
    stamps = track.stamps
    match rng.integers(6):
        case 0:
            stamps[few] = rng.choice([0.0, -1.0, -5e9, 1e18, 9.2e18, np.nan, np.inf])
        case 1:
            stamps[span.start :] += rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(6, 18)
        case 2:
            stamps[span] = stamps[few[0]]
        case 3:
            stamps = np.floor(stamps / 1e9) * 1e9
        case 4:
            stamps = stamps * rng.choice([1e-9, 1e-3, 1e3, 1e9, -1.0, 0.0])
        case _:
            stamps += rng.normal(0.0, 10.0 ** rng.uniform(5, 10), len(stamps))
    return replace(track, stamps=stamps)


def _turned(rng: np.random.Generator, track: Track, span: slice, few: Index) -> Track:
    quaternions = track.quaternions
    match rng.integers(6):
        case 0:
            quaternions[few] = rng.choice([0.0, np.nan, np.inf, 1e308])
        case 1:
            # Half a turn about the body's x.
            quaternions[few] = quaternions[few][:, [3, 2, 1, 0]] * [1, 1, -1, -1]
        case 2:
            quaternions[span] *= rng.choice([-1.0, 1.01, 0.5, 1e-200, 1e200])
        case 3:
            quaternions[:] = (0.0, 0.0, 0.0, 1.0)
        case 4:
            quaternions = np.roll(quaternions, 1, axis=1)
        case _:
            quaternions[span] = quaternions[few[0]]
            track.positions[span] = track.positions[few[0]]
    return replace(track, quaternions=quaternions)


def _moved(rng: np.random.Generator, track: Track, span: slice, few: Index) -> Track:
    positions = track.positions
    match rng.integers(7):
        case 0:
            positions[few] += rng.normal(0.0, 10.0 ** rng.uniform(-1, 8), 3)
        case 1:
            positions *= 10.0 ** rng.choice([-300.0, -9.0, -3.0, 3.0, 6.0, 9.0, 150.0, 300.0])
        case 2:
            positions += 10.0 ** rng.uniform(3, 12)
        case 3:
            positions[few] = rng.choice([np.nan, np.inf, 1e308])
        case 4:
            # In a plane, on a line, at a point.
            positions[:, rng.permutation(3)[: rng.integers(1, 4)]] = 0.0
        case 5:
            positions[:], track.quaternions[:] = positions[0], track.quaternions[0]
        case _:
            positions[span.start :] += rng.normal(0.0, 10.0, 3)
    return replace(track, positions=positions)


def written(track: Track, form: str) -> Rows:
    """Return the words of each pose in a format; the first is the stamp, for KITTI too."""
    numbers = np.concatenate([track.positions, track.quaternions], axis=1)
    scale, digits = (1.0, 0) if form == "euroc" else (1e9, 9)
    stamps = [f"{stamp / scale:.{digits}f}" for stamp in track.stamps.tolist()]
    if form == "euroc":
        numbers = numbers[:, [0, 1, 2, 6, 3, 4, 5]]
    if form == "kitti":
        x, y, z, w = track.quaternions.T
        with np.errstate(all="ignore"):
            square = x * x + y * y + z * z + w * w
            elements = [
                *(square - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
                *(2 * (x * y + w * z), square - 2 * (x * x + z * z), 2 * (y * z - w * x)),
                *(2 * (x * z - w * y), 2 * (y * z + w * x), square - 2 * (x * x + y * y)),
            ]
        rotations = np.stack(elements, axis=-1).reshape(-1, 3, 3)
        numbers = np.concatenate([rotations, track.positions[:, :, None]], axis=2).reshape(-1, 12)
    words = ([f"{value:.9g}" for value in row] for row in numbers.tolist())
    return [[stamp, *row] for stamp, row in zip(stamps, words, strict=True)]


def misspelt(rng: np.random.Generator, rows: Rows) -> Rows:
    """Return the words with some wrong ones, missing ones, or too many."""
    rows = [list(row) for row in rows]
    for _ in range(rng.integers(1, 4)):
        row = rows[rng.integers(len(rows))] if rows else []
        column = int(rng.integers(len(row))) if row else 0
        word = _WORDS[rng.integers(len(_WORDS))]
        match rng.integers(5):
            case 0:
                row[column : column + 1] = [word]
            case 1:
                row[column : column + 1] = []
            case 2:
                row.insert(column, word)
            case 3:
                rows = [[*each[:column], word, *each[column + 1 :]] for each in rows]
            case _:
                rows = [each[:column] + each[column + 1 :] for each in rows]
    return rows


_NOTHING = (b"", b"\n", b"# only this\n", b" \t \n", b"\xff\xfe")


def corrupted(rng: np.random.Generator, content: bytes) -> bytes:
    """Return the bytes with some of them wrong, missing, doubled or strange."""
    i, j = np.sort(rng.integers(0, len(content) + 1, 2)).tolist()
    match rng.integers(12):
        case 0 | 1 | 2:
            array = np.frombuffer(content, dtype=np.uint8).copy()
            count = rng.choice([1, 3, 30]) if len(array) else 0
            array[rng.integers(0, max(len(array), 1), count)] = rng.integers(0, 256, count)
            return array.tobytes()
        case 3:
            return content[:j]
        case 4:
            return content[:i] + content[j:]
        case 5:
            return content[:j] + content[i:]
        case 6:
            return content.replace(b"\n", b"\r\n" if rng.integers(2) else b"\r")
        case 7:
            return b"\xef\xbb\xbf" + content
        case 8:
            return content[:i] + b"\0" * int(rng.integers(1, 600)) + content[i:]
        case 9:
            return _NOTHING[rng.integers(len(_NOTHING))]
        case 10:
            return content.decode("utf-8", "replace").encode("utf-16")
        case _:
            return content[:i] + "# µ é\n".encode("latin-1" if rng.integers(2) else "utf-8")


def content(rng: np.random.Generator, rows: Rows, separator: str) -> bytes:
    """Return the file of these words, at times with damaged words or bytes."""
    if rng.random() < 0.2:
        rows = misspelt(rng, rows)
    made = "".join(separator.join(row) + "\n" for row in rows).encode()
    return corrupted(rng, made) if rng.random() < 0.2 else made


def case(rng: np.random.Generator, folder: Path) -> str:
    """Write a damaged run, evaluate it, check; return what became of it."""
    form = str(rng.choice(["tum", "euroc", "kitti"]))
    tracks = list(good_run(int(rng.integers(4))))
    for _ in range(rng.integers(0, 3)):
        which = rng.integers(2)
        tracks[which] = damaged(rng, tracks[which])
    if form == "kitti":
        # One file of stamps for both.
        n = min(len(track.stamps) for track in tracks)
        tracks = [replace(t.rows(np.arange(n)), stamps=tracks[1].stamps[:n]) for t in tracks]
    suffix, separator = (".csv", ",") if form == "euroc" else (".txt", " ")
    paths = [folder / f"{name}{suffix}" for name in ("ground_truth", "estimate")]
    options = []
    for path, track in zip(paths, tracks, strict=True):
        rows = written(track, form)
        if form == "kitti":
            options = ["--times", str(folder / "times.txt")]
            (folder / "times.txt").write_bytes(content(rng, [row[:1] for row in rows], " "))
            rows = [row[1:] for row in rows]
        path.write_bytes(content(rng, rows, separator))
    if rng.random() < 0.3:
        options += ["--set", f"gauge={rng.choice(['none', 'yaw_translation', 'sim3'])}"]
    if rng.random() < 0.3:
        options += ["--set", "likelihood.covariance=joint"]
    return oracle.evaluate_and_check([form, *map(str, paths), *options], folder)
