# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the table of ``docs/parameters.md`` from the one table of parameters in the code."""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.online.parameters import PARAMETERS, Parameter, Value

PAGE = Path(__file__).with_name("parameters.md")
BEGIN, END = "<!-- begin table -->", "<!-- end table -->"


def table() -> str:
    """Return the table in Markdown."""
    lines = ["| name | default | unit | values | at run time | |", "|---|---|---|---|---|---|"]
    for parameter in PARAMETERS.values():
        cells = (
            f"`{parameter.name}`",
            f"`{_written(parameter.default)}`",
            parameter.unit,
            _allowed(parameter),
            "may change" if parameter.dynamic else "",
            parameter.description,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def page(text: str) -> str:
    """Return the page ``text`` with its table written anew."""
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


def _written(value: Value) -> str:
    """Return a value as ``--set`` and YAML take it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(f"{entry:g}" for entry in value) + "]"
    return value or '""' if isinstance(value, str) else repr(value)


def _allowed(parameter: Parameter) -> str:
    if parameter.choices:
        return ", ".join(f"`{choice}`" for choice in parameter.choices)
    limits = []
    if parameter.above is not None:
        limits.append(f"above {parameter.above:g}")
    if parameter.lower is not None:
        limits.append(f"from {parameter.lower:g}")
    if parameter.upper is not None:
        limits.append(f"to {parameter.upper:g}")
    return ", ".join(limits)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
