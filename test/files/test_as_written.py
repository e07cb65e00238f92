# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files as tools write them: each reads as the plain file of the same trajectory, and says so."""

import gzip
import io
import pathlib

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.files.euroc import read_euroc
from trajeval_ros.files.names import columns_of, split_names
from trajeval_ros.files.trajectory import TrajectoryFileError
from trajeval_ros.files.tum import read_tum

DATA = pathlib.Path(__file__).parents[2] / ".." / "shared" / "data"
COUNT = 200


@pytest.fixture
def write(tmp_path):
    """Write a file of that content, its path."""

    def write_file(content, name="trajectory.txt"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


def make(first=1403638128, count=COUNT):
    """Rows of eight texts, TUM's, 20 Hz."""
    random = np.random.default_rng(4)
    twists = np.cumsum(0.05 * random.normal(size=(count, 6)), axis=0)
    positions, quaternions = se3.to_position_quaternion(se3.exp(twists))
    return [
        [f"{first + i // 20}.{i % 20 * 50_000_000:09d}", *(f"{v:.9f}" for v in (*p, *q))]
        for i, (p, q) in enumerate(zip(positions, quaternions, strict=True))
    ]


ROWS = make()


def text(rows, separator=" "):
    return "".join(separator.join(row) + "\n" for row in rows)


def same(read, plain, norm=0.0):
    np.testing.assert_array_equal(read.stamps, plain.stamps)
    np.testing.assert_allclose(read.positions, plain.positions, rtol=0, atol=1e-12)
    np.testing.assert_allclose(read.quaternions, plain.quaternions, rtol=0, atol=norm or 1e-12)


@pytest.fixture
def plain(write):
    read = read_tum(write(text(ROWS), "plain.txt"))
    assert read.remarks == ()
    return read


# -- the order of rows ----------------------------------------------------------------------------


def test_shuffled_rows_are_sorted_and_it_is_said(write, plain):
    order = np.random.default_rng(0).permutation(COUNT)
    read = read_tum(write(text([ROWS[i] for i in order])))
    same(read, plain)
    assert read.rows.tolist() == (np.argsort(order) + 1).tolist()
    assert len(read.superseded_rows) == 0
    assert "not in the order of time" in read.remarks[0]


def test_of_windows_that_overlap_the_last_written_row_counts(write, plain):
    rows, rough = [], []
    for start in range(0, COUNT - 10, 10):
        # Fourteen rows that the next window writes again, better.
        for i in range(start, min(start + 24, COUNT)):
            good = i < start + 10 or start + 20 >= COUNT
            rows.append(ROWS[i] if good else [ROWS[i][0], "9", *ROWS[i][2:]])
            rough.append(not good)
    read = read_tum(write(text(rows)))
    same(read, plain)
    assert read.superseded_rows.tolist() == (np.flatnonzero(rough) + 1).tolist()
    assert len(read) + len(read.superseded_rows) == len(rows)
    assert f"{sum(rough)} rows have the stamp of a later row" in read.remarks[1]


def test_a_broken_row_supersedes_no_good_one(write, plain):
    broken = [ROWS[50][0], "nan", *ROWS[50][2:]]
    read = read_tum(write(text([*ROWS, broken])))
    same(read, plain)
    assert read.superseded_rows.tolist() == [COUNT + 1]


def test_a_wrong_stamp_moves_no_row(write):
    for stamp in ("0", "1403638129.0251", "1403638999.5"):
        rows = [list(row) for row in ROWS]
        rows[150][0] = stamp
        rows[150][1] = str(0.5 * (float(ROWS[149][1]) + float(ROWS[151][1])))
        read = read_tum(write(text(rows)))
        assert read.rows.tolist() == list(range(1, COUNT + 1))
        assert read.remarks == ()


def test_a_row_that_came_late_takes_its_place(write, plain):
    rows = [list(row) for row in ROWS]
    late = rows.pop(20)
    rows.insert(150, late)
    read = read_tum(write(text(rows)))
    same(read, plain)
    assert read.rows[20] == 151


def test_stamps_too_coarse_to_tell_rows_apart_correct_nothing(write):
    rows = [[row[0].partition(".")[0], *row[1:]] for row in ROWS]
    read = read_tum(write(text(rows)))
    assert len(read) == COUNT
    assert len(read.superseded_rows) == 0


def test_stamps_that_are_all_one_are_refused(write):
    with pytest.raises(TrajectoryFileError, match=r"all 200 rows have one stamp, 1\.40364e\+09"):
        read_tum(write(text([["1.40364e+09", *row[1:]] for row in ROWS])))


# -- columns --------------------------------------------------------------------------------------


@pytest.mark.parametrize("separator", [" ", ",", ", ", "\t"])
def test_columns_by_name_in_any_order(write, plain, separator):
    names = ["num", "qw", "tz", "ty", "tx", "timestamp", "qx", "qy", "qz"]
    rows = [
        [str(i), row[7], row[3], row[2], row[1], row[0], *row[4:7]] for i, row in enumerate(ROWS)
    ]
    read = read_tum(write(text([names, *rows], separator)))
    same(read, plain)
    assert read.rows.tolist() == list(range(2, COUNT + 2))
    assert read.remarks == (
        "columns by their names, stamp in 6, x in 5, y in 4, z in 3, qx in 7, qy in 8, qz in 9,"
        " qw in 2",
    )


EUROC = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
)


def euroc_rows(rows, more=()):
    return [[row[0].replace(".", ""), *row[1:4], row[7], *row[4:7], *more] for row in rows]


def test_a_file_of_euroc_read_as_tum(write, plain):
    path = write(EUROC + "\n" + text(euroc_rows(ROWS), ","))
    read = read_tum(path)
    same(read, plain)
    assert "qx in 6, qy in 7, qz in 8, qw in 5" in read.remarks[0]
    assert read.remarks[1] == "stamps in nanoseconds"
    assert read_euroc(path).remarks == ()
    same(read_euroc(path), plain)


def test_rostopic_echo(write, plain):
    names = (
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.child_frame_id,"
        "field.pose.pose.position.x,field.pose.pose.position.y,field.pose.pose.position.z,"
        "field.pose.pose.orientation.x,field.pose.pose.orientation.y,"
        "field.pose.pose.orientation.z,field.pose.pose.orientation.w,field.pose.covariance0,"
        "field.twist.twist.linear.x,field.twist.twist.angular.z"
    )
    rows = [
        [str(10**18 + i), str(i), row[0].replace(".", ""), "the map", "", *row[1:], "1", "2", "3"]
        for i, row in enumerate(ROWS)
    ]
    same(read_tum(write(names + "\n" + text(rows, ","))), plain)


def test_results_of_orb_slam3_on_euroc(write, plain):
    rows = [[row[0].replace(".", "") + ".000000", *row[1:]] for row in ROWS]
    read = read_tum(write(text(rows)))
    same(read, plain)
    assert read.remarks == ("stamps in nanoseconds",)


def test_results_of_kimera(write, plain):
    names = "#timestamp,x,y,z,qw,qx,qy,qz,vx,vy,vz,bgx,bgy,bgz,bax,bay,baz"
    rows = euroc_rows(ROWS, more=["0.5"] * 9)
    same(read_tum(write(names + "\n" + text(rows, ","))), plain)


def test_stamps_in_two_columns(write, plain):
    names = "Time,header.stamp.secs,header.stamp.nsecs,position.x,position.y,position.z,"
    names += "orientation.x,orientation.y,orientation.z,orientation.w"
    rows = [
        ["7.5", row[0].partition(".")[0], str(int(row[0].partition(".")[2])), *row[1:]]
        for row in ROWS
    ]
    same(read_tum(write(names + "\n" + text(rows, ","))), plain)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("# timestamp tx ty tz qx qy qz qw", (0, 1, 2, 3, 4, 5, 6, 7)),
        ("# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12 Pt11", (0, 1, 2, 3, 4, 5, 6, 7)),
        ("num,t,x,y,z,qx,qy,qz,qw", (1, 2, 3, 4, 5, 6, 7, 8)),
        ("timestamp, q[0], q[1], q[2], q[3], x, y, z, vx, vy, vz", (0, 5, 6, 7, 2, 3, 4, 1)),
        ("time (s) posX posY posZ quatW quatX quatY quatZ", (0, 1, 2, 3, 5, 6, 7, 4)),
        ("stamp x y z", (0, 1, 2, 3)),
        ("timestamp_ns p_x p_y p_z q_w q_x q_y q_z b_w_x b_a_x", (0, 1, 2, 3, 5, 6, 7, 4)),
    ],
)
def test_names(header, expected):
    columns = columns_of(split_names(header))
    assert columns is not None
    assert (*columns.stamp, *columns.position, *columns.quaternion) == expected


@pytest.mark.parametrize(
    "header",
    [
        "# ground truth trajectory",
        "# file: 'rgbd_dataset_freiburg2_desk.bag'",
        "# t x y",
        "time x y z qx qy qz",
        "time x y z x qx qy qz qw",
        "time timestamp time x y z rx ry rz",
        "r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz",
    ],
)
def test_what_is_not_understood_names_nothing(header):
    found = columns_of(split_names(header))
    assert found is None or found.quaternion == ()


def test_names_that_are_the_formats_own_are_no_difference(write, plain):
    for header in ("# timestamp tx ty tz qx qy qz qw\n", "timestamp,tx,ty,tz,qx,qy,qz,qw\n"):
        read = read_tum(write(header + text(ROWS, "," if "," in header else " ")))
        same(read, plain)
        assert read.remarks == ()


def test_millimetres_by_name(write, plain):
    rows = [[row[0], *(str(1000 * float(v)) for v in row[1:4]), *row[4:]] for row in ROWS]
    header = "t,x [mm],y [mm],z [mm],qx,qy,qz,qw\n"
    same(read_tum(write(header + text(rows, ","))), plain)


def test_a_column_that_numbers_the_rows(write, plain):
    read = read_tum(write(text([[str(i + 7), *row] for i, row in enumerate(ROWS)])))
    same(read, plain)
    assert read.remarks == ("the first column numbers the rows: left out",)


def test_results_of_vins(write, plain):
    rows = euroc_rows(ROWS, more=["0.1", "0.2", "0.3"])
    read = read_euroc(write("".join(",".join(row) + ",\n" for row in rows)))
    same(read, plain)
    assert read.remarks == ("3 columns after the first 8 are not read",)


def test_twenty_columns(write, plain):
    triangles = "0.01 0.002 0.001 0.02 0.003 0.03 1 0.2 0.1 2 0.3 3"
    read = read_tum(write(text([[*row, triangles] for row in ROWS])))
    same(read, plain)
    rotation = np.array([[0.01, 0.002, 0.001], [0.002, 0.02, 0.003], [0.001, 0.003, 0.03]])
    position = np.array([[1, 0.2, 0.1], [0.2, 2, 0.3], [0.1, 0.3, 3]])
    turn = se3.from_position_quaternion(read.positions[7], read.quaternions[7])[:3, :3]
    np.testing.assert_array_equal(read.covariances[7, :3, :3], position)
    np.testing.assert_allclose(read.covariances[7, 3:, 3:], turn @ rotation @ turn.T, atol=1e-12)
    assert "covariances" in read.remarks[0]


@pytest.mark.skipif(not DATA.is_dir(), reason="the real trajectories are not here")
def test_a_real_file_of_twenty_columns():
    read = read_tum(DATA / "rpng_ironsides_01" / "groundtruth.txt")
    assert len(read) > 1000
    np.testing.assert_array_equal(
        np.diagonal(read.covariances[0]), [2.013561, 4.141225, 18.688329, 0, 0, 0]
    )


# -- stamps ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "digits"), [("milliseconds", 3), ("microseconds", 6), ("nanoseconds", 9)]
)
@pytest.mark.parametrize("reader", [read_tum, read_euroc])
def test_the_unit_of_stamps_since_1970_shows(write, plain, unit, digits, reader):
    rows = euroc_rows(ROWS) if reader is read_euroc else ROWS
    stamps = [row[0].replace(".", "")[: 10 + digits] for row in ROWS]
    read = reader(write(text([[s, *row[1:]] for s, row in zip(stamps, rows, strict=True)])))
    same(read, plain)
    format_ = unit == "nanoseconds" and reader is read_euroc
    assert read.remarks == (() if format_ else (f"stamps in {unit}",))


def test_seconds_in_a_file_of_euroc(write, plain):
    rows = [[a[0], *b[1:]] for a, b in zip(ROWS, euroc_rows(ROWS), strict=True)]
    read = read_euroc(write(text(rows, ",")))
    same(read, plain)
    assert read.remarks == ("stamps in seconds",)


def test_time_since_a_start_keeps_the_formats_unit(write):
    # 100 s of whole nanoseconds since the start of a simulation.
    rows = euroc_rows(make(first=100))
    assert read_euroc(write(text(rows, ","))).stamps[0] == 100 * 10**9


# -- how it is packed -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pack", "remark"),
    [
        (lambda data: gzip.compress(data), None),
        (lambda data: gzip.compress(data[:4000]) + gzip.compress(data[4000:]), None),
        (lambda data: data.decode().encode("utf-16"), "encoded in UTF-16"),
        (lambda data: "# Höhe über Grund\n".encode("latin-1") + data, "not UTF-8"),
        (lambda data: data + b"\0" * 512, "512 zero bytes at the end"),
        (lambda data: data + ROWS[-1][0][:12].encode(), "row 201, the last, is cut off"),
        (lambda data: data + b"1403638138.000000000 1.0 -", "row 201, the last, is cut off"),
        (lambda data: data + b"1403638139.000000000 " + b"1.0 " * 6 + b"-", "row 201"),
        (lambda data: data.replace(b"\n", b"\r\n"), None),
    ],
)
def test_packed_encoded_or_cut(write, plain, pack, remark):
    read = read_tum(write(pack(text(ROWS).encode())))
    same(read, plain)
    if remark is None:
        assert read.remarks == ()
    else:
        (said,) = read.remarks
        assert remark in said


def test_a_number_that_is_cut_short(write, plain):
    read = read_tum(write(text(ROWS) + " ".join(ROWS[0])[:-3]))
    same(read, plain)
    assert "is cut off" in read.remarks[0]


def test_a_gzip_file_that_is_cut_off(write, plain):
    packed = gzip.compress(text(ROWS).encode())
    read = read_tum(write(packed[: len(packed) // 2]))
    assert 50 < len(read) < 150
    assert read.stamps.tolist() == plain.stamps[: len(read)].tolist()
    assert "gzip file is cut off" in read.remarks[0]


def test_a_whole_last_row_needs_no_line_end(write, plain):
    read = read_tum(write(text(ROWS).rstrip("\n")))
    same(read, plain)
    assert read.remarks == ()


def test_standard_input(monkeypatch, plain):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text(ROWS).encode())))
    read = read_tum("-")
    same(read, plain)
    assert read.source == "standard input"


def test_quaternions_of_one_norm_are_normalised_and_of_many_are_not(write, plain):
    rows = [[*row[:4], *(repr(2 * float(v)) for v in row[4:])] for row in ROWS]
    read = read_tum(write(text(rows)))
    same(read, plain, norm=1e-8)
    assert read.remarks == ("quaternions of norm 2: normalised",)
    # One that is none stays so, without a warning.
    none = [*rows, [*rows[-1][:4], "0", "0", "0", "0"]]
    none[-1][0] = repr(float(rows[-1][0]) + 0.1)
    assert not read_tum(write(text(none))).quaternions[-1].any()
    for i, row in enumerate(rows[::2]):
        row[4:] = [repr((1 + 0.01 * i) * float(v)) for v in row[4:]]
    assert read_tum(write(text(rows))).remarks == ()
