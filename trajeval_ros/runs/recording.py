# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run from files as the node would have published it, in an mcap file.

The topics are those of a node called ``evaluator``, but for ``/diagnostics``, which is of a running
process; besides, the two trajectories as they were read, under the names of the node's inputs. So
the bag can be evaluated again, and played to a node.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.alignment.gauge import Similarity
from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.comparison.words import sentence
from trajeval_ros.files.mcap import Topic, message_types, write_mcap
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.online.results import Evaluations, Results
from trajeval_ros.runs.statuses import (
    NUMBERS,
    STATUSES,
    error_model_entries,
    flatten,
    flatten_comparison,
    latest_path_entries,
)
from trajeval_ros.runs.trail import DEVIATIONS, SMALLEST, Poses, Trail, ellipsoids

Array = npt.NDArray[np.float64]
Figures = Mapping[str, Any]
_Message = tuple[int, str, Any]

_SECOND = 1_000_000_000
_NODE = "/evaluator/"
_WORLD, _BODY = "world", "body"
# Stamps in a message are seconds in 32 bits; none in a bag is below zero.
_LATEST = (1 << 31) * _SECOND - 1
# How often paths and markers are shown anew in the course of a run.
_SCENES = 20
_LINE_WIDTH = 0.01
_UNCERTAINTY = (0.2, 0.6, 1.0, 0.4)
# One for each estimate, over and over.
_ERRORS = ((1.0, 0.3, 0.2, 0.9), (0.2, 0.8, 0.3, 0.9), (0.9, 0.7, 0.1, 0.9), (0.7, 0.4, 0.9, 0.9))
_SPHERE, _LINE_LIST, _ADD = 2, 5, 0

_FLOAT = "std_msgs/msg/Float64"
_VECTOR = "geometry_msgs/msg/Vector3Stamped"
_POSE = "geometry_msgs/msg/PoseStamped"
_POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_PATH = "nav_msgs/msg/Path"
_MARKERS = "visualization_msgs/msg/MarkerArray"
_TABLE = "diagnostic_msgs/msg/DiagnosticArray"
_OK = b"\x00"


@dataclass(frozen=True)
class _Batch:
    """What a call of the engine brought, and the statuses of ``~/metrics`` after it."""

    evaluations: Evaluations
    absolute: float | None
    alignment: Similarity | None
    statuses: Mapping[str, Mapping[str, str]]

    @property
    def latest(self) -> int:
        return int(self.evaluations.stamps[-1])


@dataclass
class Recorded:
    """One estimate's run, batch by batch; see ``offline.Scoring.observe``."""

    batches: list[_Batch] = field(default_factory=list)

    def observe(self, results: Results, summary: Callable[[], Figures]) -> None:
        """Keep what a batch brought, and the run's figures then."""
        if len(results.evaluations):
            self.batches.append(
                _Batch(
                    results.evaluations,
                    results.absolute_log_likelihood,
                    results.alignment,
                    _statuses(summary()),
                )
            )


@dataclass(frozen=True)
class Recording:
    """A whole run: its ground truth, and of each estimate what was read and what came of it.

    ``summaries`` are those of ``summary.json``: the figures of the last message of ``~/metrics``.
    """

    truth: Trajectory
    estimates: Mapping[str, Trajectory]
    recorded: Mapping[str, Recorded]
    summaries: Mapping[str, Figures]
    comparisons: Sequence[Comparison] = ()

    def write(self, path: Path) -> None:
        """Write the mcap file; see `write_mcap`."""
        types, serialize = message_types()
        topics: dict[str, Topic] = {}
        streams = list(self._streams(_Messages(types), topics))
        messages = (
            (when, topic, serialize(message, topics[topic].kind))
            for when, topic, message in heapq.merge(*streams, key=lambda item: item[0])
            if 0 <= when <= _LATEST
        )
        write_mcap(path, topics, messages)

    def _streams(self, make: _Messages, topics: dict[str, Topic]) -> Iterator[Iterable[_Message]]:
        """The messages of each topic in the order of time; fills in the ``topics``."""
        several = len(self.estimates) > 1

        def topic(name: str, kind: str, latched: bool = False) -> str:
            topics[name] = Topic(kind, latched)
            return name

        inputs = {"ground_truth": self.truth}
        inputs |= self.estimates if several else {"estimate": next(iter(self.estimates.values()))}
        for name, trajectory in inputs.items():
            frame = _WORLD if name == "ground_truth" else f"{name}_world"
            kind = _POSE if trajectory.covariances is None else _POSE_WITH_COVARIANCE
            yield _input(make, topic(f"/{name}", kind), trajectory, frame)
        for name, recorded in self.recorded.items():
            below = f"{_NODE}{name}/" if several else _NODE
            batches = recorded.batches
            yield _each(
                batches,
                topic(f"{below}relative/log_likelihood", _FLOAT),
                lambda one: one.evaluations.relative_log_likelihood,
                lambda stamp, value: make.number(value),
            )
            yield _absolute(make, batches, topic(f"{below}absolute/log_likelihood", _FLOAT))
            for which in ("relative", "absolute"):
                for part, columns in (("translation", slice(3)), ("rotation", slice(3, None))):
                    yield _errors(
                        make,
                        batches,
                        topic(f"{below}{which}/{part}_error", _VECTOR),
                        which,
                        columns,
                    )
            yield _answers(make, batches, topic(f"{below}ground_truth/pose", _POSE_WITH_COVARIANCE))
            metrics = self._metrics(name)
            for number, where in NUMBERS.items():
                yield _number(make, metrics, topic(f"{below}{number}", _FLOAT), where)
            title = f"{name}: " if several else ""
            yield _tables(make, metrics, topic(f"{_NODE}metrics", _TABLE), title)
        paths = {
            name: topic(f"{_NODE}{name if several else 'estimate'}/path", _PATH, True)
            for name in self.recorded
        }
        truth = topic(f"{_NODE}ground_truth/path", _PATH, True)
        markers = topic(f"{_NODE}markers", _MARKERS, True)
        yield _scenes(make, self.recorded, paths, truth, markers)
        if several:
            yield self._compared(make, topic(f"{_NODE}comparison", _TABLE))

    def _metrics(self, name: str) -> list[tuple[int, Mapping[str, Mapping[str, str]]]]:
        """The statuses after each batch; those of the last are the run's."""
        batches, summary = self.recorded[name].batches, self.summaries[name]
        if not batches:
            return []
        last = dict(_statuses(summary))
        models = {
            part: model
            for part, model in (
                ("run", summary.get("error_model")),
                ("window", (summary.get("window") or {}).get("error_model")),
            )
            if model
        }
        if models:
            last["error_model"] = error_model_entries(models)
        if summary.get("latest_path"):
            last["latest_path"] = latest_path_entries(summary["latest_path"])
        running = [(one.latest, one.statuses) for one in batches[:-1]]
        return [*running, (batches[-1].latest, last)]

    def _compared(self, make: _Messages, topic: str) -> Iterator[_Message]:
        stamps = [one.batches[-1].latest for one in self.recorded.values() if one.batches]
        if stamps and self.comparisons:
            rows = {
                f"{one.a} vs {one.b}": (sentence(one), flatten_comparison(one))
                for one in self.comparisons
            }
            yield max(stamps), topic, make.table(max(stamps), rows)


def _statuses(summary: Figures) -> dict[str, dict[str, str]]:
    """The statuses of ``~/metrics``, without the error model, which has one of its own."""
    window = summary.get("window")
    if window:
        summary = {**summary, "window": {k: v for k, v in window.items() if k != "error_model"}}
    found = flatten({key: value for key, value in summary.items() if value is not None})
    return {status: found[status] for status in STATUSES if status in found}


class _Messages:
    """Makes messages."""

    def __init__(self, types: Mapping[str, Any]) -> None:
        self.types = types
        self._time = types["builtin_interfaces/msg/Time"]
        self._header = types["std_msgs/msg/Header"]
        self._vector3 = types["geometry_msgs/msg/Vector3"]
        self._point = types["geometry_msgs/msg/Point"]
        self._quaternion = types["geometry_msgs/msg/Quaternion"]
        self._pose = types["geometry_msgs/msg/Pose"]

    def number(self, value: float) -> Any:
        return self.types[_FLOAT](value)

    def header(self, stamp: int, frame: str) -> Any:
        return self._header(self._time(*divmod(stamp, _SECOND)), frame)

    def vector(self, stamp: int, xyz: Sequence[float]) -> Any:
        return self.types[_VECTOR](self.header(stamp, _BODY), self._vector3(*xyz))

    def pose(self, position: Sequence[float], quaternion: Sequence[float]) -> Any:
        return self._pose(self._point(*position), self._quaternion(*quaternion))

    def pose_stamped(
        self, stamp: int, frame: str, position: Sequence[float], quaternion: Sequence[float]
    ) -> Any:
        return self.types[_POSE](self.header(stamp, frame), self.pose(position, quaternion))

    def pose_with_covariance(
        self,
        stamp: int,
        frame: str,
        position: Sequence[float],
        quaternion: Sequence[float],
        covariance: Array,
    ) -> Any:
        pose = self.types["geometry_msgs/msg/PoseWithCovariance"](
            self.pose(position, quaternion), covariance.ravel()
        )
        return self.types[_POSE_WITH_COVARIANCE](self.header(stamp, frame), pose)

    def path(self, stamps: npt.NDArray[np.int64], poses: Array) -> Any:
        rows = zip(
            stamps.tolist(),
            *(part.tolist() for part in se3.to_position_quaternion(poses)),
            strict=True,
        )
        shown = [self.pose_stamped(stamp, _WORLD, at, turned) for stamp, at, turned in rows]
        return self.types[_PATH](self.header(int(stamps[-1]), _WORLD), shown)

    def table(self, stamp: int, rows: Mapping[str, tuple[str, Mapping[str, str]]]) -> Any:
        status = self.types["diagnostic_msgs/msg/DiagnosticStatus"]
        entry = self.types["diagnostic_msgs/msg/KeyValue"]
        return self.types[_TABLE](
            self.header(stamp, ""),
            [
                status(_OK[0], name, said, "", [entry(*pair) for pair in values.items()])
                for name, (said, values) in rows.items()
            ],
        )

    def markers(self, markers: Sequence[Any]) -> Any:
        return self.types[_MARKERS](list(markers))

    def marker(
        self,
        stamp: int,
        name: tuple[str, int],
        kind: int,
        color: Sequence[float],
        scale: Sequence[float],
        pose: Any = None,
        points: Array | None = None,
    ) -> Any:
        duration = self.types["builtin_interfaces/msg/Duration"]
        return self.types["visualization_msgs/msg/Marker"](
            header=self.header(stamp, _WORLD),
            ns=name[0],
            id=name[1],
            type=kind,
            action=_ADD,
            pose=self.pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)) if pose is None else pose,
            scale=self._vector3(*scale),
            color=self.types["std_msgs/msg/ColorRGBA"](*color),
            lifetime=duration(0, 0),
            frame_locked=False,
            points=[] if points is None else [self._point(*xyz) for xyz in points.tolist()],
            colors=[],
            texture_resource="",
            texture=self.types["sensor_msgs/msg/CompressedImage"](
                self.header(0, ""), "", np.empty(0, dtype=np.uint8)
            ),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=self.types["visualization_msgs/msg/MeshFile"](
                "", np.empty(0, dtype=np.uint8)
            ),
            mesh_use_embedded_materials=False,
        )


def _input(make: _Messages, topic: str, trajectory: Trajectory, frame: str) -> Iterator[_Message]:
    """A trajectory as it was read."""
    quaternions = trajectory.quaternions
    if not trajectory.has_orientation:
        quaternions = np.full_like(quaternions, np.nan)
    rows = zip(
        trajectory.stamps.tolist(),
        trajectory.positions.tolist(),
        quaternions.tolist(),
        strict=True,
    )
    for number, (stamp, position, quaternion) in enumerate(rows):
        if not 0 <= stamp <= _LATEST:
            continue
        if trajectory.covariances is None:
            message = make.pose_stamped(stamp, frame, position, quaternion)
        else:
            message = make.pose_with_covariance(
                stamp, frame, position, quaternion, trajectory.covariances[number]
            )
        yield stamp, topic, message


def _each(
    batches: Iterable[_Batch],
    topic: str,
    values: Callable[[_Batch], Array],
    message: Callable[[int, Any], Any],
) -> Iterator[_Message]:
    """A message for each pose."""
    for batch in batches:
        rows = zip(batch.evaluations.stamps.tolist(), values(batch).tolist(), strict=True)
        for stamp, value in rows:
            if value == value:  # not NaN
                yield stamp, topic, message(stamp, value)


def _absolute(make: _Messages, batches: Iterable[_Batch], topic: str) -> Iterator[_Message]:
    for batch in batches:
        if batch.absolute is not None:
            yield batch.latest, topic, make.number(float(batch.absolute))


def _errors(
    make: _Messages, batches: Iterable[_Batch], topic: str, which: str, columns: slice
) -> Iterator[_Message]:
    for batch in batches:
        errors = getattr(batch.evaluations, f"{which}_error")[:, columns].tolist()
        for stamp, xyz in zip(batch.evaluations.stamps.tolist(), errors, strict=True):
            if xyz[0] == xyz[0]:  # not NaN
                yield stamp, topic, make.vector(stamp, xyz)


def _answers(make: _Messages, batches: Iterable[_Batch], topic: str) -> Iterator[_Message]:
    """The ground truth at the estimate's stamps."""
    for batch in batches:
        poses = batch.evaluations.ground_truth
        positions, quaternions = se3.to_position_quaternion(poses)
        rows = zip(
            batch.evaluations.stamps.tolist(),
            positions.tolist(),
            quaternions.tolist(),
            se3.covariance_to_fixed_axes(batch.evaluations.covariance, poses),
            strict=True,
        )
        for stamp, position, quaternion, covariance in rows:
            message = make.pose_with_covariance(stamp, _WORLD, position, quaternion, covariance)
            yield stamp, topic, message


def _number(
    make: _Messages,
    metrics: Iterable[tuple[int, Mapping[str, Mapping[str, str]]]],
    topic: str,
    where: tuple[str, str],
) -> Iterator[_Message]:
    status, key = where
    for stamp, statuses in metrics:
        value = statuses.get(status, {}).get(key)
        if value is not None:
            yield stamp, topic, make.number(float(value))


def _tables(
    make: _Messages,
    metrics: Iterable[tuple[int, Mapping[str, Mapping[str, str]]]],
    topic: str,
    title: str,
) -> Iterator[_Message]:
    for stamp, statuses in metrics:
        rows = {f"{title}{status}": ("", values) for status, values in statuses.items()}
        yield stamp, topic, make.table(stamp, rows)


def _scenes(
    make: _Messages,
    recorded: Mapping[str, Recorded],
    paths: Mapping[str, str],
    truth: str,
    markers: str,
) -> Iterator[_Message]:
    """Paths and markers as they are in the course of the run, and at its end."""
    order = sorted(
        ((name, batch) for name, one in recorded.items() for batch in one.batches),
        key=lambda item: item[1].latest,
    )
    trails = {name: Trail() for name in recorded}
    alignments: dict[str, Similarity | None] = {}
    every = max(1, len(order) // _SCENES)
    for left, (name, batch) in zip(range(len(order) - 1, -1, -1), order, strict=True):
        trails[name].add(batch.evaluations)
        alignments[name] = batch.alignment
        if left % every:
            continue
        run = trails[name].run
        yield batch.latest, truth, make.path(run.stamps, run.ground_truth)
        for each, topic in paths.items():
            if each in alignments:
                poses = trails[each].run
                shown = _aligned(poses, alignments[each])
                yield batch.latest, topic, make.path(poses.stamps, shown)
        yield batch.latest, markers, _markers(make, name, trails, alignments)


def _aligned(poses: Poses, alignment: Similarity | None) -> Array:
    return poses.estimate if alignment is None else alignment.apply(poses.estimate)


def _markers(
    make: _Messages,
    farthest: str,
    trails: Mapping[str, Trail],
    alignments: Mapping[str, Similarity | None],
) -> Any:
    """Lines from the ground truth to the estimates, and the ground truth's uncertainty."""
    found = []
    for number, name in enumerate(trails):
        if name in alignments:
            poses = trails[name].recent
            ends = (poses.ground_truth, _aligned(poses, alignments[name]))
            found.append(
                make.marker(
                    int(poses.stamps[-1]),
                    (f"{name}: error" if len(trails) > 1 else "error", 0),
                    _LINE_LIST,
                    _ERRORS[number % len(_ERRORS)],
                    (_LINE_WIDTH, 0.0, 0.0),
                    points=np.stack([end[:, :3, 3] for end in ends], axis=1).reshape(-1, 3),
                )
            )
    poses = trails[farthest].recent
    positions, quaternions, deviations = ellipsoids(poses.ground_truth, poses.covariance)
    rows = zip(positions.tolist(), quaternions.tolist(), deviations.tolist(), strict=True)
    for number, (position, quaternion, axes) in enumerate(rows):
        found.append(
            make.marker(
                int(poses.stamps[-1]),
                ("uncertainty", number),
                _SPHERE,
                _UNCERTAINTY,
                # Foxglove and RViz take the diameter.
                [max(2.0 * DEVIATIONS * axis, SMALLEST) for axis in axes],
                pose=make.pose(position, quaternion),
            )
        )
    return make.markers(found)
