# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The format of a file by its content, whatever it is called."""

import os
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.files.recognise import recognise
from trajeval_ros.files.trajectory import TrajectoryFileError

POSE = "1.5 0 0 0 0 0 1"
MATRIX = "1 0 0 5 0 1 0 0 0 0 1 0"


def csv(*stamps: int, columns: int = 8) -> str:
    return "\n".join(",".join(map(str, (t, 1, 2, 3, 1, *[0] * (columns - 5)))) for t in stamps)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (f"1403636579.76 {POSE}\n1403636579.77 {POSE}\n", "tum"),
        (f"# stamp tx ty\n0.1,{POSE.replace(' ', ',')}\n", "tum"),
        # Whole seconds, with commas.
        (csv(0, 1, 2), "tum"),
        (csv(1403636579, 1403636580), "tum"),
        (MATRIX, "kitti"),
        (MATRIX.replace(" ", ","), "kitti"),
        ("#timestamp,p_x\n" + csv(1403636579763555584, 1403636579768555584), "euroc"),
        (csv(1403636579763555584, 1403636579768555584, columns=17), "euroc"),
        # A simulator's clock begins at zero.
        (csv(0, 5_000_000, 10_000_000), "euroc"),
        (csv(0, 5_000_000, 10_000_000, columns=17), "euroc"),
        ('{"poses": []}', "nerfstudio"),
        ("  [1, 2]", "nerfstudio"),
        # Whose reader says what is wrong.
        ("1 2 3\n", "tum"),
        ("", "tum"),
        ("\ufeff" + MATRIX, "kitti"),
    ],
)
def test_text(text: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "named.bag"
    path.write_text(text, encoding="utf-8")
    found = recognise(path)
    assert found.format == expected
    assert found.evidence


def test_a_long_file_is_cut_at_a_row(tmp_path: Path) -> None:
    path = tmp_path / "long.txt"
    # No power of two, so that the cut lies within a row, and within a character of a comment.
    path.write_text(f"{MATRIX} # ü\n" * 10_000, encoding="utf-8")
    assert recognise(path).format == "kitti"


def test_bags(tmp_path: Path) -> None:
    ros1, mcap, database = (tmp_path / name for name in ("a.txt", "b.txt", "c.txt"))
    ros1.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    mcap.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with sqlite3.connect(database) as connection:
        connection.execute("create table topics (id integer)")
    connection.close()
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(TrajectoryFileError, match="without a bag"):
        recognise(folder)
    (folder / "metadata.yaml").write_text("{}", encoding="utf-8")
    for path in (ros1, mcap, database, folder):
        assert recognise(path).format == "bag"


def test_arrays(tmp_path: Path) -> None:
    path = tmp_path / "poses.npz"
    np.savez(path, stamps=np.arange(3.0))
    assert recognise(path).format == "npz"


def test_what_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryFileError, match=r"nothing.txt: it cannot be read: no such file"):
        recognise(tmp_path / "nothing.txt")
    picture = tmp_path / "picture.png"
    picture.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    with pytest.raises(TrajectoryFileError, match="neither text nor a bag"):
        recognise(picture)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(TrajectoryFileError, match="read twice; name its format"):
        recognise(pipe)
