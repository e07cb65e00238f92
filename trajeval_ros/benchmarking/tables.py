# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables as Markdown, LaTeX (booktabs) and HTML."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trajeval_ros.benchmarking.noise import Figure
from trajeval_ros.benchmarking.table import Cell, Line, Table

CAPTION = (
    "Median over runs, first to third quartile in brackets; over several sequences their geometric"
    " mean. A failed run is worse than any other. Bold: better than the second by more than noise"
    " (rank tests over runs, within sequences; 5 %, Holm's correction over a table's figures)."
)
_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:80rem;padding:0 1rem}"
    "table{border-collapse:collapse;margin:1rem 0}"
    "th,td{padding:.25rem .75rem;text-align:right;border-bottom:1px solid #ddd}"
    "th:first-child,td:first-child{text-align:left}small{color:#666}"
)


def write(folder: Path, made: Sequence[Table]) -> list[Path]:
    """Write ``tables.md``, ``tables.tex`` and ``tables.html``; return where they are."""
    texts = {"md": markdown(made), "tex": latex(made), "html": page(made)}
    paths = []
    for ending, text in texts.items():
        path = folder / f"tables.{ending}"
        path.write_text(text, encoding="utf-8")
        paths.append(path)
    return paths


def markdown(made: Sequence[Table]) -> str:
    """Every table in GitHub's Markdown."""
    parts = []
    for table in made:
        head = ["system", "runs", *(f"{f.title} [{f.unit}]" for f in table.figures)]
        body = [
            [_escaped_markdown(line.system), _counts(line), *_cells(table, line, "**", "**", "-")]
            for line in table.lines
        ]
        rows = [head, ["---", *["---:"] * (len(head) - 1)], *body]
        shown = "\n".join(f"| {' | '.join(row)} |" for row in rows)
        parts.append(f"## {_escaped_markdown(table.title)}\n\n{shown}\n")
    return "\n".join([*parts, f"{CAPTION}\n"])


def latex(made: Sequence[Table]) -> str:
    r"""Every table as a ``table`` with booktabs' rules; it needs ``\usepackage{booktabs}``."""
    parts = []
    for table in made:
        titles = [f"{_escaped_latex(f.title)} [{_latex_unit(f)}]" for f in table.figures]
        head = " & ".join(["System", "Runs", *titles])
        body = [
            " & ".join(
                [
                    _escaped_latex(line.system),
                    _counts(line),
                    *_cells(table, line, r"\textbf{", "}", "--"),
                ]
            )
            for line in table.lines
        ]
        rows = "\n".join(f"    {row} \\\\" for row in body)
        parts.append(
            "\\begin{table}\n  \\centering\n"
            f"  \\caption{{{_escaped_latex(table.title)}. {_escaped_latex(CAPTION)}}}\n"
            f"  \\begin{{tabular}}{{l{'r' * (len(table.figures) + 1)}}}\n    \\toprule\n"
            f"    {head} \\\\\n    \\midrule\n{rows}\n    \\bottomrule\n"
            "  \\end{tabular}\n\\end{table}\n"
        )
    return "\n".join(["% \\usepackage{booktabs}", *parts])


def page(made: Sequence[Table]) -> str:
    """Every table on one page that needs nothing else."""
    parts = []
    for table in made:
        head = ["system", "runs", *(f"{f.title} [{f.unit}]" for f in table.figures)]
        rows = ["".join(f"<th>{html.escape(text)}</th>" for text in head)]
        for line in table.lines:
            cells = [html.escape(line.system), _counts(line)]
            cells += _cells(table, line, "<b>", "</b>", "&ndash;")
            rows.append("".join(f"<td>{cell}</td>" for cell in cells))
        shown = "\n".join(f"<tr>{row}</tr>" for row in rows)
        parts.append(f"<h2>{html.escape(table.title)}</h2>\n<table>\n{shown}\n</table>")
    body = "\n".join([*parts, f"<p><small>{html.escape(CAPTION)}</small></p>"])
    return (
        '<!doctype html>\n<html lang="en">\n<head><meta charset="utf-8"><title>Benchmark</title>'
        f"<style>{_STYLE}</style></head>\n<body>\n<h1>Benchmark</h1>\n{body}\n</body>\n</html>\n"
    )


def _counts(line: Line) -> str:
    """How many of how many were evaluated."""
    lost = f" (+{line.lost} lost)" if line.lost else ""
    return f"{line.evaluated}/{line.runs}{lost}"


def _cells(table: Table, line: Line, begin: str, end: str, none: str) -> list[str]:
    return [
        _shown(figure, cell, begin, end, none)
        for figure, cell in zip(table.figures, line.cells, strict=True)
    ]


def _shown(figure: Figure, cell: Cell, begin: str, end: str, none: str) -> str:
    if cell.median is None or cell.lower is None or cell.upper is None:
        return none
    median = number(cell.median * figure.factor)
    if cell.best:
        median = f"{begin}{median}{end}"
    if cell.lower == cell.upper:
        return median
    return (
        f"{median} ({number(cell.lower * figure.factor)} to {number(cell.upper * figure.factor)})"
    )


def number(value: float) -> str:
    """Four digits; an infinite error is that of a run that failed."""
    if not np.isfinite(value):
        return "failed"
    shown = f"{value:.4g}"
    return (
        f"{value:.3e}"
        if "e" in shown and abs(value) < 1
        else (f"{value:.0f}" if "e" in shown else shown)
    )


def _escaped_markdown(text: str) -> str:
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>|#" else c for c in text)


_LATEX = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    **{"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"},
}


def _escaped_latex(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)


def _latex_unit(figure: Figure) -> str:
    return _escaped_latex(figure.unit).replace("sqrt(s)", r"$\sqrt{\mathrm{s}}$")
