# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate --figures``: the files of a paper, and the numbers that are drawn."""

import json
import os
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_evaluate import evaluate

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

FIGURES = ("error", "relative_error", "trajectory")


def names_of(figures: tuple[str, ...]) -> list[str]:
    return sorted(
        f"{figure}_{width}.{kind}"
        for figure in figures
        for width in ("single", "double")
        for kind in ("pdf", "svg")
    )


@pytest.fixture(scope="module")
def one(paths: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one")
    (folder / "figures").mkdir()
    (folder / "figures" / ".error_single.pdf.123.partial").touch()  # a killed run has left it
    result = evaluate("tum", *paths, "--output", folder, "--figures", folder / "figures")
    assert result.returncode == 0, result.stderr
    assert f"Written: 12 files in {folder / 'figures'}" in result.stdout
    return folder


def streams(pdf: bytes) -> bytes:
    """The PDF with what is in its compressed streams."""
    found = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL)
    unpacked = []
    for stream in found:
        try:
            unpacked.append(zlib.decompress(stream))
        except zlib.error:
            unpacked.append(stream)
    return pdf + b"".join(unpacked)


def test_the_files(one: Path) -> None:
    assert sorted(os.listdir(one / "figures")) == names_of(FIGURES)


def test_fonts_are_of_type_42(one: Path) -> None:
    for path in (one / "figures").glob("*.pdf"):
        text = streams(path.read_bytes())
        assert b"/Type3" not in text, path.name
        assert b"/TrueType" in text or b"/CIDFontType2" in text, path.name


def test_text_stays_text_and_widths_are_those_of_columns(one: Path) -> None:
    for path in (one / "figures").glob("*.svg"):
        text = path.read_text(encoding="utf-8")
        assert "<text" in text, path.name
        points = 72.0 * (3.5 if "single" in path.name else 7.16)
        (width,) = re.findall(r'<svg [^>]*width="([0-9.]+)pt"', text)
        assert float(width) == pytest.approx(points, abs=0.01)


def test_the_same_run_gives_the_same_files(
    paths: tuple[Path, Path], one: Path, tmp_path: Path
) -> None:
    assert evaluate("tum", *paths, "--figures", tmp_path).returncode == 0
    # Another record's buckets may be cut elsewhere: the trajectory has none.
    name = "trajectory_single.svg"
    assert (tmp_path / name).read_bytes() == (one / "figures" / name).read_bytes()


def test_what_is_drawn_are_the_figures_of_the_summary(
    paths: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from trajeval_ros.commands import evaluate as command
    from trajeval_ros.report import paper

    drawn: list[Any] = []
    write = paper.write_figures
    monkeypatch.setattr(
        paper, "write_figures", lambda folder, each: [drawn.extend(each), write(folder, each)][1]
    )
    folder = tmp_path / "figures"
    given = ["tum", *map(str, paths), "--output", str(tmp_path), "--figures", str(folder)]
    assert command.main(given) == 0
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    conventional = summary["conventional"]
    (one,) = drawn

    def rms(values: Any) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    assert rms(one.ate[0]) == pytest.approx(conventional["ate_translation_rmse"], rel=1e-9)
    assert np.radians(rms(one.ate[1])) == pytest.approx(conventional["ate_rotation_rmse"], rel=1e-9)
    off = np.linalg.norm(one.estimate - one.ground_truth, axis=1)
    assert rms(off) == pytest.approx(conventional["ate_translation_rmse"], rel=1e-9)
    # All steps here, those that follow one another there.
    assert rms(one.re[0]) == pytest.approx(conventional["re_translation_rmse"], rel=0.3)
    assert one.re_step == "1 s"


def test_several_are_compared(paths: tuple[Path, Path], tmp_path: Path) -> None:
    truth, estimate = paths
    sparse = tmp_path / "sparse.txt"
    lines = estimate.read_text(encoding="utf-8").splitlines()
    sparse.write_text("\n".join(lines[::2]) + "\n", encoding="utf-8")
    folder = tmp_path / "figures"
    result = evaluate("tum", truth, estimate, sparse, "--figures", folder)
    assert result.returncode == 0, result.stderr
    assert sorted(os.listdir(folder)) == names_of((*FIGURES, "comparison"))
    for path in folder.glob("*.svg"):
        text = path.read_text(encoding="utf-8")
        assert ">sparse</text>" in text, path.name
        assert ">estimate</text>" in text, path.name
        # Two of Okabe and Ito's colours.
        assert "#0072b2" in text, path.name
        assert "#d55e00" in text, path.name


def test_positions_alone_have_no_rotation(paths: tuple[Path, Path], tmp_path: Path) -> None:
    truth, estimate = paths
    lines = estimate.read_text(encoding="utf-8").splitlines()
    bare = tmp_path / "bare.txt"
    rows = [" ".join(line.split()[:4]) for line in lines if not line.startswith("#")]
    bare.write_text("\n".join(rows) + "\n", encoding="utf-8")
    folder = tmp_path / "figures"
    result = evaluate("tum", truth, bare, "--figures", folder)
    assert result.returncode == 0, result.stderr
    text = (folder / "error_single.svg").read_text(encoding="utf-8")
    assert ">translation (m)</text>" in text
    assert "rotation" not in text


def test_a_folder_that_cannot_be_written_costs_the_figures_alone(
    paths: tuple[Path, Path], tmp_path: Path
) -> None:
    taken = tmp_path / "figures"
    taken.write_text("a file", encoding="utf-8")
    result = evaluate("tum", *paths, "--figures", taken)
    assert result.returncode == 1
    assert result.stderr.splitlines() == [f"evaluate: error: cannot write {taken}: File exists"]
    assert "ATE" in result.stdout
    assert taken.read_text(encoding="utf-8") == "a file"


def test_without_the_library_one_line(
    paths: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    from trajeval_ros.commands import evaluate as command
    from trajeval_ros.commands import exports

    monkeypatch.setattr(exports, "find_spec", lambda name: None)
    assert command.main(["tum", *map(str, paths), "--figures", str(tmp_path / "figures")]) == 1
    said = capsys.readouterr()
    assert said.err.splitlines() == [
        "evaluate: error: --figures: drawing needs the library matplotlib: pip install matplotlib"
    ]
    assert said.out == ""
    assert os.listdir(tmp_path) == []
