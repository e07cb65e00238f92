# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes evaluator.yaml: every parameter with its default, as the code has them."""

from __future__ import annotations

import textwrap
from pathlib import Path

from trajeval_ros.online.parameters import PARAMETERS, Parameter, Value

HERE = Path(__file__).parent
HEAD = """\
# Every parameter of the node evaluator with its default. Copy it, change it, and start with
#   ros2 run trajeval_ros evaluator --ros-args --params-file FILE
# or evaluate --params FILE. Written by make_evaluator.py.
/**/evaluator:
  ros__parameters:
"""


def text() -> str:
    """Return the file's text."""
    return HEAD + "\n".join(_entry(parameter) for parameter in PARAMETERS.values())


def _entry(parameter: Parameter) -> str:
    words = [parameter.description]
    if parameter.unit:
        words.append(f"[{parameter.unit}]")
    remarks = _remarks(parameter)
    if remarks:
        words.append(f"({'; '.join(remarks)})")
    comment = textwrap.wrap(" ".join(words), 90, break_long_words=False)
    lines = [f"    # {line}" for line in comment]
    return "\n".join([*lines, f"    {parameter.name}: {_written(parameter.default)}", ""])


def _remarks(parameter: Parameter) -> list[str]:
    remarks = []
    if parameter.choices:
        remarks.append(", ".join(parameter.choices))
    bounds = [
        f"{word} {bound:g}"
        for word, bound in (
            ("at least", parameter.lower),
            ("at most", parameter.upper),
        )
        if bound is not None
    ]
    if bounds:
        remarks.append(", ".join(bounds))
    if parameter.dynamic:
        remarks.append("may change at run time")
    return remarks


def _written(value: Value) -> str:
    """Return the value as YAML, a floating point number always with its point."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_written, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)


if __name__ == "__main__":
    (HERE / "evaluator.yaml").write_text(text(), encoding="utf-8")
