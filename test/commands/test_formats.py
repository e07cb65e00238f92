# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate`` and ``replay`` where no format is named, and KITTI's files without stamps."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from twins.bags import write_bag

from trajeval_ros import se3
from trajeval_ros.commands import evaluate, inputs, replay
from trajeval_ros.commands.console import CommandError
from trajeval_ros.files.trajectory import Trajectory
from trajeval_ros.files.tum import read_tum


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same 20 s in every format: ``gt.*``, and ``est.*`` with an error of a centimetre."""
    place = tmp_path_factory.mktemp("formats")
    seconds = np.arange(200) / 10.0
    angle = 0.3 * seconds
    poses = se3.exp(
        np.stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle, 0 * angle, angle], axis=1)
    )
    noise = np.random.default_rng(0).normal(size=(len(seconds), 6)) * 0.01
    for name, stack in (("gt", poses), ("est", se3.compose(poses, se3.exp(noise)))):
        position, quaternion = se3.to_position_quaternion(stack)
        rows = np.column_stack((seconds, position, quaternion))
        np.savetxt(place / f"{name}.tum", rows, fmt="%.17g")
        np.savetxt(place / f"{name}.kitti", stack[:, :3].reshape(-1, 12), fmt="%.17g")
        csv = [
            ",".join((str(100_000_000 * i), *map(repr, row[[1, 2, 3, 7, 4, 5, 6]].tolist())))
            for i, row in enumerate(rows)
        ]
        (place / f"{name}.csv").write_text("#stamp,p,q\n" + "\n".join(csv) + "\n")
    return place


def ate(output: Path) -> float:
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    value = summary["conventional"]["ate_translation_rmse"]
    assert isinstance(value, float)
    return value


@pytest.mark.parametrize(
    ("truth", "estimate", "said"),
    [
        ("gt.tum", "est.tum", "read as tum (rows of 8 numbers): "),
        ("gt.csv", "est.tum", "read as euroc (commas, and stamps in nanoseconds): "),
        ("gt.kitti", "est.kitti", "read as kitti (rows of 12 numbers): "),
        ("gt.csv", "est.csv", "read as euroc "),
    ],
)
def test_each_file_is_read_as_what_it_is(
    folder: Path,
    truth: str,
    estimate: str,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    files = [str(folder / truth), str(folder / estimate)]
    # The option may come first.
    assert evaluate.main(["--output", str(tmp_path / "auto"), *files]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"info: {said}")
    assert files[0] in lines[0]
    assert files[1] in lines[0]
    kitti = truth.endswith("kitti")
    assert sum("0.1 s apart" in line for line in lines) == kitti
    named = [str(folder / "gt.tum"), str(folder / "est.tum")]
    assert evaluate.main(["tum", *named, "--output", str(tmp_path / "named")]) == 0
    assert "read as" not in capsys.readouterr().out
    assert ate(tmp_path / "auto") == pytest.approx(ate(tmp_path / "named"), rel=1e-9)


def test_kitti_without_stamps_is_at_ten_hertz(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(folder / "gt.kitti"), str(folder / "est.kitti")]
    assert evaluate.main(["kitti", *files, "--output", str(tmp_path / "without")]) == 0
    assert "info: no --times" in capsys.readouterr().out
    np.savetxt(tmp_path / "times.txt", np.arange(200) / 10.0, fmt="%.17g")
    times = ["--times", str(tmp_path / "times.txt")]
    for command in (["kitti"], []):
        assert evaluate.main([*command, *files, *times, "--output", str(tmp_path / "with")]) == 0
        assert "no --times" not in capsys.readouterr().out
        assert ate(tmp_path / "with") == pytest.approx(ate(tmp_path / "without"), rel=1e-9)


def test_wrong_usage(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth, estimate = str(folder / "gt.tum"), str(folder / "est.tum")
    for arguments, said in (
        (["tmu", truth, estimate], "neither a file nor a format 'tmu'; formats: tum, euroc"),
        ([truth], "name a ground truth and an estimate"),
        ([truth, estimate, "--estimate", "/odom"], "there is no bag"),
    ):
        assert evaluate.main(arguments) == 2
        assert said in capsys.readouterr().err
    assert replay.main([truth]) == 2
    assert "name a ground truth and an estimate" in capsys.readouterr().err
    assert evaluate.main([truth, str(folder / "absent.txt")]) == 1
    assert "absent.txt: it cannot be read" in capsys.readouterr().err


def test_a_bag_is_taken_for_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "recording.data"
    bag.write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    assert evaluate.main([str(bag), "--ground-truth", "/gt", "--estimate", "/odom"]) == 1
    assert str(bag) in capsys.readouterr().err
    other = tmp_path / "gt.txt"
    other.write_text("0.1 0 0 0 0 0 0 1\n")
    assert evaluate.main([str(other), str(bag)]) == 1
    assert f"it is an mcap file: which topic? name bag:{bag}:TOPIC" in capsys.readouterr().err


def read(*arguments: str) -> inputs.Inputs:
    parsed = evaluate.make_parser().parse_args(inputs.with_format(list(map(str, arguments))))
    return inputs.read(inputs.recognised(parsed))


def same(read: Trajectory, expected: Trajectory) -> None:
    np.testing.assert_array_equal(read.stamps, expected.stamps)
    np.testing.assert_allclose(read.positions, expected.positions, rtol=0, atol=1e-9)
    sign = np.sign((read.quaternions * expected.quaternions).sum(axis=1))[:, None]
    np.testing.assert_allclose(sign * read.quaternions, expected.quaternions, rtol=0, atol=1e-9)


@pytest.fixture(scope="module")
def more(folder: Path) -> Path:
    """The estimate in more formats, and its stamps in a file of their own."""
    plain = read_tum(folder / "est.tum")
    poses = se3.from_position_quaternion(plain.positions, plain.quaternions)
    seconds = plain.stamps / 1e9
    np.savetxt(folder / "times.txt", seconds, fmt="%.9f")
    np.savez(folder / "est.npz", poses=poses, timestamps=plain.stamps, intrinsics=np.eye(3))
    np.save(folder / "est.npy", poses)
    np.save(folder / "rows.npy", np.column_stack((seconds, poses.reshape(-1, 16))))
    frames = [
        {"file_path": f"images/{s}.jpg", "transform_matrix": pose.tolist(), "timestamp": s / 1e9}
        for s, pose in zip(plain.stamps.tolist(), poses, strict=True)
    ]
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 500.0, "frames": frames}))
    (folder / "est.tum.gz").write_bytes(gzip.compress((folder / "est.tum").read_bytes()))
    (folder / "utf16.txt").write_text((folder / "est.tum").read_text(), encoding="utf-16")
    return folder


@pytest.mark.parametrize("command", ["", "tum", "euroc", "kitti"])
@pytest.mark.parametrize(
    "name",
    [
        *("tum:est.tum", "euroc:est.csv", "kitti:est.kitti", "kitti:est.kitti:times.txt"),
        *("npz:est.npz", "npz:est.npy:times.txt", "npz:rows.npy", "nerfstudio:transforms.json"),
        "tum:est.tum.gz",
    ],
)
def test_the_format_may_stand_before_the_name(
    command: str, name: str, more: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(more)
    data = read(*[command] * bool(command), "tum:gt.tum", name)
    same(data.estimate, read_tum("est.tum"))
    same(data.ground_truth, read_tum("gt.tum"))


@pytest.mark.parametrize(
    "name", ["est.npz", "rows.npy", "transforms.json", "est.tum.gz", "utf16.txt"]
)
def test_more_is_recognised(name: str, more: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(more)
    same(read("gt.tum", name).estimate, read_tum("est.tum"))


def test_names_of_estimates_are_those_of_their_places() -> None:
    names = ["tum:runs/orb.txt", "bag:run 1.mcap:/vins/odometry", "kitti:sptam.txt:times.txt"]
    assert inputs.names_of(names) == ("orb", "odometry", "sptam")


def test_a_file_and_a_topic_two_bags(more: Path, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="needs the extra bags")
    for name in ("gt", "est"):
        write_bag(tmp_path / f"{name}: one", {f"/{name}": read_tum(more / f"{name}.tum")})
    truth, estimate = (f"bag:{tmp_path}/{name}: one:/{name}" for name in ("gt", "est"))
    for arguments in (
        (truth, estimate),
        (more / "gt.tum", estimate),
        ("tum", truth, more / "est.tum"),
        ("bag", f"{tmp_path}/est: one", "--estimate", "/est", "--ground-truth", truth),
        ("bag", f"{tmp_path}/gt: one", "--estimate", f"tum:{more}/est.tum", "--ground-truth", "gt"),
    ):
        data = read(*arguments)
        same(data.ground_truth, read_tum(more / "gt.tum"))
        same(data.estimate, read_tum(more / "est.tum"))


def test_strict_refuses_what_is_read_differently(
    more: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(more)
    assert read("tum", "gt.tum", "est.tum", "--strict").remarks == ()
    with pytest.raises(CommandError, match=r"--strict: utf16\.txt: encoded in UTF-16"):
        read("tum", "gt.tum", "utf16.txt", "--strict")
    assert read("tum", "gt.tum", "utf16.txt").remarks == ("utf16.txt: encoded in UTF-16",)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("npz:est.npy", "no array of 200 stamps in it; name a file of them: npz:FILE:TIMES"),
        ("npz:est.tum", "it is no file of NumPy's, or damaged"),
        ("npz:absent.npy", "it cannot be read: no such file"),
        ("nerfstudio:est.tum", "it is no transforms.json with frames in it"),
        ("kitti:est.kitti:few.txt", "3 stamps for the 200 poses of est.kitti: there must be one"),
        ("bag:est.tum", "which topic of it? name it as bag:est.tum:TOPIC"),
    ],
)
def test_what_cannot_be_read(
    name: str, said: str, more: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(more)
    Path("few.txt").write_text("0\n1\n2\n")
    with pytest.raises(CommandError) as caught:
        read("tum", "gt.tum", name)
    assert said in str(caught.value)


def test_replay_recognises_too(folder: Path) -> None:
    files = [str(folder / "gt.csv"), str(folder / "est.kitti"), "--rate", "5"]
    arguments = replay.make_parser().parse_args(inputs.with_format(files))
    data = inputs.read(inputs.recognised(arguments))
    assert len(data.ground_truth) == len(data.estimate) == 200
    assert [remark.split(" ", 3)[2] for remark in data.remarks[:1]] == ["euroc"]
