# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories in bags: ROS 1 (``.bag``), ROS 2 (a folder, ``.mcap`` or ``.db3``).

Bags are read with the library rosbags, the extra ``bags``; no ROS is needed. Stamps are those of
the message headers, which say when a pose was true, not of the log, which say when it was
written down (they may not even be on the same clock).

Topics: PoseStamped, PoseWithCovarianceStamped, Odometry, TransformStamped; Path, of which each
message brings the poses that are new in it; and one transform of
a TFMessage, named as evo does: ``/tf:odom.base_link`` is the pose of ``base_link`` in ``odom``, as
published, or where it is not, composed along the tree of those that are, static ones included.
"""

import contextlib
import dataclasses
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros import se3
from trajeval_ros.files.fixes import FixCounts
from trajeval_ros.files.paths import PATH_TYPE, GrowingPath, PathMessage, decode_path, path_of
from trajeval_ros.files.points import FIX_TYPE, POINT_TYPES, PYPROJ_IS_MISSING, Points
from trajeval_ros.files.salvage import lone_bag, salvaged
from trajeval_ros.files.salvage_ros1 import salvaged_ros1
from trajeval_ros.files.text import PathLike
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError
from trajeval_ros.files.transforms import Edge, composed, finest, way
from trajeval_ros.online.samples import PoseSamples

Progress = Callable[[int, int], None]
"""Called with the number of messages read, and of all there are to read."""

_POSE_TYPES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/TransformStamped",
    PATH_TYPE,
    *POINT_TYPES,
)
_WITH_COVARIANCE = ("geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry")
_TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_PROGRESS_EVERY = 500
_CUT_OFF = "the bag is cut off, as by a recorder that was killed: its readable part"
_DAMAGED = "the bag is damaged: what comes before that"


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A topic that holds a trajectory.

    Attributes:
        topic: its name, as `read_bag` takes it.
        message_type: such as ``geometry_msgs/msg/PoseStamped``.
        count: number of poses.
        rate: poses a second by their header stamps, Hz; None where the stamps span no time.
    """

    topic: str
    message_type: str
    count: int
    rate: float | None


def list_candidates(path: PathLike, progress: Progress | None = None) -> tuple[Candidate, ...]:
    """The topics of a bag that hold a trajectory, by name; reads their messages for the rates.

    A transform that was published once, as a static one is, is no trajectory. A topic of several
    types that hold poses is listed with all of them, and `read_bag` refuses it.

    Raises:
        TrajectoryFileError: the bag cannot be read, or rosbags is not installed.
    """
    source = os.fspath(path)
    with _opened(source, []) as reader:
        types = _types(reader)
        wanted = {topic for topic, kinds in types.items() if _usable(kinds)}
        columns: dict[tuple[str, str], _Column] = {}
        for topic, edge, pose in _poses(source, reader, wanted, progress, []):
            columns.setdefault((topic, edge), _Column()).add(pose)
    return tuple(
        Candidate(
            topic=f"{topic}:{edge}" if edge else topic,
            message_type=" and ".join(_usable(types[topic])),
            count=len(column.stamps),
            rate=_rate(column.stamps),
        )
        for (topic, edge), column in sorted(columns.items())
        if not edge or len(column.stamps) > 1
    )


def read_bag(
    path: PathLike, topics: Sequence[str], progress: Progress | None = None
) -> tuple[Trajectory, ...]:
    """Read the trajectories of several topics in one pass, in the order of the log.

    Topics of PoseWithCovarianceStamped and Odometry have covariances. A leading slash may be
    there or not.

    Args:
        path: the bag.
        topics: their names, one trajectory each.
        progress: called from time to time.

    Raises:
        TrajectoryFileError: the bag cannot be read, rosbags is not installed, or a topic is not
            in it, holds no message, messages of another type or of two that hold poses.
    """
    source = os.fspath(path)
    remarks: list[str] = []
    made: dict[tuple[str, str], str] = {}
    paths: dict[str, GrowingPath] = {}
    points: dict[str, Points] = {}
    with _opened(source, remarks) as reader:
        keys = [_find(source, reader, topic) for topic in topics]
        columns = {key: _Column() for key in keys}
        for topic, edge, pose in _poses(
            source, reader, {topic for topic, _ in keys}, progress, remarks, paths, points
        ):
            if (topic, edge) in columns:
                columns[topic, edge].add(pose)
                columns[topic, edge].has_orientation = pose.has_orientation
        for key in keys:
            if key[1] and not columns[key].stamps:
                columns[key], made[key] = _composed(source, reader, *key)
    for name, key in zip(topics, keys, strict=True):
        if not columns[key].stamps:
            raise TrajectoryFileError(source, f"there is no pose on the topic {name!r}")
        if len(columns[key].stamps) > 1 and not any(columns[key].stamps):
            raise TrajectoryFileError(
                source, f"header.stamp was never set on the topic {name!r}: it is 0 throughout"
            )
    return tuple(
        columns[key].trajectory(
            f"{source}, topic {name}",
            (*remarks, *([made[key]] if key in made else []), *_remarks_on(paths.get(key[0]))),
            paths[key[0]].latest if key[0] in paths else None,
            points[key[0]].fixes if key[0] in points else None,
        )
        for name, key in zip(topics, keys, strict=True)
    )


def _remarks_on(path: GrowingPath | None) -> tuple[str, ...]:
    if path is None or not path.lacks_stamps:
        return ()
    return ("the poses of its paths have no stamps: the last of each is taken, at the path's",)


@dataclasses.dataclass(frozen=True)
class _Pose:
    """A message's stamp, position with quaternion, covariance if its type has one, and frames."""

    stamp: int
    numbers: tuple[float, ...]
    covariance: Any
    row: int
    frames: tuple[str, str] = ("", "")
    has_orientation: bool = True


class _Column:
    """The poses of one topic as they are read."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self._numbers: list[tuple[float, ...]] = []
        self._covariances: list[Any] = []
        self._rows: list[int] = []
        self.has_orientation = True

    def add(self, pose: _Pose) -> None:
        self.stamps.append(pose.stamp)
        self._numbers.append(pose.numbers)
        self._rows.append(pose.row)
        if pose.covariance is not None:
            self._covariances.append(pose.covariance)

    @property
    def rows(self) -> list[int]:
        """The message of each."""
        return self._rows

    def edge(self, static: bool) -> Edge:
        """The transform that these are."""
        numbers = np.array(self._numbers, dtype=np.float64)
        with np.errstate(over="ignore"):
            norms = np.linalg.norm(numbers[:, 3:], axis=1)
        good = np.isfinite(numbers).all(axis=1) & (np.abs(norms - 1.0) < 1e-2)
        poses = se3.from_position_quaternion(numbers[good, :3], numbers[good, 3:])
        return Edge.of(np.array(self.stamps, dtype=np.int64)[good], poses, static)

    def trajectory(
        self,
        source: str,
        remarks: tuple[str, ...],
        latest_path: PoseSamples | None,
        fixes: FixCounts | None,
    ) -> Trajectory:
        numbers = np.array(self._numbers, dtype=np.float64)
        covariances = None
        if self._covariances:
            covariances = np.array(self._covariances, dtype=np.float64).reshape(-1, 6, 6)
        return Trajectory(
            stamps=np.array(self.stamps, dtype=np.int64),
            positions=numbers[:, :3].copy(),
            quaternions=numbers[:, 3:].copy(),
            rows=np.array(self._rows, dtype=np.int64),
            source=source,
            covariances=covariances,
            remarks=remarks,
            latest_path=latest_path,
            has_orientation=self.has_orientation,
            fixes=fixes,
        )


def _composed(source: str, reader: Any, topic: str, name: str) -> tuple[_Column, str]:
    """A transform that is not published itself, along the tree of those that are; what to say."""
    static_topic = f"{topic}_static"
    static: dict[tuple[str, str], bool] = {}
    columns: dict[tuple[str, str], _Column] = {}
    for of_topic, _, pose in _poses(source, reader, {topic, static_topic}, None, []):
        columns.setdefault(pose.frames, _Column()).add(pose)
        static[pose.frames] = of_topic == static_topic
    edges = {pair: column.edge(static[pair]) for pair, column in columns.items()}
    frames = {frame for pair in edges for frame in pair}
    # A frame may have dots in its name.
    cuts = [place for place, letter in enumerate(name) if letter == "."]
    asked = [(_frame(name[:cut]), _frame(name[cut + 1 :])) for cut in cuts]
    parent, child = next((pair for pair in asked if frames >= set(pair)), asked[0])
    for frame in (parent, child):
        if frame not in frames:
            raise TrajectoryFileError(
                source, f"there is no frame {frame!r} on {topic}; there are {_listed(frames)}"
            )
    steps = way(edges, parent, child)
    if not steps:
        raise TrajectoryFileError(source, f"{parent!r} and {child!r} are not connected on {topic}")
    timed_by = finest(edges, steps)
    stamps, poses = composed(edges, steps, timed_by)
    positions, quaternions = se3.to_position_quaternion(poses)
    row = dict(zip(columns[timed_by].stamps, columns[timed_by].rows, strict=True))
    result = _Column()
    for stamp, p, q in zip(stamps.tolist(), positions.tolist(), quaternions.tolist(), strict=True):
        result.add(_Pose(stamp, (*p, *q), None, row[stamp]))
    along = ", ".join(f"{a} to {b}" for (a, b), _ in steps)
    return result, f"{topic}:{name} is composed of {along}"


def _listed(frames: set[str]) -> str:
    shown = sorted(frames)[:12]
    return ", ".join(shown) + (" ..." if len(frames) > len(shown) else "")


@contextlib.contextmanager
def _opened(source: str, remarks: list[str]) -> Iterator[Any]:
    """The bag, open for reading; whatever is wrong with it as a `TrajectoryFileError`.

    Of a bag whose writer was killed the whole records are read, and ``remarks`` say so.
    """
    try:
        # Here and not above: an optional library, which the other formats do without.
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise TrajectoryFileError(
            source, "reading bags needs the library rosbags: pip install rosbags"
        ) from None
    if not Path(source).exists():
        raise TrajectoryFileError(source, "it cannot be read: no such file or directory")
    place = Path(source)
    if place.is_dir() and not (place / "metadata.yaml").exists():
        alone = lone_bag(place)
        if alone is None:
            raise TrajectoryFileError(
                source, "it is no bag: there is no metadata.yaml in the folder"
            )
        place = alone
        remarks.append(f"there is no metadata.yaml: its only bag is read, {place.name}")
    with contextlib.ExitStack() as stack:

        def opened(path: Path) -> Any:
            bag = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            return stack.enter_context(bag)

        try:
            reader = opened(place)
        except Exception as error:  # see _unreadable
            part = _salvaged(source, place, stack, error)
            if part is None:
                raise _unreadable(source, error) from error
            try:
                reader = opened(part)
            except Exception:  # noqa: BLE001 - see _unreadable
                raise _unreadable(source, error) from error
            remarks.append(_CUT_OFF)
        yield reader


def _salvaged(source: str, place: Path, stack: contextlib.ExitStack, why: Exception) -> Path | None:
    """The whole records of a bag that is cut off, in a folder that goes when the stack does."""
    try:
        bags = [place] if place.is_file() else sorted(place.glob("*.mcap"))
        if len(bags) != 1:
            return None
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="trajeval_ros_")))
        return salvaged(bags[0], folder) or salvaged_ros1(bags[0], folder)
    except OSError as error:
        raise TrajectoryFileError(
            source, f"it is cut off, and its readable part cannot be kept: {error.strerror}"
        ) from error
    except Exception:  # noqa: BLE001 - what decompresses damaged data raises errors of its own
        raise _unreadable(source, why) from why


def _messages(
    source: str, reader: Any, connections: list[Any], remarks: list[str]
) -> Iterator[tuple[Any, Any]]:
    """Connection and message, in log order, up to where the bag is damaged."""
    some = False
    try:
        for connection, _, raw in reader.messages(connections):
            yield connection, _read(reader, connection.msgtype, raw)
            some = True
    except Exception as error:  # see _unreadable
        if not some:
            raise _unreadable(source, error) from error
        remarks.append(_DAMAGED)


def _read(reader: Any, kind: str, raw: bytes) -> Any:
    """A message; a path, which may hold many poses, in the quickest way there is."""
    path = decode_path(raw) if kind == PATH_TYPE and reader.is2 else None
    return reader.deserialize(raw, kind) if path is None else path


def _unreadable(source: str, error: Exception) -> TrajectoryFileError:
    """What to say of an error inside rosbags.

    On damaged bags its parsers raise anything, from UnicodeDecodeError to MemoryError, besides
    the library's own errors and SQLite's; only those have something to say to the user. Nothing
    but calls of the library may stand where this is used.
    """
    if type(error).__name__ in ("AnyReaderError", "ReaderError", "FileNotFoundError"):
        return TrajectoryFileError(source, f"it is no readable bag: {' '.join(str(error).split())}")
    if isinstance(error, OSError):
        return TrajectoryFileError(source, f"it cannot be read: {(error.strerror or '').lower()}")
    return TrajectoryFileError(source, "it is no readable bag: it is damaged or of another kind")


def _poses(
    source: str,
    reader: Any,
    topics: set[str],
    progress: Progress | None,
    remarks: list[str],
    paths: dict[str, GrowingPath] | None = None,
    points: dict[str, Points] | None = None,
) -> Iterator[tuple[str, str, _Pose]]:
    """Topic, ``parent.child`` of a transform in a TFMessage or "", and pose, in log order.

    ``paths`` and ``points`` are filled in by topic.
    """
    paths = {} if paths is None else paths
    points = {} if points is None else points
    # A topic may have other types besides, which hold no poses.
    connections = [c for c in reader.connections if c.topic in topics and _usable([c.msgtype])]
    # Without connections, the library would read every message.
    if not connections:
        return
    total = sum(c.msgcount for c in connections)
    rows = dict.fromkeys(topics, 0)
    messages = _messages(source, reader, connections, remarks)
    for done, (connection, message) in enumerate(messages, start=1):
        topic = connection.topic
        rows[topic] += 1
        if connection.msgtype in _TF_TYPES:
            for transform in message.transforms:
                frames = _frame(transform.header.frame_id), _frame(transform.child_frame_id)
                yield topic, ".".join(frames), _pose(transform, rows[topic], frames=frames)
        elif connection.msgtype == PATH_TYPE:
            path = message if isinstance(message, PathMessage) else path_of(message)
            for pose in _poses_of(paths.setdefault(topic, GrowingPath()).take(path), rows[topic]):
                yield topic, "", pose
        elif connection.msgtype in POINT_TYPES:
            point = points.setdefault(topic, Points()).read(message)
            if point is None:
                raise TrajectoryFileError(source, PYPROJ_IS_MISSING)
            covariance = point.covariance
            if covariance is None and connection.msgtype == FIX_TYPE:
                covariance = np.zeros((6, 6))  # of no fix
            numbers = (*point.position, 0.0, 0.0, 0.0, 1.0)
            yield (
                topic,
                "",
                _Pose(point.stamp, numbers, covariance, rows[topic], has_orientation=False),
            )
        else:
            yield topic, "", _pose(message, rows[topic], connection.msgtype in _WITH_COVARIANCE)
        if progress is not None and (done % _PROGRESS_EVERY == 0 or done == total):
            progress(done, total)


def _poses_of(samples: PoseSamples, row: int) -> Iterator[_Pose]:
    numbers = np.concatenate([samples.positions, samples.quaternions], axis=1).tolist()
    for stamp, each in zip(samples.stamps.tolist(), numbers, strict=True):
        yield _Pose(stamp, tuple(each), None, row)


def _pose(
    message: Any, row: int, with_covariance: bool = False, frames: tuple[str, str] = ("", "")
) -> _Pose:
    """Of a message of one of the types, or of a transform of a TFMessage."""
    covariance = None
    if hasattr(message, "transform"):
        position, quaternion = message.transform.translation, message.transform.rotation
    else:
        pose = message.pose
        if with_covariance:
            covariance, pose = pose.covariance, pose.pose
        position, quaternion = pose.position, pose.orientation
    stamp = message.header.stamp
    return _Pose(
        stamp.sec * 1_000_000_000 + stamp.nanosec,
        (
            position.x,
            position.y,
            position.z,
            quaternion.x,
            quaternion.y,
            quaternion.z,
            quaternion.w,
        ),
        covariance,
        row,
        frames,
    )


def _types(reader: Any) -> dict[str, list[str]]:
    """The types of each topic's messages, in the order of the bag; as a rule there is one."""
    types: dict[str, list[str]] = {}
    for connection in reader.connections:
        kinds = types.setdefault(connection.topic, [])
        if str(connection.msgtype) not in kinds:
            kinds.append(str(connection.msgtype))
    return types


def _usable(types: Sequence[str]) -> list[str]:
    """Those of the types that hold poses."""
    return [kind for kind in types if kind in _POSE_TYPES or kind in _TF_TYPES]


def _find(source: str, reader: Any, name: str) -> tuple[str, str]:
    """The topic of the bag that is meant, and the transform in it or ""."""
    types = _types(reader)
    wanted, _, edge = name.partition(":")
    topic = next(
        (t for same in (str, _frame) for t in types if same(t) == same(wanted)),
        None,
    )
    if topic is None:
        others = sorted(t for t, kinds in types.items() if _usable(kinds))
        there = f"with poses there are {', '.join(others)}" if others else "none has poses"
        raise TrajectoryFileError(source, f"there is no topic {wanted!r}; {there}")
    usable = _usable(types[topic])
    if not usable:
        held = " and ".join(types[topic])
        raise TrajectoryFileError(
            source, f"the topic {topic!r} holds {held}, from which no pose is taken"
        )
    if len(usable) > 1:
        raise TrajectoryFileError(
            source,
            f"the topic {topic!r} holds poses of {len(usable)} types, {' and '.join(usable)}:"
            " two sources on one topic; keep one of them in the bag",
        )
    if usable[0] in _TF_TYPES:
        if "." not in edge:
            raise TrajectoryFileError(
                source,
                f"the topic {topic!r} holds transforms: name one as {topic}:parent.child",
            )
        return topic, edge
    if edge:
        raise TrajectoryFileError(source, f"the topic {topic!r} holds no transforms: {name!r}")
    return topic, ""


def _frame(name: str) -> str:
    """A name without the leading slash that older systems give it."""
    return name.removeprefix("/")


def _rate(stamps: list[int]) -> float | None:
    span = max(stamps) - min(stamps)
    return (len(stamps) - 1) * 1e9 / span if span > 0 else None
