# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A trajectory named by format and place: ``tum:FILE``, ``kitti:FILE:TIMES``, ``bag:BAG:TOPIC``."""

import os
from collections.abc import Callable

from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError

FORMATS = ("tum", "euroc", "kitti", "npz", "nerfstudio", "bag")

Progress = Callable[[int, int], None]


def split(name: str) -> tuple[str | None, str]:
    """The format that stands in front of a name, or None; and the rest of it.

    A file that is called so is a file.
    """
    format_, colon, rest = name.partition(":")
    if colon and format_ in FORMATS and not os.path.exists(name):
        return format_, rest
    return None, name


def place_of(name: str) -> str:
    """What names it: the file, or the topic in a bag."""
    format_, rest = split(name)
    if format_ == "bag":
        return _parts(rest)[1] or rest
    return _parts(rest)[0] if format_ in ("kitti", "npz") else rest


def read(
    format_: str, name: str, times: str | None = None, progress: Progress | None = None
) -> Trajectory:
    """Read a trajectory of a format.

    Args:
        format_: one of `FORMATS`.
        name: the file; ``FILE:TIMES`` (kitti, npz) and ``BAG:TOPIC``.
        times: the file of stamps of those that have none, where ``name`` has none.
        progress: of a bag, called from time to time.

    Raises:
        TrajectoryFileError: what its reader does not read; or a bag without a topic.
    """
    # Each reader when it is asked for: half of them, and what they bring, are not.
    if format_ == "tum":
        from trajeval_ros.files.tum import read_tum

        return read_tum(name)
    if format_ == "euroc":
        from trajeval_ros.files.euroc import read_euroc

        return read_euroc(name)
    if format_ == "nerfstudio":
        from trajeval_ros.files.matrices import read_nerfstudio

        return read_nerfstudio(name)
    place, more = _parts(name)
    if format_ == "kitti":
        from trajeval_ros.files.kitti import read_kitti

        return read_kitti(place, more or times)
    if format_ == "npz":
        from trajeval_ros.files.matrices import read_arrays

        return read_arrays(place, more or times)
    from trajeval_ros.files.bag import read_bag

    if not more:
        raise TrajectoryFileError(place, f"which topic of it? name it as bag:{place}:TOPIC")
    (trajectory,) = read_bag(place, [more], progress)
    return trajectory


def _parts(name: str) -> tuple[str, str]:
    """A file, which may have colons in its name, and what stands behind it."""
    colons = [place for place, letter in enumerate(name) if letter == ":"]
    for place in reversed([*colons, len(name)]):
        if os.path.exists(name[:place]):
            return name[:place], name[place + 1 :]
    first, _, rest = name.partition(":")
    return first, rest
