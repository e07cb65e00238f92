# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 1 and ROS 2, written here and real ones."""

import contextlib
import pathlib
import sys
import types

import numpy as np
import pytest

from trajeval_ros.files.bag import list_candidates, read_bag
from trajeval_ros.files.trajectory import TrajectoryFileError

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

BAGS = pathlib.Path(__file__).parents[2] / ".." / "shared" / "data" / "rosbags"
FORMATS = ["bag", "mcap", "sqlite3"]
COUNT = 5
LOG_OFFSET = 1_778_000_000_000_000_000
TOPICS = {
    "/pose": "geometry_msgs/msg/PoseStamped",
    "/pose_with_covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/odometry": "nav_msgs/msg/Odometry",
    "/transform": "geometry_msgs/msg/TransformStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/words": "std_msgs/msg/String",
}


def stamp_of(i):
    return 7_000_000_001 + i * 500_000_000


def numbers_of(topic, i):
    rng = np.random.default_rng([sorted(TOPICS).index(topic), i])
    return rng.normal(size=7)


def covariance_of(topic, i):
    return np.random.default_rng([sorted(TOPICS).index(topic), i, 1]).normal(size=36)


def message(store, topic, i, ros1):
    """The i-th message of a topic."""

    def make(name, *values):
        return store.types[name](*values)

    numbers = numbers_of(topic, i).tolist()
    kind = TOPICS[topic]
    if kind == "std_msgs/msg/String":
        return make(kind, "hello")
    time = make("builtin_interfaces/msg/Time", *divmod(stamp_of(i), 1_000_000_000))
    header = make("std_msgs/msg/Header", *([i] if ros1 else []), time, "odom")
    quaternion = make("geometry_msgs/msg/Quaternion", *numbers[3:])
    if kind in ("geometry_msgs/msg/TransformStamped", "tf2_msgs/msg/TFMessage"):
        vector = make("geometry_msgs/msg/Vector3", *numbers[:3])
        transform = make(
            "geometry_msgs/msg/TransformStamped",
            header,
            "/base_link",
            make("geometry_msgs/msg/Transform", vector, quaternion),
        )
        return make(kind, [transform]) if kind == "tf2_msgs/msg/TFMessage" else transform
    pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", *numbers[:3]), quaternion)
    if kind == "geometry_msgs/msg/PoseStamped":
        return make(kind, header, pose)
    with_covariance = make("geometry_msgs/msg/PoseWithCovariance", pose, covariance_of(topic, i))
    if kind == "geometry_msgs/msg/PoseWithCovarianceStamped":
        return make(kind, header, with_covariance)
    zero = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    twist = make("geometry_msgs/msg/Twist", zero, zero)
    return make(
        kind,
        header,
        "base_link",
        with_covariance,
        make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )


def write_bag(folder, kind):
    """A bag of all types, logged on another clock than stamped; its path."""
    path = folder / ("run.bag" if kind == "bag" else "run")
    if kind == "bag":
        store = get_typestore(Stores.ROS1_NOETIC)
        transforms = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
        writer = Writer1(path)
    else:
        store = get_typestore(Stores.ROS2_JAZZY)
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    serialize = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
    with writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, name in TOPICS.items()
        }
        for i in range(COUNT):
            for topic, connection in connections.items():
                raw = serialize(message(store, topic, i, kind == "bag"), TOPICS[topic])
                writer.write(connection, LOG_OFFSET + i * 1000, raw)
    return path


@pytest.fixture(params=FORMATS)
def bag(request, tmp_path):
    return write_bag(tmp_path, request.param)


def test_every_type(bag):
    names = ["/pose", "/pose_with_covariance", "/odometry", "transform", "/tf:odom.base_link"]
    trajectories = read_bag(bag, names)
    assert len(trajectories) == len(names)
    for name, trajectory in zip(names, trajectories, strict=True):
        topic = "/" + name.removeprefix("/").partition(":")[0]
        assert trajectory.stamps.tolist() == [stamp_of(i) for i in range(COUNT)]
        expected = np.array([numbers_of(topic, i) for i in range(COUNT)])
        np.testing.assert_array_equal(trajectory.positions, expected[:, :3])
        np.testing.assert_array_equal(trajectory.quaternions, expected[:, 3:])
        assert trajectory.rows.tolist() == list(range(1, COUNT + 1))
        assert trajectory.source == f"{bag}, topic {name}"
        if topic in ("/pose_with_covariance", "/odometry"):
            covariances = np.array([covariance_of(topic, i) for i in range(COUNT)])
            np.testing.assert_array_equal(trajectory.covariances, covariances.reshape(COUNT, 6, 6))
        else:
            assert trajectory.covariances is None


def test_the_same_topic_twice(bag):
    ground_truth, estimate = read_bag(bag, ["/pose", "/pose"])
    np.testing.assert_array_equal(ground_truth.positions, estimate.positions)


def test_candidates_by_header_stamps(bag):
    calls = []
    candidates = list_candidates(bag, lambda done, total: calls.append((done, total)))
    assert [(c.topic, c.message_type) for c in candidates] == [
        ("/odometry", "nav_msgs/msg/Odometry"),
        ("/pose", "geometry_msgs/msg/PoseStamped"),
        ("/pose_with_covariance", "geometry_msgs/msg/PoseWithCovarianceStamped"),
        ("/tf:odom.base_link", "tf2_msgs/msg/TFMessage"),
        ("/transform", "geometry_msgs/msg/TransformStamped"),
    ]
    assert all(c.count == COUNT for c in candidates)
    assert all(c.rate == pytest.approx(2.0) for c in candidates)
    assert calls[-1] == (25, 25)


@pytest.mark.parametrize(
    ("topic", "text"),
    [
        ("/nothing", "there is no topic '/nothing'; with poses there are /odometry, /pose,"),
        ("/words", "the topic '/words' holds std_msgs/msg/String, from which no pose is taken"),
        ("/tf", "the topic '/tf' holds transforms: name one as /tf:parent.child"),
        ("/tf:map.odom", "there is no frame 'map' on /tf; there are base_link, odom"),
        ("/pose:odom.base_link", "the topic '/pose' holds no transforms"),
    ],
)
def test_wrong_topics(bag, topic, text):
    with pytest.raises(TrajectoryFileError) as caught:
        read_bag(bag, [topic])
    assert str(caught.value).startswith(f"{bag}: ")
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def write_mixed(folder, other):
    """A bag whose topic /pose has messages of another topic's type as well; its path."""
    path = folder / "mixed"
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic in ("/pose", other):
            connection = writer.add_connection("/pose", TOPICS[topic], typestore=store)
            for i in range(COUNT):
                raw = store.serialize_cdr(message(store, topic, i, False), TOPICS[topic])
                writer.write(connection, LOG_OFFSET + i * 1000, raw)
    return path


def test_a_topic_of_two_types_with_poses_is_refused(tmp_path):
    path = write_mixed(tmp_path, "/odometry")
    with pytest.raises(TrajectoryFileError, match=r"holds poses of 2 types, .*PoseStamped and nav"):
        read_bag(path, ["/pose"])
    (candidate,) = list_candidates(path)
    assert candidate.message_type == "geometry_msgs/msg/PoseStamped and nav_msgs/msg/Odometry"
    assert candidate.count == 2 * COUNT


def test_another_type_without_poses_on_a_topic_is_passed_over(tmp_path):
    (trajectory,) = read_bag(write_mixed(tmp_path, "/words"), ["/pose"])
    assert trajectory.stamps.tolist() == [stamp_of(i) for i in range(COUNT)]


def test_no_candidate(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(tmp_path / "run.bag") as writer:
        connection = writer.add_connection("/words", "std_msgs/msg/String", typestore=store)
        text = store.types["std_msgs/msg/String"]("hello")
        writer.write(connection, 1, store.serialize_ros1(text, "std_msgs/msg/String"))
    assert list_candidates(tmp_path / "run.bag") == ()
    with pytest.raises(TrajectoryFileError, match="none has poses"):
        read_bag(tmp_path / "run.bag", ["/pose"])


@pytest.mark.parametrize("name", ["missing.bag", "missing.mcap", "missing"])
def test_missing(tmp_path, name):
    with pytest.raises(TrajectoryFileError, match="cannot be read: no such file"):
        list_candidates(tmp_path / name)


@pytest.mark.parametrize("name", ["words.bag", "words.mcap", "words.db3", "words.txt", "empty/"])
def test_not_a_bag(tmp_path, name):
    path = tmp_path / name
    if name.endswith("/"):
        path.mkdir()
    else:
        path.write_text("these are words and not a bag\n" * 10)
    with pytest.raises(TrajectoryFileError) as caught:
        list_candidates(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("seed", range(5))
def test_damaged(tmp_path, kind, seed):
    """A bag with wrong bytes in it: the same."""
    path = write_bag(tmp_path, kind)
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    content = np.frombuffer(file.read_bytes(), dtype=np.uint8).copy()
    rng = np.random.default_rng(seed)
    content[rng.integers(len(content), size=50)] = rng.integers(256, size=50)
    file.write_bytes(content.tobytes())
    with contextlib.suppress(TrajectoryFileError):
        assert read_bag(path, ["/pose"])


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("keep", [0.0, 0.02, 0.3, 0.6, 0.9, 0.99])
def test_cut_off(tmp_path, kind, keep):
    """A bag that breaks off anywhere: what is there, or one clear error, and no other."""
    path = write_bag(tmp_path, kind)
    file = path
    if path.is_dir():
        file = next(f for f in path.iterdir() if f.suffix != ".yaml")
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * keep)])
    with contextlib.suppress(TrajectoryFileError):
        trajectories = read_bag(path, ["/pose", "/odometry"])
        assert all(len(trajectory) <= COUNT for trajectory in trajectories)


def write_poses(path, count, stamped=True):
    """An mcap of so many poses, one every 10 ms."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds, kind = store.types, "geometry_msgs/msg/PoseStamped"
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/pose", kind, typestore=store)
        for i in range(count):
            stamp = (i // 100, i % 100 * 10_000_000) if stamped else (0, 0)
            header = kinds["std_msgs/msg/Header"](
                stamp=kinds["builtin_interfaces/msg/Time"](*stamp), frame_id="map"
            )
            pose = kinds["geometry_msgs/msg/Pose"](
                kinds["geometry_msgs/msg/Point"](0.1 * i, 0.0, 0.0),
                kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            )
            message = kinds[kind](header=header, pose=pose)
            writer.write(connection, i * 10_000_000, store.serialize_cdr(message, kind))
    return next(path.glob("*.mcap"))


@pytest.mark.parametrize("metadata", [True, False])
def test_of_an_mcap_that_is_cut_off_the_readable_part(tmp_path, metadata):
    file = write_poses(tmp_path / "run", 1000)
    if not metadata:
        (tmp_path / "run" / "metadata.yaml").unlink()
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * 0.5)])
    for path in (tmp_path / "run", file):
        (read,) = read_bag(path, ["/pose"])
        assert 300 < len(read) < 700
        assert read.stamps.tolist() == [i * 10_000_000 for i in range(len(read))]
        assert "the bag is cut off" in read.remarks[-1]
    said = read_bag(tmp_path / "run", ["/pose"])[0].remarks
    assert any("there is no metadata.yaml" in remark for remark in said) is not metadata
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
@pytest.mark.parametrize("keep", [0.5, 0.97])
def test_of_a_ros1_bag_that_is_cut_off_the_readable_part(tmp_path, compression, keep):
    """Within a chunk, and within the index behind all of them."""
    store, kind = get_typestore(Stores.ROS1_NOETIC), "geometry_msgs/msg/PoseStamped"
    file = tmp_path / "run.bag"
    writer = Writer1(file)
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        connection = writer.add_connection("/pose", kind, typestore=store)
        writer.add_connection("/pose", kind, typestore=store, callerid="/other")
        for i in range(20_000):
            made = message(store, "/pose", i, True)
            writer.write(connection, stamp_of(i), store.serialize_ros1(made, kind))
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * keep)])
    (read,) = read_bag(file, ["/pose"])
    assert (0.3 if keep == 0.5 else 0.8) * 20_000 < len(read) <= 20_000
    assert read.stamps.tolist() == [stamp_of(i) for i in range(len(read))]
    assert np.array_equal(read.positions[-1], numbers_of("/pose", len(read) - 1)[:3])
    assert "the bag is cut off" in read.remarks[-1]


def test_stamps_that_were_never_set(tmp_path):
    write_poses(tmp_path / "run", 20, stamped=False)
    with pytest.raises(TrajectoryFileError, match="was never set on the topic '/pose'"):
        read_bag(tmp_path / "run", ["/pose"])


def test_without_rosbags(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", types.ModuleType("rosbags.highlevel"))
    with pytest.raises(TrajectoryFileError, match="pip install rosbags"):
        list_candidates(tmp_path / "run.bag")


@pytest.mark.skipif(
    not BAGS.is_dir(), reason="the real bags (shared/data beside the repository) are not here"
)
class TestRealBags:
    def test_a_real_mcap_that_is_cut_off(self, tmp_path):
        content = (BAGS / "nav2_turtlebot.mcap").read_bytes()
        (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
        (whole,) = read_bag(BAGS / "nav2_turtlebot.mcap", ["/odom"])
        (read,) = read_bag(tmp_path / "cut.mcap", ["/odom"])
        assert 0.2 * len(whole) < len(read) < 0.8 * len(whole)
        assert read.stamps.tolist() == whole.stamps[: len(read)].tolist()
        assert "the bag is cut off" in read.remarks[0]

    def test_a_real_ros1_bag_that_is_cut_off(self, tmp_path):
        content = (BAGS / "ROS_example.bag").read_bytes()
        (tmp_path / "cut.bag").write_bytes(content[: len(content) // 8])
        (whole,) = read_bag(BAGS / "ROS_example.bag", ["/groundtruth"])
        (read,) = read_bag(tmp_path / "cut.bag", ["/groundtruth"])
        assert 0 < len(read) < len(whole)
        assert read.stamps.tolist() == whole.stamps[: len(read)].tolist()
        assert "the bag is cut off" in read.remarks[0]

    def test_ros1(self):
        ground_truth, estimate = read_bag(BAGS / "ROS_example.bag", ["groundtruth", "/ORB-SLAM"])
        assert (len(ground_truth), len(estimate)) == (12765, 8362)
        for trajectory in (ground_truth, estimate):
            assert np.isfinite(trajectory.positions).all()
            norms = np.linalg.norm(trajectory.quaternions, axis=-1)
            np.testing.assert_allclose(norms, 1.0, atol=1e-4)

    def test_mcap_with_header_stamps_in_simulated_time(self):
        candidates = {c.topic: c for c in list_candidates(BAGS / "nav2_turtlebot.mcap")}
        assert candidates["/odom"].count == 2639
        assert candidates["/amcl_pose"].count == 135
        assert "/tf:odom.base_link" in candidates
        odometry, transforms = read_bag(
            BAGS / "nav2_turtlebot.mcap", ["/odom", "/tf:odom.base_link"]
        )
        assert odometry.stamps.max() < 10_000_000_000_000
        assert odometry.covariances.shape == (2639, 6, 6)
        assert transforms.covariances is None
        # Both are published by one driver.
        _, i, j = np.intersect1d(odometry.stamps, transforms.stamps, return_indices=True)
        assert len(i) > 1000
        np.testing.assert_allclose(odometry.positions[i], transforms.positions[j], atol=1e-9)

    def test_transforms_of_ros1(self):
        candidates = {c.topic: c.count for c in list_candidates(BAGS / "tf_example.bag")}
        assert candidates == {"/tf:odom.base_footprint": 517}
        (trajectory,) = read_bag(BAGS / "tf_example.bag", ["/tf:odom.base_footprint"])
        assert len(trajectory) == 517


def test_positions_without_orientation(tmp_path):
    """Points as they are, fixes in metres of the first one; what has no fix is no number."""
    pytest.importorskip("pyproj")
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    place = tmp_path / "positions"
    kinds = {"/prism": "geometry_msgs/msg/PointStamped", "/fix": "sensor_msgs/msg/NavSatFix"}
    with Writer2(place, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        to = {t: writer.add_connection(t, kind, typestore=store) for t, kind in kinds.items()}
        for i in range(4):
            time = types["builtin_interfaces/msg/Time"](i, 5)
            header = types["std_msgs/msg/Header"](time, "map")
            point = types["geometry_msgs/msg/Point"](1.0 * i, 2.0, 3.0)
            status = types["sensor_msgs/msg/NavSatStatus"](-1 if i == 3 else 2, 1)
            covariance = np.diag([1.0, 4.0, 9.0]).ravel()
            made = {
                "/prism": types[kinds["/prism"]](header, point),
                "/fix": types[kinds["/fix"]](
                    header, status, 47.3 + 1e-5 * i, 8.5, 400.0 + i, covariance, 2
                ),
            }
            for topic, each in made.items():
                writer.write(to[topic], i, store.serialize_cdr(each, kinds[topic]))
    prism, fix = read_bag(place, ["/prism", "/fix"])
    assert not prism.has_orientation
    assert not fix.has_orientation
    assert prism.positions.tolist() == [[1.0 * i, 2.0, 3.0] for i in range(4)]
    assert prism.stamps.tolist() == [i * 1_000_000_000 + 5 for i in range(4)]
    # A degree of latitude is 111.2 km at 47 degrees.
    expected = [[0.0, 1.1118 * i, 1.0 * i] for i in range(3)]
    np.testing.assert_allclose(fix.positions[:3], expected, atol=1e-3)
    assert np.isnan(fix.positions[3]).all()
    np.testing.assert_array_equal(np.diagonal(fix.covariances[0]), [1.0, 4.0, 9.0, 0.0, 0.0, 0.0])
