# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures in few characters, alike in the terminal and in the node's log."""

from __future__ import annotations

_NONE = "-"


def number(value: float | None, digits: int = 4) -> str:
    """Return a figure in few characters, with thousands separated, or a dash for None."""
    if value is None:
        return _NONE
    if isinstance(value, int):
        return f"{value:,}"
    size = abs(value)
    if size < 1e3:
        return f"{value:.{digits}g}"
    if size < 1e9:
        return f"{value:,.0f}" if size >= 1e4 else f"{value:,.1f}"
    return f"{value:.{digits - 1}e}"


def compact(value: float | None) -> str:
    """Return a figure in eleven characters at most, however large: 298,122,999 is 298.123 M."""
    if value is None:
        return _NONE
    for size, suffix in ((1e12, "T"), (1e9, "G"), (1e6, "M")):
        if max(size, 1e7) <= abs(value) < 1e15:
            return f"{value / size:.6g} {suffix}"
    return number(value) if abs(value) < 1e15 else f"{value:.3e}"
