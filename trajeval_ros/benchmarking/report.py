# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of a benchmark: one HTML file that needs nothing else."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from trajeval_ros.benchmarking import charts
from trajeval_ros.benchmarking.errors import Band, Errors, band
from trajeval_ros.benchmarking.figures import FIGURES, Figure, Runs, costs, values
from trajeval_ros.benchmarking.gate import Verdict
from trajeval_ros.benchmarking.grids import heading, number, of_figure, summary
from trajeval_ros.benchmarking.table import Cell, Comparison
from trajeval_ros.benchmarking.tables import element
from trajeval_ros.benchmarking.work import FAILED, LOST, OK, Row, cell
from trajeval_ros.online.parameters import PARAMETERS

REPORT = "report.html"
_STYLE = Path(__file__).with_name("report.css")
# Of more sequences than this there are no pictures, and of more runs that failed no lines.
_MOST_PICTURES = 24
_MOST_LINES = 100
# Whose errors the first sentence says.
_MOST_SAID = 5
# Ten times the best error has the full colour; a tenth of it is as strong as can be read through.
_STRONGEST = 0.8

_HEAT = (
    "Medians over runs; a cell is the darker the further it is from the best on its sequence: ten"
    " times the error, or the largest distance there is, has the full colour."
)
_BOXES = (
    "Every run a dot; the box holds the middle half of them and the line in it is the median;"
    " whiskers reach to the last run within one and a half times the box."
)
_BANDS = (
    "The line is the median over runs at each moment, the band their middle half, of position"
    " errors under each run's own alignment (RMS in 200 bins). Where fewer than half of the runs"
    " have a pose there is neither."
)
_SHARES = "How many of a system's runs{where} have an error of at most this."
_ENDS = " A curve ends below 100 % by the share of runs that failed."
_RANKS = (
    "A bar is as wide as the critical difference (Nemenyi, 5 %): systems whose bars do not overlap"
    " are told apart."
)


@dataclass(frozen=True)
class Benchmark:
    """What a report shows: the rows, how they compare, errors over time, the gate's findings.

    ``errors`` gives those of the runs of some keys, as far as there are any.
    """

    rows: Sequence[Row]
    comparison: Comparison
    errors: Callable[[Sequence[str]], Sequence[Errors]]
    verdict: Verdict | None = None

    @cached_property
    def groups(self) -> dict[tuple[str, str], list[Row]]:
        """The rows by system and sequence."""
        found: dict[tuple[str, str], list[Row]] = {}
        for row in self.rows:
            found.setdefault((str(row["system"]), str(row["sequence"])), []).append(row)
        return found


def page(benchmark: Benchmark) -> str:
    """Return ``report.html``."""
    comparison = benchmark.comparison
    whole = "Over all" if len(comparison.each) > 1 else html.escape(comparison.over_all.title)
    sections = [
        (whole, "".join(_over_all(benchmark))),
        ("Each sequence", _tabs(benchmark)),
        ("Errors over time", _over_time(benchmark)),
        ("All runs", _all_runs(benchmark)),
        ("Against the baseline", _against(benchmark.verdict)),
        ("Runs without figures", _failures(benchmark.rows)),
        ("Made with", _origin(benchmark.rows)),
    ]
    body = "\n".join(
        f"<section><h2>{title}</h2>\n{content}</section>" for title, content in sections if content
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Benchmark</title><style>{_STYLE.read_text(encoding='utf-8')}"
        f"{_tab_style(len(comparison.over_all.figures))}</style></head>\n<body>\n"
        f"<h1>Benchmark</h1>\n{_head(benchmark)}\n{body}\n"
        "<footer>trajeval_ros</footer>\n</body></html>\n"
    )


def _head(benchmark: Benchmark) -> str:
    comparison, rows = benchmark.comparison, benchmark.rows
    counts = {status: sum(row["status"] == status for row in rows) for status in (OK, FAILED, LOST)}
    parts = [f"{counts[OK]:,} evaluated"]
    parts += [f"{counts[FAILED]:,} failed"] if counts[FAILED] else []
    parts += [f"{counts[LOST]:,} lost with their worker"] if counts[LOST] else []
    legend = "".join(
        f'<li class="{charts.colour(place)}"><i></i>{html.escape(name)}</li>'
        for place, name in enumerate(comparison.systems)
    )
    said = "".join(
        f"<li{' class=bad' if bad else ''}>{text}</li>" for bad, text in _says(benchmark)
    )
    return (
        f"<p class=sub>{_several(len(comparison.systems), 'system')} on"
        f" {_several(len(comparison.each), 'sequence')}, {_several(len(rows), 'run')}:"
        f" {', '.join(parts)}</p>\n<ul class=legend>{legend}</ul>\n<ul class=says>{said}</ul>"
    )


def _says(benchmark: Benchmark) -> Iterator[tuple[bool, str]]:
    """What there is to know first, and whether it is bad."""
    comparison = benchmark.comparison
    table = comparison.over_all
    if not any(counts.evaluated for counts in table.counts):
        first = benchmark.rows[0]
        name = "/".join(str(first[part]) for part in ("system", "sequence", "run"))
        why = html.escape(f"{name}: {first['error']}")
        yield True, f"No run could be evaluated. The first, {why}."
    yield from ((False, line) for line in _errors(comparison))
    for place, system in enumerate(comparison.systems):
        best = [
            f.title
            for f, cells in zip(table.figures, table.cells, strict=True)
            if cells[place].best
        ]
        if best:
            where = f" over {len(table.sequences)} sequences" if len(table.sequences) > 1 else ""
            yield (
                False,
                f"<b>{html.escape(system)}</b> is best{where}, beyond noise, in {_listed(best)}.",
            )
    none = not any(one.best for cells in table.cells for one in cells)
    if none and table.cells and len(comparison.systems) > 1:
        yield False, "No system is best in any figure beyond noise."
    yield from ((False, line) for line in _each_best(comparison))
    failed = [
        f"<b>{html.escape(system)}</b> {counts.failed} of {counts.evaluated + counts.failed}"
        if counts.evaluated or counts.failed == 1
        else f"<b>{html.escape(system)}</b> all {counts.failed}"
        for system, counts in zip(comparison.systems, table.counts, strict=True)
        if counts.failed
    ]
    if failed:
        yield True, f"Runs that failed: {', '.join(failed)}."
    verdict = benchmark.verdict
    if verdict is not None:
        worse = [change for change in verdict.changes if change.worse]
        if not verdict.regressed:
            yield False, "Nothing is worse than in the baseline, beyond noise."
        for system in sorted({change.system for change in worse}):
            figures = [change.figure.title for change in worse if change.system == system]
            yield (
                True,
                f"<b>{html.escape(system)}</b> is worse than the baseline in {_listed(figures)}.",
            )
        for system, sequence in verdict.missing:
            yield (
                True,
                (f"<b>{html.escape(system)}</b> has no run on {html.escape(sequence)} any more."),
            )


def _errors(comparison: Comparison) -> Iterator[str]:
    """How large the systems' ATE is, the smallest first; only of those that can be compared."""
    table, ate = comparison.over_all, FIGURES[0]
    known = [
        (one.median, place)
        for place, one in enumerate(table.of(ate))
        if one.whole and one.median is not None and np.isfinite(one.median)
    ]
    if not known:
        return
    shown = [
        f"<b>{html.escape(comparison.systems[place])}</b> {number(median * ate.factor)} {ate.unit}"
        for median, place in sorted(known)[:_MOST_SAID]
    ]
    many = len(table.sequences) > 1
    over = f", geometric mean over {len(table.sequences)} sequences" if many else ""
    first = f" of the best {_MOST_SAID} systems" if len(known) > _MOST_SAID else ""
    yield f"ATE{first}, median over runs{over}: {', '.join(shown)}."


def _each_best(comparison: Comparison) -> Iterator[str]:
    """On how many sequences a system has the best ATE, beyond noise."""
    if len(comparison.each) < 2:
        return
    ate = FIGURES[0]
    for place, system in enumerate(comparison.systems):
        best = sum(table.of(ate)[place].best for table in comparison.each)
        if best:
            sequences = _several(len(comparison.each), "sequence")
            yield (
                f"<b>{html.escape(system)}</b> has the best ATE, beyond noise, on {best} of"
                f" {sequences}."
            )


def _over_all(benchmark: Benchmark) -> Iterator[str]:
    for grid in summary(benchmark.comparison):
        if grid.title != benchmark.comparison.over_all.title:
            yield f"<h3>{html.escape(grid.title)}</h3>"
        yield _scrolled(element(grid))
    chosen = [
        one
        for one in benchmark.comparison.rankings
        if one.figure in (FIGURES[0], FIGURES[2]) or one.best is not None
    ][:6]
    pictures = [
        charts.ranks(one.figure.title, one.ranks, one.systems, benchmark.comparison.systems)
        for one in chosen
    ]
    if pictures:
        yield _pictures(pictures, _RANKS)


def _tab_style(count: int) -> str:
    """Which panel is shown: that of the figure that is chosen, without a script."""
    return (
        ",".join(f"#f{k}:checked~.p{k}" for k in range(count)) + "{display:block}" if count else ""
    )


def _tabs(benchmark: Benchmark) -> str:
    """A panel for each figure: heat map, boxes, table."""
    figures = benchmark.comparison.over_all.figures
    labels = "".join(
        f'<input type="radio" name="figure" id="f{k}"{" checked" if k == 0 else ""}>'
        f'<label for="f{k}">{html.escape(figure.title)}</label>'
        for k, figure in enumerate(figures)
    )
    panels = "".join(
        f'<div class="panel p{k}">{_panel(benchmark, figure)}</div>'
        for k, figure in enumerate(figures)
    )
    return f"<div class=tabs>{labels}{panels}</div>" if figures else ""


def _panel(benchmark: Benchmark, figure: Figure) -> str:
    comparison = benchmark.comparison
    parts = [f"<h3>{html.escape(heading(figure))}</h3>"]
    if len(comparison.each) > 1:
        parts.append(_scrolled(_heat_map(comparison, figure)) + f"<p class=note>{_HEAT}</p>")
    if len(comparison.each) <= _MOST_PICTURES:
        pictures = []
        for table in comparison.each:
            found = _by_system(benchmark, figure, table.sequences)
            if found:
                pictures.append(charts.boxes(table.title, figure, found, comparison.systems))
        if pictures:
            parts.append(_pictures(pictures, _BOXES))
    if len(comparison.each) > 1:
        parts.append(_scrolled(element(of_figure(comparison, figure))))
    return "".join(parts)


def _by_system(benchmark: Benchmark, figure: Figure, sequences: Sequence[str]) -> dict[int, Runs]:
    """The runs of each system that has any, by its place."""
    found = {}
    for place, system in enumerate(benchmark.comparison.systems):
        rows = [row for name in sequences for row in benchmark.groups.get((system, name), ())]
        if len(of_runs := values(rows, figure)):
            found[place] = of_runs
    return found


def _heat_map(comparison: Comparison, figure: Figure) -> str:
    tables = (*comparison.each, comparison.over_all)
    head = "".join(
        f"<th{' class=sum' if table is comparison.over_all else ''}>{_breakable(table.title)}</th>"
        for table in tables
    )
    shades = [_shades(table.of(figure), figure) for table in tables]
    rows = []
    for place, system in enumerate(comparison.systems):
        cells = [
            _heat_cell(figure, table.of(figure)[place], shade[place], table is comparison.over_all)
            for table, shade in zip(tables, shades, strict=True)
        ]
        rows.append(f"<tr><th>{html.escape(system)}</th>{''.join(cells)}</tr>")
    return (
        f"<table class=heat><thead><tr><th></th>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _heat_cell(figure: Figure, shown: Cell, shade: float, is_sum: bool) -> str:
    kinds = ["sum"] if is_sum else []
    if shown.median is None:
        return f'<td class="{" ".join(kinds)}">–</td>'
    text = number(shown.median * figure.factor)
    kinds += ["failed"] if text == "failed" else []
    text = f"<b>{text}</b>" if shown.best else text
    return f'<td class="{" ".join(kinds)}" style="--h:{_STRONGEST * shade:.2f}">{text}</td>'


def _shades(cells: Sequence[Cell], figure: Figure) -> list[float]:
    """From 0, the best on a sequence, to 1; of errors the ratio counts, of others the distance."""
    found = np.array([np.nan if one.median is None else one.median for one in cells])
    cost = costs(found, figure)
    finite = np.isfinite(cost)
    if not finite.any():
        return [0.0] * len(cells)
    far = cost - cost[finite].min()
    full = np.log(10.0) if figure.ratios else max(float(far[finite].max()), 1e-9)
    return [float(np.clip(np.nan_to_num(one, posinf=full), 0.0, full) / full) for one in far]


def _over_time(benchmark: Benchmark) -> str:
    comparison = benchmark.comparison
    if len(comparison.each) > _MOST_PICTURES:
        return f"<p class=note>No pictures, of more than {_MOST_PICTURES} sequences.</p>"
    pictures = []
    for table in comparison.each:
        found: dict[int, Band] = {}
        for place, system in enumerate(comparison.systems):
            group = benchmark.groups.get((system, table.sequences[0]), ())
            keys = [str(row["key"]) for row in group if row["status"] in (OK, FAILED)]
            of_runs = band(benchmark.errors(keys), len(keys))
            if of_runs is not None:
                found[place] = of_runs
        if found:
            pictures.append(charts.bands(table.title, found, comparison.systems))
    return _pictures(pictures, _BANDS, "grid wide") if pictures else ""


def _all_runs(benchmark: Benchmark) -> str:
    ate, comparison = FIGURES[0], benchmark.comparison
    runs = _by_system(benchmark, ate, comparison.over_all.sequences)
    picture = charts.shares(ate, runs, comparison.systems)
    if not picture:
        return ""
    where = ", on all sequences together," if len(comparison.each) > 1 else ""
    ends = _ENDS if any(row["status"] == FAILED for row in benchmark.rows) else ""
    caption = _SHARES.format(where=where) + ends
    return f"<figure class=whole>{picture}<figcaption>{caption}</figcaption></figure>"


def _against(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    rows = []
    for change in sorted(verdict.changes, key=lambda one: one.p_value):
        figure = change.figure
        cells = [
            html.escape(change.system),
            html.escape(heading(figure)),
            number(change.now * figure.factor),
            number(change.before * figure.factor),
            html.escape(change.difference),
            f"{change.p_value:.2g}",
            "worse" if change.worse else "",
        ]
        kind = " class=worse" if change.worse else ""
        rows.append(f"<tr{kind}>{''.join(f'<td>{text}</td>' for text in cells)}</tr>")
    head = "".join(f"<th>{name}</th>" for name in ("system", "figure", "now", "was", "", "p", ""))
    note = (
        "Means over the sequences that both have, of medians over runs. p: of its being no worse,"
        " one-sided, Holm's correction over all lines."
    )
    table = (
        f"<table class=gate><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )
    return _scrolled(table) + f"<p class=note>{note}</p>"


def _failures(rows: Sequence[Row]) -> str:
    bad = [row for row in rows if row["status"] != OK]
    if not bad:
        return ""
    names = ("system", "sequence", "run", "status", "error")
    head = "".join(f"<th>{name}</th>" for name in names)
    lines = "".join(
        f"<tr>{''.join(f'<td>{html.escape(str(row[name]))}</td>' for name in names)}</tr>"
        for row in bad[:_MOST_LINES]
    )
    table = f"<table class=words><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>"
    more = len(bad) - _MOST_LINES
    rest = f"<p class=note>And {more:,} more, in results.csv.</p>" if more > 0 else ""
    return _scrolled(table) + rest


def _origin(rows: Sequence[Row]) -> str:
    """Versions, parameters that are not at their defaults, and what the ground truths were."""
    lines = [
        (name, ", ".join(sorted({str(row[column]) for row in rows if row.get(column)})))
        for name, column in (
            *(("trajeval_ros", "version"), ("Python", "python")),
            *(("NumPy", "numpy"), ("SciPy", "scipy")),
        )
    ]
    lines += _changed(rows)
    hashes = {
        str(row["sequence"]): str(row["ground_truth_sha256"])
        for row in rows
        if row.get("ground_truth_sha256")
    }
    lines += [(f"{name}: ground truth, sha256", value) for name, value in sorted(hashes.items())]
    body = "".join(
        f"<tr><td>{html.escape(name)}</td><td><code>{html.escape(value)}</code></td></tr>"
        for name, value in lines
    )
    return f"<table class=words><tbody>{body}</tbody></table>"


def _changed(rows: Sequence[Row]) -> list[tuple[str, str]]:
    found: dict[str, dict[str, set[str]]] = {}
    sequences = {str(row["sequence"]) for row in rows}
    for row in rows:
        for name, parameter in PARAMETERS.items():
            value = row.get(f"parameters.{name}")
            if value is not None and value != cell(parameter.default):
                text = f"{value:g}" if isinstance(value, float) else str(value)
                found.setdefault(name, {}).setdefault(text, set()).add(str(row["sequence"]))
    return [
        (name, value if where == sequences else f"{value} ({', '.join(sorted(where))})")
        for name, by_value in sorted(found.items())
        for value, where in sorted(by_value.items())
    ]


def _listed(words: Sequence[str]) -> str:
    return html.escape(", ".join(words))


def _breakable(name: str) -> str:
    """A name that may go over several lines at its underscores."""
    return html.escape(name).replace("_", "_<wbr>")


def _several(count: int, what: str) -> str:
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def _scrolled(table: str) -> str:
    return f"<div class=scroll>{table}</div>"


def _pictures(pictures: Iterable[str], caption: str, kind: str = "grid") -> str:
    shown = "".join(f"<figure>{picture}</figure>" for picture in pictures)
    return f'<div class="{kind}">{shown}</div><p class=note>{caption}</p>'
