# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is to be done: the runs by content, and the tasks that they are cut into."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from trajeval_ros import __version__
from trajeval_ros.benchmarking.manifest import Manifest, Run, Sequence, Source
from trajeval_ros.files.provenance import bytes_of, content_of
from trajeval_ros.online.parameters import Value

# Runs that share a ground truth in one task at most, and bytes of their files, some 300,000 poses:
# what a worker's death costs, and its memory.
_MOST_RUNS = 50
_MOST_BYTES = 32_000_000


@dataclass(frozen=True)
class Planned:
    """A run with the hashes (sha256) of what its figures depend on; ``key`` is that of all."""

    run: Run
    ground_truth: str
    estimate: str
    parameters: str
    key: str

    @property
    def name(self) -> tuple[str, str, str]:
        """System, sequence and run."""
        return self.run.system, self.run.sequence, self.run.run


@dataclass(frozen=True)
class Task:
    """Runs of one sequence: its ground truth is read and modelled once for them."""

    ground_truth: Source
    parameters: Mapping[str, Value]
    runs: tuple[Planned, ...]


def plan(manifest: Manifest) -> dict[str, list[Planned]]:
    """Return the runs of each sequence, with the hashes of their files as they are now."""
    return {sequence.name: _planned(sequence) for sequence in manifest.sequences}


def _planned(sequence: Sequence) -> list[Planned]:
    truth = _content(sequence.ground_truth)
    parameters = _digest(dict(sequence.parameters))
    found = []
    for run in sequence.runs:
        estimate = _content(run.source)
        name = [run.system, run.sequence, run.run]
        key = _digest([__version__, *name, truth, estimate, parameters])
        found.append(Planned(run, truth, estimate, parameters, key))
    return found


def _content(source: Source) -> str:
    """The hash of the file, of the file of its stamps, and of how it is to be read."""
    times = "" if source.times is None else content_of(source.times)
    whole = content_of(source.path)
    if not times and source.topic is None and source.format is None:
        return whole
    return _digest([whole, times, source.topic, source.format])


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def tasks(manifest: Manifest, planned: Mapping[str, Iterable[Planned]], workers: int) -> list[Task]:
    """Cut the runs that are left to do into tasks, at least two a worker where there are so many.

    Fewer would leave workers idle at the end; more would model a ground truth more often.
    """
    total = sum(len(list(runs)) for runs in planned.values())
    size = min(max(-(-total // (2 * workers)), 1), _MOST_RUNS)
    return [
        Task(sequence.ground_truth, sequence.parameters, tuple(part))
        for sequence in manifest.sequences
        for part in _parts(_in_turn(planned[sequence.name]), size)
    ]


def _parts(runs: Iterable[Planned], size: int) -> Iterator[list[Planned]]:
    """The runs in order, cut where there are enough of them, or of their bytes."""
    part: list[Planned] = []
    held = 0
    for one in runs:
        more = bytes_of(one.run.source.path)
        if part and (len(part) == size or held + more > _MOST_BYTES):
            yield part
            part, held = [], 0
        part.append(one)
        held += more
    if part:
        yield part


def _in_turn(runs: Iterable[Planned]) -> list[Planned]:
    """The first run of each system, then the second: all systems are as far at any time."""
    seen: Counter[str] = Counter()
    places = []
    for one in runs:
        places.append((seen[one.run.system], one))
        seen[one.run.system] += 1
    return [one for _, one in sorted(places, key=lambda place: place[0])]
