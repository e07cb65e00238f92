# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows in the order of their stamps, and one row a stamp.

A file is read by stamp: rows may be shuffled, and a smoother writes a window of poses again and
again, each better than the last. What stands elsewhere because its stamp is wrong is left there,
for the engine to reject.
"""

import dataclasses

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.median import median

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# Rows with the stamp of the row before and another pose: from this share on, stamps are too coarse
# to tell rows apart, and none of them corrects another.
_COARSE = 1.0 / 3.0
# ns that a stamp must be off those of the rows around it to be doubted.
_OFF = 500_000_000


def ordered(read: Trajectory) -> Trajectory:
    """The trajectory by stamp, the last finite row of each; its remarks say what was done."""
    stamps = read.stamps
    if (stamps[1:] > stamps[:-1]).all():
        return read
    remarks = list(read.remarks)
    wrong = _wrong_stamps(stamps, read.positions)
    right = np.flatnonzero(~wrong)
    order = right
    backward = _steps_back(stamps[right])
    if backward:
        order = right[np.argsort(stamps[right], kind="stable")]
        remarks.append(f"rows are not in the order of time ({backward:,} steps back): sorted")
    superseded = np.zeros(0, dtype=np.int64)
    if _coarse(read):
        different = np.unique(stamps)
        resolved = median(np.diff(different)) / 1e9 if len(different) > 1 else 0.0
        remarks.append(
            f"stamps resolve only {resolved:g} s, {len(different):,} different ones in"
            f" {len(stamps):,} rows: write them with more digits"
        )
    else:
        superseded, order = _superseded(read, order)
        if len(superseded):
            count = len(superseded)
            have = "1 row has" if count == 1 else f"{count:,} rows have"
            remarks.append(f"{have} the stamp of a later row, which counts: superseded")
    # What is wrong stays behind the row that it stood behind.
    place = np.concatenate([np.searchsorted(right, np.flatnonzero(wrong)), np.arange(len(order))])
    if wrong.any():
        everything = np.concatenate([np.flatnonzero(wrong), order])
        kind = np.concatenate([np.zeros(int(wrong.sum())), np.ones(len(order))])
        order = everything[np.lexsort((kind, place))]
    return dataclasses.replace(
        read,
        stamps=stamps[order],
        positions=read.positions[order],
        quaternions=read.quaternions[order],
        rows=read.rows[order],
        covariances=None if read.covariances is None else read.covariances[order],
        superseded_rows=np.sort(read.rows[superseded]),
        remarks=tuple(remarks),
    )


def _wrong_stamps(stamps: Integers, positions: Array) -> Mask:
    """Single rows whose stamp, not their place, is wrong.

    The rows around one are in order, its stamp is far off both of theirs, and its position is
    nearer to theirs than to that of the rows of its own time; and all other rows are in order.
    """
    wrong = np.zeros(len(stamps), dtype=np.bool_)
    if len(stamps) < 4:
        return wrong
    before, here, after = stamps[:-2], stamps[1:-1], stamps[2:]
    # Differences of int64 may not fit into one.
    after_it, before_it = before - here.astype(np.float64), here - after.astype(np.float64)
    off = (before <= after) & ((after_it > _OFF) | (before_it > _OFF))
    doubted = np.flatnonzero(off) + 1
    rest = np.delete(np.arange(len(stamps)), doubted)
    if len(doubted) == 0 or _steps_back(stamps[rest]):
        return wrong
    place = np.searchsorted(stamps[rest], stamps[doubted])
    outside = (place == 0) | (place == len(rest))
    earlier, later = rest[np.maximum(place - 1, 0)], rest[np.minimum(place, len(rest) - 1)]
    with np.errstate(over="ignore", invalid="ignore"):
        there = 0.5 * (positions[earlier] + positions[later])
        around = 0.5 * (positions[doubted - 1] + positions[doubted + 1])
        nearer = np.linalg.norm(positions[doubted] - around, axis=1) <= np.linalg.norm(
            positions[doubted] - there, axis=1
        )
    wrong[doubted[outside | nearer]] = True
    return wrong


def _steps_back(stamps: Integers) -> int:
    return int((stamps[1:] < stamps[:-1]).sum())


def _coarse(read: Trajectory) -> bool:
    """Whether many rows have the stamp of the row before, but another pose."""
    same = read.stamps[1:] == read.stamps[:-1]
    other = (read.positions[1:] != read.positions[:-1]).any(axis=1)
    return int((same & other).sum()) > _COARSE * len(read)


def _superseded(read: Trajectory, order: Integers) -> tuple[Integers, Integers]:
    """Of the rows in ``order`` (by stamp): those with the stamp of a later finite one; the rest."""
    stamps = read.stamps[order]
    values = np.concatenate([read.positions[order], read.quaternions[order]], axis=1)
    finite = np.isfinite(values).all(axis=1)
    group = np.concatenate([[0], np.cumsum(stamps[1:] != stamps[:-1])])
    # The last of a group by (finite, place) counts.
    best = np.lexsort((np.arange(len(order)), finite, group))
    last = best[np.concatenate([np.diff(group[best]) != 0, [True]])]
    kept = np.zeros(len(order), dtype=np.bool_)
    kept[last] = True
    return order[~kept], order[kept]
