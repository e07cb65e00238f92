# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What must stay the same when an input is changed in a way that is no difference.

Damaged runs go through the engine, or through ``evaluate``, twice: cut into other batches, later,
with rows that are no poses or come twice, in a world moved rigidly, or as they were.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fuzz import oracle
from fuzz.oracle import require
from fuzz.text import SECOND, Track, damaged, good_run, written
from trajeval_ros import se3
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.samples import PoseSamples

Pair = tuple[PoseSamples, PoseSamples]
_TOPICS = ("ground_truth", "estimate")

# Of figures, and what is rounded twice is not the same: a part of themselves, or of the largest of
# those beside them.
_SAME, _ALIKE = 1e-7, 1e-2
# m: so far from the origin, round-off is as large a part of an error of a centimetre.
_FAR = 1e6
# Figures of round-off, of stamps, and of the world itself.
_ROUND_OFF = ("consistency",)
_OF_STAMPS = ("begin", "end", "stamps", "text")
_OF_WORLD = ("alignment", "observability", "text", "detail")


@dataclass(frozen=True)
class Changed:
    """A pair that is to give the same figures.

    ``chunk`` (ns) to feed at a time; ``more``: of each topic what is rejected in addition, by
    reason; ``aside``: figures that may differ; ``tolerance``: relative.
    """

    pair: Pair
    chunk: int = SECOND
    more: tuple[dict[str, int], dict[str, int]] = ({}, {})
    aside: tuple[str, ...] = ()
    tolerance: float = _SAME


def _batches(rng: np.random.Generator, pair: Pair) -> Changed:
    """Cut anyhow, as long as what comes late comes no later."""
    return Changed(pair, int(SECOND * 10.0 ** rng.uniform(-1.5, 1.5)))


def _later(rng: np.random.Generator, pair: Pair) -> Changed:
    """Hours later: whole ones, so that ticks stay ticks."""
    by = 3600 * SECOND * int(rng.integers(1, 10_000))
    first, second = (replace(samples, stamps=samples.stamps + by) for samples in pair)
    return Changed((first, second), aside=_OF_STAMPS)


def _spoilt(rng: np.random.Generator, pair: Pair) -> Changed:
    """With rows between that are no poses."""
    found, more = [], []
    for samples in pair:
        n = len(samples)
        count = int(rng.integers(0, 6)) if n > 2 else 0
        at = np.sort(rng.integers(1, max(n, 2), count))
        parts = (np.insert(part, at, part[at - 1], axis=0) for part in _parts(samples))
        spoilt = PoseSamples(*parts)
        rows = at + np.arange(count)
        spoilt.positions[rows], spoilt.quaternions[rows] = 0.0, (0.0, 0.0, 0.0, 1.0)
        if rng.integers(2):
            spoilt.positions[rows, rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
            more.append({"non_finite": count})
        else:
            spoilt.quaternions[rows] = 0.0
            more.append({"zero_quaternion": count})
        found.append(spoilt)
    return Changed((found[0], found[1]), more=(more[0], more[1]))


def _moved(rng: np.random.Generator, pair: Pair) -> Changed:
    """Each in a world of its own, moved rigidly: what is aligned does not mind."""
    turn = se3.exp_so3(rng.normal(0.0, 1.0, (2, 3)))
    found = []
    for samples, rotation in zip(pair, turn, strict=True):
        world = np.eye(4)
        world[:3, :3], world[:3, 3] = rotation, rng.normal(0.0, 10.0, 3)
        poses = world @ se3.from_position_quaternion(samples.positions, samples.quaternions)
        found.append(PoseSamples(samples.stamps, *se3.to_position_quaternion(poses)))
    return Changed((found[0], found[1]), aside=_OF_WORLD, tolerance=_ALIKE)


def _parts(samples: PoseSamples) -> tuple[Any, ...]:
    return samples.stamps, samples.positions, samples.quaternions


def _in_order(track: Track) -> PoseSamples:
    """Rows in the order of their stamps, each once: late ones depend on when they come.

    Those at zero and before are not set, and would be hours later.
    """
    stamps, first = np.unique(track.held(SECOND, 2**62), return_index=True)
    return PoseSamples(stamps, track.positions[first], track.quaternions[first])


def _is_good(samples: PoseSamples) -> bool:
    """Whether nothing is wrong with any row by itself."""
    norms = np.linalg.norm(samples.quaternions, axis=1)
    near = np.abs(samples.positions).max(initial=0.0) < 1e3
    return bool(near and (np.abs(norms - 1.0) < 1e-3).all())


def _summary(settings: dict[str, object], pair: Pair, chunk: int) -> Any:
    engine = Engine(settings)
    for number, _ in enumerate(feed(engine, *pair, chunk)):
        if number % 8 == 0:
            oracle.check_accounts(engine.summary())
    summary: Any = engine.summary()
    oracle.check_accounts(summary)
    return json.loads(json.dumps(summary))


def differences(
    first: Any, second: Any, aside: tuple[str, ...], tolerance: float, path: str = ""
) -> Iterator[str]:
    """Yield where two summaries differ, and how."""
    if isinstance(first, dict) and isinstance(second, dict):
        for name in {**first, **second}:
            if name not in aside and name not in _ROUND_OFF:
                pair = first.get(name), second.get(name)
                yield from differences(*pair, aside, tolerance, f"{path}.{name}".strip("."))
    elif isinstance(first, list) and isinstance(second, list) and len(first) == len(second):
        numbers = [each for each in (*first, *second) if isinstance(each, float)]
        scale = max(map(abs, numbers), default=0.0)
        for number, (a, b) in enumerate(zip(first, second, strict=True)):
            if isinstance(a, float) and isinstance(b, float):
                if abs(a - b) > tolerance * scale:
                    yield f"{path}[{number}]: {a:.12g} and {b:.12g}"
            else:
                yield from differences(a, b, aside, tolerance, f"{path}[{number}]")
    elif isinstance(first, float) and isinstance(second, float):
        if not math.isclose(first, second, rel_tol=tolerance, abs_tol=_least(path, tolerance)):
            yield f"{path}: {first:.12g} and {second:.12g}"
    elif first != second:
        yield f"{path}: {first!r} and {second!r}"


def _least(path: str, tolerance: float) -> float:
    """Errors (m, rad) below this are none; of p-values only the first digits count."""
    return tolerance if path.endswith("p_value") else 1e-6 * tolerance


def _expected(summary: Any, more: tuple[dict[str, int], dict[str, int]]) -> Any:
    """The summary with what is rejected in addition."""
    for topic, counts in zip(_TOPICS, more, strict=True):
        account = summary[topic]
        for reason, count in counts.items():
            account["received"] += count
            if count:
                account["rejected"][reason] = account["rejected"].get(reason, 0) + count
    return summary


def _through_engine(rng: np.random.Generator, folder: Path, pair: Pair) -> str:
    relation = (_batches, _later, _spoilt, _moved)[rng.integers(4)]
    if relation is _moved and not all(map(_is_good, pair)):
        relation = _batches
    settings: dict[str, object] = {"max_wait": 60.0}
    if rng.random() < 0.3:
        settings["likelihood.covariance"] = "joint"
    if rng.random() < 0.3:
        settings["ground_truth.stamps"] = "regularize"
    changed = relation(rng, pair)
    _kept(folder, relation.__name__, settings, changed, pair)
    with oracle.guarded():
        first = _expected(_summary(settings, pair, SECOND), changed.more)
        second = _summary(settings, changed.pair, changed.chunk)
    farthest = max(np.abs(p[np.isfinite(p)]).max(initial=0.0) for p in (s.positions for s in pair))
    tolerance = changed.tolerance * max(float(farthest) / _FAR, 1.0)
    found = list(differences(first, second, changed.aside, tolerance))
    require(
        not found, f"{relation.__name__.strip('_')}: {len(found)} differ: {'; '.join(found[:3])}"
    )
    return "evaluated"


def _kept(folder: Path, name: str, settings: Any, changed: Changed, pair: Pair) -> None:
    """Leave what was tried for whoever wants to repeat it."""
    said = {"relation": name.strip("_"), "settings": settings, "chunk": changed.chunk}
    (folder / "relation.json").write_text(json.dumps(said), encoding="utf-8")
    for label, both in (("first", pair), ("second", changed.pair)):
        for topic, samples in zip(_TOPICS, both, strict=True):
            np.savez(folder / f"{label}_{topic}.npz", *_parts(samples))


def _through_files(rng: np.random.Generator, folder: Path, pair: Pair) -> str:
    """Evaluate files twice; at times the second ones with rows that later ones supersede."""
    superseded = bool(rng.integers(2))
    lines = [[" ".join(row) + "\n" for row in written(_track(each), "tum")] for each in pair]
    more = [{"superseded": 0}, {"superseded": 0}]
    summaries, poses = [], []
    for number in range(2):
        here = folder / str(number)
        here.mkdir()
        paths = [folder / f"{topic}.txt" for topic in _TOPICS]
        if superseded and number:
            for rows, count in zip(lines, more, strict=True):
                # Many would be coarse stamps.
                count["superseded"] = min(int(rng.integers(1, 5)), len(rows) // 50)
                for at in rng.integers(0, max(len(rows), 1), count["superseded"]).tolist():
                    stamp = rows[at].split(" ", 1)[0]
                    rows.insert(at, f"{stamp} {rng.normal():.3f} 0 0 0 0 0 1\n")
        for path, rows in zip(paths, lines, strict=True):
            path.write_text("".join(rows), encoding="utf-8")
        became = oracle.evaluate_and_check(["tum", *map(str, paths)], here)
        if became != "evaluated":
            return became
        output = here / "output"
        summaries.append(json.loads((output / "summary.json").read_text(encoding="utf-8")))
        poses.append((output / "poses.csv").read_bytes())
    first, second = summaries
    name = "superseded" if superseded else "twice"
    aside = ("inputs",) if superseded else ("inputs", "output")
    found = list(differences(_expected(first, (more[0], more[1])), second, aside, 0.0))
    require(not found, f"{name}: {len(found)} differ: {'; '.join(found[:3])}")
    require(poses[0] == poses[1], f"{name}: poses.csv is not the same")
    return "evaluated"


def _track(samples: PoseSamples) -> Track:
    return Track(samples.stamps.astype(np.float64), samples.positions, samples.quaternions)


def case(rng: np.random.Generator, folder: Path) -> str:
    """Damage a run, change it in a way that makes no difference, compare; what became of it."""
    tracks = list(good_run(int(rng.integers(4))))
    for _ in range(rng.integers(0, 3)):
        which = int(rng.integers(2))
        tracks[which] = damaged(rng, tracks[which])
    pair = _in_order(tracks[0]), _in_order(tracks[1])
    through = _through_files if rng.random() < 0.25 else _through_engine
    return through(rng, folder, pair)
