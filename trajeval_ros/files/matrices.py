# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses as matrices: NumPy's ``.npy`` and ``.npz``, and nerfstudio's ``transforms.json``."""

import json
import os
import re
import zipfile
from pathlib import PurePath
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.files.rows import trajectory_of
from trajeval_ros.files.stamps import NANOSECONDS, SECONDS, read_stamps
from trajeval_ros.files.text import Layout, PathLike, Table, read_table
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError

Array = npt.NDArray[np.float64]

# KITTI's own matrices are orthonormal to 1e-6 only, some systems write four digits.
_ORTHONORMAL_TO = 1e-2
_STAMPS_IN_FRAME = ("timestamp", "stamp", "time", "timestamp_ns")


def quaternions_of(matrices: Array) -> Array:
    """Quaternions (N, 4), x y z w, of matrices (N, 3, 3).

    What is no rotation to 1e-2 (zero, scaled, a mirror image) gets (0, 0, 0, 0), and what is not
    finite NaN, so that the engine recognises both as bad poses.
    """
    quaternions = np.zeros((len(matrices), 4))
    finite = np.isfinite(matrices).all(axis=(1, 2))
    quaternions[~finite] = np.nan
    known = matrices[finite]
    products = np.swapaxes(known, 1, 2) @ known
    good = np.abs(products - np.eye(3)).max(axis=(1, 2), initial=0.0) < _ORTHONORMAL_TO
    good &= np.linalg.det(known) > 0
    poses = np.tile(np.eye(4), (int(good.sum()), 1, 1))
    poses[:, :3, :3] = known[good]
    quaternions[np.flatnonzero(finite)[good]] = se3.to_position_quaternion(poses)[1]
    return quaternions


def read_arrays(path: PathLike, times: PathLike | None = None) -> Trajectory:
    """Read a stack of poses: (N, 4, 4) or (N, 3, 4), with stamps.

    These are the array (N,) beside them in a ``.npz``, or the file ``times`` (``.npy``, or text);
    or the first column of rows of 17, 13 or 8 numbers (8: in TUM's order). Integers are
    nanoseconds and others seconds, unless their size says otherwise.

    Raises:
        TrajectoryFileError: the file cannot be read, holds no such stack, two, or no stamps.
    """
    source = os.fspath(path)
    arrays = _loaded(source)
    stacks = {name: array for name, array in arrays.items() if _holds_poses(array)}
    if len(stacks) != 1:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        what = "no stack of poses" if not stacks else f"{len(stacks)} stacks of poses"
        raise TrajectoryFileError(source, f"there is {what} in it, such as (N, 4, 4): {shapes}")
    ((name, stack),) = stacks.items()
    if stack.ndim == 2:
        stamps, stack = stack[:, 0], stack[:, 1:]
    elif times is not None:
        stamps = _times(os.fspath(times))
    else:
        stamps = _beside(source, arrays, len(stack))
    if len(stamps) != len(stack):
        raise TrajectoryFileError(
            source, f"{len(stamps):,} stamps for the {len(stack):,} poses of {name}"
        )
    values = stack.reshape(len(stack), -1).astype(np.float64)
    if values.shape[1] == 7:
        return _trajectory(source, _words(stamps), values[:, :3], values[:, 3:])
    matrices = values[:, :12].reshape(-1, 3, 4)
    quaternions = quaternions_of(matrices[:, :, :3])
    return _trajectory(source, _words(stamps), matrices[:, :, 3], quaternions)


def _loaded(source: str) -> dict[str, npt.NDArray[Any]]:
    """The arrays of numbers in a file, by name."""
    try:
        loaded = np.load(source, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"the array": loaded}
        with loaded:
            arrays = {name: np.asarray(loaded[name]) for name in loaded.files}
    except OSError as error:
        reason = (error.strerror or "it is no file of NumPy's").lower()
        raise TrajectoryFileError(source, f"it cannot be read: {reason}") from None
    except (ValueError, EOFError, zipfile.BadZipFile):
        raise TrajectoryFileError(source, "it is no file of NumPy's, or damaged") from None
    return {name: array for name, array in arrays.items() if array.dtype.kind in "iuf"}


def _holds_poses(array: npt.NDArray[Any]) -> bool:
    if array.dtype.kind not in "iuf" or len(array.shape) < 2 or len(array) == 0:
        return False
    return array.shape[1:] in ((4, 4), (3, 4), (17,), (13,), (8,))


def _beside(source: str, arrays: dict[str, npt.NDArray[Any]], count: int) -> npt.NDArray[Any]:
    """The stamps among the arrays: the only ones of as many numbers, or named as such."""
    found = {name: array for name, array in arrays.items() if array.shape in ((count,), (count, 1))}
    named = {name: array for name, array in found.items() if re.search("stamp|time", name.lower())}
    chosen = named if len(named) == 1 else found
    if len(chosen) != 1:
        what = "no array" if not chosen else f"{len(chosen)} arrays"
        raise TrajectoryFileError(
            source,
            f"there is {what} of {count:,} stamps in it; name a file of them: npz:FILE:TIMES",
        )
    return next(iter(chosen.values())).reshape(-1)


def _times(source: str) -> npt.NDArray[Any]:
    """Stamps from a file of their own."""
    if source.endswith(".npy"):
        (array,) = _loaded(source).values()
        return array.reshape(-1)
    return np.array(read_table(source, Layout({1: "stamps"})).first, dtype=np.str_)


def _words(stamps: npt.NDArray[Any]) -> list[str]:
    return [str(value) if isinstance(value, str) else repr(value) for value in stamps.tolist()]


def read_nerfstudio(path: PathLike) -> Trajectory:
    """Read a ``transforms.json``: ``frames``, each with a ``transform_matrix`` and a stamp.

    The stamp is the frame's ``timestamp`` (or ``time``), or the number that its image is called.

    Raises:
        TrajectoryFileError: the file cannot be read, or a frame has no matrix or no stamp.
    """
    source = os.fspath(path)
    try:
        with open(source, "rb") as file:
            frames = json.load(file)["frames"]
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TrajectoryFileError(source, f"it cannot be read: {reason}") from None
    except (ValueError, TypeError, KeyError, RecursionError):
        raise TrajectoryFileError(source, "it is no transforms.json with frames in it") from None
    if not isinstance(frames, list) or not frames:
        raise TrajectoryFileError(source, "there is no frame in it")
    words, matrices = [], []
    for number, frame in enumerate(frames, start=1):
        words.append(_stamp_of(source, frame, number))
        matrices.append(_matrix_of(source, frame, number))
    poses = np.array(matrices)
    remark = "cameras look along -z, y up (OpenGL)"
    quaternions = quaternions_of(poses[:, :3, :3])
    return _trajectory(source, words, poses[:, :3, 3], quaternions, (remark,))


def _stamp_of(source: str, frame: Any, number: int) -> str:
    if isinstance(frame, dict):
        for key in _STAMPS_IN_FRAME:
            if isinstance(frame.get(key), int | float):
                return repr(frame[key])
        stem = PurePath(str(frame.get("file_path", ""))).name
        # The dot before the ending of an image is none of a number.
        found = re.fullmatch(r"(\d{9,}(?:\.\d+)?)(?:\.[a-zA-Z]\w*)?", stem)
        if found:
            return found.group(1)
    raise TrajectoryFileError(
        source, "the frame has neither a timestamp nor an image that is called by one", number
    )


def _matrix_of(source: str, frame: Any, number: int) -> Array:
    try:
        matrix = np.array(frame["transform_matrix"], dtype=np.float64)
    except (ValueError, TypeError, KeyError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise TrajectoryFileError(source, "the frame has no transform_matrix of 4x4", number)
    return matrix[:3]


def _trajectory(
    source: str,
    words: list[str],
    positions: Array,
    quaternions: Array,
    remarks: tuple[str, ...] = (),
) -> Trajectory:
    rows = np.arange(1, len(words) + 1, dtype=np.int64)
    table = Table(source, np.array(words, dtype=np.float64)[:, None], words, rows, None, remarks)
    whole = all(word.isdecimal() for word in words)
    # Integers that would be years apart in seconds are nanoseconds, as ROS and most tools have it.
    few = whole and len(words) > 1 and float(np.median(np.abs(np.diff(table.values[:, 0])))) < 1e4
    exponent = NANOSECONDS if whole and not few else SECONDS
    stamps, finite, said = read_stamps(table, exponent)
    return trajectory_of(table, stamps, finite, positions, quaternions, said)
