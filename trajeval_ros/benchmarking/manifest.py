# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The manifest: which sequences there are, and where the estimates lie. Checked before all else."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from trajeval_ros.benchmarking.pattern import Pattern, PatternError
from trajeval_ros.files.recognise import recognise
from trajeval_ros.files.sources import FORMATS
from trajeval_ros.files.trajectory import TrajectoryFileError
from trajeval_ros.online.parameters import PARAMETERS, ParameterError, Value, complete

_SOURCE = ("format", "times", "topic")
_TOP = ("sequences", "estimates", "parameters")
_SEQUENCE = ("ground_truth", "parameters", *_SOURCE)
_ESTIMATES = ("pattern", *_SOURCE)


class ManifestError(ValueError):
    """What is wrong with a manifest: ``problems``, each a line with file and line."""

    def __init__(self, problems: list[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(problems))


@dataclass(frozen=True)
class Source:
    """A trajectory's place: ``format`` (None: by content), ``times`` of KITTI, a bag ``topic``."""

    path: str
    format: str | None = None
    times: str | None = None
    topic: str | None = None


@dataclass(frozen=True)
class Run:
    """One estimate of a system on a sequence."""

    system: str
    sequence: str
    run: str
    source: Source


@dataclass(frozen=True)
class Sequence:
    """A ground truth with its parameters (all of them), and the runs there are of it."""

    name: str
    ground_truth: Source
    parameters: Mapping[str, Value]
    runs: tuple[Run, ...]


@dataclass(frozen=True)
class Manifest:
    """What is to be evaluated, every file of it there when it was read."""

    path: Path
    sequences: tuple[Sequence, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        """Every run, sequence by sequence."""
        return tuple(run for sequence in self.sequences for run in sequence.runs)


def read_manifest(path: str | Path) -> Manifest:
    """Read and check a manifest; relative paths in it are relative to its folder.

    Raises :class:`ManifestError` with every mistake in it.
    """
    return _Reader(Path(path)).read()


class _Reader:
    """Goes through the YAML's nodes, which know their lines, and gathers what is wrong."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.folder = path.expanduser().resolve().parent
        self.problems: list[str] = []

    def read(self) -> Manifest:
        top = self._mapping(self._document(), _TOP, "the manifest")
        if self.problems and not top:
            raise ManifestError(self.problems)
        for key in ("sequences", "estimates"):
            if key not in top:
                self.problems.append(f"{self.path}:1: {key} is missing")
        common = self._parameters(top["parameters"]) if "parameters" in top else {}
        pattern, like = self._estimates(top["estimates"]) if "estimates" in top else (None, None)
        sequences = []
        if "sequences" in top:
            found = self._mapping(top["sequences"], None, "sequences")
            if not found and not self.problems:
                self._wrong(top["sequences"], "there is no sequence")
            for name, node in found.items():
                if not re.fullmatch(r"[^/\s]+", name):
                    self._wrong(node, f"a sequence cannot be named {name!r}")
                sequences.append(self._sequence(name, node, common, pattern, like))
        if self.problems:
            raise ManifestError(self.problems)
        return Manifest(self.path, tuple(sequence for sequence in sequences if sequence))

    def _document(self) -> Any:
        import yaml

        try:
            node = yaml.compose(self.path.read_text(encoding="utf-8"), yaml.SafeLoader)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise ManifestError([f"{self.path}: it cannot be read: {reason}"]) from error
        except UnicodeDecodeError as error:
            raise ManifestError([f"{self.path}: it is not text"]) from error
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else 1
            raise ManifestError([f"{self.path}:{line}: no YAML: {error.problem}"]) from error
        except (yaml.YAMLError, RecursionError) as error:
            raise ManifestError([f"{self.path}: no YAML"]) from error
        if node is None:
            raise ManifestError([f"{self.path}:1: it is empty"])
        return node

    def _wrong(self, node: Any, text: str) -> None:
        self.problems.append(f"{self.path}:{node.start_mark.line + 1}: {text}")

    def _mapping(self, node: Any, known: tuple[str, ...] | None, what: str) -> dict[str, Any]:
        """The nodes of a mapping by key; ``known`` keys, or any."""
        if node.id != "mapping":
            self._wrong(node, f"{what} must be a mapping")
            return {}
        found: dict[str, Any] = {}
        for key, value in node.value:
            name = str(key.value)
            if known is not None and name not in known:
                self._wrong(key, f"unknown key {name}{_suggestion(name, known)}")
            elif name in found:
                self._wrong(key, f"{name} is there twice")
            else:
                found[name] = value
        return found

    def _text(self, node: Any, what: str) -> str | None:
        if node.id != "scalar" or not node.value:
            self._wrong(node, f"{what} must be text")
            return None
        return str(node.value)

    def _file(self, node: Any, what: str) -> str | None:
        text = self._text(node, what)
        if text is None:
            return None
        path = self.folder / Path(text).expanduser()
        if not path.exists():
            self._wrong(node, f"{what}: there is no {text}")
            return None
        return str(path)

    def _source(self, found: Mapping[str, Any], path: str) -> Source:
        """The keys that say how to read a trajectory."""
        kind = self._text(found["format"], "format") if "format" in found else None
        if kind is not None and kind not in FORMATS:
            self._wrong(found["format"], f"format must be one of {', '.join(FORMATS)}, got {kind}")
        times = self._file(found["times"], "times") if "times" in found else None
        topic = self._text(found["topic"], "topic") if "topic" in found else None
        return Source(path, kind, times, topic)

    def _estimates(self, node: Any) -> tuple[Pattern | None, Source]:
        if node.id == "mapping":
            found = self._mapping(node, _ESTIMATES, "estimates")
            if "pattern" not in found:
                self._wrong(node, "estimates: pattern is missing")
                return None, Source("")
            text, like = self._text(found["pattern"], "pattern"), self._source(found, "")
        else:
            text, like = self._text(node, "estimates"), Source("")
        if text is None:
            return None, like
        try:
            return Pattern.of(text), like
        except PatternError as error:
            self._wrong(node, f"estimates: {error}")
            return None, like

    def _sequence(
        self,
        name: str,
        node: Any,
        common: Mapping[str, Any],
        pattern: Pattern | None,
        like: Source | None,
    ) -> Sequence | None:
        found = self._mapping(node, _SEQUENCE, f"sequence {name}")
        if "ground_truth" not in found:
            self._wrong(node, f"sequence {name}: ground_truth is missing")
            return None
        path = self._file(found["ground_truth"], f"sequence {name}: ground_truth")
        truth = self._source(found, path or "")
        if path is not None:
            self._recognise(found["ground_truth"], f"sequence {name}: ground_truth", truth)
        own = self._parameters(found["parameters"]) if "parameters" in found else {}
        parameters: Mapping[str, Value] = {}
        try:
            parameters = complete({**common, **own})
        except ParameterError as error:
            self._wrong(found.get("parameters", node), f"sequence {name}: {error}")
        if pattern is None or like is None:
            return None
        runs = tuple(
            Run(system, name, run, Source(file, like.format, like.times, like.topic))
            for system, run, file in pattern.files(self.folder, name)
        )
        if not runs:
            self._wrong(node, f"sequence {name}: no file matches {pattern.of_sequence(name)}")
        else:
            # Of the first alone: there may be thousands, and each tells of itself in its row.
            with contextlib.suppress(TrajectoryFileError):
                self._topic_is_named(node, f"sequence {name}: its estimates", runs[0].source)
        self._told_apart(node, runs)
        return Sequence(name, truth, parameters, runs)

    def _told_apart(self, node: Any, runs: tuple[Run, ...]) -> None:
        """Two files of one name would be one row."""
        seen: dict[tuple[str, str], str] = {}
        for run in runs:
            other = seen.setdefault((run.system, run.run), run.source.path)
            if other != run.source.path:
                self._wrong(node, f"{other} and {run.source.path} are the same run")

    def _recognise(self, node: Any, what: str, source: Source) -> None:
        try:
            self._topic_is_named(node, what, source)
        except TrajectoryFileError as error:
            self._wrong(node, str(error))

    def _topic_is_named(self, node: Any, what: str, source: Source) -> None:
        if source.topic is None and (source.format or recognise(source.path).format) == "bag":
            self._wrong(node, f"{what}: a bag, but which topic of it? set topic")

    def _parameters(self, node: Any) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for name, value in self._leaves(node, ""):
            if name not in PARAMETERS:
                self._wrong(value, f"unknown parameter {name}{_suggestion(name, PARAMETERS)}")
                continue
            if name in values:
                self._wrong(value, f"{name} is there twice")
                continue
            try:
                values[name] = PARAMETERS[name].validate(_value(value, PARAMETERS[name].default))
            except ParameterError as error:
                self._wrong(value, str(error))
        return values

    def _leaves(self, node: Any, prefix: str) -> Iterator[tuple[str, Any]]:
        """``gp: {kernel: x}`` as well as ``gp.kernel: x``."""
        if node.id != "mapping":
            self._wrong(node, "parameters must be a mapping")
            return
        for key, value in node.value:
            name = f"{prefix}{key.value}"
            if value.id == "mapping":
                yield from self._leaves(value, f"{name}.")
            else:
                yield name, value


def _value(node: Any, like: Value) -> Any:
    """A node as Python has it; 1e-3 is a number, which YAML 1.1 takes for a text."""
    import yaml

    loader = yaml.SafeLoader("")
    try:
        value = loader.construct_object(node, deep=True)
    except (yaml.YAMLError, ValueError, OverflowError):
        return str(node.value)
    finally:
        loader.dispose()
    if isinstance(value, str) and isinstance(like, float):
        try:
            return float(value)
        except ValueError:
            return value
    return value


def _suggestion(name: str, known: Any) -> str:
    close = get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]}?" if close else ""


_TRUTHS = ("ground_truth", "groundtruth", "gt", "reference")
_ENDINGS = (".txt", ".csv", ".tum", ".kitti", ".mcap", ".bag", ".npz")


DISCOVERED = "manifest.yaml"


def discover(folder: str | Path) -> Path:
    """Write ``manifest.yaml`` into a folder, for what lies in it; return its path.

    A sequence's ground truth is ``ground_truth/SEQUENCE.txt`` or ``SEQUENCE/ground_truth.txt`` (or
    ``groundtruth``, ``gt``, ``reference``; any ending of a trajectory); estimates lie under
    ``results``, ``estimates`` or beside it as ``SYSTEM/SEQUENCE/RUN`` or ``SYSTEM/SEQUENCE``.

    Raises :class:`ManifestError` where there is none of them, or a manifest already.
    """
    root = Path(folder).expanduser()
    place = root / DISCOVERED
    if place.exists():
        raise ManifestError([f"{place}: it is there already"])
    truths = _truths(root)
    if not truths:
        raise ManifestError(
            [
                f"{root}: no ground truth in it: ground_truth/SEQUENCE.txt or"
                " SEQUENCE/ground_truth.txt"
            ]
        )
    candidates = [
        f"{parent}{{system}}/{{sequence}}{run}{ending}"
        for parent in ("results/", "estimates/", "")
        for run in ("/{run}", "")
        for ending in _ENDINGS
    ]
    counts = {
        text: sum(
            not path.endswith(tuple(truths.values()))
            for name in truths
            for _, _, path in Pattern.of(text).files(root.resolve(), name)
        )
        for text in candidates
    }
    best = max(candidates, key=lambda text: counts[text])
    if not counts[best]:
        raise ManifestError([f"{root}: no estimates in it: results/SYSTEM/SEQUENCE/RUN.txt"])
    # JSON's text in quotes is YAML's.
    lines = [f"estimates: {json.dumps(best)}", "sequences:"]
    for name, path in truths.items():
        if Pattern.of(best).files(root.resolve(), name):
            lines.append(f"  {json.dumps(name)}: {{ground_truth: {json.dumps(path)}}}")
    try:
        place.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ManifestError([f"{place}: it cannot be written: {error.strerror}"]) from error
    return place


def _truths(root: Path) -> dict[str, str]:
    """The ground truths by sequence, relative to the folder."""
    if not root.is_dir():
        return {}
    found = {}
    for path in sorted(root.glob("*/*")):
        if not path.is_file() or path.suffix not in _ENDINGS:
            continue
        relative = path.relative_to(root).as_posix()
        if path.parent.name in _TRUTHS:
            found[path.stem] = relative
        elif path.stem in _TRUTHS:
            found[path.parent.name] = relative
    return found
