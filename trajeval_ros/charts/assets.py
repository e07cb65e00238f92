# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The script and the style, as one text each."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

_FOLDER = Path(__file__).parent
_LIBRARY = "uPlot.iife.min.js"
# In the order in which they need one another.
_SCRIPTS = ("numbers.js", "pens.js", "board.js", "time_chart.js", "map.js", "controls.js")
_STYLES = ("uPlot.min.css", "charts.css")
# Comments that begin a line, and indentation: no string of ours goes over several lines.
_NOT_NEEDED = re.compile(r"^[ \t]*(?:/\*.*?\*/|//[^\n]*)\n|^[ \t]+", re.MULTILINE | re.DOTALL)
_OFFERED = "Board, TimeChart, MapView, controls, printable, floats, nearest, reading, moment"

ESTIMATE_COLOURS = tuple(f"e{number}" for number in range(8))
"""Names of the colours of estimates, in the order in which they are given out."""


@cache
def script() -> str:
    """JavaScript that defines ``uPlot`` and ``charts``; it has no ``</script`` in it."""
    own = "\n".join(compact(_text(name)) for name in _SCRIPTS)
    scope = f'(() => {{\n"use strict";\n{own}\nreturn {{ {_OFFERED} }};\n}})()'
    return f"{_text(_LIBRARY)}\nconst charts = {scope};"


@cache
def style() -> str:
    """The style of the figures, and the colours of light and dark."""
    return "\n".join(_text(name) for name in _STYLES)


def compact(script: str) -> str:
    """A script of ours without what only its readers need."""
    return _NOT_NEEDED.sub("", script)


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")
