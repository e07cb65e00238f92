# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a benchmark hands over: tables, printed and written into the documentation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"


class SkippedError(Exception):
    """The benchmark cannot run here; the message says what is missing, and how to get it."""


@dataclass(frozen=True, slots=True)
class Table:
    """Figures in words, with the place ``name`` of the page ``page`` below docs/ they go to.

    ``page`` None: they are printed only; and so are the rows ``further``.
    """

    name: str
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    page: str | None = "performance.md"
    further: tuple[tuple[str, ...], ...] = ()

    def text(self) -> str:
        """Return the table for a terminal."""
        lines = [self.header, *self.rows, *self.further]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.header))]
        return "\n".join(
            [self.title]
            + ["  " + "  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
        )

    def markdown(self) -> str:
        """Return the table for a page."""
        rules = tuple("---" for _ in self.header)
        lines = [self.header, rules, *self.rows]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture for the file ``path`` below docs/, drawn when it is wanted."""

    path: str
    draw: Callable[[Path], None]


def written(text: str, table: Table) -> str:
    """Return a page's text with the table in its place.

    Raises ValueError where the page has no such place.
    """
    begin, end = f"<!-- begin {table.name} -->", f"<!-- end {table.name} -->"
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f"{table.page} has no place {begin} ... {end}")
    before, rest = text.split(begin)
    _, after = rest.split(end)
    return f"{before}{begin}\n{table.markdown()}\n{end}{after}"


def write(table: Table | Picture, docs: Path = DOCS) -> None:
    """Write the table into its page, or the picture into its file."""
    if isinstance(table, Picture):
        table.draw(docs / table.path)
    elif table.page is not None:
        path = docs / table.page
        path.write_text(written(path.read_text(encoding="utf-8"), table), encoding="utf-8")


def targets(
    name: str, title: str, found: Sequence[Target], page: str | None = "performance.md"
) -> Table:
    """Return the table of what was aimed at, and what came out.

    What is measured without an aim is printed, and left out of the page.
    """
    header = ("figure", "aim", "measured", "")
    aimed, others = (
        tuple((t.figure, t.aim, t.measured, t.verdict) for t in found if (t.met is None) is is_open)
        for is_open in (False, True)
    )
    return Table(name, title, header, aimed, page, others)


@dataclass(frozen=True, slots=True)
class Target:
    """One figure, what it should be, and what it is; ``met`` None where nothing is aimed at."""

    figure: str
    aim: str
    measured: str
    met: bool | None

    @property
    def verdict(self) -> str:
        """``met``, ``not met`` or nothing."""
        return {True: "met", False: "not met", None: ""}[self.met]


def at_most(figure: str, value: float, limit: float, form: str = ".2f") -> Target:
    """Return a figure that should not exceed ``limit``."""
    return Target(figure, f"at most {limit:g}", f"{value:{form}}", value <= limit)


def at_least(figure: str, value: float, limit: float, form: str = ".1f") -> Target:
    """Return a figure that should reach ``limit``."""
    return Target(figure, f"at least {limit:g}", f"{value:{form}}", value >= limit)
