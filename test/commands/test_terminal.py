# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a person sees on a narrow terminal: no word is broken at its edge."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

from trajeval_ros.commands.simulate import write_files

_COLUMNS = 80


def shown(*arguments: str, cwd: Path) -> list[str]:
    """The lines that ``evaluate`` prints on a terminal of so many columns."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 50, _COLUMNS, 0, 0))
    environment = {k: v for k, v in os.environ.items() if k != "COLUMNS"}
    command = [sys.executable, "-m", "trajeval_ros.commands.evaluate", *arguments]
    with subprocess.Popen(
        command, stdout=slave, stderr=subprocess.DEVNULL, cwd=cwd, env=environment
    ) as child:
        os.close(slave)
        data = b""
        while True:
            try:
                piece = os.read(master, 65536)
            except OSError:  # the other end is closed
                break
            if not piece:
                break
            data += piece
        os.close(master)
        assert child.wait() == 0
    return data.decode().replace("\r\n", "\n").splitlines()


def test_nothing_is_wider_than_the_terminal(tmp_path: Path) -> None:
    truth, estimate = write_files(tmp_path, 20.0, 3)
    # Clocks that differ, so that there is a likely cause, and poses outside the ground truth.
    rows = [line.split() for line in estimate.read_text(encoding="utf-8").splitlines()]
    late = [[f"{float(row[0]) + 0.5:.9f}", *row[1:]] for row in rows if row[0] != "#"]
    other = tmp_path / "late.txt"
    other.write_text("\n".join(map(" ".join, late)) + "\n", encoding="utf-8")
    lines = shown(truth.name, estimate.name, other.name, cwd=tmp_path)
    text = "\n".join(lines)
    assert "likely cause: " in text
    assert "Compared, each with each" in text
    wide = [line for line in lines if len(line) > _COLUMNS]
    # One word, such as an extrinsic, may be as long as it is.
    assert [line for line in wide if not re.fullmatch(r" *\S+", line)] == []
