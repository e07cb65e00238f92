# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report is one page that needs nothing else, says what there is, and draws what it has."""

from __future__ import annotations

import html.parser
import re
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from benchmarking.conftest import SEQUENCES, SYSTEMS, made_rows

from trajeval_ros.benchmarking import svg
from trajeval_ros.benchmarking.errors import Errors
from trajeval_ros.benchmarking.figures import FIGURES
from trajeval_ros.benchmarking.gate import judge
from trajeval_ros.benchmarking.report import Benchmark, page
from trajeval_ros.benchmarking.table import compare
from trajeval_ros.benchmarking.work import FAILED, Row

_VOID = ("meta", "input", "wbr")


class _Page(html.parser.HTMLParser):
    """Checks that tags are balanced; keeps what is drawn and what is written."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.labels: list[str] = []
        self.links: list[str] = []
        self.words = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        values = dict(attrs)
        self.links += [str(values[name]) for name in ("src", "href") if name in values]
        if tag == "svg":
            self.labels.append(str(values["aria-label"]))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] != ["style"]:
            self.words += data


def keyed(rows: list[Row]) -> list[Row]:
    return [{**row, "key": str(place), "error": None} for place, row in enumerate(rows)]


Ask = Callable[[Sequence[str]], list[Errors]]


def errors_for(rows: list[Row]) -> Ask:
    generator = np.random.default_rng(0)
    return asked([Errors(str(r["key"]), 0.5, generator.uniform(0.0, 1.0, 200)) for r in rows])


def asked(errors: list[Errors]) -> Ask:
    return lambda keys: [one for one in errors if one.key in keys]


def test_it_is_one_page_with_every_picture() -> None:
    rows = keyed(made_rows(1, larger=1.3))
    text = page(Benchmark(rows, compare(rows), errors_for(rows), judge(rows, made_rows(2))))
    made = _Page(text)
    assert made.links == []
    assert "script" not in made.tags
    assert "http" not in text
    for sequence in SEQUENCES:
        assert f"ATE over runs, {sequence}" in made.labels
        assert f"Errors over time, {sequence}" in made.labels
    assert "Share of runs with ATE at most" in made.labels
    assert "Mean ranks by ATE" in made.labels
    assert made.tags.count("input") == len(FIGURES)
    assert "orb_slam is best over 3 sequences, beyond noise, in ATE" in made.words
    assert "vins is worse than the baseline in" in made.words
    assert "Against the baseline" in made.words


def test_without_a_baseline_there_is_no_word_of_one() -> None:
    rows = keyed(made_rows(1))
    assert "baseline" not in _Page(page(Benchmark(rows, compare(rows), asked([])))).words


def test_names_are_text() -> None:
    names = dict(zip(SYSTEMS, ("<b>vins & co", 'orb" onload="'), strict=True))
    rows = keyed(
        [{**row, "system": names[str(row["system"])], "sequence": "<i>q"} for row in made_rows(1)]
    )
    made = _Page(page(Benchmark(rows, compare(rows), errors_for(rows), judge(rows, rows))))
    assert all(name in made.words for name in names.values())
    assert "Errors over time, <i>q" in made.labels


def test_failures_are_listed_and_drawn_beside_the_boxes() -> None:
    rows = [
        {**row, "status": FAILED, "error": "no pose"} if row["run"] in ("3", "4") else row
        for row in keyed(made_rows(1))
    ]
    made = _Page(page(Benchmark(rows, compare(rows), asked([]))))
    assert "Runs that failed: orb_slam 6 of 30, vins 6 of 30" in made.words
    assert "2 failed" in made.words
    assert made.words.count("no pose") == 12
    whole = [{**row, "status": FAILED, "error": "no pose"} for row in rows]
    bare = [{k: v for k, v in row.items() if not isinstance(v, float)} for row in whole]
    said = _Page(page(Benchmark(bare, compare(bare), asked([])))).words
    first = "/".join(str(bare[0][name]) for name in ("system", "sequence", "run"))
    assert f"No run could be evaluated. The first, {first}: no pose." in said
    assert "Runs that failed: orb_slam all 30, vins all 30." in said
    assert "best" not in said
    assert "ATE, median" not in said


def test_the_first_sentence_has_each_system_s_error_the_smallest_first() -> None:
    said = _Page(page(Benchmark(rows := keyed(made_rows(1, 1.3)), compare(rows), asked([])))).words
    found = re.search(
        r"ATE, median over runs, geometric mean over 3 sequences:"
        r" orb_slam ([\d.]+) m, vins ([\d.]+) m\.",
        said,
    )
    assert found is not None
    assert float(found[2]) == pytest.approx(1.3 * float(found[1]), rel=0.1)
    many = [
        {**row, "system": f"s{n:02}", "key": f"{n} {row['key']}"}
        for n in range(8)
        for row in rows[:3]
    ]
    said = _Page(page(Benchmark(many, compare(many), asked([])))).words
    assert "ATE of the best 5 systems, median over runs: s00 " in said
    assert "s05 0." not in said


def test_one_system_on_one_sequence_is_spoken_of_as_that() -> None:
    rows = [r for r in keyed(made_rows(1)) if (r["system"], r["sequence"]) == ("vins", "hall")]
    said = _Page(page(Benchmark(rows, compare(rows), asked([])))).words
    assert "1 system on 1 sequence, 10 runs: 10 evaluated" in said
    errors = [float(str(row["conventional.ate_translation_rmse"])) for row in rows]
    assert f"ATE, median over runs: vins {np.median(errors):#.3g} m." in said
    for word in ("Over all", "Bold", "sequences", "failed", "best"):
        assert word not in said, word


@pytest.mark.parametrize(
    ("low", "high", "logarithmic"),
    [
        *((0.0, 1.0, False), (0.013, 0.0131, False), (-32.0, -28.0, False), (1.0, 4e5, False)),
        *((0.011, 0.034, True), (1.0, 4e5, True), (0.9e-6, 2e4, True)),
    ],
)
def test_ticks_are_few_and_within(low: float, high: float, logarithmic: bool) -> None:
    axis = svg.Axis(low, high, 10.0, 200.0, logarithmic)
    ticks = axis.ticks(5)
    assert 2 <= len(ticks) <= 6
    places = [axis(tick) for tick in ticks]
    assert places == sorted(set(places))
    assert low - 1e-9 <= ticks[0]
    assert ticks[-1] <= high + 1e-9 * abs(high)
    assert [axis(low), axis(high)] == pytest.approx([10.0, 200.0])


@pytest.mark.parametrize("value", [0.001, 0.0, 1e-7, 123456.0, 5e9, -28.0])
def test_a_tick_s_text_is_its_value(value: float) -> None:
    assert float(svg.shown(value)) == pytest.approx(value)
    assert len(svg.shown(value)) < 8


def test_the_pictures_have_no_number_that_is_none() -> None:
    rows = keyed(made_rows(1))
    for row in rows[::7]:
        row["status"] = FAILED
    holes = errors_for(rows)([str(row["key"]) for row in rows])
    for one in holes:
        one.values[40:90] = np.nan
    text = page(Benchmark(rows, compare(rows), asked(holes)))
    assert re.findall(r'"[^"]*\b(?:nan|inf)\b[^"]*"', text) == []
