# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which format a file has, by what is in it and not by its name."""

from __future__ import annotations

import dataclasses
import itertools
import os
from pathlib import Path
from typing import Literal

from trajeval_ros.files.content import PathLike, text_of
from trajeval_ros.files.trajectory import TrajectoryFileError

Format = Literal["bag", "npz", "nerfstudio", "kitti", "euroc", "tum"]

_MAGIC: tuple[tuple[bytes, Format, str], ...] = (
    (b"\x89MCAP0\r\n", "bag", "an mcap file"),
    (b"SQLite format 3\0", "bag", "an sqlite3 database"),
    (b"#ROSBAG V", "bag", "a ROS 1 bag"),
    (b"PK\x03\x04", "npz", "a zip archive"),
    (b"\x93NUMPY", "npz", "an array of NumPy's"),
)
_BAG_FILES = (".mcap", ".db3", ".bag")
_HEAD = 65536
_KITTI_COLUMNS = 12
_EUROC_LEAST_COLUMNS = 8
# Whole numbers that cannot be seconds: more of them than int64 nanoseconds hold, 292 years; or
# rows a day apart. In nanoseconds that is 9.2 s after the clock began, and rows 0.09 ms apart.
_NO_SECONDS = 9_223_372_036
_NO_STEP_IN_SECONDS = 86_400


@dataclasses.dataclass(frozen=True)
class Recognised:
    """What a file is.

    Attributes:
        format: its name, as the commands have it.
        evidence: what shows it, a noun for a sentence: "rows of 12 numbers".
    """

    format: Format
    evidence: str


def recognise(path: PathLike) -> Recognised:
    """Recognise the format of a trajectory; reads no more than the first 64 KiB.

    What is text, but of none of the other formats, is taken for TUM's, whose reader says what is
    wrong with it.

    Raises:
        TrajectoryFileError: the file cannot be read, is neither text nor of a known kind, or is a
            folder without a bag in it; or is a pipe.
    """
    source = os.fspath(path)
    try:
        if os.path.isdir(source):
            return _folder(source)
        if not os.path.isfile(source) and os.path.exists(source):
            # What is read of a pipe is gone for its reader.
            raise TrajectoryFileError(
                source, "it is no file that can be read twice; name its format"
            )
        with open(source, "rb") as file:
            head = file.read(_HEAD + 1)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TrajectoryFileError(source, f"it cannot be read: {reason}") from None
    for magic, kind, evidence in _MAGIC:
        if head.startswith(magic):
            return Recognised(kind, evidence)
    try:
        text = text_of(source, head, cut=len(head) > _HEAD)
    except TrajectoryFileError:
        raise TrajectoryFileError(source, "it is neither text nor a bag") from None
    return _text(text)


def _folder(source: str) -> Recognised:
    names = sorted(entry.name for entry in Path(source).iterdir())
    if "metadata.yaml" in names or any(name.endswith(_BAG_FILES) for name in names):
        return Recognised("bag", "a folder with a bag in it")
    raise TrajectoryFileError(source, "it is a folder without a bag in it")


def _text(text: str) -> Recognised:
    if text.lstrip()[:1] in ("{", "["):
        return Recognised("nerfstudio", "text that begins with a bracket")
    rows = [line for line in (raw.partition("#")[0] for raw in text.splitlines()) if line.strip()]
    cells = [row.replace(",", " ").split() for row in rows]
    columns = len(cells[0]) if cells else 0
    if columns == _KITTI_COLUMNS:
        return Recognised("kitti", f"rows of {_KITTI_COLUMNS} numbers")
    first = [row[0] for row in cells if row]
    if columns >= _EUROC_LEAST_COLUMNS and "," in rows[0] and _are_nanoseconds(first):
        return Recognised("euroc", "commas, and stamps in nanoseconds")
    return Recognised("tum", f"rows of {columns} numbers" if columns else "text")


def _are_nanoseconds(first: list[str]) -> bool:
    """Whether whole numbers are stamps that cannot be seconds."""
    if not all(word.isdecimal() and word.isascii() for word in first):
        return False
    stamps = sorted(map(int, first))
    if stamps[-1] > _NO_SECONDS:
        return True
    steps = sorted(b - a for a, b in itertools.pairwise(stamps) if b > a)
    return bool(steps) and steps[len(steps) // 2] >= _NO_STEP_IN_SECONDS
