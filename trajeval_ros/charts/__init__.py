# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures that one can touch: what a page needs to draw and link them in a browser.

The page has ``style()`` in a ``<style>`` and ``script()`` in a ``<script>``, which fetch nothing.
There the global ``charts`` has

- ``new Board({start, end, estimates: [{name, colour}]})``: what all figures of a page share. Its
  ``setCursor``, ``setRange``, ``goTo``, ``show``, ``setRaw``, and for a run that goes on
  ``setWhole``; ``on("cursor" | "range" | "shown", listener)``.
- ``new TimeChart(board, element, spec)`` and ``new MapView(board, element, spec)``; each has
  ``update(spec)`` for other data, and ``svg()``. ``time_chart.js`` and ``map.js`` say what is in a
  ``spec``.
- ``controls(board, element, {raw, clock, moments})``: the bar to switch and to zoom with;
  ``printable(board)``: on paper each figure is SVG.
- ``floats(text)``: the numbers that :func:`numbers` wrote.

Colours are names of custom properties of ``charts.css``: ``e0`` to ``e7`` for estimates, ``truth``,
``band`` and so on. Curves are drawn by uPlot (MIT, ``uPlot.LICENSE``), which lies here as its
authors built it.
"""

from trajeval_ros.charts.arrays import numbers
from trajeval_ros.charts.assets import ESTIMATE_COLOURS, compact, script, style

__all__ = ["ESTIMATE_COLOURS", "compact", "numbers", "script", "style"]
