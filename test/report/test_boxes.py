# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The boxes over sub-trajectories, in a report that a command has written."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands import evaluate

TITLE = "<h2>Over sub-trajectories</h2>"


def written(folder: Path, speed: float) -> tuple[str, list[dict[str, float]]]:
    """The page and the boxes of a run of half a minute."""
    pytest.importorskip("matplotlib", reason="the extra report")
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 30.0, 0.05)
    poses = se3.exp(np.stack([speed * t, *np.zeros((4, len(t))), 0.02 * speed * t], axis=1))
    for name, std in (("gt", 0.002), ("est", 0.02)):
        noise = se3.exp(std * rng.normal(size=(len(t), 6)) * [1, 1, 1, 0.1, 0.1, 0.1])
        rows = np.column_stack((t, *se3.to_position_quaternion(poses @ noise)))
        np.savetxt(folder / f"{name}.txt", rows, fmt="%.12g")
    files = [str(folder / "gt.txt"), str(folder / "est.txt"), "--output", str(folder)]
    assert evaluate.main(["tum", *files]) == 0
    summary = json.loads((folder / "summary.json").read_text())
    return (folder / "report.html").read_text(), summary["drift"]["sub_trajectories"]


def test_a_box_for_each_length(tmp_path: Path) -> None:
    page, boxes = written(tmp_path, 10.0)
    section = page[page.index(TITLE) :]
    picture = section[: section.index("</svg>")]
    assert len(boxes) == 5
    for box in boxes:
        assert re.search(rf">\s*{box['length']:.3g}\s*<", picture), box["length"]
    assert "Translation error in metres" in picture
    assert "Drift over 100 m" in page
    assert "Drift over 300 m" not in page


def test_none_where_nothing_moves(tmp_path: Path) -> None:
    page, boxes = written(tmp_path, 0.0)
    assert boxes == []
    assert TITLE not in page
    assert "Drift over 100 m" not in page
