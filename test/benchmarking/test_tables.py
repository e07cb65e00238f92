# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Best is bold only beyond noise, what is missing is said, and every format is well formed."""

from __future__ import annotations

import html.parser
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from benchmarking.conftest import SEQUENCES, made_rows

from trajeval_ros.benchmarking import tables
from trajeval_ros.benchmarking.figures import FIGURES
from trajeval_ros.benchmarking.grids import Grid, grids, number, summary
from trajeval_ros.benchmarking.table import compare
from trajeval_ros.benchmarking.work import FAILED, LOST, Row


def bold(grid: Grid) -> set[str]:
    """The systems of which anything is bold."""
    return {
        name
        for _, entries in grid.rows
        for name, entry in zip(grid.columns, entries, strict=True)
        if entry.bold
    }


def texts(grid: Grid, system: str) -> dict[str, str]:
    column = grid.columns.index(system)
    return {name: entries[column].text for name, entries in grid.rows}


def replaced(
    rows: list[Row], chosen: dict[str, str | None], **columns: str | float | None
) -> list[Row]:
    """The rows, those of the ``chosen`` system, sequence or run with other columns."""
    return [
        {**row, **columns} if all(row[name] == value for name, value in chosen.items()) else row
        for row in rows
    ]


def test_best_is_bold_only_beyond_noise() -> None:
    assert bold(summary(compare(made_rows(1, larger=1.3)))[0]) == {"orb_slam"}
    few = [row for row in made_rows(1) if row["run"] in "012"]
    (whole, *_) = summary(compare(few))
    assert bold(whole) == set()
    assert "Nothing is bold: no difference is beyond noise." in whole.notes


def test_a_caption_speaks_of_what_there_is() -> None:
    rows = made_rows(1, larger=1.3)
    (whole, *_) = summary(compare(replaced(rows, {"system": "vins", "run": "3"}, status=FAILED)))
    assert all(word in whole.notes[0] for word in ("several sequences", "A failed run", "Bold:"))
    alone = [row for row in rows if (row["system"], row["sequence"]) == ("vins", "hall")]
    (whole,) = summary(compare(alone))
    assert whole.notes == ("Median over runs, with the first and third quartile in brackets.",)
    (whole,) = summary(compare(alone[:1]))
    assert whole.notes == ("One run of each: how much runs differ is not known.",)


def test_failures_are_counted_in() -> None:
    rows = [
        {**row, "status": FAILED} if row["system"] == "vins" and row["run"] != "0" else row
        for row in made_rows(1)
    ]
    whole = texts(summary(compare(rows))[0], "vins")
    assert whole["Runs evaluated"] == "3/30"
    assert whole["ATE (m)"] == whole["Error model (nats/pose)"] == "failed"
    assert whole["Coverage (%)"] == "0.00"
    # One sequence in a hundred pieces, and the others whole: over all it is a failure.
    one = replaced(made_rows(1), {"system": "vins", "sequence": "hall"}, status=FAILED)
    assert texts(summary(compare(one))[0], "vins")["ATE (m)"] == "failed"


def test_with_one_run_of_each_nothing_is_bold_and_it_is_said() -> None:
    rows = [row for row in made_rows(1, larger=9.0) if row["run"] == "0"]
    whole, ranks, *_ = grids(compare(rows))
    assert bold(whole) == bold(ranks) == set()
    assert not any(entry.spread for _, entries in whole.rows for entry in entries)
    assert any(note.startswith("One run of each") for note in whole.notes)
    assert any("with so few runs" in note for note in whole.notes)


def test_where_all_fail_there_is_no_figure_and_it_is_said() -> None:
    rows = [
        {k: row[k] for k in ("system", "sequence", "run")} | {"status": FAILED}
        for row in made_rows(1)
    ]
    whole, *rest = grids(compare(rows))
    assert [name for name, _ in whole.rows] == ["Runs evaluated"]
    assert whole.notes == ("No run could be evaluated.",)
    assert [grid.title for grid in rest] == ["Runs evaluated"]


def test_systems_that_tie_exactly_share_their_ranks() -> None:
    vins = [row for row in made_rows(1) if row["system"] == "vins"]
    rows = vins + [{**row, "system": "orb_slam"} for row in vins]
    whole, ranks, *_ = grids(compare(rows))
    assert bold(whole) == bold(ranks) == set()
    for _, entries in ranks.rows:
        assert [entry.text for entry in entries[:2]] == ["1.50", "1.50"]
        assert entries[-1].text == "1"


def test_one_sequence_has_one_table_and_no_ranks() -> None:
    rows = [row for row in made_rows(1) if row["sequence"] == "hall"]
    (only,) = grids(compare(rows))
    assert only.title == "hall"
    assert only.columns == ("orb_slam", "vins")


def test_what_a_system_lacks_is_marked_and_compared_with_nothing() -> None:
    rows = made_rows(1, larger=9.0)
    ate = FIGURES[0].column
    lacking = replaced(rows, {"system": "orb_slam", "sequence": "hall", "run": "3"}, **{ate: None})
    whole, ranks, *_ = grids(compare(lacking))
    assert texts(whole, "orb_slam")["ATE (m)"].endswith("†")
    assert any(note.startswith("†") for note in whole.notes)
    entries = dict(whole.rows)["ATE (m)"]
    assert not any(entry.bold for entry in entries)
    assert any(entry.bold for entry in dict(whole.rows)["RE (m)"])
    assert "ATE" not in dict(ranks.rows)
    # A sequence that it was not run on is lacking as well; a run that was lost is not.
    absent = [r for r in rows if (r["system"], r["sequence"]) != ("orb_slam", "hall")]
    assert texts(summary(compare(absent))[0], "orb_slam")["ATE (m)"].endswith("†")
    lost = replaced(rows, {"system": "orb_slam", "sequence": "hall", "run": "3"}, status=LOST)
    whole = summary(compare(lost))[0]
    assert texts(whole, "orb_slam")["Runs evaluated"] == "29/29 (+1 lost)"
    assert dict(whole.rows)["ATE (m)"][0].bold


def test_the_medians_are_those_of_the_runs() -> None:
    rows = made_rows(4)
    comparison = compare(rows)
    ate = FIGURES[0]
    medians = []
    for place, sequence in enumerate(SEQUENCES):
        own = [
            float(str(row[ate.column]))
            for row in rows
            if row["system"] == "vins" and row["sequence"] == sequence
        ]
        cell = comparison.each[place].of(ate)[1]
        assert [cell.lower, cell.median, cell.upper] == pytest.approx(
            np.quantile(own, [0.25, 0.5, 0.75]).tolist()
        )
        medians.append(np.median(own))
    assert comparison.over_all.of(ate)[1].median == pytest.approx(np.prod(medians) ** (1 / 3))
    nats = next(figure for figure in FIGURES if figure.title == "Error model")
    assert comparison.over_all.of(nats)[1].median == pytest.approx(
        np.mean([table.of(nats)[1].median for table in comparison.each])
    )


@pytest.mark.parametrize(
    ("value", "like", "text"),
    [
        *((0.0213456, None, "0.0213"), (12.3456, None, "12.3"), (99.97, None, "100.0")),
        *((1234567.0, None, "1234567"), (0.0, None, "0.00"), (3e-8, None, "3.00e-08")),
        *((np.inf, None, "failed"), (-np.inf, None, "failed"), (-31.987, None, "-32.0")),
        *((0.2, 0.0213, "0.2000"), (1.0, np.inf, "1.00")),
    ],
)
def test_numbers_have_three_digits(value: float, like: float | None, text: str) -> None:
    assert number(value, like) == text


class _Balance(html.parser.HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[int] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        del attrs
        if tag == "meta":
            return
        self.open.append(tag)
        if tag == "tr":
            self.cells.append(0)
        self.cells[-1:] = [n + (tag in ("td", "th")) for n in self.cells[-1:]]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


NAMES = {"vins": "vins_mono & co. 100 % #1", "orb_slam": "[orb] ~^\\{}<b>|*"}
"""What names may have in them, and each format takes for something else."""


def awkward(seed: int) -> list[Row]:
    return [
        {**row, "system": NAMES[str(row["system"])], "sequence": f"[{row['sequence']}]_é"}
        for row in made_rows(seed, larger=1.3)
    ]


def test_tables_are_well_formed(tmp_path: Path) -> None:
    made = grids(compare(awkward(3)))
    paths = {path.suffix: path.read_text() for path in tables.write(tmp_path, made)}
    widths = [1 + len(grid.columns) for grid in made]
    blocks = re.findall(r"\\begin\{tabular\}.*?\\end\{tabular\}", paths[".tex"], re.S)
    for block, columns in zip(blocks, widths, strict=True):
        rows = re.findall(r"^    (.*) \\\\$", block, re.M)
        assert {len(re.split(r"(?<!\\)&", row)) for row in rows} == {columns}
        assert all(rule in block for rule in (r"\toprule", r"\midrule", r"\bottomrule"))
    assert re.findall(r"(?<!\\)[%_#]", paths[".tex"].split("\n", 1)[1]) == []
    parser = _Balance()
    parser.feed(paths[".html"])
    assert parser.open == []
    assert parser.cells == [
        w for grid, w in zip(made, widths, strict=True) for _ in (0, *grid.rows)
    ]
    shown = [line for line in paths[".md"].splitlines() if line.startswith("|")]
    counts = [len(re.split(r"(?<!\\)\|", line)) - 2 for line in shown]
    assert counts == [w for grid, w in zip(made, widths, strict=True) for _ in (0, 0, *grid.rows)]


def five_systems() -> list[Row]:
    names = ("VINS-Mono", "VINS-Fusion", "ORB-SLAM3", "OpenVINS", "Kimera")
    return [
        {**row, "system": name}
        for seed, name in enumerate(names)
        for row in made_rows(seed, larger=1.0 + 0.2 * seed)
        if row["system"] == "vins"
    ]


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="there is no LaTeX here")
@pytest.mark.parametrize("systems", ["of awkward names", "five"])
def test_latex_compiles(tmp_path: Path, systems: str) -> None:
    rows = awkward(3) if systems == "of awkward names" else five_systems()
    tables.write(tmp_path, grids(compare(rows)))
    (tmp_path / "paper.tex").write_text(
        r"\documentclass[twocolumn]{article}\usepackage[utf8]{inputenc}\usepackage{booktabs}"
        # As wide as the pages of most conferences.
        r"\setlength{\textwidth}{7.1in}"
        r"\begin{document}\input{tables.tex}\end{document}"
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert systems != "five" or "Overfull" not in done.stdout
