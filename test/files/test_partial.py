# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are there whole or not at all, and what killed processes leave of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from trajeval_ros.files.partial import remove_leftovers, replacing, workshop

ROOT = Path(__file__).resolve().parents[2]

KILLED = {
    "workshop": """
import sys
from pathlib import Path
from trajeval_ros.files.partial import workshop
with workshop(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("half of it")
    print("writing", flush=True)
    sys.stdin.read()
""",
    "replacing": """
import sys
from pathlib import Path
from trajeval_ros.files.partial import replacing
with replacing(Path(sys.argv[1])) as file:
    print("writing", flush=True)
    sys.stdin.read()
""",
    "bag": """
import sys
from pathlib import Path
from trajeval_ros.files.mcap import Topic, write_mcap
def messages():
    yield 1, "/a", b"\\0\\1\\0\\0" + bytes(8)
    print("writing", flush=True)
    sys.stdin.read()
write_mcap(Path(sys.argv[1]), {"/a": Topic("std_msgs/msg/Float64")}, messages())
""",
}


@pytest.mark.parametrize("how", KILLED)
def test_what_a_killed_process_leaves_is_removed_and_a_living_ones_is_not(
    how: str, tmp_path: Path
) -> None:
    if how == "bag":
        pytest.importorskip("rosbags", reason="rosbags is not installed")
    path = tmp_path / "run.mcap"
    path.write_text("the one before", encoding="utf-8")
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED[how], str(path)],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        },
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "writing\n"
    (partial,) = tmp_path.glob(".*.partial")
    # Another file of the kind, in the same folder.
    with workshop(tmp_path / "other.mcap"):
        assert partial.exists()
    child.kill()
    child.communicate()
    assert partial.exists()
    assert path.read_text(encoding="utf-8") == "the one before"
    with workshop(tmp_path / "other.mcap"):
        assert not partial.exists()
    assert os.listdir(tmp_path) == ["run.mcap"]


def test_it_takes_its_place_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with replacing(path) as file:
        file.write(b"first")
        assert not path.exists()
    assert path.read_bytes() == b"first"
    with pytest.raises(TypeError), replacing(path) as file:
        file.write("no bytes")  # type: ignore[arg-type]
    assert path.read_bytes() == b"first"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_nothing_else_is_removed(tmp_path: Path) -> None:
    for name in ("run.mcap", ".run.mcap", ".run.pdf.1.partial", "run.mcap.partial"):
        (tmp_path / name).touch()
    remove_leftovers(tmp_path, ".*.mcap.*.partial")
    assert len(os.listdir(tmp_path)) == 4
