# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the table of parameters, which the code holds, into the documentation."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from trajeval_ros.online.parameters import PARAMETERS, Parameter, Value

DOCS = Path(__file__).parent
BEGIN, END = "<!-- begin table -->", "<!-- end table -->"


# What there is for both stands in one row, described as the first of them.
_TWINS = (("estimate.", "ground_truth."), ("gp.translation.", "gp.rotation."))


def parameters() -> str:
    """Return the table of parameters."""
    lines = ["| name | default | unit | values | |", "|---|---|---|---|---|"]
    written: set[str] = set()
    for parameter in PARAMETERS.values():
        if parameter.name in written:
            continue
        both = [parameter, *_twin(parameter)]
        written |= {one.name for one in both}
        cells = (
            _each(f"`{one.name}`" for one in both),
            _each(f"`{_written(one.default)}`" for one in both),
            _each(one.unit for one in both),
            _each(_allowed(one) for one in both),
            parameter.description + ("; may change at run time" if parameter.dynamic else ""),
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _each(texts: Iterable[str]) -> str:
    """Different ones, each once."""
    return ", ".join(dict.fromkeys(texts))


def _twin(parameter: Parameter) -> list[Parameter]:
    names = [
        parameter.name.replace(one, other, 1)
        for one, other in _TWINS
        if parameter.name.startswith(one)
    ]
    return [PARAMETERS[name] for name in names if name in PARAMETERS]


TABLES: dict[str, Callable[[], str]] = {"parameters.md": parameters}


def page(text: str, table: str) -> str:
    """Return the page ``text`` with its table written anew."""
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{table}\n{END}{after}"


def _written(value: Value) -> str:
    """Return a value as ``--set`` and YAML take it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(e if isinstance(e, str) else f"{e:g}" for e in value) + "]"
    return value or '""' if isinstance(value, str) else repr(value)


def _allowed(parameter: Parameter) -> str:
    if parameter.choices:
        return ", ".join(f"`{choice}`" for choice in parameter.choices)
    limits = []
    if parameter.lower is not None:
        limits.append(f"{parameter.lower:g}")
    if parameter.upper is not None:
        limits.append(f"to {parameter.upper:g}")
    return " ".join(limits)


if __name__ == "__main__":
    for name, table in TABLES.items():
        path = DOCS / name
        path.write_text(page(path.read_text(encoding="utf-8"), table()), encoding="utf-8")
