# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The dashboards for several estimates, by their names.

python3 for_estimates.py vins orb

Writes ``foxglove_vins_orb.json`` and ``plotjuggler_vins_orb.xml`` into the working directory.
"""

import copy
import json
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
# Two or three of each estimate, dark first; over and over.
COLOURS = (
    ("#1769aa", "#5ea3d6", "#0b3a5e"),
    ("#c2560c", "#ef9a5c", "#6e2f05"),
    ("#2f7d46", "#78bd8c", "#174425"),
    ("#7b3fa0", "#b98cd3", "#452259"),
)
# What there is one of, however many estimates.
SHARED = ("metrics", "markers", "ground_truth/path", "comparison")


def of(name: str, text: str) -> str:
    """Return the topic, path or curve of an estimate where ``text`` is that of the only one."""
    text = re.sub(r'(/evaluator/metrics\.status\[:\]\{name==")', rf"\g<1>{name}: ", text)
    text = re.sub(r"^(/evaluator/metrics/)", rf"\g<1>{name}: ", text)
    shared = "|".join(re.escape(topic) for topic in SHARED)
    text = re.sub(rf"^/evaluator/(?!(?:{shared})\b)(?:estimate/)?", f"/evaluator/{name}/", text)
    return text


def colour(estimate: int, series: int) -> str:
    """Return the colour of an estimate's series."""
    shades = COLOURS[estimate % len(COLOURS)]
    return shades[series % len(shades)]


def foxglove(names: Sequence[str]) -> dict[str, Any]:
    """Return the layout: each series once for each estimate."""
    layout = json.loads((HERE / "foxglove.json").read_text(encoding="utf-8"))
    for panel in layout["configById"].values():
        if "paths" in panel:
            panel["paths"] = [
                {
                    **path,
                    "value": of(name, path["value"]),
                    "label": f"{name}: {path['label']}",
                    "color": colour(k, series),
                }
                for k, name in enumerate(names)
                for series, path in enumerate(panel["paths"])
            ]
        if "layers" in panel:
            topics: dict[str, Any] = {}
            for topic, shown in panel["topics"].items():
                for k, name in enumerate(names):
                    one = copy.deepcopy(shown)
                    if topic == "/evaluator/estimate/path":
                        one["gradient"] = [f"{colour(k, 0)}ff"] * 2
                    topics[of(name, topic)] = one
            panel["topics"] = topics
    return layout


def plotjuggler(names: Sequence[str]) -> ElementTree.ElementTree:
    """Return the layout: each curve once for each estimate."""
    tree = ElementTree.parse(HERE / "plotjuggler.xml")
    root = tree.getroot()
    for plot in root.iter("plot"):
        curves = plot.findall("curve")
        for curve in curves:
            plot.remove(curve)
        for k, name in enumerate(names):
            for series, curve in enumerate(curves):
                given = {"name": of(name, curve.attrib["name"]), "color": colour(k, series)}
                ElementTree.SubElement(plot, "curve", given)
    selected = root.find("Plugins/plugin/selected_topics")
    if selected is not None:
        topics = selected.attrib["value"].split(";")
        every = dict.fromkeys(of(name, topic) for topic in topics for name in names)
        selected.attrib["value"] = ";".join(every)
    return tree


def main(names: Sequence[str]) -> int:
    """Write both."""
    if not names or any(name.startswith("-") for name in names):
        print(__doc__)
        return 2
    ending = "_".join(names)
    written = Path(f"foxglove_{ending}.json"), Path(f"plotjuggler_{ending}.xml")
    written[0].write_text(json.dumps(foxglove(names), indent=2) + "\n", encoding="utf-8")
    plotjuggler(names).write(written[1], encoding="UTF-8", xml_declaration=True)
    print("\n".join(str(path) for path in written))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
