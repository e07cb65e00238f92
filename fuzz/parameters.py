# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters, good and bad, in random combination, on the command line and in YAML files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fuzz import oracle
from fuzz.text import corrupted, good_run, written
from trajeval_ros.online.parameters import PARAMETERS, Parameter

_WRONG: tuple[str, ...] = (
    "",
    " ",
    "abc",
    "nan",
    "-inf",
    "1e400",
    "true",
    "null",
    "[1, 2]",
    "{a: 1}",
    "-1",
    "1e-400",
)
_WRONG += ("3.5", "99999999999999999999", "µ", "a=b", "0x10", "~", "'", "1,2,3,4,5,6,7", "a\nb")


def value(rng: np.random.Generator, parameter: Parameter, folder: Path) -> str:
    """Return a value as a user types it: mostly right, at times on a bound, out of range, wrong."""
    if parameter.name == "output.directory":
        # Any text names a folder; none but these may be written.
        return str(rng.choice([str(folder / "other"), "/proc/none", "/dev/null/none"]))
    if rng.random() < 0.12:
        return str(rng.choice(_WRONG))
    match parameter.default:
        case bool():
            return str(rng.choice(["true", "false"]))
        case (str(), *_):
            return str(rng.choice(["estimate", "vins", "gauge", "a,b", ""]))
        case tuple():
            turn = rng.normal(size=4)
            pose = [*rng.normal(size=3), *(turn / np.linalg.norm(turn))]
            return ",".join(f"{number:.6g}" for number in pose)
        case str():
            free = ("", "/estimate", "estimate", "/tf:map.base_link", "/tf:", "pose.pose", "a[0].b")
            return str(rng.choice(parameter.choices or free))
    lower, upper = parameter.lower, parameter.upper
    assert lower is not None
    assert upper is not None
    chance = rng.random()
    if chance < 0.3:
        number = float(rng.choice([lower, upper]))
    elif chance < 0.35:
        number = float(rng.choice([np.nextafter(lower, -np.inf), np.nextafter(upper, np.inf)]))
    elif lower > 0:
        number = float(np.exp(rng.uniform(np.log(lower), np.log(upper))))
    else:
        number = float(rng.choice([0.0, rng.uniform(lower, upper), rng.uniform(0.0, 1.0)]))
    return str(round(number)) if isinstance(parameter.default, int) else repr(number)


def _yaml(rng: np.random.Generator, values: dict[str, str]) -> bytes:
    """Return the values as a file of the node's, or as a plain mapping; at times damaged."""
    indent, head = ("    ", "evaluator:\n  ros__parameters:\n")
    if rng.random() < 0.3:
        indent, head = "", ""
    lines = []
    for name, text in values.items():
        listed = f"[{text}]" if isinstance(PARAMETERS[name].default, tuple) else text
        quoted = json.dumps(text) if PARAMETERS[name].choices else listed
        lines.append(f"{indent}{name}: {quoted}\n")
    made = (head + "".join(lines)).encode()
    return corrupted(rng, made) if rng.random() < 0.4 else made


def case(rng: np.random.Generator, folder: Path) -> str:
    """Evaluate a good run with random parameters, check; return what became of it."""
    paths = [folder / f"{name}.txt" for name in ("ground_truth", "estimate")]
    for path, track in zip(paths, good_run(int(rng.integers(4))), strict=True):
        path.write_text("".join(" ".join(row) + "\n" for row in written(track, "tum")))
    options = []
    drawn = rng.choice(list(PARAMETERS), rng.integers(1, 7), replace=False).tolist()
    values = {name: value(rng, PARAMETERS[name], folder) for name in drawn}
    if rng.random() < 0.5:
        (folder / "parameters.yaml").write_bytes(_yaml(rng, values))
        options = ["--params", str(folder / "parameters.yaml")]
        values = {name: value(rng, PARAMETERS[name], folder) for name in drawn[:1]}
    if rng.random() < 0.05:
        values[str(rng.choice(["gp", "gauges", "", "estimate.", "x\ny"]))] = "1"
    for name, text in values.items():
        options += ["--set", f"{name}={text}"]
    return oracle.evaluate_and_check(["tum", *map(str, paths), *options], folder)
