# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How errors grow with the length, in a report that a command has written."""

import re
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands import evaluate


def written(folder: Path, speed: float) -> str:
    """The page of a run of half a minute."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 30.0, 0.05)
    poses = se3.exp(np.stack([speed * t, *np.zeros((4, len(t))), 0.02 * speed * t], axis=1))
    for name, std in (("gt", 0.002), ("est", 0.02)):
        noise = se3.exp(std * rng.normal(size=(len(t), 6)) * [1, 1, 1, 0.1, 0.1, 0.1])
        rows = np.column_stack((t, *se3.to_position_quaternion(poses @ noise)))
        np.savetxt(folder / f"{name}.txt", rows, fmt="%.12g")
    files = [str(folder / "gt.txt"), str(folder / "est.txt"), "--output", str(folder)]
    assert evaluate.main(["tum", *files]) == 0
    return (folder / "report.html").read_text(encoding="utf-8")


def pictures(page: str) -> list[str]:
    """The drawings of the section on the kind of error."""
    section = page[page.index("<h2>What kind of error</h2>") :]
    return re.findall(r"<svg.*?</svg>", section[: section.index("</section>")])


def test_a_box_for_each_length(tmp_path: Path) -> None:
    page = written(tmp_path, 10.0)
    drawn = [picture for picture in pictures(page) if "sub-trajectory" in picture]
    assert len(drawn) == 4
    for picture, title in zip(drawn, ("Translation, m", "Rotation, °") * 2, strict=True):
        assert f">{title}</text>" in picture
        assert picture.count("<rect") >= 5
    assert re.findall(r" over (\d+(?:\.\d+)?)[,\"]", drawn[0])[-4:] == ["1", "2", "5", "10"]
    assert re.findall(r" over (\d+(?:\.\d+)?)[,\"]", drawn[2])[-4:] == ["10", "20", "50", "100"]
    assert "Drift over 100 m" in page
    assert "Drift over 300 m" not in page
    # White noise of orientations is as large over any length.
    medians = [float(size) for size in re.findall(r"([\d.]+) ° over", drawn[1])]
    assert max(medians) < 1.3 * min(medians)


def test_no_path_where_nothing_moves(tmp_path: Path) -> None:
    page = written(tmp_path, 0.0)
    assert "sub-trajectory, s" in "".join(pictures(page))
    assert "m of path" not in "".join(pictures(page))
    assert "Drift over 100 m" not in page


def test_what_is_printed_needs_none_of_it(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    written(tmp_path, 10.0)
    told = capsys.readouterr().out
    files = [str(tmp_path / "gt.txt"), str(tmp_path / "est.txt")]
    assert evaluate.main(["tum", *files]) == 0
    printed = capsys.readouterr().out.strip()
    assert len(printed.splitlines()) > 20
    assert told.startswith(printed)
