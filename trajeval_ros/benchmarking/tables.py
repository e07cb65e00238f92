# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables as Markdown, LaTeX (booktabs) and HTML."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from pathlib import Path

from trajeval_ros.benchmarking.grids import Entry, Grid

_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:80rem;padding:0 1rem}"
    "table{border-collapse:collapse;margin:1rem 0}"
    "th,td{padding:.25rem .75rem;text-align:right;border-bottom:1px solid #ddd}"
    "th:first-child,td:first-child{text-align:left}small,.note{color:#666}"
)


def write(folder: Path, made: Sequence[Grid]) -> list[Path]:
    """Write ``tables.md``, ``tables.tex`` and ``tables.html``; return where they are."""
    texts = {"md": markdown(made), "tex": latex(made), "html": page(made)}
    paths = []
    for ending, text in texts.items():
        path = folder / f"tables.{ending}"
        path.write_text(text, encoding="utf-8")
        paths.append(path)
    return paths


def markdown(made: Iterable[Grid]) -> str:
    """Every table in GitHub's Markdown."""
    parts = []
    for grid in made:
        head = [grid.corner, *map(_escaped_markdown, grid.columns)]
        rows = [head, ["---", *["---:"] * len(grid.columns)]]
        rows += [
            [_escaped_markdown(name), *(_markdown(entry) for entry in row)]
            for name, row in grid.rows
        ]
        shown = "\n".join(f"| {' | '.join(row)} |" for row in rows)
        notes = "".join(f"\n{note}\n" for note in grid.notes)
        parts.append(f"## {_escaped_markdown(grid.title)}\n\n{shown}\n{notes}")
    return "\n".join(parts)


def _markdown(entry: Entry) -> str:
    text = f"**{entry.text}**" if entry.bold else entry.text
    return f"{text} [{entry.spread}]" if entry.spread else text


def latex(made: Iterable[Grid]) -> str:
    r"""Every table as a ``table*`` with booktabs' rules; it needs ``\usepackage{booktabs}``.

    Both columns of a paper wide; quartiles have a line of their own, so that five systems fit.
    """
    parts = ["% \\usepackage{booktabs}\n"]
    for grid in made:
        caption = " ".join([f"{grid.title}.", *grid.notes])
        head = " & ".join(map(_escaped_latex, (grid.corner, *grid.columns)))
        lines = [line for name, row in grid.rows for line in _latex_lines(name, row)]
        rows = "\n".join(f"    {line}" for line in lines)
        parts.append(
            "\\begin{table*}\n  \\centering\n  \\footnotesize\n  \\setlength{\\tabcolsep}{4pt}\n"
            f"  \\caption{{{_escaped_latex(caption)}}}\n"
            f"  \\begin{{tabular}}{{l{'r' * len(grid.columns)}}}\n    \\toprule\n"
            f"    {head} \\\\\n    \\midrule\n{rows}\n    \\bottomrule\n"
            "  \\end{tabular}\n\\end{table*}\n"
        )
    return "\n".join(parts)


def _latex_lines(name: str, row: Sequence[Entry]) -> list[str]:
    values = [_escaped_latex(entry.text) for entry in row]
    shown = [
        f"\\textbf{{{value}}}" if entry.bold else value
        for value, entry in zip(values, row, strict=True)
    ]
    # A line that begins with a bracket would be an option of the line before.
    guard = "{}" if name.startswith("[") else ""
    lines = [" & ".join([guard + _escaped_latex(name), *shown]) + r" \\"]
    if any(entry.spread for entry in row):
        spreads = [f"{{\\scriptsize [{e.spread}]}}" if e.spread else "" for e in row]
        lines.append(" & ".join(["", *spreads]) + r" \\")
    return lines


def page(made: Iterable[Grid]) -> str:
    """Every table on one page that needs nothing else."""
    body = "\n".join(f"<h2>{html.escape(grid.title)}</h2>\n{element(grid)}" for grid in made)
    return (
        '<!doctype html>\n<html lang="en">\n<head><meta charset="utf-8"><title>Benchmark</title>'
        f"<style>{_STYLE}</style></head>\n<body>\n<h1>Benchmark</h1>\n{body}\n</body>\n</html>\n"
    )


def element(grid: Grid) -> str:
    """One table with its notes, as part of a page."""
    head = "".join(f"<th>{html.escape(text)}</th>" for text in (grid.corner, *grid.columns))
    rows = "\n".join(
        f"<tr><th>{html.escape(name)}</th>{''.join(map(_cell, row))}</tr>"
        for name, row in grid.rows
    )
    notes = "".join(f"\n<p class=note>{html.escape(note)}</p>" for note in grid.notes)
    return f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table>{notes}"


def _cell(entry: Entry) -> str:
    text = html.escape(entry.text)
    text = f"<b>{text}</b>" if entry.bold else text
    spread = f" <small>[{html.escape(entry.spread)}]</small>" if entry.spread else ""
    return f"<td>{text}{spread}</td>"


def _escaped_markdown(text: str) -> str:
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>|#" else c for c in text)


_LATEX = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    **{"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"},
    **{"†": r"\textsuperscript{\dag}", "–": "--", "<": r"\textless{}"},
    **{">": r"\textgreater{}", "|": r"\textbar{}"},
}


def _escaped_latex(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text).replace("√s", r"$\sqrt{\mathrm{s}}$")
