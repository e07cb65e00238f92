# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""TUM, EuRoC and KITTI files: exact stamps, what is kept, and errors that name the row."""

import decimal
import json
import pathlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trajeval_ros import se3
from trajeval_ros.files.euroc import read_euroc
from trajeval_ros.files.kitti import read_kitti
from trajeval_ros.files.trajectory import Trajectory, TrajectoryFileError
from trajeval_ros.files.tum import read_tum, write_tum

DATA = pathlib.Path(__file__).parents[2] / ".." / "shared" / "data"
POSE = "1.5 -2 3e-1 0 0 0 1"


@pytest.fixture
def write(tmp_path):
    """Write a file of that content, its path."""

    def write_file(content, name="trajectory.txt"):
        path = tmp_path / name
        if isinstance(content, str):
            content = content.encode()
        path.write_bytes(content)
        return path

    return write_file


def nanoseconds(text):
    """The slow, obvious way to exact nanoseconds."""
    with decimal.localcontext(prec=100):
        value = decimal.Decimal(text) * 10**9
        return int(value.to_integral_value(decimal.ROUND_HALF_EVEN))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1403638128.940097024", 1403638128940097024),
        ("1403715529.112143517", 1403715529112143517),
        ("1305031098.6659", 1305031098665900000),
        ("0.000000", 0),
        ("0", 0),
        ("470.", 470_000_000_000),
        (".5", 500_000_000),
        ("-0.5", -500_000_000),
        ("+1.5", 1_500_000_000),
        ("1e9", 1_000_000_000_000_000_000),
        ("1.403638128940097024e+09", 1403638128940097024),
        ("1.036224e-01", 103_622_400),
        ("1.0000000005", 1_000_000_000),
        ("1.0000000015", 1_000_000_002),
        ("1.00000000050000000000000000000001", 1_000_000_001),
        ("9223372036.854775807", 2**63 - 1),
        ("-9223372036.854775808", -(2**63)),
        ("0000001.25", 1_250_000_000),
        ("1e-400", 0),
    ],
)
def test_stamps_are_exact(write, text, expected):
    trajectory = read_tum(write(f"{text} {POSE}\n"))
    assert trajectory.stamps.tolist() == [expected] == [nanoseconds(text)]
    assert trajectory.stamps.dtype == np.int64


@given(st.decimals(-9_000_000_000, 9_000_000_000, allow_nan=False, places=None))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_decimal_stamp_is_exact(write, value):
    trajectory = read_tum(write(f"{value} {POSE}\n"))
    assert trajectory.stamps.tolist() == [nanoseconds(str(value))]


def test_tum(write):
    path = write(
        "# stamp tx ty tz qx qy qz qw\n\n  1.5 1 2 3 0.1 0.2 0.3 0.9\n2 4 5 6 0 0 0 1 # end\n"
    )
    trajectory = read_tum(path)
    assert trajectory.stamps.tolist() == [1_500_000_000, 2_000_000_000]
    np.testing.assert_array_equal(trajectory.positions, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(trajectory.quaternions, [[0.1, 0.2, 0.3, 0.9], [0, 0, 0, 1]])
    assert trajectory.rows.tolist() == [3, 4]
    assert trajectory.source == str(path)
    assert trajectory.where(4) == f"{path}, row 4"
    assert len(trajectory) == 2


@pytest.mark.parametrize(
    "content",
    [
        "1,2,3,4,0,0,0,1\n2,2,3,4,0,0,0,1",
        "1, 2, 3, 4, 0, 0, 0, 1\r\n2, 2, 3, 4, 0, 0, 0, 1\r\n",
        "1\t2\t3\t4\t0\t0\t0\t1\n2   2 3 4 0 0 0 1   \n",
        "\ufeff1 2 3 4 0 0 0 1\n2 2 3 4 0 0 0 1\n",
    ],
)
def test_separators(write, content):
    trajectory = read_tum(write(content))
    assert trajectory.stamps.tolist() == [1_000_000_000, 2_000_000_000]
    np.testing.assert_array_equal(trajectory.positions, [[2, 3, 4], [2, 3, 4]])
    assert trajectory.rows.tolist() == [1, 2]


def test_bad_poses_are_kept(write):
    trajectory = read_tum(
        write("1 nan 0 0 0 0 0 1\n2 0 0 0 0 0 0 0\n3 0 inf 0 0 0 0 1.1\n4 0 0 -inf 0 0 NaN 1\n")
    )
    assert (trajectory.stamps // 1_000_000_000).tolist() == [1, 2, 3, 4]
    assert np.isnan(trajectory.positions[0, 0])
    assert trajectory.quaternions[1].tolist() == [0, 0, 0, 0]
    assert trajectory.quaternions[2, 3] == 1.1


def test_stamps_that_are_not_finite_are_listed(write):
    trajectory = read_tum(write(f"# t\nnan {POSE}\n1 {POSE}\ninf {POSE}\n1e999 {POSE}\n2 {POSE}\n"))
    assert trajectory.stamps.tolist() == [1_000_000_000, 2_000_000_000]
    assert trajectory.rows.tolist() == [3, 6]
    assert trajectory.non_finite_stamp_rows.tolist() == [2, 4, 5]
    assert len(read_tum(write(f"nan {POSE}\n"))) == 0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "there is nothing in it"),
        ("\n \n", "there is nothing in it"),
        ("# stamp\n", "there is nothing but comments in it"),
        ("these are words\n", ", row 1: 'these' is not a number"),
        (f"# t\n1 {POSE}\n2 1 2 3\n", ", row 3: 4 columns where there should be 8 (stamp tx"),
        (f"1 {POSE}\n2 {POSE} 7\n", ", row 2: 9 columns where there should be 8"),
        ("1\n", ", row 1: 1 column where there should be 8"),
        ("1 2 3 4 5 6 7 8 9 10 11 12\n" * 2, ", row 1: 12 columns where there should be 8"),
        (f"1 {POSE}\n2 1 2 x 0 0 0 1\n", ", row 2: 'x' is not a number"),
        (f"1_0 {POSE}\n", ", row 1: '1_0' is not a number"),
        (f"0x10 {POSE}\n", ", row 1: '0x10' is not a number"),
        (f"{'y' * 200} {POSE}\n", "yyy...' is not a number"),
        (f"9403638128940 {POSE}\n", ", row 1: the stamp '9403638128940' is out of the range of"),
        (f"1 {POSE}\n9223372036.854775808 {POSE}\n", ", row 2: the stamp '9223372036.854775808'"),
        (f"1 {POSE}\n1e300 {POSE}\n", ", row 2: the stamp '1e300' is out of the range"),
        (b"\x00\xff\xfe\x00", "it is not a text file"),
        (b"\x00\x01\x02 3\n", ", row 1: '\\x00\\x01\\x02' is not a number"),
    ],
)
def test_errors_of_tum(write, content, message):
    path = write(content)
    with pytest.raises(TrajectoryFileError) as caught:
        read_tum(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_opened(tmp_path):
    with pytest.raises(TrajectoryFileError, match=r"nowhere\.txt: .*no such file"):
        read_tum(tmp_path / "nowhere.txt")
    with pytest.raises(TrajectoryFileError, match="directory"):
        read_tum(tmp_path)
    trajectory = Trajectory(
        np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0, np.int64), "-"
    )
    with pytest.raises(TrajectoryFileError, match=r"cannot be written: no such file"):
        write_tum(tmp_path / "nowhere" / "file.txt", trajectory)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(
            st.integers(-(2**63), 2**63 - 1),
            st.lists(st.floats(width=64), min_size=7, max_size=7),
        ),
        min_size=1,
        max_size=20,
        unique_by=lambda pose: pose[0],
    ).map(sorted)
)
def test_tum_round_trip(tmp_path, poses):
    stamps = np.array([stamp for stamp, _ in poses], dtype=np.int64)
    values = np.array([value for _, value in poses])
    written = Trajectory(
        stamps, values[:, :3].copy(), values[:, 3:].copy(), np.arange(len(poses)), "here"
    )
    write_tum(tmp_path / "file.txt", written)
    read = read_tum(tmp_path / "file.txt")
    np.testing.assert_array_equal(read.stamps, stamps)
    np.testing.assert_array_equal(read.positions, values[:, :3])
    np.testing.assert_array_equal(read.quaternions, values[:, 3:])
    assert read.rows.tolist() == list(range(2, len(poses) + 2))


EUROC_17 = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], ...\n"
    "1403636580838555648,4.688319,-1.786938,0.783338,0.534108,-0.153029,-0.827383,-0.082152,"
    "-0.027876,0.033207,0.800006,-0.003172,0.021267,0.078502,-0.025266,0.136696,0.075593\n"
)


@pytest.mark.parametrize("columns", [8, 17])
def test_euroc(write, columns):
    header, row = EUROC_17.splitlines()
    path = write(header + "\n" + ",".join(row.split(",")[:columns]) + "\n")
    trajectory = read_euroc(path)
    assert trajectory.stamps.tolist() == [1403636580838555648]
    np.testing.assert_array_equal(trajectory.positions, [[4.688319, -1.786938, 0.783338]])
    np.testing.assert_array_equal(
        trajectory.quaternions, [[-0.153029, -0.827383, -0.082152, 0.534108]]
    )
    assert trajectory.rows.tolist() == [2]


def test_euroc_stamps_in_scientific_notation(write):
    path = write(
        f"1.403636580838555648e+18,{POSE.replace(' ', ',')}\nnan,{POSE.replace(' ', ',')}\n"
    )
    trajectory = read_euroc(path)
    assert trajectory.stamps.tolist() == [1403636580838555648]
    assert trajectory.non_finite_stamp_rows.tolist() == [2]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "there is nothing in it"),
        ("time,x,y\n", ", row 1: 'time' is not a number"),
        (
            "1403,1,2\n",
            ", row 1: 3 columns where there should be 8 (stamp px py pz qw qx qy qz) or 17",
        ),
        ("1403,1,2,3,1,0,0,0\n1404,1,2,3,1,0,0\n", ", row 2: 7 columns where there should be 8 ("),
        ("1403715529112143.5,1,2,3,1,0,0,0\n", "not a whole number of nanoseconds"),
        ("9223372036854775808,1,2,3,1,0,0,0\n", "out of the range of nanoseconds"),
        ("1e99,1,2,3,1,0,0,0\n", "out of the range of nanoseconds"),
    ],
)
def test_errors_of_euroc(write, content, message):
    with pytest.raises(TrajectoryFileError) as caught:
        read_euroc(write(content))
    assert message in str(caught.value)


def kitti_row(pose):
    return " ".join(repr(value) for value in pose[:3].ravel().tolist())


def test_kitti(write):
    poses = se3.exp(np.random.default_rng(0).normal(size=(20, 6)))
    path = write("\n".join(map(kitti_row, poses)))
    times = write("".join(f"{0.1036224 * i:.6e}\n" for i in range(20)), "times.txt")
    trajectory = read_kitti(path, times)
    assert trajectory.stamps[1] == 103_622_400
    read = se3.from_position_quaternion(trajectory.positions, trajectory.quaternions)
    np.testing.assert_allclose(read, poses, atol=1e-14)
    np.testing.assert_array_equal(trajectory.positions, poses[:, :3, 3])
    assert trajectory.rows.tolist() == list(range(1, 21))


def test_kitti_bad_poses_are_kept_and_recognisable(write):
    good, zero, mirrored, scaled, broken = np.tile(np.eye(4), (5, 1, 1))
    zero[:3, :3] = 0
    mirrored[0, 0] = -1
    scaled[:3, :3] *= 2
    broken[1, 1] = np.nan
    path = write("\n".join(map(kitti_row, (good, zero, mirrored, scaled, broken, good))))
    trajectory = read_kitti(path, write("0\n1\n2\n3\n4\nnan\n", "times.txt"))
    assert trajectory.quaternions[0].tolist() == [0, 0, 0, 1]
    np.testing.assert_array_equal(trajectory.quaternions[1:4], np.zeros((3, 4)))
    assert np.isnan(trajectory.quaternions[4]).all()
    assert trajectory.non_finite_stamp_rows.tolist() == [6]


def test_errors_of_kitti(write):
    row = kitti_row(np.eye(4))
    path, times = write(row + "\n" + row + "\n"), write("0\n1\n2\n", "times.txt")
    with pytest.raises(TrajectoryFileError, match=r"times\.txt: 3 stamps for the 2 poses of"):
        read_kitti(path, times)
    with pytest.raises(TrajectoryFileError, match=r"times\.txt: .*no such file"):
        read_kitti(path, times.with_name("no_times.txt"))
    with pytest.raises(TrajectoryFileError, match="row 1: 3 columns where there should be 12"):
        read_kitti(write("1 2 3\n", "poses.txt"), times)
    with pytest.raises(TrajectoryFileError, match="row 2: 2 columns where there should be 1"):
        read_kitti(path, write("1\n1 2\n", "times.txt"))


def real_files():
    return [
        (folder.parent.name, name)
        for folder in sorted(DATA.glob("*/meta.json"))
        for name in sorted(path.name for path in folder.parent.glob("*.txt"))
    ]


@pytest.mark.skipif(
    not DATA.is_dir(),
    reason="the real trajectories (shared/data beside the repository) are not here",
)
def test_real_files():
    assert len(real_files()) >= 13
    for folder, name in real_files():
        path = DATA / folder / name
        if folder == "rpng_ironsides_01":  # with covariances in further columns
            continue
        trajectory = read_tum(path)
        meta = json.loads((DATA / folder / "meta.json").read_text())
        if name == "groundtruth.txt" and "groundtruth" not in meta:
            assert len(trajectory) > 100
        elif name == "groundtruth.txt":
            count = len(trajectory) + len(trajectory.superseded_rows)
            assert count == meta["groundtruth"]["n_gt"]
            assert trajectory.stamps[0] == nanoseconds(meta["groundtruth"]["stamp_first"])
            assert trajectory.stamps[-1] == nanoseconds(meta["groundtruth"]["stamp_last"])
        else:
            count = len(trajectory) + len(trajectory.superseded_rows)
            assert count == meta["estimates"][path.stem]["n_est"]
        lines = path.read_text().splitlines()
        rows = [lines[row - 1].split() for row in trajectory.rows]
        assert trajectory.stamps.tolist() == [nanoseconds(row[0]) for row in rows]
        table = np.array([row[:8] for row in rows], dtype=np.float64)
        np.testing.assert_array_equal(trajectory.positions, table[:, 1:4])
        np.testing.assert_array_equal(trajectory.quaternions, table[:, 4:8])


def test_trajectory_checks_its_shapes_and_stays_as_it_is():
    stamps, rows = np.zeros(2, dtype=np.int64), np.arange(2)
    trajectory = Trajectory(stamps, np.zeros((2, 3)), np.zeros((2, 4)), rows, "here")
    with pytest.raises(ValueError, match="read-only"):
        trajectory.positions[0, 0] = 1.0
    with pytest.raises(ValueError, match="quaternions must be"):
        Trajectory(stamps, np.zeros((2, 3)), np.zeros((2, 3)), rows, "here")
    with pytest.raises(ValueError, match="covariances must be"):
        Trajectory(stamps, np.zeros((2, 3)), np.zeros((2, 4)), rows, "here", np.zeros((2, 3, 3)))
    with pytest.raises(ValueError, match="stamps must be int64"):
        Trajectory(np.zeros(2), np.zeros((2, 3)), np.zeros((2, 4)), rows, "here")
